"""Recordings that contradict themselves, and those that do not."""

from __future__ import annotations

import numpy as np
import pytest
from tests.pace import within

from towtank.core.attitude import quaternions_from_eulers
from towtank.recording import Recording, standard_channel
from towtank.recording.consistency import Finding, inconsistencies
from towtank.recording.frames.rotations import conjugate, rotate

NOISE = {"x": 1e-3, "phi": 2e-3, "u": 5e-3, "p": 2e-3}
GROUPS = {"x": ("x", "y", "z"), "phi": ("phi", "theta", "psi"), "u": ("u", "v", "w"), "p": ("p", "q", "r")}
Columns = dict[str, np.ndarray]


def sines(t: np.ndarray, sizes: tuple[float, ...], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Sums of sines (n, 3) of about these speeds, and their derivatives."""
    x, rate = np.zeros((2, t.size, len(sizes)))
    for j, size in enumerate(sizes):
        for _ in range(5):
            w, phase = 2.0 * np.pi * rng.uniform(0.03, 0.4), rng.uniform(0.0, 2.0 * np.pi)
            x[:, j] += size / np.sqrt(2.5) / w * np.sin(w * t + phase)
            rate[:, j] += size / np.sqrt(2.5) * np.cos(w * t + phase)
    return x, rate


def motion(seconds: float = 120.0, rate: float = 50.0, seed: int = 0, size: float = 1.0) -> tuple[np.ndarray, Columns]:
    """Times and exact columns of a body that moves on all axes, its velocity in the world under `vn ve vd`."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    place, speed = sines(t, (0.3 * size, 0.3 * size, 0.2 * size), rng)
    angles, rates = sines(t, (0.1 * size, 0.1 * size, 0.4 * size), rng)
    (phi, theta), (dphi, dtheta, dpsi) = angles[:, :2].T, rates.T
    p = dphi - np.sin(theta) * dpsi
    q = np.cos(phi) * dtheta + np.cos(theta) * np.sin(phi) * dpsi
    r = -np.sin(phi) * dtheta + np.cos(theta) * np.cos(phi) * dpsi
    body = rotate(conjugate(quaternions_from_eulers(angles)), speed)
    columns = np.column_stack([place, angles, body, p, q, r, speed]).T
    return t, dict(zip(("x", "y", "z", "phi", "theta", "psi", *"uvwpqr", "vn", "ve", "vd"), columns, strict=True))


def noisy(columns: Columns, seed: int, times: float = 1.0) -> Columns:
    rng = np.random.default_rng(1000 + seed)
    out = {}
    for first, names in GROUPS.items():
        for name in names:
            out[name] = columns[name] + times * NOISE[first] * rng.normal(size=columns[name].size)
    return out


def found(changes: Columns | None = None, without: str = "", **how: float) -> tuple[Finding, ...]:
    t, columns = motion()
    table = {**noisy(columns, 0), **(changes or {}), **how}
    return inconsistencies(Recording.from_table(t, {name: x for name, x in table.items() if name not in without}))


def test_a_recording_that_agrees_with_itself_is_left_alone() -> None:
    assert found() == ()


T, EXACT = motion()
TURN = np.exp(1j * np.radians(15.0)) * (EXACT["u"] + 1j * EXACT["v"])


@pytest.mark.parametrize(
    "changes, what, words",
    [
        ({"p": -EXACT["p"]}, "p", "p is -1 times what the attitude does: its sign"),
        ({"v": -EXACT["v"], "w": -EXACT["w"]}, "v w", 'FLU, not FRD (body = "FLU" in the mapping)'),
        ({"r": np.degrees(EXACT["r"])}, "r", "r is 57 times what the attitude does: degrees, not radians"),
        ({name: 1e3 * EXACT[name] for name in "uvw"}, "u v w", "millimetres"),
        ({"u": EXACT["vn"], "v": EXACT["ve"], "w": EXACT["vd"]}, "u v w", "in the world's frame (north, east, down)"),
        ({"u": EXACT["ve"], "v": EXACT["vn"], "w": -EXACT["vd"]}, "u v w", "in the world's frame (east, north, up)"),
        ({"u": TURN.real, "v": TURN.imag}, "u v", "turned by 15° clockwise"),
        ({"p": EXACT["q"]}, "p", "p is not what the attitude does"),
    ],
)
def test_what_is_wrong_is_named(changes: Columns, what: str, words: str) -> None:
    [finding] = found(changes)
    assert finding.what == what
    assert words in finding.text
    assert not finding.allowed_for


@pytest.mark.parametrize(
    "factor, words",
    [
        (np.degrees(1.0), "degrees, not radians (scale = 0.0174533 in the mapping)"),
        (np.radians(1.0), "turned from degrees into radians twice (leave its scale out in the mapping)"),
        (1000.0, "millimetres, not metres (scale = 0.001 in the mapping)"),
        (100.0, "centimetres, not metres (scale = 0.01 in the mapping)"),
        (3.6, "km/h, not m/s (scale = 0.27778 in the mapping)"),
        (1.94384, "knots, not m/s (scale = 0.51444 in the mapping)"),
        (0.3048, "scaled from feet once too often (leave its scale out in the mapping)"),
        (3.28084, "feet, not metres (scale = 0.3048 in the mapping)"),
        (1.5, "check units, frames and the filter before it"),
        (0.7, "check units, frames and the filter before it"),
    ],
)
def test_a_unit_is_known_by_its_gain(factor: float, words: str) -> None:
    [finding] = found({name: factor * EXACT[name] for name in "uvw"})
    assert finding.what == "u v w"
    assert f"times what the position does: {words}; found " in finding.text
    assert float(finding.text.split(" times")[0].split()[-1]) == pytest.approx(factor, rel=0.05)


@pytest.mark.parametrize("gain, wrong", [(0.9, False), (0.88, True), (1.1, False), (1.14, True)])
def test_a_gain_may_be_off_by_an_eighth(gain: float, wrong: bool) -> None:
    named = [(each.what, f"{gain:.2g}"[:3] in each.text) for each in found({"v": gain * EXACT["v"]})]
    assert named == ([("v", True)] if wrong else [])


@pytest.mark.parametrize("degrees, wrong", [(5.0, False), (-5.0, False), (10.0, True), (-10.0, True), (120.0, True)])
def test_a_sensor_may_be_turned_by_some_degrees(degrees: float, wrong: bool) -> None:
    course = np.exp(1j * np.radians(degrees)) * (EXACT["u"] + 1j * EXACT["v"])
    told = found({"u": course.real, "v": course.imag})
    side = "clockwise" if degrees > 0.0 else "counter-clockwise"
    assert [each.what for each in told] == (["u v"] if wrong else [])
    for each in told:
        assert f"° {side} (seen from above) against what the position does" in each.text
        assert float(each.text.split("°")[0].split()[-1]) == pytest.approx(abs(degrees), abs=2.5)


@pytest.mark.parametrize("late, wrong", [(0.03, False), (-0.03, False), (0.06, True), (-0.06, True), (0.45, True)])
def test_stamps_may_be_off_by_some_hundredths(late: float, wrong: bool) -> None:
    speeds = Recording.from_table(T[::5] + late, {name: EXACT[name][::5] for name in "uvw"})
    pose = Recording.from_table(T, {name: EXACT[name] for name in ("x", "y", "z", "phi", "theta", "psi")})
    told = inconsistencies(pose.replace(speeds.channels))
    side = "after" if late > 0.0 else "before"
    assert [each.text.partition(":")[0] for each in told] == (
        [f"u v w arrive {abs(late):.2f} s {side} the position"] if wrong else []
    )


@pytest.mark.parametrize("gain, wrong", [(0.85, False), (0.82, True), (1.18, False), (1.22, True)])
def test_a_wrench_may_be_off_by_a_fifth(gain: float, wrong: bool) -> None:
    t = np.arange(6000) / 100.0
    commanded = np.zeros((t.size, 6))
    commanded[:, 0] = 20.0 * np.sign(np.sin(0.9 * t))
    told = inconsistencies(Recording.from_table(t, {"u": np.sin(t), "X": gain * commanded[:, 0]}), (t, commanded))
    assert [each.what for each in told] == (["X"] if wrong else [])


def test_speeds_that_have_nothing_to_do_with_the_pose_are_named_with_the_share_in_common() -> None:
    _, other = motion(seed=5)
    told = found({"p": other["p"], "q": other["q"], "r": other["r"]})
    assert [each.what for each in told] == ["p", "q", "r"]
    for each in told:
        assert f"{each.what} is not what the attitude does (it explains " in each.text
        assert 0 <= int(each.text.split(" % of it")[0].split()[-1]) < 20


def test_rates_without_an_attitude_are_judged_by_their_size() -> None:
    t, columns = motion()
    assert inconsistencies(Recording.from_table(t, {name: columns[name] for name in "pqr"})) == ()
    [finding] = inconsistencies(Recording.from_table(t, {name: np.degrees(columns[name]) for name in "pqr"}))
    assert set(finding.what.split()) <= {"p", "q", "r"}
    assert "more than any underwater vehicle turns: degrees, not radians?" in finding.text


@pytest.mark.parametrize("late", [-0.2, 0.12, 0.3])
def test_speeds_that_come_late(late: float) -> None:
    t, columns = motion()
    table = noisy(columns, 0)
    own = t[::10]
    speeds = {name: np.interp(own, t, table[name]) for name in "uvw"}
    run = Recording.from_table(t, {name: x for name, x in table.items() if name not in "uvw"})
    [finding] = inconsistencies(run.replace(Recording.from_table(own + late, speeds).channels))
    side = "after" if late > 0.0 else "before"
    told = float(finding.text.split(" s ")[0].split()[-1])
    assert f"s {side} the position" in finding.text
    assert told == pytest.approx(abs(late), abs=0.015)
    assert finding.allowed_for


def test_a_filter_makes_speeds_late_and_small() -> None:
    t, columns = motion()
    keep = np.exp(-2.0 * (t[1] - t[0]))
    smooth = {name: columns[name].copy() for name in "uvw"}
    for x in smooth.values():
        for k in range(1, t.size):
            x[k] = keep * x[k - 1] + (1.0 - keep) * x[k]
    [finding] = found(smooth)
    assert finding.what == "u v w"
    assert "a low-pass filter" in finding.text


def test_clocks_that_drift() -> None:
    t, columns = motion()
    table = noisy(columns, 0)
    own = t[::10]
    speeds = {name: np.interp(own, t, table[name]) for name in "uvw"}
    run = Recording.from_table(t, {name: x for name, x in table.items() if name not in "uvw"})
    late = 0.1 + 0.25 * own / own[-1]
    [finding] = inconsistencies(run.replace(Recording.from_table(own + late, speeds).channels))
    assert "the clocks of u v w and of the position drift apart" in finding.text
    assert "+0.1" in finding.text
    assert "+0.3" in finding.text


def test_a_depth_sensor_alone_will_do() -> None:
    t, columns = motion()
    table = {name: x for name, x in noisy(columns, 0).items() if name not in "xy"}
    assert inconsistencies(Recording.from_table(t, table)) == ()
    [finding] = inconsistencies(Recording.from_table(t, {**table, "z": -table["z"]}))
    assert "the vertical part of u v w is -1 times what the depth does" in finding.text


def test_a_heading_alone_will_do() -> None:
    t, columns = motion()
    level = np.zeros(t.size)
    table = {"psi": columns["psi"], "r": np.gradient(columns["psi"], t), "x": columns["x"], "y": columns["y"]}
    body = rotate(
        conjugate(quaternions_from_eulers(np.column_stack([level, level, columns["psi"]]))),
        np.column_stack([columns["vn"], columns["ve"], level]),
    )
    table |= {"u": body[:, 0], "v": body[:, 1]}
    assert inconsistencies(Recording.from_table(t, table)) == ()
    told = inconsistencies(Recording.from_table(t, {**table, "v": -body[:, 1], "r": -table["r"]}))
    assert [each.what for each in told] == ["v", "r"]


def test_a_quaternion_will_do() -> None:
    t, columns = motion()
    q = quaternions_from_eulers(np.column_stack([columns[name] for name in ("phi", "theta", "psi")]))
    rest = {name: columns[name] for name in ("x", "y", "z", *"uvwpqr")}
    run = Recording.from_table(t, {**rest, **dict(zip(("qw", "qx", "qy", "qz"), q.T, strict=True))})
    assert inconsistencies(run) == ()
    [finding] = inconsistencies(run.replace([standard_channel("q", t, -columns["q"])]))
    assert finding.what == "q"


def test_a_wrench_and_commands_that_disagree() -> None:
    t = np.arange(6000) / 100.0
    commanded = np.zeros((t.size, 6))
    commanded[:, 0], commanded[:, 5] = 20.0 * np.sign(np.sin(0.9 * t)), 3.0 * np.sign(np.sin(1.7 * t))
    table = {"u": np.sin(t), "X": commanded[:, 0], "Y": commanded[:, 1], "N": commanded[:, 5]}
    assert inconsistencies(Recording.from_table(t, table), (t, commanded)) == ()
    wrong = Recording.from_table(t, {**table, "X": 0.62 * table["X"], "N": -table["N"]})
    told = inconsistencies(wrong, (t, commanded))
    assert [each.what for each in told] == ["X", "N"]
    assert "X is 0.62 times what the commands make of it" in told[0].text
    assert "N is -1 times" in told[1].text
    other = Recording.from_table(t, {**table, "X": 20.0 * np.sign(np.sin(0.37 * t))})
    assert "not what the commands make of it" in inconsistencies(other, (t, commanded))[0].text


LENGTHS = ((20.0, 20.0), (45.0, 50.0), (90.0, 20.0), (200.0, 20.0))  # s, Hz


@pytest.mark.parametrize("seed", range(12))
def test_noise_alone_raises_nothing(seed: int) -> None:
    """Rest, little motion and usual motion; sensors from good to hopeless, slow ones, held ones, markers that jump."""
    rng = np.random.default_rng(seed)
    for size in (0.0, 0.03, 1.0):
        t, columns = motion(*LENGTHS[seed % 4], seed, size)
        for times in (0.1, 1.0, 20.0):
            table = noisy(columns, seed, times)
            slow = Recording.from_table(t[::5], {name: table[name][::5] for name in "uvw"})
            steps = t.size // 5
            held = {
                name: np.repeat(x[: 5 * steps : 5], 5) if name in "xyz" else x[: 5 * steps] for name, x in table.items()
            }
            jumps = dict(table)
            at = int(rng.integers(0, t.size - 10))
            jumps["x"] = table["x"] + np.where((t > t[at]) & (t < t[at] + 0.4), 0.05, 0.0)
            wander = {name: x + 0.02 * np.sin(2.0 * np.pi * t / 45.0) for name, x in table.items()}
            fast = {name: x for name, x in table.items() if name not in "uvw"}
            for run in (
                Recording.from_table(t, table),
                Recording.from_table(t, jumps),
                Recording.from_table(t, wander),
                Recording.from_table(t, fast).replace(slow.channels),
                Recording.from_table(t[: 5 * steps], held),
            ):
                assert inconsistencies(run) == ()


@pytest.mark.parametrize("seconds", [0.2, 3.0, 12.0])
def test_nothing_is_said_of_little_data(seconds: float) -> None:
    t, columns = motion(seconds)
    table = {name: -columns[name] if name in "uvwpqr" else columns[name] for name in NAMES}
    assert inconsistencies(Recording.from_table(t, table)) == ()


NAMES = ("x", "y", "z", "phi", "theta", "psi", *"uvwpqr")


def test_an_hour_costs_a_moment() -> None:
    t, columns = motion(3600.0, 100.0)
    run = Recording.from_table(t, {**{name: columns[name] for name in NAMES}, "p": -columns["p"]})
    inconsistencies(run)
    with within(1.0):  # 0.2 s
        [finding] = inconsistencies(run)
    assert finding.what == "p"
