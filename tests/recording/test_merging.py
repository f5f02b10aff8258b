"""Two files of one run: the offset between their clocks, and what is taken from each."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import towtank as tt
from towtank.core.attitude import quaternions_from_eulers
from towtank.errors import InputError
from towtank.recording import Recording, standard_channel
from towtank.recording.channel import Channel
from towtank.recording.merging.merge import merge, merges_of
from towtank.recording.merging.offset import ClockOffset, _outside, clock_offset
from towtank.recording.repairs import Repairs

ANGLES, QUATERNION = ("phi", "theta", "psi"), ("qw", "qx", "qy", "qz")
Course = Callable[[np.ndarray], np.ndarray]


def course(seed: int = 0, size: float = 0.2) -> Course:
    """Roll, pitch, yaw [rad] and depth [m] (4, n) over time: sums of sines that never repeat."""
    rng = np.random.default_rng(seed)
    omega, phase = 2.0 * np.pi * rng.uniform(0.02, 0.4, (4, 12)), rng.uniform(0.0, 6.28, (4, 12))
    each = size * np.array([0.5, 0.5, 1.0, 1.0])[:, None] / np.sqrt(6.0) / omega
    return lambda t: np.asarray((each[..., None] * np.sin(omega[..., None] * t + phase[..., None])).sum(1))


def gyro(of: Course, t: np.ndarray, seed: int = 1, noise: float = 2e-3) -> dict[str, np.ndarray]:
    phi, theta, _, _ = of(t)
    f, g, h, _ = (of(t + 1e-4) - of(t - 1e-4)) / 2e-4
    body = (
        f - np.sin(theta) * h,
        np.cos(phi) * g + np.cos(theta) * np.sin(phi) * h,
        np.cos(theta) * np.cos(phi) * h - np.sin(phi) * g,
    )
    rng = np.random.default_rng(seed)
    return {name: x + noise * rng.normal(size=t.size) for name, x in zip("pqr", body, strict=True)}


def table(t: np.ndarray, columns: dict[str, np.ndarray], source: str) -> Recording:
    return Recording.from_table(t, columns, source=source)


def dive(of: Course, seconds: float = 60.0) -> Recording:
    t = np.arange(0.0, seconds, 0.01)
    commands = {"cmd_1": np.where(np.arange(t.size) % 10, np.nan, np.sign(np.sin(t)))}
    return table(t, {**gyro(of, t), **commands}, "dive.BIN")


def mocap(
    of: Course,
    offset: float,
    *,
    start: float = 0.0,
    end: float = 60.0,
    noise: float = 2e-3,
    drift: float = 0.0,
    quaternion: bool = False,
) -> Recording:
    """What a camera saw from `start` to `end` [s] of the run, on a clock that shows `offset` less in its middle."""
    t = np.arange(start, end, 1.0 / 60.0)
    seen = of(t)[:3] + noise * np.random.default_rng(2).normal(size=(3, t.size))
    middle = 0.5 * (start + end)
    own = (t - middle) / (1.0 + drift) + middle - offset
    if quaternion:
        return table(own, dict(zip(QUATERNION, quaternions_from_eulers(seen.T).T, strict=True)), "mocap.csv")
    return table(own, dict(zip(ANGLES, seen, strict=True)), "mocap.csv")


@pytest.mark.parametrize("offset", [12.345, -300.125, 0.0, 1.7e9])
@pytest.mark.parametrize("quaternion", [False, True])
def test_the_offset_is_found_from_gyro_and_attitude(offset: float, quaternion: bool) -> None:
    of = course()
    found = clock_offset(dive(of), mocap(of, offset, quaternion=quaternion))
    assert 0.0 < found.std < 2e-3
    assert abs(found.offset - offset) < max(4.0 * found.std, 1e-6)
    assert set(found.by) == {"roll rate", "pitch rate", "yaw rate"}


@pytest.mark.parametrize("start, end", [(-40.0, 20.0), (25.0, 90.0), (20.0, 45.0), (-30.0, 100.0)])
def test_files_that_overlap_in_part(start: float, end: float) -> None:
    of = course(3)
    found = clock_offset(dive(of), mocap(of, 7.0, start=start, end=end))
    assert abs(found.offset - 7.0) < 4.0 * found.std


def test_what_is_told_is_what_errors_are() -> None:
    """Of forty runs with noise: three deviations hold nearly all, and half of one does not."""
    beyond = []
    for k in range(40):
        of = course(100 + k)
        rng = np.random.default_rng(k)
        t, own = np.arange(0.0, 40.0, 0.02), np.arange(0.0, 40.0, 0.05)
        angles = of(own)[:3] + 0.01 * rng.normal(size=(3, own.size))
        seen = table(own - 5.0, dict(zip(ANGLES, angles, strict=True)), "b")
        found = clock_offset(table(t, gyro(of, t, seed=k, noise=0.01), "a"), seen)
        beyond.append(abs(found.offset - 5.0) / found.std)
    assert np.mean(np.array(beyond) < 3.0) >= 0.95
    assert np.mean(np.array(beyond) < 0.5) <= 0.7


def test_clocks_that_drift() -> None:
    of = course(4)
    found = clock_offset(dive(of, 400.0), mocap(of, 5.0, end=400.0, drift=300e-6))
    assert found.drift == pytest.approx(300e-6, abs=5.0 * found.drift_std)
    assert found.drift_std < 10e-6
    assert re.search(r"; its clock is (29|30)\d ± \d ppm slow$", found.text("a", "b"))
    run = merge(dive(of, 400.0), mocap(of, 5.0, end=400.0, drift=300e-6))
    at = run["psi"].t
    assert np.max(np.abs(run["psi"].values - of(at)[2])) < 0.02  # 60 ms of drift would be more


def test_depth_will_do_where_nothing_turns() -> None:
    of = course(5)
    t, own = np.arange(0.0, 90.0, 0.1), np.arange(-5.0, 80.0, 0.05)
    a = table(t, {"z": of(t)[3] + 4.0}, "dive.BIN")
    b = table(own - 33.3, {"z": of(own)[3] - 1.0}, "logger.csv")  # another zero of depth
    found = clock_offset(a, b)
    assert abs(found.offset - 33.3) < max(4.0 * found.std, 2e-3)
    assert found.text("a", "b").endswith("by depth")


def test_velocity_and_acceleration_will_do() -> None:
    of = course(6, size=0.5)
    t, own = np.arange(0.0, 90.0, 0.1), np.arange(0.0, 90.0, 0.125)
    for names in (("u", "v", "w"), ("ax", "ay", "az")):
        a = table(t, dict(zip(names, of(t)[:3], strict=True)), "a")
        b = table(own + 8.0, dict(zip(names, of(own)[:3], strict=True)), "b")
        found = clock_offset(a, b)
        assert found.offset == pytest.approx(-8.0, abs=5e-3)
        assert " before a" in found.text("a", "b")


def refusal(a: Recording, b: Recording) -> str:
    with pytest.raises(InputError) as error:
        clock_offset(a, b)
    text = str(error.value)
    assert "\n" not in text
    assert "--merge mocap.csv@+SECONDS" in text
    return text


def test_a_periodic_motion_is_ambiguous() -> None:
    def sine(t: np.ndarray) -> np.ndarray:
        return np.stack([0.0 * t, 0.0 * t, 0.5 * np.sin(2.0 * np.pi * t / 6.0), 0.0 * t])

    assert "ambiguous: a shift by another 6.0 s" in refusal(dive(sine), mocap(sine, 3.0))


def test_other_motion_is_refused() -> None:
    for seed in range(10):
        text = refusal(dive(course(10 + seed)), mocap(course(50 + seed), 3.0))
        assert "in common" in text or "ambiguous" in text


def test_motion_that_is_common_in_a_small_part_is_refused_however_long_it_lasts() -> None:
    own, common = course(3), course(4)

    def partly(t: np.ndarray) -> np.ndarray:
        return own(t) + 0.5 * common(t)

    text = refusal(dive(common, 300.0), mocap(partly, 3.0, end=300.0))
    assert re.search(r"no motion in common \(correlation at most 0\.[34]\d\)", text), text


def test_rest_and_nothing_in_common_are_refused() -> None:
    def rest(t: np.ndarray) -> np.ndarray:
        return np.zeros((4, t.size))

    assert "hardly moves" in refusal(dive(course()), mocap(rest, 3.0, noise=1e-5))
    t = np.arange(0.0, 30.0, 0.1)
    assert "nothing in common" in refusal(dive(course()), table(t, {"voltage": 15.0 + np.sin(t)}, "mocap.csv"))


def test_the_merged_run_has_the_channels_of_both_on_one_clock() -> None:
    of = course(7)
    a, b = dive(of), mocap(of, 12.345)
    b = Recording(b.channels, b.source, ("seen by 8 cameras",), {"room": "tank 2", "clock": "cameras"})
    a = Recording(a.channels, a.source, (), {"clock": "autopilot"})
    run = a.merge(b)
    assert set(run.names) == {"p", "q", "r", "cmd_1", *ANGLES}
    assert run.source == "dive.BIN"
    np.testing.assert_array_equal(run["r"].t, a["r"].t)
    assert np.max(np.abs(run["psi"].values - of(run["psi"].t)[2])) < 0.015
    assert run.attributes["clock"] == "autopilot"
    assert run.attributes["clock (mocap.csv)"] == "cameras"
    assert run.attributes["room"] == "tank 2"
    assert any(re.match(r"mocap.csv lies 12\.34\d+ ± 0\.00\d+ s after dive.BIN, by ", note) for note in run.notes)
    assert "mocap.csv: seen by 8 cameras" in run.notes
    [how] = merges_of(run)
    assert how["file"] == "mocap.csv"
    assert how["offset_s"] == pytest.approx(12.345, abs=2e-3)
    assert 0.0 < float(str(how["offset_std_s"])) < 2e-3


def test_an_offset_that_is_said_is_taken_as_it_is() -> None:
    of = course(7)
    run = dive(of).merge(mocap(of, 12.0), 12.5)
    assert run["psi"].t[0] == pytest.approx(0.5)
    [how] = merges_of(run)
    assert how["offset_s"] == 12.5
    assert how["offset_std_s"] is None
    with pytest.raises(InputError, match="expected some time in common"):
        dive(of).merge(mocap(of, 12.0), 1e6)


def test_of_two_that_measure_the_same_the_one_that_tells_more_is_kept() -> None:
    of = course(8)
    rng = np.random.default_rng(0)
    a = dive(of)
    t = np.arange(0.0, 60.0, 0.1)
    worse = {name: x + 0.05 * rng.normal(size=t.size) for name, x in zip(ANGLES, of(t)[:3], strict=True)}
    both = a.replace(table(t, worse, "a").channels)
    run = both.merge(mocap(of, 3.0, quaternion=True))
    assert set(QUATERNION) <= set(run.names)
    assert not set(ANGLES) & set(run.names)
    assert any(note.startswith("attitude: from mocap.csv") for note in run.notes)
    coarse = mocap(of, 3.0, noise=0.2)
    run = both.merge(coarse.replace([coarse["psi"].renamed("temperature")]), 3.0)
    assert any(note.startswith("attitude: from dive.BIN") for note in run.notes)
    assert len(run["phi"]) == t.size
    assert "temperature" in run


def test_commands_are_the_first_files_and_motion_ends_with_them() -> None:
    of = course(9)
    a, b = dive(of), mocap(of, 2.0, start=-10.0, end=80.0)
    other = standard_channel("cmd_1", b["psi"].t, np.zeros(len(b["psi"])))
    run = a.merge(b)
    assert run.start >= 0.0
    assert run.end <= 60.0
    assert any("left out, for which dive.BIN tells no inputs" in note for note in run.notes)
    np.testing.assert_array_equal(a.merge(b.replace([other]))["cmd_1"].values, a["cmd_1"].values)
    swapped = b.merge(a)  # the cameras first: commands still come with their own motion
    assert "cmd_1" in swapped
    assert swapped.duration <= 60.1


def test_three_files_are_two_merges() -> None:
    of = course(11)
    t = np.arange(0.0, 60.0, 0.1)
    run = dive(of).merge(mocap(of, 4.0)).merge(table(t - 1.0, {"z": of(t)[3], "r": gyro(of, t)["r"]}, "logger.csv"))
    assert {"z", "psi", "cmd_1"} <= set(run.names)
    assert [how["file"] for how in merges_of(run)] == ["mocap.csv", "logger.csv"]


def shifted(run: Recording, names: tuple[str, ...], by: float) -> Recording:
    parts = [run[name] for name in names if name in run]
    return Recording({c.name: Channel(c.name, c.t - by, c.values, c.unit, c.frame) for c in parts}, "mocap.csv")


@pytest.mark.parametrize(
    "name, within",
    [
        ("bluerov2_dvl_sea_2026/orig/00000029_filtered.BIN", 0.03),
        ("ardusub_samples/small.tlog", 0.03),
        ("ardusub_samples/2023-04-18_11-03-34.tlog", 0.06),
    ],
)
def test_real_gyros_and_attitudes_find_each_other(data: Path, name: str, within: float) -> None:
    """The autopilot's attitude beside its own gyros, cut apart: late by its filter, no more."""
    log = data / name
    if not log.exists():
        pytest.skip(f"{log} is not there")
    run = tt.read(log)
    rates = Recording({each: run[each] for each in "pqr"}, "dive.BIN")
    found = clock_offset(rates, shifted(run, (*ANGLES, *QUATERNION), 123.4))
    assert found.offset == pytest.approx(123.4, abs=within)


def test_a_real_log_and_its_tables_find_each_other_by_every_quantity(data: Path) -> None:
    """The BIN's clock begins 0.065 s before that of the tables that were made of it, whatever is compared."""
    folder = data / "bluerov2_dvl_sea_2026"
    log = folder / "orig" / "00000029_filtered.BIN"
    if not log.exists():
        pytest.skip(f"{log} is not there")
    run = tt.read(log)
    columns = {"t": "t", "z": "depth_m", "ax": "acc_x", "ay": "acc_y", "az": "acc_z", "p": "p", "q": "q", "r": "r"}
    other = tt.read(folder / "run_20hz.csv", tt.recording.ColumnMapping.model_validate({"columns": columns}))
    dvl = tt.read(folder / "dvl_8hz.csv")
    for names in (("p", "q", "r"), ("z",), ("ax", "ay", "az")):
        part = Recording({name: run[name] for name in names}, "dive.BIN")
        found = clock_offset(part, Recording({name: other[name] for name in names}, "table.csv"))
        assert found.offset == pytest.approx(0.0652, abs=5e-4)
    assert clock_offset(run, dvl).offset == pytest.approx(0.0652, abs=5e-4)


def test_real_logs_of_other_days_are_refused(data: Path) -> None:
    logs = [data / "blueboat_2024" / f"log_{k}.csv" for k in (220, 224, 225, 228)]
    if not all(log.exists() for log in logs):
        pytest.skip(f"{logs[0].parent} is not there")
    runs = [tt.read(log) for log in logs]
    for k, a in enumerate(runs):
        for b in runs[:k]:
            with pytest.raises(InputError, match="cannot be told"):
                clock_offset(a, b)


def placed(of: Course, seconds: float = 60.0) -> Recording:
    """Motion capture with a north of its own, and a depth with a zero of its own."""
    t = np.arange(0.0, seconds, 0.02)
    phi, theta, psi, z = of(t)
    rng = np.random.default_rng(5)
    columns = {"x": z, "y": -z, "z": z - 9.0, "phi": phi, "theta": theta, "psi": psi + 0.7}
    noisy = {name: x + 4e-3 * rng.normal(size=t.size) for name, x in columns.items()}
    return table(t, noisy, "mocap.csv")


def test_heading_comes_from_the_file_of_the_position() -> None:
    of = course()
    t = np.arange(0.0, 60.0, 0.01)
    phi, theta, psi, _ = of(t)
    attitude = {"phi": phi, "theta": theta, "psi": psi}
    first = dive(of).with_channels(table(t, attitude, "dive.BIN").channels.values())
    both = merge(first, placed(of), 0.0)
    assert np.median(both["psi"].values - np.interp(both["psi"].t, t, psi)) == pytest.approx(0.7, abs=0.01)
    assert any("attitude: from mocap.csv" in note for note in both.notes)


def test_what_is_said_of_a_depth_goes_with_the_depth() -> None:
    of = course()
    t = np.arange(0.0, 60.0, 0.2)
    deep = table(t, {"z": 5.0 + of(t)[3]}, "dive.BIN")
    first = dive(of).with_channels(deep.channels.values())
    first = Recording(first.channels, first.source, attributes={"depth": "below the water's surface, by pressure"})
    both = merge(first, placed(of), 0.0)
    assert float(np.median(both["z"].values)) < 0.0  # motion capture tells more of it
    assert "depth" not in both.attributes


def test_states_are_no_inputs() -> None:
    of = course()
    t = np.arange(-20.0, 80.0, 0.1)
    second = table(t, gyro(of, t), "other.csv").with_channels([Channel("armed", t, np.ones(t.size), "1")])
    both = merge(dive(of), second, 0.0)
    assert both.end <= 60.0
    assert both.start >= 0.0


def test_notes_and_repairs_of_the_second_file_bear_its_name() -> None:
    of = course()
    second = mocap(of, 2.0)
    second = replace(second, repairs=Repairs(damaged=3, details=("three lines",)), notes=("seen",))
    once = merge(dive(of), second, 2.0)
    assert once.repairs.damaged == 3
    assert once.repairs.details == ("mocap.csv: three lines",)
    twice = merge(once, second, 2.0)
    assert [each["offset_s"] for each in merges_of(twice)] == [2.0, 2.0]
    thrice = merge(twice, second, 2.0)
    assert len(merges_of(thrice)) == 3


def test_supply_and_wrench_are_the_first_files_where_it_has_them() -> None:
    of = course()
    t = np.arange(0.0, 60.0, 0.1)
    supply = standard_channel("voltage", t, 15.0 + np.sin(t))
    push = standard_channel("X", t, np.sin(t))
    second = mocap(of, 0.0).replace([supply, push, supply.renamed("temperature")])
    alone = merge(dive(of), second, 0.0)
    assert alone["voltage"] == supply
    assert {"X", "cmd_1", "temperature"} <= set(alone.names)
    first = dive(of).replace([standard_channel("voltage", t, 12.0 + 0.0 * t), standard_channel("Y", t, 0.0 * t)])
    both = merge(first.replace([supply.renamed("temperature")]), second, 0.0)
    assert float(both["voltage"].values[0]) == 12.0
    assert "X" not in both
    assert {"temperature", "temperature (mocap.csv)"} <= set(both.names)
    said = [note for note in both.notes if "from dive.BIN, not from mocap.csv" in note]
    assert said == ["X: from dive.BIN, not from mocap.csv", "voltage: from dive.BIN, not from mocap.csv"]


def test_seconds_before_and_after_the_commands_are_added_up() -> None:
    of = course()
    early, late = merge(dive(of), mocap(of, 0.0, start=-3.0), 0.0), merge(dive(of), mocap(of, 0.0, end=64.5), 0.0)
    both = merge(dive(of), mocap(of, 0.0, start=-3.0, end=64.5), 0.0)
    said = [[note for note in run.notes if "left out" in note] for run in (early, late, both)]
    words = "s of mocap.csv left out, for which dive.BIN tells no inputs"
    assert said == [[f"3.0 {words}"], [f"4.5 {words}"], [f"7.5 {words}"]]
    inside = merge(dive(of), mocap(of, 0.0, start=1.0, end=59.0), 0.0)
    assert not [note for note in inside.notes if "left out" in note]


def test_of_two_that_tell_as_many_axes_the_one_known_better_counts_and_dead_ones_tell_nothing() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 60.0, 0.1)
    two = table(t, {"p": 0.1 * rng.normal(size=t.size), "q": 0.1 * rng.normal(size=t.size)}, "two.csv")
    three = table(t, {name: 0.5 * rng.normal(size=t.size) for name in "pqr"}, "three.csv")
    dead = table(t, {name: np.full(t.size, 0.1) for name in "pqr"}, "dead.csv")
    for first, second, better in ((two, three, "three.csv"), (three, dead, "three.csv"), (dead, three, "three.csv")):
        run = merge(first, second, 0.0)
        assert any(note.startswith(f"rates: from {better}, which tells more") for note in run.notes), better


def test_an_offset_with_a_drift_leads_there_and_back() -> None:
    clock = ClockOffset(5.0, drift=1e-3, middle=100.0)
    t = np.array([0.0, 100.0, 300.0])
    assert clock.times(t).tolist() == pytest.approx([4.9, 105.0, 305.2])
    assert clock.own(clock.times(t)).tolist() == pytest.approx(t.tolist())


@pytest.mark.parametrize(
    "clock, text",
    [
        (ClockOffset(2.5), "b lies 2.5 s after a, as was said"),
        (ClockOffset(-2.5), "b lies 2.5 s before a, as was said"),
        (ClockOffset(0.0), "b lies 0 s after a, as was said"),
        (ClockOffset(1.23456, 2e-3, by=("yaw rate",)), "b lies 1.235 ± 0.002 s after a, by yaw rate"),
        (ClockOffset(1.23456, 1e-5, by=("yaw rate",)), "b lies 1.2346 ± 0.0001 s after a, by yaw rate"),
        (ClockOffset(-1.0, 5e-4, by=("depth", "yaw rate")), "b lies 1.000 ± 0.001 s before a, by depth and yaw rate"),
        (ClockOffset(1.0, 1e-2, by=("yaw rate", "roll rate")), "b lies 1.000 ± 0.010 s after a, by yaw and roll rate"),
        (
            ClockOffset(1.0, 1e-2, 5e-5, 1e-5, by=("depth",)),
            "b lies 1.000 ± 0.010 s after a, by depth; its clock is 50 ± 10 ppm slow",
        ),
        (
            ClockOffset(1.0, 1e-2, -5e-5, 1e-6, by=("depth",)),
            "b lies 1.000 ± 0.010 s after a, by depth; its clock is 50 ± 1 ppm fast",
        ),
        (ClockOffset(1.0, 1e-2, 5e-5, 2e-5, by=("depth",)), "b lies 1.000 ± 0.010 s after a, by depth"),
        (ClockOffset(1.0, 1e-2, 5e-7, 1e-8, by=("depth",)), "b lies 1.000 ± 0.010 s after a, by depth"),
    ],
)
def test_an_offset_in_words(clock: ClockOffset, text: str) -> None:
    assert clock.text("a", "b") == text


def test_a_peak_ends_where_it_has_fallen_by_half_and_rises_again() -> None:
    gain = np.array([4.0, 0.0, 1.0, 5.0, 10.0, 6.0, 2.0, 3.0, 1.0])
    assert _outside(gain, 4).tolist() == [True, False, False, False, False, False, False, True, True]
    assert _outside(gain[::-1], 4).tolist() == [True, True, False, False, False, False, False, False, True]
    dip = np.array([4.0, 0.0, 9.0, 8.0, 10.0, 8.0, 9.0, 1.0, 0.0, 4.0])
    assert _outside(dip, 4).tolist() == [True, *[False] * 8, True]
    assert not _outside(np.array([1.0, 2.0, 3.0]), 2).any()
    assert not _outside(np.array([3.0, 2.0, 1.0]), 0).any()


def test_a_file_that_is_too_short_or_at_rest_says_so() -> None:
    of = course()
    assert "one of them is too short" in refusal(dive(of), mocap(of, 0.0, end=0.9))
    t = np.arange(0.0, 60.0, 0.02)
    still = table(t, {name: 1e-3 * np.sin(t + k) for k, name in enumerate(ANGLES)}, "mocap.csv")
    assert "the second file hardly moves" in refusal(dive(of), still)
    rest = table(t, {name: 1e-3 * np.sin(t + k) for k, name in enumerate("pqr")}, "dive.BIN")
    assert "the first file hardly moves and the second file hardly moves" in refusal(rest, still)
