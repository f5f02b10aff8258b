"""The step's linearisation against differences of the step itself; the free coefficients against the vehicle."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.core.attitude import quaternion_product
from towtank.core.forces import add_inflow_damping_into
from towtank.core.layout import I_CONSTANT, I_INFLOW, I_MASS, I_MASS_INVERSE
from towtank.core.rk4 import simulate_run
from towtank.errors import InputError
from towtank.identification.kalman.state import transition_scratch
from towtank.identification.model.linearisation import inflow_wrench_into, step_and_linearise
from towtank.identification.model.parameters import (
    N_FIXED,
    FreeParameters,
    free_parameters,
    invert_mass,
    put_parameters,
)
from towtank.identification.model.prior import prior_of
from towtank.vehicle import Vehicle, configuration_matrix, load_vehicle

NAMES = (
    *("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot", "Y_rdot", "X_qdot"),
    *("X_u", "Y_vv", "N_rr", "N_v", "K_pp", "W_minus_B", "BG_x", "BG_y", "BG_z", "X_0", "N_0"),
    *("Y_uv", "Y_ur", "N_uv", "N_ur", "K_up", "Z_uw", "Z_uq", "M_uw", "M_uq"),
    *("X_u2", "Y_v2", "Z_w2", "K_p2", "M_q2", "N_r2"),
    *("delay", "lag"),
)
MASSES = NAMES[:8]
H = 0.01


@pytest.fixture
def vehicle() -> Vehicle:
    start = load_vehicle("vlbv300")
    lift = {"Y_uv": -30.0, "Y_ur": 6.0, "N_uv": 4.0, "N_ur": -2.0, "K_up": -0.4, "Z_uw": -28.0, "Z_uq": -5.0}
    others = {"Y_rdot": 0.7, "X_qdot": -0.4, "N_v": -1.3, "X_u": -4.0, "BG_x": 0.3, "BG_y": -0.2}
    others |= {"X_u2": 9.0, "Y_v2": -7.0, "Z_w2": 12.0, "K_p2": 0.4, "M_q2": -0.3, "N_r2": 0.5}
    return start.with_coefficients({**lift, "M_uw": 3.0, **others})


def _moved(x: Array, error: Array) -> Array:
    out = x.copy()
    out[:3] += error[:3]
    size = float(np.linalg.norm(error[3:6]))
    axis = error[3:6] / size if size else np.zeros(3)
    turn = np.concatenate([[np.cos(0.5 * size)], np.sin(0.5 * size) * axis])
    out[3:7] = quaternion_product(x[3:7], turn)
    out[7:] += error[6:12]
    return out


def _difference(a: Array, b: Array) -> Array:
    """Error of a as seen from b."""
    inverse = b[3:7] * np.array([1.0, -1.0, -1.0, -1.0])
    e = quaternion_product(inverse, a[3:7])
    return np.concatenate([a[:3] - b[:3], 2.0 * np.sign(e[0]) * e[1:], a[7:] - b[7:]])


class Step:
    """One step of a vehicle, as a function of everything that it is linearised by.

    The disturbance is an acceleration: whatever the mass matrix is, it does the same to the speeds.
    """

    def __init__(self, vehicle: Vehicle, free: FreeParameters) -> None:
        generator = np.random.default_rng(3)
        self.free = free
        self.theta = free.theta(vehicle, delay=0.0, lag=0.2)
        self.p = vehicle.parameters.copy()
        self.shape = configuration_matrix(vehicle)
        m = self.shape.shape[1]
        self.pushed = generator.normal(size=(3, m))
        self.x = np.concatenate([[1.0, 2.0, 3.0], [0.9, 0.2, -0.3, 0.1], [0.4, -0.2, 0.15, 0.3, -0.4, 0.5]])
        self.x[3:7] /= np.linalg.norm(self.x[3:7])
        self.disturbance = np.linalg.solve(vehicle.mass_matrix, generator.normal(size=6))
        self.current = np.array([0.1, -0.2, 0.05])

    def run(self, error: Array) -> Array:
        theta = self.theta + error[N_FIXED:]
        p = self.p.copy()
        assert put_parameters(p, self.free.codes, theta, np.empty((6, 6)))
        steps = error[N_FIXED:]
        push = self.pushed[0].copy()
        for k, name in enumerate(self.free.names):
            row = {"delay": 1, "lag": 2}.get(name)
            if row is not None:
                push += steps[k] * self.pushed[row] / (self.theta[k] if name == "lag" else 1.0)  # by its logarithm
        add_inflow_damping_into(self.shape, self.pushed[0], p[I_INFLOW], p)
        mass = p[I_MASS:I_MASS_INVERSE].reshape(6, 6)
        tau = self.shape @ push + mass @ (self.disturbance + error[12:18])
        x = _moved(self.x, error)
        current = self.current + error[18:21]
        velocity = x.copy()
        R = _rotation(x[3:7])
        velocity[7:10] += R.T @ current  # simulate_run takes the absolute velocity
        out = simulate_run(p, velocity, tau.reshape(1, 1, 6), H, current)[1]
        out[7:10] -= _rotation(out[3:7]).T @ current
        return out

    def linearised(self) -> tuple[Array, Array]:
        F, A, work, scratch = transition_scratch(len(self.free))
        p = self.p.copy()
        assert put_parameters(p, self.free.codes, self.theta, np.empty((6, 6)))
        add_inflow_damping_into(self.shape, self.pushed[0], p[I_INFLOW], p)
        x = self.x.copy()
        tau = self.shape @ self.pushed[0]
        step_and_linearise(
            p,
            x,
            tau,
            self.disturbance,
            self.current,
            H,
            0.0,
            self.free.codes,
            self.theta,
            self.shape,
            self.pushed,
            F,
            A,
            work,
            scratch,
        )
        return x, F


def _rotation(q: Array) -> Array:
    from towtank.core.attitude import rotation_from_quaternion

    return rotation_from_quaternion(q)


def test_the_step_is_the_simulators(vehicle: Vehicle) -> None:
    step = Step(vehicle, free_parameters(vehicle, NAMES))
    x, _ = step.linearised()
    np.testing.assert_allclose(x, step.run(np.zeros(N_FIXED + len(step.free))), atol=1e-13)


def _by_differences(step: Step) -> Array:
    n = N_FIXED + len(step.free)
    found = np.empty((12, n))
    for j in range(n):
        error = np.zeros(n)
        error[j] = 1e-5
        found[:, j] = (_difference(step.run(error), step.run(-error))) / 2e-5
    return found


def test_every_column_is_the_derivative(vehicle: Vehicle) -> None:
    step = Step(vehicle, free_parameters(vehicle, NAMES))
    _, F = step.linearised()
    found = _by_differences(step)
    # F is second order in the step: what is left is h^3 times the fastest rate cubed.
    assert (np.abs(F - found) <= 2e-4 * np.abs(found).max(axis=0)).all()


def test_a_disturbance_is_an_acceleration_and_says_nothing_of_inertia(vehicle: Vehicle) -> None:
    """The speeds that it adds are its own, and what an inertia does is known beside it however large it is."""
    step, none = (Step(vehicle, free_parameters(vehicle, MASSES)) for _ in range(2))
    step.disturbance *= 5.0
    none.disturbance *= 0.0
    x, F = step.linearised()
    found = _by_differences(step)
    np.testing.assert_allclose(F[6:, 12:18], H * np.eye(6), atol=0.03 * H)  # damping and Coriolis within the step
    np.testing.assert_allclose(_difference(x, none.linearised()[0])[6:], H * step.disturbance, atol=5e-4)
    inertias = slice(N_FIXED, None)
    assert (np.abs(F - found)[:, inertias] <= 1e-3 * np.abs(found).max(axis=0)[inertias]).all()
    # taken for a force, it would be among the accelerations that inertia takes part in
    off = np.abs(none.linearised()[1] - F)[6:, inertias].max(axis=0)
    assert (off < 0.05 * H * np.abs(step.disturbance).max()).all()


def test_the_loss_by_inflow_is_damping_by_the_thrusters(vehicle: Vehicle) -> None:
    free = free_parameters(vehicle, ("X_udot", "inflow_loss"))
    step = Step(vehicle, free)
    step.theta[1] = 0.25  # s/m
    x, F = step.linearised()
    np.testing.assert_allclose(x, step.run(np.zeros(N_FIXED + 2)), atol=1e-13)
    found = _by_differences(step)
    assert (np.abs(F - found) <= 2e-4 * np.abs(found).max(axis=0)).all()
    assert np.abs(found[6:, -1]).max() > 1e-4


def test_the_wrench_of_inflow_is_the_thrust_that_each_thruster_loses() -> None:
    generator = np.random.default_rng(11)
    B, forces, nu = generator.normal(size=(6, 5)), generator.normal(size=5), generator.normal(size=6)
    out, p = np.empty(6), np.zeros(I_CONSTANT + 100)
    inflow_wrench_into(B, forces, nu, out)
    lost = [abs(force) * (column @ nu) for force, column in zip(forces, B.T, strict=True)]
    np.testing.assert_allclose(out, -B @ lost, rtol=1e-12)
    assert out @ nu < 0.0  # it takes work, ahead and astern
    add_inflow_damping_into(B, forces, 1.0, p)
    linear = p[72:108].reshape(6, 6)
    np.testing.assert_allclose(out, linear @ nu, rtol=1e-12)


def test_gains_are_the_inputs_forces(vehicle: Vehicle) -> None:
    """A gain does what the disturbance does that its thrust makes: M^-1 times it."""
    name = f"gain_{vehicle.thrusters[0].name}"
    step = Step(vehicle, free_parameters(vehicle, (name,)))
    _, F = step.linearised()
    push = step.shape[:, 0] * step.pushed[0, 0]
    acceleration = np.linalg.solve(step.p[I_MASS:I_MASS_INVERSE].reshape(6, 6), push)
    np.testing.assert_allclose(F[:, N_FIXED], F[:, 12:18] @ acceleration, rtol=1e-11)


def test_theta_and_back(vehicle: Vehicle) -> None:
    free = free_parameters(vehicle, NAMES)
    theta = free.theta(vehicle, delay=0.03, lag=0.2)
    values = free.values(theta)
    for name, value in zip(free.names, values, strict=True):
        expected = {"delay": 0.03, "lag": 0.2}.get(name)
        assert value == pytest.approx(vehicle.coefficient(name) if expected is None else expected, rel=1e-12)
    np.testing.assert_allclose(free.thetas(values), theta, rtol=1e-12)
    shift = 1e-6
    for k in range(len(free)):
        moved = theta.copy()
        moved[k] += shift
        assert (free.values(moved) - values)[k] / shift == pytest.approx(free.slopes(theta)[k], rel=1e-5)


def test_put_back_is_the_vehicle(vehicle: Vehicle) -> None:
    free = free_parameters(vehicle, NAMES)
    p = vehicle.parameters.copy()
    p[I_MASS:I_MASS_INVERSE] *= 1.0
    assert put_parameters(p, free.codes, free.theta(vehicle, delay=0.0, lag=0.1), np.empty((6, 6)))
    np.testing.assert_allclose(p, vehicle.parameters, rtol=1e-9, atol=1e-12)


def test_the_mirror_of_a_coupling_is_the_same_number(vehicle: Vehicle) -> None:
    assert free_parameters(vehicle, ("Y_rdot", "N_vdot")).names == ("Y_rdot",)


def test_sizes_of_forward_speed_terms_are_those_of_published_vehicles() -> None:
    """Within a factor of six of REMUS 100 (Prestero, 2001, without parts of the added mass) and of the ECA A9."""
    published = {
        (31.0, 0.18, 3.45): {"Y_uv": 28.6, "Y_ur": 6.2, "N_uv": 10.6, "N_ur": 3.9},
        (69.7, 0.6, 35.0): {"Y_uv": 162.0, "Y_ur": 150.0, "N_uv": 34.0, "N_ur": 32.0, "K_up": 13.0, "Z_uq": 100.0},
    }
    for (mass, inertia_x, inertia_y), values in published.items():
        body = Vehicle(name="a", rigid_body={"mass": mass, "inertia": (inertia_x, inertia_y, inertia_y)})
        prior = prior_of(body, commands=False, more=tuple(values)).only(tuple(values))
        ratios = np.array([prior.std[prior.names.index(name)] / value for name, value in values.items()])
        assert ratios.max() < 12.0
        assert ratios.min() > 1.0 / 6.0


def test_an_unknown_name_is_one_line(vehicle: Vehicle) -> None:
    with pytest.raises(InputError, match="X_udto"):
        free_parameters(vehicle, ("X_udto",))


def test_inverse_by_cholesky() -> None:
    generator = np.random.default_rng(0)
    root = generator.normal(size=(6, 6))
    p = np.zeros(I_CONSTANT + 6)
    p[:36] = (root @ root.T + np.eye(6)).ravel()
    assert invert_mass(p, np.empty((6, 6)))
    np.testing.assert_allclose(p[36:72].reshape(6, 6) @ p[:36].reshape(6, 6), np.eye(6), atol=1e-12)
    p[0] = -1.0
    before = p[36:72].copy()
    assert not invert_mass(p, np.empty((6, 6)))
    np.testing.assert_array_equal(p[36:72], before)
