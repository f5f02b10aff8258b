"""Velocity in the world frame becomes body velocity where the attitude is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import towtank as tt
from towtank.core.attitude import quaternions_from_eulers
from towtank.identification.data.samples import prepared, samples_of
from towtank.recording import Recording, align, standard_channel, with_body_velocity
from towtank.recording.frames.rotations import rotate
from towtank.simulation import manoeuvre
from towtank.vehicle import load_vehicle

VEHICLE = load_vehicle("vlbv300")
WORLD, BODY = ("vn", "ve", "vd"), ("u", "v", "w")


@pytest.fixture(scope="module")
def run() -> Recording:
    """All axes moved, perfect sensors, with the velocity in the world beside that in the body."""
    drive = manoeuvre("all-multisine", VEHICLE, duration=10.0, dt=0.02)
    log = tt.simulate(VEHICLE, commands=drive.commands, dt=0.02, sensors="perfect")
    return log.replace(standard_channel(name, log["u"].t, v) for name, v in zip(WORLD, world(log).T, strict=True))


def world(log: Recording) -> np.ndarray:
    q = quaternions_from_eulers(np.column_stack([log[name].values for name in ("phi", "theta", "psi")]))
    return rotate(q, np.column_stack([log[name].values for name in BODY]))


def test_it_is_the_velocity_in_the_body(run: Recording) -> None:
    found = with_body_velocity(run.without(*BODY))
    for name in BODY:
        assert found[name].values == pytest.approx(run[name].values, abs=1e-12)
        assert found[name].unit == "m/s"
        assert found[name].frame == "FRD"
    assert any("turned into the body" in note for note in found.notes)


def test_a_quaternion_will_do(run: Recording) -> None:
    q = quaternions_from_eulers(np.column_stack([run[name].values for name in ("phi", "theta", "psi")]))
    t = run["u"].t
    by_q = run.without(*BODY, "phi", "theta", "psi").replace(
        standard_channel(name, t, -q[:, j]) for j, name in enumerate(("qw", "qx", "qy", "qz"))
    )
    assert with_body_velocity(by_q)["u"].values == pytest.approx(run["u"].values, abs=1e-12)


def test_stamps_are_kept_and_gaps_of_the_attitude_never_bridged(run: Recording) -> None:
    t = run["u"].t
    slow = 5.0 * np.arange(t.size // 10) * 0.04 + 0.007  # 5 Hz, between the samples of the attitude
    slow = slow[slow < t[-1]]
    channels = [standard_channel(name, slow, np.interp(slow, t, run[name].values)) for name in WORLD]
    hole = (t > 3.0) & (t < 5.0)
    attitude = [standard_channel(name, t[~hole], run[name].values[~hole]) for name in ("phi", "theta", "psi")]
    found = with_body_velocity(run.without(*BODY).replace([*channels, *attitude]))
    kept = found["u"].t
    assert set(kept) <= set(slow)
    assert not ((kept > 3.02) & (kept < 4.98)).any()
    assert kept.size == np.count_nonzero((slow < 3.0) | (slow > 5.0))
    assert found["u"].values == pytest.approx(np.interp(kept, t, run["u"].values), abs=2e-3)
    assert any("samples left out" in note for note in found.notes)


def test_grid_and_samples_have_it(run: Recording) -> None:
    without = run.without(*BODY)
    assert align(without).velocity == pytest.approx(align(run).velocity, abs=1e-12)
    assert samples_of(prepared(without, VEHICLE), VEHICLE).values[:, 6:9] == pytest.approx(
        samples_of(prepared(run, VEHICLE), VEHICLE).values[:, 6:9], abs=1e-12
    )


@pytest.mark.parametrize(
    "absent, note",
    [
        ((), "u v w are measured"),
        ((*BODY, "vd"), "vn ve not used: to become u v w it takes all"),
        ((*BODY, "psi"), "they need roll, pitch and yaw"),
    ],
)
def test_where_it_cannot_be_used_it_is_said(absent: tuple[str, ...], note: str, run: Recording) -> None:
    found = with_body_velocity(run.without(*absent))
    assert any(note in text for text in found.notes)
    assert [name for name in BODY if name in found] == [name for name in BODY if name not in absent]
    assert with_body_velocity(found).notes == found.notes
    assert with_body_velocity(run.without(*WORLD)).notes == run.notes


def test_enu_and_a_marker(run: Recording, tmp_path: Path) -> None:
    """An EKF that speaks ENU of a point away from the body origin."""
    arm = np.array([0.3, -0.1, 0.2])
    rates = np.column_stack([run[name].values for name in ("p", "q", "r")])
    q = quaternions_from_eulers(np.column_stack([run[name].values for name in ("phi", "theta", "psi")]))
    north, east, down = (world(run) + rotate(q, np.cross(rates, arm))).T
    t = run["u"].t
    table = {"east": east, "north": north, "up": -down}
    enu = {"roll": run["phi"].values + np.pi, "pitch": -run["theta"].values, "yaw": np.pi / 2 - run["psi"].values}
    columns = {"time": t, **table, **enu, **{name: run[name].values for name in ("p", "q", "r")}}
    log = tmp_path / "ekf.csv"
    np.savetxt(log, np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns), comments="")
    mapping = tmp_path / "map.toml"
    mapping.write_text(
        'world = "ENU"\n[columns]\nt = "time"\nvn = "north"\nve = "east"\nvd = "up"\n'
        'phi = "roll"\ntheta = "pitch"\npsi = "yaw"\np = "p"\nq = "q"\nr = "r"\n'
        '[marker]\nposition = [0.3, -0.1, 0.2]\nof = ["velocity"]\n'
    )
    found = tt.read(log, mapping)
    assert "vn" not in found
    for name in BODY:
        assert found[name].values == pytest.approx(run[name].values, abs=1e-9)
