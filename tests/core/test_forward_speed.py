"""Forward-speed terms u (F nu): the power they are said to have, their symmetries, and what they cost others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from towtank.core.dynamics import inverse_dynamics
from towtank.core.forces import add_extra_force_into, add_extra_rate_into
from towtank.core.layout import FORWARD_COLUMNS, FORWARD_ROWS, I_ASYMMETRY, I_FORWARD, N_PARAMETERS
from towtank.core.rk4 import simulate_run

from .independent import Body, body, quaternion, state
from .proof import eulers, proof, seeds, sized, vectors

STILL = np.zeros(3)
MIRROR = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])  # port for starboard: v, p, r and Y, K, N change their sign


def force(lift: np.ndarray, nu: np.ndarray) -> np.ndarray:
    p, out = np.zeros(N_PARAMETERS), np.zeros(6)
    p[I_FORWARD:I_ASYMMETRY] = lift
    add_extra_force_into(p, nu, 1.0, out)
    return out


@proof
@given(vectors(9, 50.0), vectors(6, 3.0))
def test_is_the_printed_form_and_has_the_printed_power(lift: np.ndarray, nu: np.ndarray) -> None:
    b = replace(body(1), lift=lift)
    found = force(lift, nu)
    assert np.abs(found - b.forward_speed(nu)).max() < 1e-11
    Y_uv, Y_ur, N_uv, N_ur, K_up, Z_uw, Z_uq, M_uw, M_uq = lift
    u, v, w, p, q, r = nu
    lateral = Y_uv * v**2 + (Y_ur + N_uv) * v * r + N_ur * r**2 + K_up * p**2
    vertical = Z_uw * w**2 + (Z_uq + M_uw) * w * q + M_uq * q**2
    assert abs(nu @ found - u * (lateral + vertical)) < 1e-9


@proof
@given(vectors(6, 3.0))
def test_a_pair_of_opposite_signs_does_no_work(nu: np.ndarray) -> None:
    """Y_ur = -N_uv and Z_uq = -M_uw: the force turns the motion, as the Munk moment does, and takes no energy."""
    assert abs(nu @ force(np.array([0.0, 7.0, -7.0, 0.0, 0.0, 0.0, -4.0, 4.0, 0.0]), nu)) < 1e-12 * 1e3


@proof
@given(vectors(6, 3.0))
def test_fins_take_energy_ahead_and_feed_it_in_astern(nu: np.ndarray) -> None:
    """A fin at x gives Y = -k u (v + x r) and N = x Y: negative semidefinite ahead, and the opposite astern."""
    k, x = 20.0, -0.6
    lift = np.array([-k, -k * x, -k * x, -k * x * x, -1.0, -k, k * x, k * x, -k * x * x])
    power = nu @ force(lift, nu)
    assert power * nu[0] <= 1e-12
    back = nu * np.array([-1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    assert abs(power + back @ force(lift, back)) < 1e-12 * (1.0 + abs(power))


@proof
@given(vectors(9, 50.0), vectors(6, 3.0))
def test_port_and_starboard_are_alike(lift: np.ndarray, nu: np.ndarray) -> None:
    assert np.array_equal(force(lift, MIRROR * nu), MIRROR * force(lift, nu) + 0.0)


@proof
@given(vectors(9, 50.0), vectors(6, 3.0), vectors(6, 1.0))
def test_rate_is_the_derivative(lift: np.ndarray, nu: np.ndarray, way: np.ndarray) -> None:
    """The force is quadratic in the velocity, so that central differences are exact."""
    p, rate = np.zeros(N_PARAMETERS), np.zeros(6)
    p[I_FORWARD:I_ASYMMETRY] = lift
    add_extra_rate_into(p, nu, way, rate)
    assert np.abs(0.5 * (force(lift, nu + way) - force(lift, nu - way)) - rate).max() < 1e-10


@proof
@given(seeds, eulers, vectors(6, 3.0), vectors(6, 3.0))
def test_inverse_dynamics_differ_by_them_alone(
    seed: int, euler: np.ndarray, nu: np.ndarray, nu_dot: np.ndarray
) -> None:
    b, q = body(seed), quaternion(euler)
    without = replace(b, lift=np.zeros(9))
    tau = [inverse_dynamics(each.p[None], q[None], nu[None], nu_dot[None])[0] for each in (without, b)]
    assert np.abs(tau[0] - tau[1] - b.forward_speed(nu)).max() < 1e-11 * (1.0 + np.abs(tau[0]).max())


def test_the_elements_are_those_of_the_names() -> None:
    from towtank.vehicle import FORWARD_SPEED
    from towtank.vehicle.names import COLUMNS, ROWS

    pairs = zip(FORWARD_ROWS, FORWARD_COLUMNS, strict=True)
    assert tuple(f"{ROWS[i]}_u{COLUMNS[j]}" for i, j in pairs) == FORWARD_SPEED


@pytest.mark.parametrize("current", [STILL, np.array([0.4, -0.3, 0.2])])
def test_a_vehicle_without_them_moves_to_the_last_bit_as_before_and_one_with_a_trace_nearly_so(
    current: np.ndarray,
) -> None:
    """The two ways through a step, with and without the terms, are the same motion where the terms come to nothing."""
    n = sized(400, 40)
    tau = 20.0 * np.sin(0.05 * np.arange(n)[:, None, None] + np.arange(6))
    start = state(np.array([0.3, -0.2, 1.0, 0.2, -0.3, 1.0]), np.array([0.6, 0.3, -0.2, 0.3, -0.2, 0.4]))
    b: Body = replace(body(3), lift=np.zeros(9), asymmetry=np.zeros(6))
    trace = replace(b, lift=np.full(9, 1e-300))
    a, c = (simulate_run(each.p, start, tau, 0.02, current) for each in (b, trace))
    assert np.abs(a - c).max() < 1e-12
