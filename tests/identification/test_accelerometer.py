"""An accelerometer away from the body's origin, whose place nobody knows: what it feels of turning goes with the place
times the coefficients, and must not pass for more information than it is."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import N_MEASURED, NoiseLevels
from towtank.identification.kalman.state import N_FIXED, FilterSettings, new_joint_state
from towtank.identification.kalman.update import update_specific_force
from towtank.identification.model.parameters import PLACES
from towtank.identification.model.prior import prior_of
from towtank.vehicle import configuration_matrix, load_vehicle

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from accelerometer_study import learned

VEHICLE = load_vehicle("vlbv300")
PRIOR = prior_of(VEHICLE, more=PLACES).only(("X_udot", "N_rdot", "M_qdot", "X_uu", "N_r", *PLACES))
AT = np.where(np.isin(PRIOR.names, PLACES), 0.0, PRIOR.mean)
AT[-3:] = 0.2, -0.1, 0.15
AWAY = np.array([0.3, -0.4, 0.2, 0.1, 0.3, 0.1, 0.2, -0.1])


def _expected(theta: Array, linearised_at: Array) -> tuple[Array, Array]:
    """What the accelerometer is expected to show (3,), and the rows of H of the coefficients (3, n)."""
    levels = NoiseLevels(np.full(N_MEASURED, 0.01), np.full(6, 0.01))
    B, settings = configuration_matrix(VEHICLE), FilterSettings(biases=True)
    p = np.array(VEHICLE.parameters)
    state = new_joint_state(p, PRIOR.free, theta, PRIOR.std, B, levels, settings, linearised_at=linearised_at)
    state.x[7:] = 0.4, 0.5, 0.3, -0.6, 0.5, 0.8
    state.tau[:] = 10.0, 5.0, -3.0, 0.2, 3.0, 4.0
    far = np.full(N_MEASURED, np.nan)
    far[12:15] = 1e4  # rejected, so that the innovation stays to be read
    update_specific_force(state, far)
    return far[12:15] - state.innovation, state.H[:3, N_FIXED : N_FIXED + AT.size].copy()


def test_coefficients_and_place_away_from_where_it_is_linearised_count_to_first_order() -> None:
    """What is left is of second order, half as far away a quarter; and the rows stay those of the linearisation."""
    left = []
    for size in (0.1, 0.05):
        theta = AT + size * AWAY
        (first_order, rows), (exactly, _) = _expected(theta, AT), _expected(theta, theta)
        np.testing.assert_array_equal(rows, _expected(AT, AT)[1])
        left.append(np.abs(first_order - exactly).max())
    assert 0.0 < left[1] < 0.3 * left[0]


def test_the_rows_are_its_derivative() -> None:
    step, rows = 1e-6, _expected(AT, AT)[1]
    for c in range(AT.size):
        e = step * np.eye(AT.size)[c]
        (above, _), (below, _) = _expected(AT + e, AT + e), _expected(AT - e, AT - e)
        np.testing.assert_allclose(
            rows[:, c], (above - below) / (2.0 * step), rtol=1e-5, atol=1e-6, err_msg=PRIOR.names[c]
        )


def test_an_accelerometer_that_nobody_says_the_place_of() -> None:
    """Rows that followed the coefficients ended 25 % off at eight deviations."""
    off = np.array([size for _, size in learned("off", 3).values()])
    assert off.size > 20
    assert np.sqrt(np.mean(off**2)) < 1.5
    assert np.abs(off).max() < 4.0
