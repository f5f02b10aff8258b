"""A pose beyond the gate: one that fails jumps, and a vehicle that is pushed by an unknown force does not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.core.zero_order_hold import new_zero_order_hold
from towtank.identification.data.samples import Samples, samples_of
from towtank.identification.kalman.filter import joint_events, rows_of
from towtank.identification.kalman.state import JointState
from towtank.simulation import Ins, Mocap, simulate
from towtank.vehicle import Vehicle, load_vehicle

from .test_joint_filter import filter_for, run_of, run_through

DT, PUSHED = 0.01, 500  # s; row of the push
NOISE = 1e-3  # m, rad


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("vlbv300")


def run_pushed(vehicle: Vehicle, force: float) -> Samples:
    """A run in which a force [N] and a moment of a tenth of it [N m], that nobody told of, act from 5 s on."""
    own = np.zeros((800, 6))
    own[:, 0] = 20.0 * np.sin(0.8 * DT * np.arange(800))
    felt = own.copy()
    felt[PUSHED:, 0] += force
    felt[PUSHED:, 5] += 0.1 * force
    run = simulate(vehicle, wrench=felt, dt=DT, sensors=Mocap(noise_mm=1.0, jump_fraction=0.0), seed=3)
    told = samples_of(simulate(vehicle, wrench=own, dt=DT, sensors=Mocap(jump_fraction=0.0), seed=3), vehicle)
    return replace(samples_of(run, vehicle), input_t=told.input_t, input_force=told.input_force)


@pytest.fixture(scope="module")
def pushed(vehicle: Vehicle) -> Samples:
    return run_pushed(vehicle, 6.0)


def after(vehicle: Vehicle, samples: Samples, last: int) -> JointState:
    return run_through(filter_for(vehicle, B=samples.B, off=0.0), samples, last)


def followed(vehicle: Vehicle, samples: Samples, shown: Samples) -> tuple[Array, Array]:
    """Return how far [m] the position is from what was shown, and whether a pose is left out, row by row from the push
    on."""
    state, held = filter_for(vehicle, B=samples.B, off=0.0), new_zero_order_hold(samples.B.shape[1], samples.lag, 0.0)
    rows, taken = rows_of(samples), 0
    away, left_out = np.zeros(len(samples)), np.zeros(len(samples), dtype=bool)
    for i in range(len(samples)):
        taken = joint_events(state, held, rows, i, i + 1, taken)
        away[i] = np.abs(state.x[:3] - shown.values[i, :3]).max()
        left_out[i] = (state.outages["rejected"][:2] > 0.0).any()
    return away[PUSHED:], left_out[PUSHED:]


def with_pose(samples: Samples, rows: slice, columns: slice, values: Array | float) -> Samples:
    changed = samples.values.copy()
    changed[rows, columns] = values
    return replace(samples, values=changed)


def test_a_vehicle_that_is_pushed_is_followed(vehicle: Vehicle, pushed: Samples) -> None:
    """By twelve times what the filter supposes; held for a marker that has jumped it is left out for most of the time,
    and 7 cm away."""
    away, left_out = followed(vehicle, pushed, pushed)
    assert away.max() < 0.01
    assert left_out.mean() < 0.02


def test_depths_between_two_positions_do_not_matter(vehicle: Vehicle, pushed: Samples) -> None:
    """A number that is not there is not forgotten, up to the time for which two samples are neighbours."""
    rows = np.arange(len(pushed)) % 2 == 1
    changed = pushed.values.copy()
    changed[rows, :2] = np.nan
    away, left_out = followed(vehicle, replace(pushed, values=changed), pushed)
    assert away.max() < 0.015
    assert left_out.mean() < 0.02


def test_an_attitude_that_leaves_its_gyros_in_some_samples_is_followed(vehicle: Vehicle) -> None:
    """As where its error turns with the vehicle; refused, it stays so until it is taken at its word."""
    calm = run_of(vehicle, Ins(gyro_bias=0.0, attitude_noise_mrad=1.0, heading_noise_mrad=1.0))
    gone = with_pose(calm, slice(300, 700), slice(5, 6), calm.values[300:700, 5:6] + 8e-3 * np.minimum(ramp(400), 1.0))
    state, beside = (run_through(filter_for(vehicle, B=each.B, off=0.0), each, 400) for each in (gone, calm))
    assert state.statistics["rejected"][5] - beside.statistics["rejected"][5] <= 3.0


def ramp(rows: int) -> Array:
    return (np.arange(rows)[:, None] + 1.0) / 20.0


def test_a_position_that_drifts_off_beside_its_own_speed_is_refused(vehicle: Vehicle) -> None:
    """Faster than noise lets one sample go on from the last ones."""
    calm = run_of(vehicle, Mocap(noise_mm=1.0, jump_fraction=0.0))
    values = calm.values.copy()
    values[:, 6:9] = run_of(vehicle, Ins()).values[:, 6:9]
    drifting = values.copy()
    drifting[300:340, :3] += 0.002 * np.arange(1, 41)[:, None]
    state = run_through(filter_for(vehicle, B=calm.B, off=0.0), replace(calm, values=drifting), 340)
    beside = run_through(filter_for(vehicle, B=calm.B, off=0.0), replace(calm, values=values), 340)
    assert state.statistics["rejected"][0] - beside.statistics["rejected"][0] > 20
    np.testing.assert_allclose(state.x[:3], beside.x[:3], atol=0.02)


@pytest.mark.parametrize("off", [0.0, 2.7])
def test_an_outlier_by_chance_costs_one_sample(vehicle: Vehicle, off: float) -> None:
    """Also where the filter is a little off, as a model mostly is: what goes on so has not jumped."""
    calm = run_of(vehicle, Mocap(noise_mm=0.0, jump_fraction=0.0))
    values = calm.values[400:450, 0] + NOISE * np.where(np.arange(50) == 0, 5.2, off)
    state = run_through(
        filter_for(vehicle, B=calm.B, off=0.0), with_pose(calm, slice(400, 450), slice(0, 1), values[:, None]), 450
    )
    assert 1.0 <= state.statistics["rejected"][0] <= 3.0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("columns", "size"), [(slice(0, 3), 0.02), (slice(0, 3), 0.3), (slice(5, 6), 0.3)])
def test_a_marker_that_jumps_is_left_out(vehicle: Vehicle, columns: slice, size: float, seed: int) -> None:
    """For half a second, while a force that is as large as it is supposed to be moves the vehicle."""
    calm = run_of(vehicle, Mocap(noise_mm=1.0, jump_fraction=0.0), seed=seed)
    moved = with_pose(calm, slice(400, 450), columns, calm.values[400:450, columns] + size)
    state, beside = (run_through(filter_for(vehicle, B=each.B, off=0.0), each, 450) for each in (moved, calm))
    assert state.statistics["rejected"][columns].min() >= 45
    assert state.clock[0].resets == 0.0
    np.testing.assert_allclose(state.x[:3], beside.x[:3], atol=0.02)
    assert abs(float(state.x[3:7] @ beside.x[3:7])) > np.cos(0.01)


def test_so_is_one_that_jumps_again_and_again(vehicle: Vehicle, pushed: Samples) -> None:
    """Half of the samples spikes: a spike is no neighbour that the next one could go on from."""
    calm = after(vehicle, pushed, 400)
    values = pushed.values[300:400, 0] + 0.05 * (np.arange(100) % 2)
    state = after(vehicle, with_pose(pushed, slice(300, 400), slice(0, 1), values[:, None]), 400)
    assert state.statistics["rejected"][0] >= 45
    np.testing.assert_allclose(state.x[:3], calm.x[:3], atol=5.0 * NOISE)


def test_so_is_a_pose_that_is_dead(vehicle: Vehicle, pushed: Samples) -> None:
    """One that shows the same while the vehicle moves drifts away as slowly as a vehicle that is pushed."""
    calm = after(vehicle, pushed, 355)
    assert np.linalg.norm(pushed.values[355, :3] - pushed.values[300, :3]) > 0.05
    dead = with_pose(pushed, slice(300, 355), slice(0, 6), pushed.values[300, :6])
    state = after(vehicle, dead, 355)
    assert state.statistics["rejected"][0] > 20
    np.testing.assert_allclose(state.x[:3], calm.x[:3], atol=0.02)


def test_a_sample_that_is_left_out_costs_as_much_as_one_at_the_gate(vehicle: Vehicle, pushed: Samples) -> None:
    one = with_pose(pushed, slice(300, 301), slice(0, 3), pushed.values[300, :3] + 0.3)
    none = with_pose(pushed, slice(300, 301), slice(0, 3), np.nan)
    left_out, missing = after(vehicle, one, 301), after(vehicle, none, 301)
    cost = missing.clock[0].log_likelihood - left_out.clock[0].log_likelihood
    S = np.diag(missing.P)[:3] + NOISE**2
    assert cost == pytest.approx(0.5 * np.sum(np.log(S) + 2.0 * (2.0 * 4.5 - 2.0)), abs=1e-4)
