"""What counts of a recording: each reason found where it is, and nothing of a run that has none."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from towtank.core.attitude import quaternions_from_eulers
from towtank.errors import InputError
from towtank.readers import read
from towtank.recording import Channel, Recording, load_mapping
from towtank.recording.grids.free_motion import DEPTH_BELOW_SURFACE, FreeMotion, free_motion, free_parts, mode_names
from towtank.simulation import MANOEUVRES, manoeuvre, simulate
from towtank.vehicle import load_vehicle

SECONDS, RATE = 100.0, 20.0
T = np.arange(round(SECONDS * RATE) + 1) / RATE
ROV = load_vehicle("bluerov2")
BOAT = load_vehicle("blueboat")


def dive(states: dict[str, tuple[list[float], list[float]]] | None = None, **columns: np.ndarray) -> Recording:
    """A run under water, level, with commands at 20 Hz; columns take the place of its own."""
    own = {"z": np.full(T.size, 3.0), "phi": 0.1 * np.sin(T), "theta": 0.1 * np.cos(T), "r": np.sin(T)}
    run = Recording.from_table(T, {**own, "cmd_1": 1500.0 + 100.0 * np.sign(np.sin(T)), **columns}, source="dive")
    channels = [Channel(name, *pair, "1") for name, pair in (states or {}).items()]
    run = run.replace(channels)
    return Recording(run.channels, run.source, attributes=dict([DEPTH_BELOW_SURFACE]))


def between(start: float, end: float, inside: float, outside: float) -> np.ndarray:
    return np.where((start <= T) & (end > T), inside, outside)


def cuts(found: FreeMotion) -> list[tuple[str, float, float]]:
    return [
        (each.kind, pytest.approx(each.start, abs=0.11), pytest.approx(each.end, abs=0.11)) for each in found.left_out
    ]


def test_a_run_under_water_counts_whole() -> None:
    assert free_motion(dive(), ROV) == FreeMotion(((0.0, SECONDS),), ())


def test_disarmed() -> None:
    found = free_motion(dive({"armed": ([0.0, 41.0, 90.0], [0.0, 1.0, 0.0])}), ROV)
    assert cuts(found) == [("disarmed", 0.0, 41.0), ("disarmed", 90.0, 100.0)]
    assert found.kept == ((41.0, 90.0),)
    assert [each.text for each in found.left_out] == ["0 to 41 s: disarmed", "90 to 100 s: disarmed"]


def test_armed_all_along_or_unknown() -> None:
    assert not free_motion(dive({"armed": ([0.0], [1.0])}), ROV).left_out
    assert not free_motion(dive({"mode": ([0.0], [9.0])}), ROV).left_out  # a number without a name


@pytest.mark.parametrize(
    ("name", "cut"),
    [("SURFACE", True), ("MOTOR_DETECT", True), ("GUIDED", False), ("AUTO", False), ("ALT_HOLD", False)],
)
def test_modes_whose_outputs_are_no_commands_or_that_come_up(name: str, cut: bool) -> None:
    """In other modes the outputs are known whoever gives them: they count."""
    run = dive({"mode": ([0.0, 50.0, 70.0], [19.0, 7.0, 19.0])})
    run = Recording(run.channels, attributes={"modes": f"7 {name}, 19 MANUAL"})
    assert mode_names(run) == {7: name, 19: "MANUAL"}
    found = free_motion(run, ROV)
    assert cuts(found) == ([("mode", 50.0, 70.0)] if cut else [])
    assert all(name in each.reason for each in found.left_out)


def test_before_the_first_and_after_the_last_command() -> None:
    run = dive().without("cmd_1")
    t = np.arange(10.0, 80.0, 0.2)
    run = run.replace([*Recording.from_table(t, {"cmd_1": 1500.0 + 100.0 * np.sin(t)}).channels.values()])
    found = free_motion(run, ROV)
    assert cuts(found) == [("no commands", 0.0, 10.0), ("no commands", 80.0, 100.0)]
    assert [each.reason for each in found.left_out] == ["before the first command", "after the last command"]


def test_commands_that_fall_silent_in_between() -> None:
    t = T[(T < 30.0) | (T >= 45.0)]
    run = dive().without("cmd_1").replace(Recording.from_table(t, {"cmd_1": np.sin(t)}).channels)
    assert cuts(free_motion(run, ROV)) == [("no commands", 30.0, 45.0)]


def test_commands_recorded_as_they_change_fall_never_silent() -> None:
    changing = np.cumsum(np.tile([0.2, 3.0, 0.4, 5.0], 8)) - 0.2
    for t in (np.array([0.0, 5.0, 10.0]), changing):
        run = dive().without("cmd_1").replace(Recording.from_table(t, {"cmd_1": np.sin(t)}).channels)
        assert not free_motion(run, ROV).left_out


def surfacing(depth: float = 3.0) -> Recording:
    z = np.where((T >= 20.0) & (T < 30.0), 0.02 + 0.02 * np.sin(9.0 * T), depth)
    z = np.where((T >= 60.0) & (T < 60.3), -0.3, z)  # a spike
    return dive(z=z)


def test_at_the_surface() -> None:
    found = free_motion(surfacing(), ROV)
    assert cuts(found) == [("surface", 20.0, 30.0)]
    assert np.allclose(found.kept, ((0.0, 20.0), (30.0, 100.0)))


def test_waves_at_the_surface_are_one_surfacing() -> None:
    z = between(20.0, 30.0, 1.0, 3.0) * np.where((T >= 20.0) & (T < 30.0), 0.06 + 0.06 * np.sin(4.0 * T), 1.0)
    assert cuts(free_motion(dive(z=z), ROV)) == [("surface", 20.0, pytest.approx(30.0, abs=1.0))]


def test_a_boat_is_always_at_the_surface() -> None:
    """What no thruster drives down, and does not go deeper, swims there; one that goes deeper dives all the same."""
    flat = dive(z=np.full(T.size, 0.01))
    assert not free_motion(flat, BOAT).left_out
    assert not free_motion(flat).left_out
    assert cuts(free_motion(flat, ROV)) == [("surface", 0.0, 100.0)]
    assert cuts(free_motion(surfacing(), BOAT)) == [("surface", 20.0, 30.0)]


def test_a_depth_that_is_not_from_the_surface_tells_nothing() -> None:
    run = surfacing()
    assert not free_motion(Recording(run.channels), ROV).left_out


def test_on_the_bottom() -> None:
    run = dive({"bottomed": ([0.0, 12.0, 30.0], [0.0, 1.0, 0.0])})
    assert cuts(free_motion(run, ROV)) == [("bottom", 12.0, 30.0)]


def as_quaternions(run: Recording) -> Recording:
    q = quaternions_from_eulers(np.column_stack([run["phi"].values, run["theta"].values, 0.3 * T]))
    columns = dict(zip(("qw", "qx", "qy", "qz"), q.T, strict=True))
    return run.without("phi", "theta").replace(Recording.from_table(T, columns).channels)


def as_forces(run: Recording) -> Recording:
    phi, theta = run["phi"].values, run["theta"].values
    down = np.column_stack([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
    force = dict(zip(("ax", "ay", "az"), -9.8 * down.T, strict=True))
    return run.without("phi", "theta").replace(Recording.from_table(T, force).channels)


@pytest.mark.parametrize("told", [lambda run: run, as_quaternions, as_forces], ids=["angles", "quaternion", "force"])
def test_upside_down(told: Callable[[Recording], Recording]) -> None:
    found = free_motion(told(dive(phi=between(40.0, 55.0, 3.0, 0.1))), ROV)
    assert [each.kind for each in found.left_out] == ["upside down"]
    assert found.left_out[0].start == pytest.approx(40.0, abs=0.6)
    assert found.left_out[0].end == pytest.approx(55.0, abs=0.6)


@pytest.mark.parametrize("told", [lambda run: run, as_quaternions, as_forces], ids=["angles", "quaternion", "force"])
def test_pitching_to_the_vertical_and_tumbling_count(told: Callable[[Recording], Recording]) -> None:
    vertical = dive(theta=between(20.0, 60.0, 1.5, 0.0), phi=np.zeros(T.size))
    tumbling = dive(phi=np.pi * np.sin(0.9 * T))
    for run in (vertical, tumbling):
        assert not free_motion(told(run), ROV).left_out


def test_acrobatic_mode_and_a_sensor_mounted_upside_down() -> None:
    flown = dive({"mode": ([0.0, 30.0, 60.0], [19.0, 1.0, 19.0])}, phi=between(40.0, 55.0, 3.0, 0.1))
    flown = Recording(flown.channels, attributes={"modes": "1 ACRO, 19 MANUAL"})
    assert not free_motion(flown, ROV).left_out
    assert not free_motion(dive(phi=np.full(T.size, 3.1)), ROV).left_out


def test_of_two_reasons_the_first_is_told_and_slivers_go_with_them() -> None:
    run = dive({"armed": ([0.0, 25.0], [0.0, 1.0])}, z=np.where((T >= 20.0) & (T < 50.0), 0.0, 3.0))
    run = run.replace([Channel("bottomed", [0.0, 52.0, 60.0], [0.0, 1.0, 0.0], "1")])
    found = free_motion(run, ROV)
    assert cuts(found) == [
        ("disarmed", 0.0, 25.0),
        ("surface", 25.0, 50.0),
        ("too short", 50.0, 52.0),
        ("bottom", 52.0, 60.0),
    ]
    assert found.kept == ((60.0, 100.0),)


def test_within_windows() -> None:
    run = dive({"armed": ([0.0, 41.0], [0.0, 1.0])})
    found = free_motion(run, ROV, [(30.0, 60.0), (80.0, 81.0)])
    assert cuts(found) == [("disarmed", 30.0, 41.0)]
    assert found.kept == ((41.0, 60.0), (80.0, 81.0))  # short as it was asked for


def test_all_of_it_together_is_the_recording() -> None:
    run = dive({"armed": ([0.0, 5.0, 95.0], [0.0, 1.0, 0.0])}, z=between(30.0, 40.0, 0.0, 3.0))
    found = free_motion(run, ROV)
    pieces = sorted([*found.kept, *((each.start, each.end) for each in found.left_out)])
    assert pieces[0][0] == run.start
    assert pieces[-1][1] == run.end
    assert all(b == pytest.approx(c) for (_, b), (c, _) in pairwise(pieces))


@pytest.mark.parametrize(("source", "named"), [("dive 7.BIN", "dive 7.BIN"), ("", "recording")])
def test_a_recording_of_which_nothing_counts_is_refused_by_its_name_and_why(source: str, named: str) -> None:
    run = dive({"armed": ([0.0], [0.0])})
    with pytest.raises(InputError) as error:
        free_parts(Recording(run.channels, source), ROV)
    assert str(error.value) == f"{named}: nothing of it counts (0 to 100 s: disarmed); keep_all=True takes it"


@pytest.mark.parametrize("name", ["vlbv300", "bluerov2_heavy", "blueboat"])
def test_no_simulated_run_loses_anything(name: str) -> None:
    vehicle = load_vehicle(name)
    for each in MANOEUVRES:
        try:
            made = manoeuvre(each, vehicle, duration=40.0, dt=0.05)
        except InputError:
            continue  # an axis that this vehicle does not drive
        run = simulate(vehicle, **made.inputs, sensors="ins", seed=1)
        told = Recording(run.channels, attributes=dict([DEPTH_BELOW_SURFACE])) if name == "blueboat" else run
        assert not free_motion(told, vehicle).left_out, each


# -- real logs


LOGS = {
    "bluerov2_dvl_sea_2026/orig/00000029_filtered.BIN": ("bluerov2_heavy", []),
    "ardusub_samples/small.BIN": ("bluerov2", [("surface", 0.0, 8.8), ("disarmed", 8.8, 23.7)]),
    "ardusub_samples/small.tlog": (
        "bluerov2_heavy",
        [("disarmed", 0.1, 207.1), ("surface", 207.1, 222.1), ("disarmed", 222.1, 263.8)],
    ),
    "ardusub_samples/2023-04-18_11-03-34.tlog": ("bluerov2_heavy", [("disarmed", 0.0, 313.1)]),
    "torpedo_auv_mcap_2025/SO_lastbag_0.mcap": (None, []),
}


@pytest.mark.parametrize("name", LOGS)
def test_logs_of_vehicles(data: Path, name: str) -> None:
    """The sea log is 12 m deep all along, part of it in mode GUIDED; the small ones were made on a bench."""
    if not (data / name).is_file():
        pytest.skip(f"no {name}")
    vehicle, expected = LOGS[name]
    found = free_motion(read(data / name), None if vehicle is None else load_vehicle(vehicle))
    assert cuts(found) == expected


MAPS = {
    "pool.toml": 'thrusters = ["pwm1", "pwm2", "pwm3", "pwm4", "pwm5", "pwm6"]\n[columns]\n'
    'p = "gyro_p"\nq = "gyro_q"\nr = "gyro_r"\nax = "acc_x"\nay = "acc_y"\naz = "acc_z"\n',
    "angles.toml": 'thrusters = ["pwm1", "pwm2", "pwm3", "pwm4", "pwm5", "pwm6"]\n[columns]\n'
    'phi = "ekf_phi"\ntheta = "ekf_theta"\nz = "ekf_depth_m"\n',
    "boat.toml": 'thrusters = ["pwm_left", "pwm_right"]\n[columns]\nu = "u"\nv = "v"\nr = "r"\n',
}


@pytest.mark.parametrize(
    ("pattern", "mapping", "vehicle"),
    [
        ("bluerov_pool_2016/*_2016*.csv", "pool.toml", "bluerov_2016"),
        ("bluerov_pool_2016/*_2016*.csv", "angles.toml", "bluerov_2016"),
        ("blueboat_2024/log_*.csv", "boat.toml", "blueboat_2024"),
    ],
)
def test_tables_lose_nothing(data: Path, tmp_path: Path, pattern: str, mapping: str, vehicle: str) -> None:
    """The pool's vehicle tumbles, its depth begins anywhere; the boats idle and drift under known commands."""
    (tmp_path / mapping).write_text(MAPS[mapping])
    known = load_mapping(tmp_path / mapping)
    for path in sorted(data.glob(pattern)):
        assert not free_motion(read(path, known), load_vehicle(vehicle)).left_out, path.name


def test_a_quaternion_of_nothing_is_upright_and_so_is_weightlessness() -> None:
    t = np.arange(0.0, 30.0, 0.1)
    q = dict.fromkeys(("qw", "qx", "qy", "qz"), np.zeros(t.size))
    assert free_motion(Recording.from_table(t, {**q, "r": np.sin(t)})).left_out == ()
    force = dict.fromkeys(("ax", "ay", "az"), np.zeros(t.size))
    assert free_motion(Recording.from_table(t, {**force, "r": np.sin(t)})).left_out == ()
    over = {**q, "qx": np.full(t.size, 2.0), "qw": np.where(t < 20.0, 2.0, 0.0)}  # of no unit length
    [cut] = free_motion(Recording.from_table(t, {**over, "r": np.sin(t)})).left_out
    assert (cut.kind, cut.start, cut.end) == ("upside down", pytest.approx(20.0), pytest.approx(29.9))
