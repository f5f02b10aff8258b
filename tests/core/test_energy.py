"""Energy: what the vehicle holds is what thrust put in, less what damping took out.

The work is integrated by Simpson's rule over the samples (error of order h^4, checked by leaving out every other
sample), so that no term of it comes from the integrator.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import simpson

from towtank.core.rk4 import simulate_run

from .independent import Body, body, rotation, rotation_of, state
from .proof import sized

DT = 0.001
SECONDS = sized(20.0, 2.0)
ETA0 = np.array([0.3, -0.2, 1.0, 0.2, -0.3, 1.0])
NU0 = np.array([0.6, 0.3, -0.2, 0.3, -0.2, 0.4])
PUSH = np.array([30.0, 25.0, 25.0, 2.0, 2.0, 3.0])
PACE = np.array([1.1, 0.7, 0.9, 1.7, 1.3, 0.8])


def thrust(t: np.ndarray) -> np.ndarray:
    return PUSH * np.sin(t[..., None] * PACE + np.arange(6))


def run(b: Body, pushed: bool, current: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and states, velocity relative to the water and depth in the drifting frame."""
    n = round(SECONDS / DT)
    t = DT * np.arange(n + 1)
    tau = np.stack([thrust(t[:-1]), thrust(t[:-1] + DT / 2), thrust(t[1:])], axis=1) * pushed
    start = state(ETA0, NU0)
    start[7:10] += rotation(ETA0[3:]).T @ current
    x = simulate_run(b.p, start, tau, DT, current)
    x[:, :3] -= t[:, None] * current
    x[:, 7:10] -= np.einsum("nji,j->ni", attitudes(x), current)
    return t, x


def attitudes(x: np.ndarray) -> np.ndarray:
    """Rotation matrices (n, 3, 3): one by one they are `rotation_of`, checked on the first and the last."""
    w, v = x[:, 3, None, None], x[:, 4:7]
    S = np.cross(np.eye(3), v[:, None, :])
    R = np.eye(3) + 2.0 * w * S + 2.0 * S @ S
    assert np.abs(R[[0, -1]] - [rotation_of(q) for q in x[[0, -1], 3:7]]).max() < 1e-15
    return R


def energy(b: Body, x: np.ndarray) -> np.ndarray:
    """Kinetic energy with the added mass, and the potential energy of weight and buoyancy at their depths [J]."""
    R = attitudes(x)
    depths = [x[:, 2] + R[:, 2] @ r for r in (b.r_G, b.r_B)]
    return 0.5 * np.einsum("ni,ij,nj->n", x[:, 7:], b.M, x[:, 7:]) - b.W * depths[0] + b.B * depths[1]


def test_without_thrust_and_damping_energy_stays() -> None:
    b = body(21, damped=False)
    _, x = run(b, pushed=False, current=np.zeros(3))
    E = energy(b, x)
    assert np.abs(E - E[0]).max() < 1e-8
    kinetic = 0.5 * np.einsum("ni,ij,nj->n", x[:, 7:], b.M, x[:, 7:])
    assert np.ptp(kinetic) > 0.1  # energy did change its form


@pytest.mark.parametrize("seed", [21, 22])
@pytest.mark.parametrize("current", [np.zeros(3), np.array([0.4, -0.3, 0.2])])
def test_work_of_thrust_and_damping_is_the_change_of_energy(seed: int, current: np.ndarray) -> None:
    b = body(seed)
    t, x = run(b, pushed=True, current=current)
    nu = x[:, 7:]
    damping = np.array([b.damping(each) for each in nu])
    power = (nu * (thrust(t) + damping + b.constant)).sum(axis=1)
    gained = energy(b, x)[-1] - energy(b, x)[0]
    work = simpson(power, dx=DT)
    assert abs(work - simpson(power[::2], dx=2 * DT)) < 1e-8
    assert abs(gained - work) < 1e-8
    assert simpson((nu * damping).sum(axis=1), dx=DT) < -1.0


def test_free_of_forces_both_momenta_stay_where_they_are() -> None:
    """Neutral, centres together, no damping: inertial linear and angular momentum are constant."""
    b = body(23, damped=False)
    b = Body(b.M_RB, b.M_A, b.L, b.Q, b.W, b.W, b.r_G, b.r_G)
    _, x = run(b, pushed=False, current=np.zeros(3))
    R, h = attitudes(x), x[:, 7:] @ b.M
    P = np.einsum("nij,nj->ni", R, h[:, :3])
    spin = np.einsum("nij,nj->ni", R, h[:, 3:]) + np.cross(x[:, :3], P)
    assert np.abs(P - P[0]).max() < 1e-9
    assert np.abs(spin - spin[0]).max() < 1e-9
