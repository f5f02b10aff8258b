"""Velocity through the water: in every kind of file, frame and grid what velocity over ground is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import towtank as tt
from towtank.live.pipeline.frames import MarkerArm
from towtank.live.pipeline.frames import to_ned_frd as sample_to_ned_frd
from towtank.recording import Marker, Recording, align, dead_channels, marker_to_origin, to_ned_frd
from towtank.recording.standard import LINEAR_VELOCITY, MEASURED, MOTION, RATES, RELATIVE_VELOCITY

ARM = (0.4, -0.1, 0.25)


@pytest.fixture(scope="module")
def run() -> Recording:
    """A turning, rolling body: u v w at 20 Hz, a speed log at 5 Hz that measures u_w v_w w_w."""
    rng = np.random.default_rng(5)
    t = np.arange(401) / 20.0
    slow = t[::4]
    table = {name: np.sin((0.3 + 0.1 * k) * t) + 1e-3 * rng.normal(size=t.size) for k, name in enumerate("uvwpqr")}
    fast = Recording.from_table(t, table)
    water = {f"{name}_w": 0.2 + np.cos(0.4 * slow) + 1e-3 * rng.normal(size=slow.size) for name in "uvw"}
    return fast.replace(Recording.from_table(slow, water).channels)


def as_ground(run: Recording) -> Recording:
    """The same recording, the velocity through the water under the names of that over ground."""
    rest = run.without(*LINEAR_VELOCITY)
    moved = [rest[name].renamed(name[0]) for name in RELATIVE_VELOCITY]
    return rest.without(*RELATIVE_VELOCITY).replace(moved)


def test_its_columns_stand_behind_those_of_the_motion() -> None:
    assert MEASURED[: len(MOTION)] == MOTION
    assert MEASURED[len(MOTION) :] == ("u_w", "v_w", "w_w")


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".mcap", ".mat"])
def test_files_keep_it(run: Recording, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"run{suffix}"
    if suffix == ".mat":
        from scipy.io import savemat

        of = {"fast": LINEAR_VELOCITY + RATES, "water": RELATIVE_VELOCITY}
        savemat(
            path,
            {k: {"t": run[v[0]].t, **{name: run[name].values for name in v}} for k, v in of.items()},
        )
    else:
        run.write(path)
    again = tt.read(path)
    for name in RELATIVE_VELOCITY:
        assert again[name] == run[name]
        assert (again[name].unit, again[name].frame) == ("m/s", "FRD")


def test_a_topic_of_two_velocities_is_not_taken_for_that_of_one(tmp_path: Path) -> None:
    t = np.arange(20) / 10.0
    two = Recording.from_table(t, {"u": t, "w": -t})
    run = two.replace(Recording.from_table(t[::2], {"u_w": 2.0 * t[::2]}).channels)
    run.write(tmp_path / "run.mcap")
    again = tt.read(tmp_path / "run.mcap")
    assert all(again[name] == run[name] for name in ("u", "w", "u_w"))


def test_a_mapping_names_it(tmp_path: Path) -> None:
    t = np.arange(10) / 10.0
    rows = "".join(f"{a},{100.0 * a},{a * a},{1.0}\n" for a in t)
    (tmp_path / "pitot.csv").write_text("time,cm_per_s,port,up\n" + rows)
    (tmp_path / "map.toml").write_text(
        'body = "FLU"\n[columns]\nt = "time"\nu_w = { from = "cm_per_s", scale = 0.01 }\nv_w = "port"\nw_w = "up"\n'
    )
    run = tt.read(tmp_path / "pitot.csv", tmp_path / "map.toml")
    np.testing.assert_allclose(run["u_w"].values, t)
    np.testing.assert_allclose(run["v_w"].values, -t * t)
    np.testing.assert_allclose(run["w_w"].values, -1.0)


def test_frames_turn_it_as_velocity_over_ground(run: Recording) -> None:
    turned, expected = to_ned_frd(run, body="FLU"), to_ned_frd(as_ground(run), body="FLU")
    sample = sample_to_ned_frd({name: run[name].values[3] for name in RELATIVE_VELOCITY}, "FLU", "ENU")
    for name in RELATIVE_VELOCITY:
        assert np.array_equal(turned[name].values, expected[name[0]].values)
        assert sample[name] == turned[name].values[3]


def test_the_lever_arm_moves_it_as_velocity_over_ground(run: Recording) -> None:
    moved, expected = marker_to_origin(run, ARM, ["velocity"]), marker_to_origin(as_ground(run), ARM, ["velocity"])
    for name in RELATIVE_VELOCITY:
        assert np.array_equal(moved[name].values, expected[name[0]].values)
    alone = marker_to_origin(run.without("u", "v", "w", "v_w", "w_w"), ARM, ["velocity"])
    assert alone["u_w"] == moved["u_w"]
    arm = MarkerArm(Marker(position=ARM))
    row = {name: float(run[name].values[8]) for name in RATES}
    row |= {name: float(run[name].values[2]) for name in RELATIVE_VELOCITY}
    sample = arm.to_origin(row)
    for name in RELATIVE_VELOCITY:
        assert sample[name] == pytest.approx(moved[name].values[2], abs=1e-14)


def test_the_grid_has_it_as_velocity_over_ground(run: Recording) -> None:
    values = run["u_w"].values.copy()
    values[20:30], values[60] = np.nan, 9.0  # a gap, a spike
    run = run.replace([run["u_w"].with_values(values)])
    grid, expected = align(run, rate=20.0), align(as_ground(run).replace([run["u"].renamed("vn")]), rate=20.0)
    assert np.array_equal(grid.further, expected.velocity[:, :3], equal_nan=True)
    assert np.array_equal(grid.fresh[:, 15:], expected.fresh[:, 6:9])
    assert np.isnan(grid.further[85:115, 0]).all()
    assert "1 spike in u_w" in grid.repairs.details


def test_without_it_the_grid_holds_a_single_nan(run: Recording) -> None:
    grid = align(run.without(*RELATIVE_VELOCITY))
    assert grid.further.shape == (len(grid), 3)
    assert grid.further.strides == (0, 0)
    assert not grid.fresh[:, 15:].any()


def test_a_dead_log_is_found() -> None:
    t = np.arange(1000) / 10.0
    rng = np.random.default_rng(1)
    water = {"u_w": rng.normal(size=t.size), "v_w": np.zeros_like(t), "w_w": rng.normal(size=t.size)}
    assert dead_channels(Recording.from_table(t, water)) == ("v_w",)
