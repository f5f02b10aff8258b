"""Loss of thrust with inflow: the damping matrix of all thrusters is what each of them loses by itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from towtank.core.forces import add_inflow_damping_into
from towtank.core.layout import I_LINEAR, I_QUADRATIC, N_PARAMETERS
from towtank.core.rk4 import simulate_run

from .independent import body, cross_matrix, rotation_of, state
from .proof import proof, seeds, sized, vectors


def thrusters(seed: int, m: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (m, 3) [m], unit directions (m, 3) and forces (m,) [N] at random; some push, some pull, one rests."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(m, 3))
    forces = rng.uniform(-80.0, 80.0, m)
    forces[0] = 0.0
    return rng.uniform(-0.6, 0.6, (m, 3)), directions / np.linalg.norm(directions, axis=1)[:, None], forces


def configuration(positions: np.ndarray, directions: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(
        np.array([[*d, *(cross_matrix(r) @ d)] for r, d in zip(positions, directions, strict=True)]).T
    )


def damping(B: np.ndarray, forces: np.ndarray, loss: float) -> np.ndarray:
    p = np.zeros(N_PARAMETERS)
    add_inflow_damping_into(B, forces, loss, p)
    assert not p[:I_LINEAR].any()
    assert not p[I_QUADRATIC:].any()
    return p[I_LINEAR:I_QUADRATIC].reshape(6, 6)


@proof
@given(seeds, st.integers(1, 9), st.floats(0.0, 0.5), vectors(6, 3.0))
def test_all_together_are_each_by_itself(seed: int, m: int, loss: float, nu: np.ndarray) -> None:
    """T (1 - k u sign T) of every thruster, u = d . (v + omega x r) of its place, put together as a wrench."""
    positions, directions, forces = thrusters(seed, m)
    expected = np.zeros(6)
    for r, d, T in zip(positions, directions, forces, strict=True):
        inflow = d @ (nu[:3] + np.cross(nu[3:], r))
        left = T * (1.0 - loss * inflow * np.sign(T))
        expected += (left - T) * np.concatenate([d, np.cross(r, d)])
    found = damping(configuration(positions, directions), forces, loss) @ nu
    assert np.abs(found - expected).max() < 1e-12 * (1.0 + np.abs(forces).sum())


@proof
@given(seeds, st.integers(1, 9), st.floats(0.0, 0.5), vectors(6, 3.0))
def test_never_feeds_energy_in(seed: int, m: int, loss: float, nu: np.ndarray) -> None:
    positions, directions, forces = thrusters(seed, m)
    found = damping(configuration(positions, directions), forces, loss)
    assert np.abs(found - found.T).max() < 1e-12
    assert np.linalg.eigvalsh(found).max() < 1e-10
    assert nu @ found @ nu < 1e-10


def test_is_added_to_the_damping_there_is() -> None:
    b = body(5)
    positions, directions, forces = thrusters(5, 4)
    B = configuration(positions, directions)
    p = b.p.copy()
    add_inflow_damping_into(B, forces, 0.2, p)
    D = (B * np.abs(forces)) @ B.T
    assert np.abs(p[I_LINEAR:I_QUADRATIC].reshape(6, 6) - (b.L - 0.2 * D)).max() < 1e-12
    p[I_LINEAR:I_QUADRATIC] = b.p[I_LINEAR:I_QUADRATIC]
    assert np.array_equal(p, b.p)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_thrusters_at_work_never_gain_from_it(seed: int) -> None:
    """The same body under the same forces: what it holds in the end never exceeds the work of thrust without loss."""
    b = body(seed, damped=False)
    positions, directions, forces = thrusters(seed, 6)
    B = configuration(positions, directions)
    p = b.p.copy()
    add_inflow_damping_into(B, forces, 0.3, p)
    n, dt = sized(2000, 200), 0.001
    tau = np.repeat((B @ forces)[None, None], n, axis=0)
    eta0, nu0 = np.array([0.0, 0.0, 1.0, 0.1, -0.2, 0.3]), np.array([0.6, -0.3, 0.2, 0.3, -0.2, 0.4])
    x = simulate_run(p, state(eta0, nu0), tau, dt, np.zeros(3))
    held = np.array([_energy(b, each) for each in x])
    power = x[:, 7:] @ (B @ forces)
    work = np.concatenate([[0.0], np.cumsum(0.5 * dt * (power[1:] + power[:-1]))])
    lost = held - held[0] - work
    assert (np.diff(lost) < 1e-9).all()
    assert lost[-1] < -0.1


def _energy(b, x: np.ndarray) -> float:
    R = rotation_of(x[3:7])
    depths = [x[2] + (R @ r)[2] for r in (b.r_G, b.r_B)]
    return float(0.5 * x[7:] @ b.M @ x[7:] - b.W * depths[0] + b.B * depths[1])
