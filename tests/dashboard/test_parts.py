"""The parts of the page's server, each by itself."""

from __future__ import annotations

import asyncio
import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from towtank import load_vehicle
from towtank.app.terminal.page_option import PagedCommand
from towtank.dashboard.access import Access, Address, Refusals
from towtank.dashboard.feed import Link, Now
from towtank.dashboard.motion import COMMANDS, WRENCH, Motion
from towtank.dashboard.prediction import FreeRun, free_run
from towtank.dashboard.pump import Kind, Mailbox, Thinned, decode, encode
from towtank.dashboard.verdict import AxisKnowledge, axes_known, notes, predicted, verdict
from towtank.errors import InputError
from towtank.identification import Learner
from towtank.live.pipeline.instants import Instants, rows_of
from towtank.recording.event import Event
from towtank.simulation import manoeuvre, simulate
from towtank.vehicle import thruster_wrench

HOME = {"host": "127.0.0.1:8765"}


def test_frames_come_out_as_they_went_in() -> None:
    t, values = np.array([1.7e9, 1.7e9 + 0.01]), np.array([[1.5, np.nan, -2.25], [0.5, 8.0, 3.0]])
    kind, sequence, times, found = decode(encode(Kind.SIGNALS, t, values, 2**32 + 7))
    assert (kind, sequence) == (Kind.SIGNALS, 7)
    assert np.array_equal(times, t)
    assert np.array_equal(found, values, equal_nan=True)
    assert decode(encode(Kind.TRACK, np.empty(0), np.empty((0, 3))))[3].shape == (0, 3)
    with pytest.raises(ValueError, match="not a frame"):
        decode(encode(Kind.SIGNALS, t, values)[:-1])


def test_rows_over_hours_are_kept_in_constant_memory() -> None:
    kept = Thinned(1, step=0.25, most=64)
    for k in range(40_000):
        kept.add(0.25 * k, np.array([0.25 * k]))
    assert 32 <= len(kept) <= 64
    assert np.array_equal(kept.t, kept.rows[:, 0])
    assert kept.t[0] == 0.0
    assert kept.t[-1] > 0.97 * 10_000
    steps = np.diff(kept.t)
    assert steps.max() <= 2.0 * steps.min()  # evenly, not crowded at one end


def test_the_course_goes_on_where_the_unknowns_change() -> None:
    kept = Thinned(4, step=0.5, most=64)  # values of two, then their deviations
    for k in range(3):
        kept.add(float(k), np.array([1.0, 2.0, 0.1, 0.2]) + k)
    anew = kept.of_columns(np.array([1, -1, 0, 3, -1, 2]))
    assert anew.t.tolist() == [0.0, 1.0, 2.0]
    assert anew.step == 0.5
    expected = [[2.0 + k, np.nan, 1.0 + k, 0.2 + k, np.nan, 0.1 + k] for k in range(3)]
    np.testing.assert_allclose(anew.rows, expected, rtol=1e-6)
    assert anew.add(3.0, np.zeros(6))
    assert not anew.add(3.2, np.zeros(6))
    assert len(kept) == 3
    assert len(Thinned(0, step=0.25).of_columns(np.array([-1, -1]))) == 0


def test_a_mailbox_is_bounded_and_gives_up_what_is_old() -> None:
    async def look() -> list[str | bytes]:
        box = Mailbox(room=3)
        for k in range(10):
            box.put(bytes([k]))
            box.replace("state", f"state {k}")
        assert len(box) == 4
        assert box.skipped == 7 + 9
        return [await box.next() for _ in range(4)]

    with ThreadPoolExecutor() as aside:  # a browser of other tests has a loop of its own in this thread
        found = aside.submit(lambda: asyncio.run(look())).result()
    assert found == ["state 9", b"\x07", b"\x08", b"\x09"]


def test_motion_joins_what_belongs_to_one_row_and_forgets() -> None:
    vehicle = load_vehicle("seamor")
    commands = np.linspace(10.0, 40.0, len(vehicle.thrusters))
    motion = Motion(vehicle)
    instants = []
    for k in range(10_000):
        instants += [(0.01 * k, {"pose": np.full(6, 0.01 * k)}), (0.01 * k + 0.004, {"commands": commands})]
    for k in range(0, len(instants), 1000):
        motion.add(instants[k : k + 1000])
    t, rows = motion.last(1e9)
    assert t.size <= 6000
    assert np.allclose(np.diff(t), 0.01)
    assert np.array_equal(rows[:, 0], t)
    assert np.allclose(rows[:, COMMANDS:-1], commands)
    assert np.allclose(rows[:, WRENCH], thruster_wrench(vehicle, commands))
    assert np.isnan(rows[:, -1]).all()
    assert motion.last(1.0)[0].size == pytest.approx(100, abs=2)


def test_the_free_run_of_the_true_model_is_the_measurement() -> None:
    vehicle = load_vehicle("seamor")
    plan = manoeuvre("all-multisine", vehicle, duration=12.0, dt=0.01, seed=1)
    run = simulate(vehicle, commands=plan.commands, dt=0.01, seed=1)
    motion, instants = Motion(vehicle), Instants(vehicle)
    arguments = [(t, instants.arguments(dict(zip(names, x, strict=True)))) for t, names, x in rows_of(run)]
    nothing = Learner(vehicle, method="paper").estimate
    motion.add(arguments)
    found = free_run(vehicle, nothing, 0.0, *motion.last(10.0))
    assert found is not None
    assert found.t[-1] - found.t[0] == pytest.approx(10.0, abs=0.1)
    size = np.nanstd(found.measured, axis=0)
    assert np.all(found.rms < 0.02 * size + 1e-4), found.rms / size
    only_pose = Motion(vehicle)
    only_pose.add([(t, {k: v for k, v in a.items() if k in ("pose", "commands")}) for t, a in arguments])
    derived = free_run(vehicle, nothing, 0.0, *only_pose.last(10.0))
    assert derived is not None
    driven = [0, 1, 2, 5]  # roll and pitch of this vehicle are passive, and faster than the slope of 0.4 s tells
    assert np.all(derived.rms[driven] < 0.12 * size[driven]), derived.rms / size
    middle = np.isfinite(derived.measured).all(axis=1)
    away = np.sqrt(np.mean((derived.measured[middle] - found.measured[middle]) ** 2, axis=0))
    assert np.all(away[driven] < 0.05 * size[driven]), away / size
    partly = Motion(vehicle)
    hidden = [0, 1, 3, 4]  # of the pose: depth and heading are left
    for _, each in arguments:
        if "pose" in each:
            each["pose"] = np.where(np.isin(np.arange(6), hidden), np.nan, each["pose"])
    partly.add([(t, {k: v for k, v in a.items() if k in ("pose", "commands")}) for t, a in arguments])
    told = free_run(vehicle, nothing, 0.0, *partly.last(10.0))
    assert told is not None
    assert np.isfinite(told.measured).any(axis=0).tolist() == [False, False, True, False, False, True]
    slope = told.measured[:, 5] - found.measured[:, 5]
    assert np.sqrt(np.nanmean(slope**2)) < 0.1 * size[5]


def test_an_axis_is_known_to_the_worse_of_inertia_and_drag() -> None:
    vehicle = load_vehicle("seamor")
    nothing = axes_known(Learner(vehicle, method="paper").estimate, (0.5,) * 6, ())
    assert all(math.isnan(each.known) for each in nothing)
    known = [AxisKnowledge(name, True, 0.01, 0.02, 0.5, 3.0) for name in ("surge", "sway")]
    assert known[0].known == 0.02
    assert math.isnan(AxisKnowledge("yaw", True, 0.01, math.nan, 0.5, 0.0).known)
    assert math.isnan(AxisKnowledge("yaw", True, math.nan, 0.01, 0.5, 0.0).known)


def test_which_axes_thrusters_drive() -> None:
    estimate = Learner(load_vehicle("blueboat"), method="paper").estimate
    boat = axes_known(estimate, (0.5,) * 6, (), load_vehicle("blueboat"))
    assert [each.axis for each in boat if each.drivable] == ["surge", "yaw"]
    assert all(
        each.drivable for each in axes_known(estimate, (0.5,) * 6, (), load_vehicle("vlbv300")) if each.axis != "pitch"
    )
    assert all(each.drivable for each in axes_known(estimate, (0.5,) * 6, ()))


def a_moment(**settings: Any) -> Now:
    estimate = Learner(load_vehicle("seamor"), method="paper").estimate
    return Now(5.0, 4.0, estimate, math.nan, math.nan, {}, {}, (), **{"samples": 9, "instants": 9, **settings})


def test_without_data_verdict_and_prediction_say_so() -> None:
    links = (Link("udp", 9, {}, {}, silent=12.6), Link("mocap", 9, {}, {}, silent=12.9))
    dead = a_moment(silent=12.6, links=links)
    assert verdict(dead) == "Link lost: no data since 12 s from udp and mocap. All figures are as of then."
    assert predicted(dead, None) == "no data since 12 s"
    never = a_moment(silent=3.2, links=(Link("udp", 0, {}, {}, silent=3.2),), samples=0)
    assert verdict(never) == "Nothing has come yet: no data since 3 s from udp."
    assert verdict(a_moment()) == "Nothing can be said yet of what is learned."
    rms = np.array([0.0123, np.nan, np.nan, np.nan, np.nan, 0.01])
    run = FreeRun(np.arange(2.0), np.zeros((2, 6)), np.zeros((2, 6)), rms, np.zeros(6, dtype=bool))
    assert predicted(a_moment(), run) == "off by u 0.012 m/s; r 0.57 °/s (rms)"


def test_the_verdict_is_the_sessions_own_after_why_nothing_is_learned() -> None:
    said = "Usable for prediction up to 10 s (surge), judged on the last 60 s."
    assert verdict(a_moment(verdict=said)) == said
    halted = a_moment(verdict=said, not_learning="disarmed")
    assert verdict(halted) == f"Not learning: disarmed. {said}"


def test_notes_are_told_once_with_how_often() -> None:
    lost = {"link": "udp", "state": "lost"}
    events = (
        Event(1.0, "mended", "the filter had lost itself"),
        Event(2.0, "link", "udp: link lost, no data from here on", lost),
        Event(9.0, "link", "udp: link back after 7.0 s without data", {**lost, "state": "back"}),
        Event(11.0, "mended", "the filter had lost itself"),
        Event(12.0, "occlusion", "no position for 0.8 s", {"measured": "position"}),
        Event(14.0, "occlusion", "no position for 1.8 s", {"measured": "position"}),
        Event(15.0, "mark", "here"),
        Event(16.0, "change", "net weight +2 N"),
    )
    one = a_moment(events=events, links=(Link("udp", 1, {}, {}, ("3 bad", "3 bad")),))
    assert notes(one) == (
        "the filter had lost itself (2 times)",
        "udp: the link was lost",
        "position not measured for a while (2 times)",
        "3 bad",
    )
    doubted = a_moment(remarks=("the model lacks something",), links=one.links)
    assert notes(doubted) == ("the model lacks something", "3 bad")
    two = a_moment(links=(Link("udp", 1, {}, {}, ("3 bad",)), Link("mocap", 1, {}, {}, ("3 bad",))))
    assert notes(two) == ("udp: 3 bad", "mocap: 3 bad")


def test_a_heading_alone_shows_the_yaw_rate() -> None:
    vehicle = load_vehicle("blueboat")
    plan = manoeuvre("yaw-sine", vehicle, duration=12.0, dt=0.01, seed=1)
    run = simulate(vehicle, commands=plan.commands, dt=0.01, seed=1)
    nothing = Learner(vehicle, method="paper").estimate
    whole, heading = Motion(vehicle), Motion(vehicle)
    for motion, wanted in ((whole, ("r", "cmd_")), (heading, ("psi", "cmd_"))):
        instants = Instants(vehicle)
        rows = [
            (t, {n: v for n, v in zip(names, x, strict=True) if n.startswith(wanted)}) for t, names, x in rows_of(run)
        ]
        motion.add([(t, instants.arguments(row)) for t, row in rows])
    measured, derived = (free_run(vehicle, nothing, 0.0, *motion.last(10.0)) for motion in (whole, heading))
    assert measured is not None
    assert derived is not None
    assert measured.derived.tolist() == [False] * 6
    assert derived.derived.tolist() == [False] * 5 + [True]
    assert np.isnan(derived.measured[:, :5]).all()
    seen = np.isfinite(derived.measured[:, 5])
    away = derived.measured[seen, 5] - measured.measured[seen, 5]
    assert np.sqrt(np.mean(away**2)) < 0.02 * np.nanstd(measured.measured[:, 5])


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("127.0.0.1:8765", "127.0.0.1", 8765),
        (":9000", "127.0.0.1", 9000),
        ("boat.local", "boat.local", 8765),
        ("[::1]:9000", "::1", 9000),
        ("0.0.0.0:0", "0.0.0.0", 0),
    ],
)
def test_addresses(text: str, host: str, port: int) -> None:
    assert Address.parse(text) == Address(host, port)


@pytest.mark.parametrize("text", ["127.0.0.1:http", "a b:1", "x:99999", "http://x:1"])
def test_no_addresses(text: str) -> None:
    with pytest.raises(InputError, match="--page: found"):
        Address.parse(text)


def test_only_our_own_names_are_served() -> None:
    local = Access(Address("127.0.0.1", 8765), "secret")
    for host in ("127.0.0.1:8765", "localhost:8765", "LOCALHOST:8765"):
        assert local.host({"host": host}), host
    for host in ("evil.example:8765", "127.0.0.1", "127.0.0.1:80", "192.168.1.9:8765", "", "127.0.0.1:8765.evil"):
        assert not local.host({"host": host}), host
    boat = Access(Address("0.0.0.0", 8765), "secret")
    assert boat.host({"host": "192.168.2.1:8765"})
    assert not boat.host({"host": "rebound.example:8765"})


def test_who_may_steer() -> None:
    access = Access(Address("127.0.0.1", 8765), "secret")
    cookie = {access.cookie: "secret"}
    ours = {**HOME, "origin": "http://127.0.0.1:8765"}
    assert access.may_look(HOME, {})
    assert access.may_steer(ours, cookie)
    assert access.may_steer({**HOME, "authorization": "Bearer secret"}, {})
    assert not access.may_steer(HOME, cookie)  # no origin: a cookie alone does not count
    assert not access.may_steer(ours, {})
    assert not access.may_steer(ours, {access.cookie: "secre"})
    assert not access.may_steer({**HOME, "origin": "http://evil.example"}, cookie)
    assert not access.may_steer({**HOME, "origin": "null"}, cookie)
    assert not access.may_steer({**HOME, "sec-fetch-site": "cross-site"}, cookie)
    boat = Access(Address("192.168.2.1", 8765), "secret")
    assert not boat.may_look({"host": "192.168.2.1:8765"}, {})
    assert boat.may_look({"host": "192.168.2.1:8765"}, {boat.cookie: "secret"})


def test_refusals_are_told_once_for_each_peer() -> None:
    told: list[str] = []
    refusals = Refusals(told.append)
    for _ in range(1000):
        refusals.add("10.0.0.1", "a wrong token")
    refusals.add("10.0.0.2", "a wrong token")
    assert refusals.total == 1001
    assert len(told) == 2
    for k in range(1000):
        refusals.add(f"10.0.1.{k}", "a wrong token")
    assert len(told) <= 256  # nobody fills a log


@pytest.mark.parametrize(
    ("words", "page", "sources"),
    [
        (["--page"], "127.0.0.1:8765", []),
        (["--page", "127.0.0.1:9000", "a"], "127.0.0.1:9000", ["a"]),
        (["--page", ":9000"], ":9000", []),
        (["--page", "[::1]:9000"], "[::1]:9000", []),
        (["--page", "udpin:0.0.0.0:14550"], "127.0.0.1:8765", ["udpin:0.0.0.0:14550"]),
        (["--page", "ros2:7", "--json"], "127.0.0.1:8765", ["ros2:7"]),
        (["--page=boat:9000"], "boat:9000", []),
        (["a"], None, ["a"]),
    ],
)
def test_the_option_may_stand_alone(words: list[str], page: str | None, sources: list[str]) -> None:
    import typer
    from typer.testing import CliRunner

    found: list[object] = []
    app = typer.Typer()

    def command(
        source: list[str] | None = typer.Argument(None),  # noqa: B008
        page: str | None = typer.Option(None, "--page"),
        json: bool = typer.Option(False, "--json"),
    ) -> None:
        found.extend((page, list(source or [])))

    app.command(cls=PagedCommand)(command)
    assert CliRunner().invoke(app, words).exit_code == 0
    assert found == [page, sources]
