"""The coach: movements of the sticks, a count-down, what was driven, and what comes after."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest

from towtank import load_vehicle
from towtank.core.arrays import Array
from towtank.planning import Segment, Space
from towtank.planning.coach import Coach, Next, Stage, deflection, movements, next_segment, offset_text
from towtank.planning.segments import commands_of, full_wrench
from towtank.planning.space import radius_of
from towtank.vehicle import Vehicle, allocate, thruster_wrench

SURGE = Segment("telegraph", 6.0, (0,), (30.0,), ((2.0, 4.5),), ((1.0,),))
BOTH = Segment("telegraph", 8.0, (0, 5), (20.0, 3.0), ((3.0,), (2.0, 6.0)), ((-1.0,), (1.0,)))
PERIOD = 0.1  # s


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("bluerov2_heavy")


class Pilot:
    """Drives what he is shown so many seconds ago, by so much more or less."""

    def __init__(self, vehicle: Vehicle, coach: Coach, *, late: float = 0.0, share: float = 1.0) -> None:
        self.vehicle, self.coach, self.late, self.share = vehicle, coach, late, share
        self.t, self.happened = 0.0, [""]
        self.shown = [(0.0, np.zeros(6))]
        self.commands = cache(lambda wrench: allocate(vehicle, np.array(wrench)))

    def asked(self) -> Array:
        wrench, view = np.zeros(6), self.coach.view(self.t)
        for row in range(6):
            now, _ = view.now_and_next(row)
            wrench[row] = 0.0 if now is None else now.force
        return wrench

    def go(self, seconds: float, *, sticks: Array | None = None, able: str = "") -> None:
        for _ in range(round(seconds / PERIOD)):
            self.t += PERIOD
            self.shown.append((self.t, self.asked()))
            wrench = next(w for at, w in reversed(self.shown) if at <= max(self.t - self.late, 0.0) + 1e-9)
            wrench = self.share * wrench if sticks is None else sticks
            self.coach.see(self.t, {"commands": self.commands(tuple(wrench.tolist()))})
            text = self.coach.tick(self.t, able)
            if text:
                self.happened.append(text)

    @property
    def stage(self) -> Stage:
        return self.coach.view(self.t).stage


def test_movements_say_which_way_how_far_and_how_long(vehicle: Vehicle) -> None:
    found = movements(SURGE, vehicle)
    assert [(each.start, each.end) for each in found] == [(0.0, 2.0), (2.0, 4.52), (4.52, 6.0)]  # at 25 Hz
    assert [each.force for each in found] == [30.0, -30.0, 30.0]
    assert [each.text.split()[0] for each in found] == ["forward", "back", "forward"]
    share = 100.0 * abs(deflection(vehicle, 0, 30.0))
    assert found[0].text == f"forward {share:.0f} %"


def test_movements_drive_what_the_segment_asks(vehicle: Vehicle) -> None:
    wrench = np.zeros((200, 6))
    for each in movements(BOTH, vehicle):
        wrench[round(each.start * 25) : round(each.end * 25), each.row] = each.force
    np.testing.assert_allclose(
        thruster_wrench(vehicle, allocate(vehicle, wrench)),
        thruster_wrench(vehicle, commands_of(BOTH, vehicle)),
        atol=1e-9,
    )


def test_the_full_stick_is_where_a_thruster_is_at_its_limit(vehicle: Vehicle) -> None:
    assert deflection(vehicle, 0, 0.0) == 0.0
    assert deflection(vehicle, 0, 1e5) == 1.0
    assert deflection(vehicle, 5, -1e5) == -1.0
    shares = [deflection(vehicle, 0, force) for force in (10.0, 30.0, 60.0)]
    assert shares == sorted(shares)
    assert 0.0 < shares[0] < 1.0


def test_it_begins_once_the_sticks_are_still_and_counts_down(vehicle: Vehicle) -> None:
    pilot = Pilot(vehicle, Coach(vehicle, ("X_udot", "X_uu"), 0.05, (SURGE,)))
    pilot.go(2.0, sticks=np.array([15.0, 0, 0, 0, 0, 0]))
    moving = np.zeros(6)
    for k in range(20):
        moving[0] = 40.0 * (-1) ** k
        pilot.go(0.2, sticks=moving.copy())
    assert pilot.stage is Stage.BRING
    pilot.go(3.5, sticks=np.zeros(6))
    assert pilot.stage is Stage.COUNT
    assert pilot.coach.view(pilot.t).text.startswith("Segment 1 begins in ")
    pilot.go(0.5, sticks=moving)  # the pilot is not ready after all
    assert pilot.stage is Stage.BRING
    pilot.go(4.0, sticks=np.zeros(6))
    assert pilot.stage is Stage.COUNT
    pilot.go(5.0)
    assert pilot.stage is Stage.DRIVE
    assert pilot.happened[-1] == "segment 1 begins"


def test_it_shows_now_and_next(vehicle: Vehicle) -> None:
    coach = Coach(vehicle, ("X_udot",), 0.05, (BOTH,))
    pilot = Pilot(vehicle, coach)
    pilot.go(3.5)
    pilot.go(6.0)
    view = coach.view(pilot.t)
    assert view.stage is Stage.DRIVE
    now, following = view.now_and_next(5)
    assert now is not None
    assert following is not None
    assert now.start <= view.clock < now.end == following.start
    assert view.now_and_next(1) == (None, None)
    assert view.text.startswith("Drive segment 1: ")


@pytest.mark.parametrize(("late", "share"), [(0.0, 1.0), (0.4, 1.2), (0.4, 0.8), (0.0, 0.55)])
def test_late_and_weak_is_done_all_the_same(vehicle: Vehicle, late: float, share: float) -> None:
    coach = Coach(vehicle, ("X_udot",), 0.05, (SURGE,))
    pilot = Pilot(vehicle, coach, late=late, share=share)
    pilot.go(17.0)
    assert pilot.stage is Stage.THINK
    view = coach.view(pilot.t)
    assert pilot.happened[-1] == "segment 1 driven: 3 of 3 movements done"
    for k, done in enumerate(view.done):
        assert done == pytest.approx(share, abs=0.1), k  # the pilot acts ten times a second
    assert view.seconds == pytest.approx(6.0, abs=0.01)


def test_what_was_not_driven_is_not_done(vehicle: Vehicle) -> None:
    coach = Coach(vehicle, ("X_udot",), 0.05, (SURGE,))
    pilot = Pilot(vehicle, coach, share=0.1)
    pilot.go(17.0)
    assert pilot.happened[-1] == "segment 1 driven: 0 of 3 movements done"
    coach = Coach(vehicle, ("X_udot",), 0.05, (SURGE,))
    pilot = Pilot(vehicle, coach, share=-1.0)  # the wrong way
    pilot.go(17.0)
    assert pilot.happened[-1] == "segment 1 driven: 0 of 3 movements done"
    assert coach.view(pilot.t).done == (0.0, 0.0, 0.0)


def test_a_segment_ends_where_nothing_can_be_driven(vehicle: Vehicle) -> None:
    coach = Coach(vehicle, ("X_udot",), 0.05, (SURGE,))
    pilot = Pilot(vehicle, coach)
    pilot.go(5.0, able="disarmed")
    assert pilot.stage is Stage.BRING
    assert coach.view(pilot.t).text == "Waiting: disarmed."
    pilot.go(8.5)
    assert pilot.stage is Stage.DRIVE
    pilot.go(0.2, able="disarmed")
    assert pilot.stage is Stage.THINK
    assert pilot.happened[-1] == "segment 1 broken off: disarmed"


def test_the_pilot_may_hold_begin_and_go_on(vehicle: Vehicle) -> None:
    coach = Coach(vehicle, ("X_udot",), 0.05, (SURGE,), waits=True)
    pilot = Pilot(vehicle, coach)
    pilot.go(6.0)
    assert pilot.stage is Stage.BRING  # it waits
    assert coach.ask("hold")
    assert not coach.ask("hold")
    assert pilot.stage is Stage.HELD
    assert coach.ask("on")
    assert coach.ask("begin")
    pilot.go(0.2)
    assert pilot.stage is Stage.COUNT
    pilot.go(6.0)
    assert pilot.stage is Stage.DRIVE
    assert not coach.ask("begin")
    assert coach.ask("hold")
    assert pilot.stage is Stage.THINK
    assert not coach.ask("dance")


def test_what_comes_next_is_taken_or_what_was_foreseen(vehicle: Vehicle) -> None:
    coach = Coach(vehicle, ("X_udot", "X_uu"), 0.05, (SURGE, BOTH))
    pilot = Pilot(vehicle, coach)
    pilot.go(16.5)
    assert coach.thinks
    assert coach.offer(None) == ""  # nobody can say better
    assert coach.view(pilot.t).movements == movements(BOTH, vehicle)
    pilot.go(19.0)
    assert coach.thinks
    assert coach.offer(Next({"X_udot": 0.03, "X_uu": 0.2}, ("X_uu",), SURGE, 1)) == ""
    view = coach.view(pilot.t)
    assert (view.stage, view.number, view.planned) == (Stage.BRING, 3, 4)
    assert [each.met for each in view.known] == [True, False]
    pilot.go(8.5)
    assert coach.offer(Next({}, (), None)) == ""  # while one is driven nothing is taken
    assert pilot.stage is Stage.DRIVE
    pilot.go(8.0)
    assert coach.offer(Next({"X_udot": 0.03, "X_uu": 0.04}, ())) == "All 2 coefficients are known to 5 %."
    assert pilot.stage is Stage.MET


def test_it_says_when_more_would_hardly_help(vehicle: Vehicle) -> None:
    coach = Coach(vehicle, ("X_udot", "X_uu"), 0.05)
    assert coach.thinks
    text = coach.offer(Next({"X_udot": 0.01, "X_uu": 0.2}, ("X_uu",)))
    assert text == "More driving would hardly tell more of X_uu."
    assert coach.offer(Next({"X_udot": 0.01, "X_uu": 0.2}, ("X_uu",))) == ""  # said once


def test_the_way_back_is_told_in_the_body_s_own_directions(vehicle: Vehicle) -> None:
    coach = Coach(vehicle, ("X_udot",), 0.05, (SURGE,))
    coach.see(0.0, {"pose": np.array([1.0, 2.0, 1.0, 0, 0, 0])})
    coach.see(0.1, {"commands": np.array([t.curve.rest for t in vehicle.thrusters])})
    assert coach.view(0.1).offset == ()  # no start yet
    coach.ask("begin")
    coach.tick(0.2)
    coach.tick(5.3)
    coach.see(5.4, {"pose": np.array([1.0, 4.0, 0.5, np.nan, 0, 0.5 * math.pi])})  # 2 m east, heading east
    np.testing.assert_allclose(coach.view(5.4).offset, (-2.0, 0.0, 0.5), atol=1e-12)
    assert offset_text(coach.view(5.4).offset) == "2.0 m back, 0.5 m down"
    assert offset_text((0.0, -0.3, -0.2)) == "0.3 m left, 0.2 m up"
    assert offset_text((0.01, 0.02, 0.0)) == "at the start"


def test_the_next_segment_is_for_what_is_not_known_yet(vehicle: Vehicle) -> None:
    """A file that knows all but surge asks for surge; one that knows all asks for nothing."""
    found = next_segment(vehicle, ("X_udot", "X_uu", "N_rr"), 0.05, sensors="pose")
    assert found.unmet == ("X_udot", "X_uu", "N_rr")
    assert found.segment is not None
    assert set(found.shares) == set(found.unmet)
    full = full_wrench(vehicle)
    assert all(a <= 1.5 * full[row] for a, row in zip(found.segment.amplitude, found.segment.rows, strict=True))
    easy = next_segment(vehicle, ("X_udot", "X_uu", "N_rr"), 0.9, sensors="pose")
    assert easy.segment is None
    assert easy.unmet == ()


@pytest.mark.parametrize("psi", [0.0, 2.0])
def test_a_segment_ends_where_a_wall_is_near(vehicle: Vehicle, psi: float) -> None:
    """In the tank's own directions, wherever the poses are measured from."""
    coach = Coach(vehicle, ("X_udot",), 0.05, (SURGE,), space=Space.from_text("4x3x3"))
    rest = np.array([each.curve.rest for each in vehicle.thrusters])
    ahead, began = np.array([math.cos(psi), math.sin(psi), 0.0]), np.array([10.0, -3.0, 1.0])

    def pose(t: float) -> Array:
        return np.concatenate([began + 0.5 * max(t - 6.0, 0.0) * ahead, [0.0, 0.0, psi]])

    coach.see(0.0, {"pose": pose(0.0), "commands": rest})
    coach.ask("begin")
    happened = ""
    for t in np.arange(0.5, 12.0, 0.1):
        coach.see(float(t), {"pose": pose(float(t)), "commands": rest})
        happened = coach.tick(float(t)) or happened
        if coach.thinks:
            break
    assert happened == "segment 1 broken off: a wall is near"
    gone = 0.5 * (float(t) - 6.0)
    assert 2.0 - radius_of(vehicle) - 0.2 - gone == pytest.approx(0.5, abs=0.06)  # a second at 0.5 m/s


def test_what_is_shown_is_plain(vehicle: Vehicle) -> None:
    """The page's document is JSON, which knows no numbers of NumPy."""
    coach = Coach(vehicle, ("X_udot",), 0.05, (SURGE,))
    coach.learn({"X_udot": np.float64(0.01)})
    (known,) = coach.view(0.0).known
    assert type(known.met) is bool
    assert type(known.share) is float
