"""Asymmetric drag A nu^2: the drag ahead and astern it stands for, its power, its slope, and what it costs others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given

from towtank.core.dynamics import forward_dynamics, inverse_dynamics
from towtank.core.forces import add_extra_force_into, add_extra_rate_into, damping_force
from towtank.core.layout import FORWARD, FORWARD_COLUMNS, FORWARD_ROWS, I_ASYMMETRY, I_INFLOW, N_PARAMETERS, address
from towtank.core.rk4 import simulate_run

from .independent import Body, body, quaternion, state
from .proof import eulers, proof, seeds, sized, vectors

STILL = np.zeros(3)


def parameters(asymmetry: np.ndarray) -> np.ndarray:
    p = np.zeros(N_PARAMETERS)
    p[I_ASYMMETRY:I_INFLOW] = asymmetry
    return p


def force(asymmetry: np.ndarray, nu: np.ndarray) -> np.ndarray:
    out = np.zeros(6)
    add_extra_force_into(parameters(asymmetry), nu, 1.0, out)
    return out


@proof
@given(vectors(6, 50.0), vectors(6, 3.0))
def test_is_the_difference_of_drag_ahead_and_astern(asymmetry: np.ndarray, nu: np.ndarray) -> None:
    """With X_uu: (X_uu + X_u2) u^2 ahead, -(X_uu - X_u2) u^2 astern, and the like along every axis."""
    quadratic = -np.linspace(10.0, 60.0, 6)
    found = damping_force(np.zeros((6, 6)), np.diag(quadratic), nu) + force(asymmetry, nu)
    expected = np.where(nu >= 0.0, quadratic + asymmetry, asymmetry - quadratic) * nu**2
    assert np.abs(found - expected).max() < 1e-11


@proof
@given(vectors(6, 50.0), vectors(6, 3.0))
def test_power_is_the_cube_of_the_velocity_and_no_more_than_that_of_drag(asymmetry: np.ndarray, nu: np.ndarray) -> None:
    power = nu @ force(asymmetry, nu)
    assert abs(power - np.sum(asymmetry * nu**3)) < 1e-9
    assert abs(power + -nu @ force(asymmetry, -nu)) < 1e-12  # what one way takes the other way feeds in
    drag = damping_force(np.zeros((6, 6)), np.diag(-np.abs(asymmetry)), nu)
    assert power + nu @ drag < 1e-9


@proof
@given(vectors(6, 50.0), vectors(6, 3.0), vectors(6, 1.0))
def test_rate_is_the_derivative(asymmetry: np.ndarray, nu: np.ndarray, way: np.ndarray) -> None:
    """The force is quadratic in the velocity, so that central differences are exact."""
    rate = np.zeros(6)
    add_extra_rate_into(parameters(asymmetry), nu, way, rate)
    assert np.abs(0.5 * (force(asymmetry, nu + way) - force(asymmetry, nu - way)) - rate).max() < 1e-10


@proof
@given(seeds, eulers, vectors(6, 3.0), vectors(6, 3.0))
def test_dynamics_differ_by_it_alone(seed: int, euler: np.ndarray, nu: np.ndarray, nu_dot: np.ndarray) -> None:
    """Whether it comes alone or beside forward-speed terms, both ways through the equations of motion."""
    b, q = body(seed), quaternion(euler)
    for lift in (b.lift, np.zeros(9)):
        having = replace(b, lift=lift)
        without = replace(having, asymmetry=np.zeros(6))
        tau = [inverse_dynamics(each.p[None], q[None], nu[None], nu_dot[None])[0] for each in (without, having)]
        size = 1.0 + np.abs(tau[0]).max()
        assert np.abs(tau[0] - tau[1] - b.asymmetry * nu**2).max() < 1e-11 * size
        rate = [forward_dynamics(each.p[None], q[None], nu[None], tau[0][None])[0] for each in (without, having)]
        assert np.abs(b.M @ (rate[1] - rate[0]) - b.asymmetry * nu**2).max() < 1e-11 * size


def test_every_place_is_an_axis_of_its_own() -> None:
    unit = [force(each, np.array([1.0, -2.0, 3.0, -4.0, 5.0, -6.0])) for each in np.eye(6)]
    assert np.array_equal(np.array(unit), np.diag([1.0, 4.0, 9.0, 16.0, 25.0, 36.0]))
    places = {address(FORWARD, i, j) for i, j in zip(FORWARD_ROWS, FORWARD_COLUMNS, strict=True)}
    assert places.isdisjoint(range(I_ASYMMETRY, N_PARAMETERS))


@pytest.mark.parametrize("current", [STILL, np.array([0.4, -0.3, 0.2])])
def test_a_vehicle_without_it_moves_as_one_with_a_trace(current: np.ndarray) -> None:
    """The two ways through a step, with and without the term, are the same motion where the term comes to nothing."""
    n = sized(400, 40)
    tau = 20.0 * np.sin(0.05 * np.arange(n)[:, None, None] + np.arange(6))
    start = state(np.array([0.3, -0.2, 1.0, 0.2, -0.3, 1.0]), np.array([0.6, 0.3, -0.2, 0.3, -0.2, 0.4]))
    b: Body = replace(body(3), lift=np.zeros(9), asymmetry=np.zeros(6))
    trace = replace(b, asymmetry=np.full(6, 1e-300))
    a, c = (simulate_run(each.p, start, tau, 0.02, current) for each in (b, trace))
    assert np.abs(a - c).max() < 1e-12
