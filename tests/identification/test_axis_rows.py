"""The six axis rows: an identity of the true vehicle's motion, exact but for the quadrature."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.identification.least_squares.recursion import axis_increments_into
from towtank.identification.model.terms import AXES, C_CONSTANT, C_FORCE, C_LHS, C_LINEAR, C_QUADRATIC, C_RESTORING
from towtank.simulation import simulate
from towtank.vehicle import Vehicle, inverse_dynamics

from .runs import POSE, VELOCITY, box, table

# Everything that the rows claim to honour: off-diagonal inertia and damping, offsets, net weight, constants, lift.
FULL = {
    "X_udot": -10.0, "Y_vdot": -20.0, "Z_wdot": -25.0, "K_pdot": -0.5, "M_qdot": -0.6, "N_rdot": -0.8,
    "Y_rdot": 0.6, "Z_qdot": -0.5, "X_qdot": 0.3, "K_rdot": 0.1,
    "X_u": -4.0, "Y_v": -7.0, "Z_w": -6.0, "K_p": -0.5, "M_q": -0.6, "N_r": -0.7, "Y_r": 0.4, "N_v": 0.3, "M_w": -0.2,
    "X_uu": -30.0, "Y_vv": -60.0, "Z_ww": -70.0, "K_pp": -1.0, "M_qq": -1.5, "N_rr": -2.0, "Y_rr": 0.5, "N_vv": -0.6,
    "X_0": 0.7, "Y_0": -0.4, "Z_0": 0.9, "K_0": 0.05, "M_0": -0.06, "N_0": 0.08,
    "Y_uv": -9.0, "Y_ur": 2.0, "N_uv": 1.5, "N_ur": -0.8, "K_up": -0.2, "Z_uw": -8.0, "Z_uq": -1.6, "M_uw": -1.1,
    "M_uq": -0.7,
}  # fmt: skip


def full() -> Vehicle:
    return box(
        rigid_body={"mass": 20.0, "inertia": (1.0, 1.2, 1.5), "centre_of_gravity": (0.02, -0.01, 0.03)},
        buoyancy={"force": 190.0, "centre": (-0.01, 0.02, -0.04)},
        hydrodynamics=FULL,
    )


def residuals(vehicle: Vehicle, h: float, p: np.ndarray | None = None, speed: float = 1.0) -> np.ndarray:
    """Violation (n, 6) of the identity per unit of time, over 0.3 s of coupled motion, no velocity passing zero."""
    start, tilt = speed * np.array([1.0, 0.9, 0.8, 1.2, 1.1, 1.3]), np.array([0, 0, 0, 0.2, -0.3, 1.0])
    steady = inverse_dynamics(vehicle, tilt, start, np.zeros(6))  # what keeps it going so, for a start
    pushes = steady + np.random.default_rng(2).normal(size=(3, 6)) * [9, 9, 9, 0.9, 0.9, 0.9]
    wrench = np.repeat(pushes, round(0.1 / h), axis=0)
    log = simulate(vehicle, wrench=wrench, dt=h, eta0=tilt, nu0=start, substeps=20)
    nu, eta = table(log, VELOCITY), table(log, POSE)
    assert nu.min() > 0.01
    phi, theta = eta[:, 3], eta[:, 4]
    k = np.column_stack([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
    true = vehicle.mass_matrix
    out = np.empty((6, 6))
    found = []
    for i in range(len(wrench)):
        axis_increments_into(
            np.array(vehicle.parameters) if p is None else p,
            nu[i : i + 2], k[i : i + 2], wrench[i] * h, np.zeros(6), h, np.zeros((12, 6)), out,
        )  # fmt: skip
        row = []
        for axis in AXES:
            a = axis.index
            named = [vehicle.coefficient(name) if name else 0.0 for name in axis.columns]
            known = sum(
                c * out[a, column]
                for c, column in zip(named, (C_LINEAR, C_QUADRATIC, C_RESTORING, C_CONSTANT), strict=True)
            )
            row.append((known + out[a, C_FORCE] - true[a, a] * out[a, C_LHS]) / true[a, a] / h)
        found.append(row)
    return np.array(found)


def test_the_identity_holds_for_the_whole_coupled_vehicle() -> None:
    assert np.abs(residuals(full(), 0.01)).max() < 5e-8


def test_its_error_is_of_fifth_order_in_one_interval() -> None:
    errors = [np.abs(residuals(full(), h)).max(axis=0) for h in (0.05, 0.025)]
    assert np.log2(errors[0] / errors[1]).min() > 3.6  # per unit of time: one order less


def test_a_wrong_model_of_the_slopes_costs_third_order_only() -> None:
    """On a decoupled axis the model serves the end correction alone."""
    truth = box(hydrodynamics={"X_udot": -10.0, "X_u": -30.0})
    wrong = np.array(box(hydrodynamics={"X_udot": -40.0, "X_u": -5.0}).parameters)

    def worst(h: float, p: np.ndarray | None) -> float:
        wrench = np.zeros((round(1.0 / h), 6))
        nu = table(simulate(truth, wrench=wrench, dt=h, nu0=(1, 0, 0, 0, 0, 0), substeps=20), VELOCITY)
        k = np.tile([0.0, 0.0, 1.0], (2, 1))
        out, error = np.empty((6, 6)), 0.0
        for i in range(len(wrench)):
            model = np.array(truth.parameters) if p is None else p
            axis_increments_into(model, nu[i : i + 2], k, np.zeros(6), np.zeros(6), h, np.zeros((12, 6)), out)
            error = max(error, abs(-30.0 * out[0, C_LINEAR] - 30.0 * out[0, C_LHS]) / h)
        return error

    assert np.log2(worst(0.05, wrong) / worst(0.025, wrong)) == pytest.approx(2.0, abs=0.2)
    assert worst(0.025, None) < 0.1 * worst(0.025, wrong)


def test_sums_of_increments_are_integrals_of_the_motion() -> None:
    """Over a whole run: the linear column of u adds up to the distance, the left-hand side to the change of speed."""
    vehicle = box()
    wrench = np.zeros((2000, 6))
    wrench[:, 0] = 20 * np.sign(np.sin(1.3 * np.arange(2000) * 0.01))
    log = simulate(vehicle, wrench=wrench, dt=0.01)
    nu = table(log, VELOCITY)
    k = np.tile([0.0, 0.0, 1.0], (2, 1))
    out, total = np.empty((6, 6)), np.zeros((6, 6))
    for i in range(2000):
        p = np.array(vehicle.parameters)
        axis_increments_into(p, nu[i : i + 2], k, wrench[i] * 0.01, np.zeros(6), 0.01, np.zeros((12, 6)), out)
        total += out
    assert total[0, C_LINEAR] == pytest.approx(log["x"].values[-1], abs=1e-8)
    assert total[0, C_LHS] == pytest.approx(nu[-1, 0], abs=1e-12)
    assert total[0, C_FORCE] == pytest.approx(wrench[:, 0].sum() * 0.01, abs=1e-9)
    assert total[:, C_CONSTANT] == pytest.approx([20, 20, 0, 20, 20, 20])
    assert total[2, C_RESTORING] == pytest.approx(20.0)
