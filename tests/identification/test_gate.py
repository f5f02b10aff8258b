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
from towtank.simulation import Mocap, simulate
from towtank.vehicle import Vehicle, load_vehicle

from .test_joint_filter import filter_for, run_through

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


@pytest.mark.parametrize(
    ("force", "most", "share"),
    [(6.0, 0.01, 0.02), (15.0, 0.03, 0.9)],  # of 12 and 30 times what disturbs the vehicle, for the filter's part
)
@pytest.mark.parametrize("hidden", [0, 30])
def test_a_vehicle_that_is_pushed_is_followed(
    vehicle: Vehicle, force: float, most: float, share: float, hidden: int
) -> None:
    """Also where nothing shows it for a moment: what comes then is centimetres away, and goes on from there.

    Held for a marker that has jumped, it is left out for most of the time and 7 and 36 cm away.
    """
    shown = run_pushed(vehicle, force)
    samples = with_pose(shown, slice(PUSHED, PUSHED + hidden), slice(0, 6), np.nan)
    away, left_out = followed(vehicle, samples, shown)
    assert away.max() < most
    assert left_out.mean() < share + 0.1 * bool(hidden)


@pytest.mark.parametrize("size", [0.006, 0.02, 0.3])
def test_a_marker_that_jumps_is_not(vehicle: Vehicle, pushed: Samples, size: float) -> None:
    calm = after(vehicle, pushed, 350)
    moved = with_pose(pushed, slice(300, 350), slice(0, 3), pushed.values[300:350, :3] + size)
    state = after(vehicle, moved, 350)
    assert state.statistics["rejected"][0] >= 45
    np.testing.assert_allclose(state.x[:3], calm.x[:3], atol=5.0 * NOISE)


def test_nor_is_one_that_jumps_again_and_again(vehicle: Vehicle, pushed: Samples) -> None:
    """Half of the samples spikes: a spike is no neighbour that the next one could go on from."""
    calm = after(vehicle, pushed, 400)
    values = pushed.values[300:400, 0] + 0.05 * (np.arange(100) % 2)
    state = after(vehicle, with_pose(pushed, slice(300, 400), slice(0, 1), values[:, None]), 400)
    assert state.statistics["rejected"][0] >= 45
    np.testing.assert_allclose(state.x[:3], calm.x[:3], atol=5.0 * NOISE)


def test_nor_a_pose_that_is_dead(vehicle: Vehicle, pushed: Samples) -> None:
    """One that shows the same while the vehicle moves drifts away as slowly as a vehicle that is pushed."""
    calm = after(vehicle, pushed, 355)
    assert np.linalg.norm(pushed.values[355, :3] - pushed.values[300, :3]) > 0.05
    dead = with_pose(pushed, slice(300, 355), slice(0, 6), pushed.values[300, :6])
    state = after(vehicle, dead, 355)
    assert state.statistics["rejected"][0] > 20
    np.testing.assert_allclose(state.x[:3], calm.x[:3], atol=0.02)


def test_a_sample_costs_as_much_whether_it_is_left_out_or_not(vehicle: Vehicle, pushed: Samples) -> None:
    """Once; what goes on beyond the gate is no likelier than what is rejected at it."""
    one = with_pose(pushed, slice(300, 301), slice(0, 3), pushed.values[300, :3] + 0.3)
    none = with_pose(pushed, slice(300, 301), slice(0, 3), np.nan)
    left_out, missing = after(vehicle, one, 301), after(vehicle, none, 301)
    cost = missing.clock[0].log_likelihood - left_out.clock[0].log_likelihood
    S = np.diag(missing.P)[:3] + NOISE**2
    assert cost == pytest.approx(0.5 * np.sum(np.log(S) + 2.0 * (2.0 * 4.5 - 2.0)), abs=1e-4)
