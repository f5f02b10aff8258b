"""When thrust may be sent: what begins it, what stops it, how soon, and that nothing follows a stop."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from towtank.live.driving.interlock import PERIOD, STALE, Interlock, Limits, Order, Seen, Send, Stage

WITHIN = 0.3  # s from what goes wrong to the last command that is not neutral
FULL = np.array([1.0, 0.0, -0.5, 0.0, 0.2, 0.0])


def well(t: float, **changes: Any) -> Seen:
    """Everything as it should be, the key held since long ago."""
    seen = Seen(t, pose=t, link=t, beat=t, outputs=t, key=t, pressed=0.0, armed=True, manual=True, sticks=FULL)
    return replace(seen, **changes)


def ready(*, overrides: bool = False, limits: Limits | None = None) -> Interlock:
    interlock = Interlock(limits or Limits(), overrides=overrides)
    assert interlock.switch(True, well(0.0)) == ""
    return interlock


def driving(*, overrides: bool = False, limits: Limits | None = None) -> Interlock:
    interlock = ready(overrides=overrides, limits=limits)
    assert interlock.step(well(PERIOD, pressed=PERIOD)).send is Send.STICKS
    return interlock


def steps(interlock: Interlock, first: int, count: int, **changes: Any) -> list[Order]:
    return [interlock.step(well(PERIOD * k, **changes)) for k in range(first, first + count)]


def kinds(orders: list[Order]) -> list[Send]:
    return [each.send for each in orders]


def test_nothing_is_sent_before_somebody_switches_on() -> None:
    interlock = Interlock(Limits())
    assert set(kinds(steps(interlock, 1, 100))) == {Send.NOTHING}


def test_switched_on_nothing_is_sent_until_the_key_is_pressed_and_a_segment_is_under_way() -> None:
    interlock = ready()
    assert set(kinds(steps(interlock, 1, 20, key=-math.inf))) == {Send.NOTHING}
    assert set(kinds(steps(interlock, 21, 20, pressed=0.4, sticks=None))) == {Send.NOTHING}
    assert kinds(steps(interlock, 41, 1, pressed=0.4)) == [Send.STICKS]


def test_a_key_that_was_down_before_the_switch_begins_nothing() -> None:
    interlock = ready()
    assert set(kinds(steps(interlock, 1, 20, pressed=-1.0))) == {Send.NOTHING}


@pytest.mark.parametrize(
    ("missing", "said"),
    [
        ({"pose": -1.0}, "no pose comes"),
        ({"link": -1.0}, "nothing comes from the autopilot"),
        ({"beat": -9.0}, "no heartbeat comes from the autopilot"),
        ({"outputs": -1.0}, "the autopilot does not tell its outputs"),
        ({"fault": "the vehicle is at a wall"}, "the vehicle is at a wall"),
        ({"pose": math.nan}, "no pose comes"),
    ],
)
def test_it_cannot_be_switched_on_without_what_thrust_needs(missing: dict[str, Any], said: str) -> None:
    interlock = Interlock(Limits())
    assert interlock.switch(True, well(0.0, **missing)) == said
    assert interlock.stage is Stage.OFF


def test_it_can_be_switched_on_before_the_vehicle_is_armed_but_drives_only_afterwards() -> None:
    interlock = Interlock(Limits())
    assert interlock.switch(True, well(0.0, armed=False)) == ""
    assert set(kinds(steps(interlock, 1, 20, armed=False, pressed=0.1))) == {Send.NOTHING}
    assert kinds(steps(interlock, 21, 1, pressed=0.1)) == [Send.STICKS]


@pytest.mark.parametrize("overrides", [False, True])
def test_a_stop_is_some_neutral_commands_and_then_nothing(overrides: bool) -> None:
    interlock = driving(overrides=overrides)
    found = kinds(steps(interlock, 2, 50, key=-1.0))
    assert found[:10] == [Send.NEUTRAL] * 10
    assert found[10:13] == [Send.RELEASE if overrides else Send.NOTHING] * 3
    assert set(found[13:]) == {Send.NOTHING}
    assert (interlock.stage, interlock.why, interlock.stops) == (Stage.OFF, "the key was let go", 1)


def test_after_the_end_of_a_segment_the_next_needs_a_new_press_of_the_key() -> None:
    interlock = driving()
    assert kinds(steps(interlock, 2, 10, sticks=None)) == [Send.NEUTRAL] * 10
    assert (interlock.stage, interlock.stops) == (Stage.READY, 0)
    assert set(kinds(steps(interlock, 12, 20, pressed=PERIOD))) == {Send.NOTHING}
    assert kinds(steps(interlock, 32, 1, pressed=0.5)) == [Send.STICKS]


def test_sticks_never_exceed_the_limit_and_no_run_lasts_longer_than_allowed() -> None:
    interlock = driving(limits=Limits(amplitude=0.4, duration=1.0))
    orders = steps(interlock, 2, 60)
    sticks = [each.sticks for each in orders if each.send is Send.STICKS and each.sticks is not None]
    assert len(sticks) == pytest.approx(49, abs=1)
    assert np.abs(sticks).max() == 0.4
    assert "as long as is allowed" in interlock.why


def test_a_command_that_is_no_number_is_not_sent() -> None:
    interlock = driving()
    assert kinds(steps(interlock, 2, 1, sticks=FULL * math.nan)) == [Send.NEUTRAL]


def test_switched_off_while_it_stops_it_stays_off() -> None:
    interlock = driving()
    steps(interlock, 2, 3, sticks=None)
    interlock.switch(False, well(0.1))
    steps(interlock, 5, 20)
    assert interlock.stage is Stage.OFF


@dataclass(frozen=True)
class Befalls:
    """A fault: what it is, after how many steps, and for how many."""

    kind: str
    after: int
    lasts: int


KINDS = ("pose", "link", "beat", "outputs", "key", "armed", "manual", "fault", "off", "stall", "back", "nan", "sticks")


def seen_at(t: float, since: float, fault: Befalls) -> Seen:
    """What is known at time t with a fault that began at `since`."""
    if fault.kind in ("pose", "link", "outputs", "key"):
        return well(t, pressed=0.01, **{fault.kind: since})
    if fault.kind == "beat":
        return well(t, pressed=0.01, beat=since - 2.4)  # the last one came long before
    if fault.kind in ("armed", "manual"):
        return well(t, pressed=0.01, **{fault.kind: False})
    if fault.kind == "fault":
        return well(t, pressed=0.01, fault="the pose jumped by 1.0 m")
    if fault.kind == "nan":
        return well(t, pressed=0.01, pose=math.nan)
    if fault.kind == "sticks":
        return well(t, pressed=0.01, sticks=np.full(6, math.inf * 0.0))
    if fault.kind == "back":
        return well(t - 3.0, pressed=0.01)
    return well(t, pressed=0.01)


@settings(max_examples=1000, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    fault=st.builds(Befalls, st.sampled_from(KINDS), st.integers(1, 100), st.integers(15, 60)),
    jitter=st.lists(st.floats(-0.008, 0.03), min_size=16, max_size=16),
    overrides=st.booleans(),
)
def test_of_a_thousand_faults_each_stops_thrust_in_time_and_no_command_follows(
    fault: Befalls, jitter: list[float], overrides: bool
) -> None:
    interlock = ready(overrides=overrides)
    orders: list[tuple[float, Order]] = []
    t, since = 0.0, math.inf
    for k in range(160):
        t += PERIOD + jitter[k % len(jitter)] + (0.5 if fault.kind == "stall" and k == fault.after else 0.0)
        wrong = fault.after <= k < fault.after + fault.lasts
        since = t - PERIOD if wrong and since == math.inf else since
        seen = seen_at(t, since, fault) if wrong and fault.kind not in ("off", "stall") else well(t, pressed=0.01)
        if fault.kind == "off" and k == fault.after:
            interlock.switch(False, seen)
        orders.append((t, interlock.step(seen)))
    assert orders[fault.after - 1][1].send is Send.STICKS
    thrust = [at for at, order in orders if order.send is Send.STICKS]
    assert max(thrust) - since <= WITHIN
    first = next(k for k, (at, order) in enumerate(orders) if at > max(thrust) and order.send is Send.NEUTRAL)
    assert orders[first - 1][1].send is Send.STICKS  # at once
    rest = kinds([order for _, order in orders[first:]])
    assert rest == [Send.NEUTRAL] * 10 + [Send.RELEASE] * (3 * overrides) + [Send.NOTHING] * (
        len(rest) - 10 - 3 * overrides
    )
    assert interlock.stage is Stage.OFF
    assert interlock.stops == 1


def test_what_is_lost_is_lost_soon_enough_for_thrust_to_end_in_time() -> None:
    assert STALE + 2.0 * PERIOD < WITHIN


def test_ready_it_says_what_it_waits_for() -> None:
    interlock = ready()
    steps(interlock, 1, 3, armed=False, sticks=np.zeros(6))
    assert (interlock.stage, interlock.why) == (Stage.READY, "the vehicle is disarmed")
    steps(interlock, 4, 1)
    assert interlock.why == ""


def test_a_fault_of_the_program_stops_as_any_other() -> None:
    interlock = driving()
    interlock.fail("the drive has failed")
    orders = steps(interlock, 10, 15, sticks=np.ones(6))
    assert set(kinds(orders[:10])) == {Send.NEUTRAL}
    assert set(kinds(orders[10:])) == {Send.NOTHING}
    assert (interlock.stage, interlock.why) == (Stage.OFF, "the drive has failed")
