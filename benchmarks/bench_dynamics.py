"""Integration of the six-degree-of-freedom vehicle beside plain NumPy.

    python benchmarks/bench_dynamics.py [--json]

First all must move the same vehicle to the same place. Then: one RK4 step of a single run, and the steps per second of
a batch of 1000 runs of which the final states are kept.

"Plain NumPy" is the model as people write it, function by function from Fossen's book (m2c for both mass matrices,
Rzyx, Tzyx, gvect, a linear solve): what public Python simulators of underwater vehicles do. An economical version, with
everything constant made once and not one call too many, stands beside it; no figure is promised against that one.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from figures import Figure, interleaved, report

from towtank.core.attitude import eulers_from_quaternions, quaternions_from_eulers
from towtank.core.layout import pack_parameters
from towtank.core.rk4 import simulate_run, simulate_runs

DT = 0.01
RUNS = 1_000
STEPS = 1_000
STILL = np.zeros(3)


class EconomicalVehicle:
    """The model in NumPy with care: constant matrices made once, one momentum, no `numpy.cross`, no solve."""

    def __init__(self, m: float, r_G: np.ndarray, I_G: np.ndarray, M_A: np.ndarray, coupled: bool) -> None:
        S = self.skew(r_G)
        self.M_RB = np.block([[m * np.eye(3), -m * S], [m * S, I_G - m * S @ S]])
        self.M_A = M_A
        self.M = self.M_RB + M_A
        self.M_inverse = np.linalg.inv(self.M)
        self.W = m * 9.81
        self.B = self.W + 1.5
        self.r_G, self.r_B = r_G, np.array([0.0, 0.0, -0.02])
        self.L = -np.diag([4.0, 6.0, 5.0, 0.07, 0.1, 0.1])
        if coupled:
            self.L[0, 4] = self.L[4, 0] = 0.1
        self.Q = -np.diag([18.0, 21.0, 37.0, 1.5, 1.5, 1.5])
        if coupled:
            self.Q[1, 5] = 0.3

    @staticmethod
    def skew(a: np.ndarray) -> np.ndarray:
        return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])

    @staticmethod
    def rotation(phi: float, theta: float, psi: float) -> np.ndarray:
        cphi, sphi = np.cos(phi), np.sin(phi)
        cth, sth = np.cos(theta), np.sin(theta)
        cpsi, spsi = np.cos(psi), np.sin(psi)
        return np.array(
            [
                [cpsi * cth, -spsi * cphi + cpsi * sth * sphi, spsi * sphi + cpsi * cphi * sth],
                [spsi * cth, cpsi * cphi + sphi * sth * spsi, -cpsi * sphi + sth * spsi * cphi],
                [-sth, cth * sphi, cth * cphi],
            ]
        )

    @staticmethod
    def rates(phi: float, theta: float) -> np.ndarray:
        cphi, sphi, cth, tth = np.cos(phi), np.sin(phi), np.cos(theta), np.tan(theta)
        return np.array([[1.0, sphi * tth, cphi * tth], [0.0, cphi, -sphi], [0.0, sphi / cth, cphi / cth]])

    def coriolis(self, nu: np.ndarray) -> np.ndarray:
        h = self.M @ nu
        C = np.zeros((6, 6))
        C[:3, 3:] = -self.skew(h[:3])
        C[3:, :3] = -self.skew(h[:3])
        C[3:, 3:] = -self.skew(h[3:])
        return C

    def damping(self, nu: np.ndarray) -> np.ndarray:
        return -(self.L + self.Q * np.abs(nu))

    def restoring(self, phi: float, theta: float) -> np.ndarray:
        W, B = self.W, self.B
        (xg, yg, zg), (xb, yb, zb) = self.r_G, self.r_B
        sth, cth, sphi, cphi = np.sin(theta), np.cos(theta), np.sin(phi), np.cos(phi)
        return np.array(
            [
                (W - B) * sth,
                -(W - B) * cth * sphi,
                -(W - B) * cth * cphi,
                -(yg * W - yb * B) * cth * cphi + (zg * W - zb * B) * cth * sphi,
                (zg * W - zb * B) * sth + (xg * W - xb * B) * cth * cphi,
                -(xg * W - xb * B) * cth * sphi - (yg * W - yb * B) * sth,
            ]
        )

    def rate(self, x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        phi, theta, psi = x[3:6]
        nu = x[6:]
        J = np.zeros((6, 6))
        J[:3, :3] = self.rotation(phi, theta, psi)
        J[3:, 3:] = self.rates(phi, theta)
        force = tau - self.coriolis(nu) @ nu - self.damping(nu) @ nu - self.restoring(phi, theta)
        return np.concatenate([J @ nu, self.M_inverse @ force])

    def step(self, x: np.ndarray, tau: np.ndarray, dt: float) -> np.ndarray:
        k1 = self.rate(x, tau)
        k2 = self.rate(x + 0.5 * dt * k1, tau)
        k3 = self.rate(x + 0.5 * dt * k2, tau)
        k4 = self.rate(x + dt * k3, tau)
        return x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)

    def simulate(self, x: np.ndarray, tau: np.ndarray, dt: float) -> np.ndarray:
        for f in tau:
            x = self.step(x, f, dt)
        return x

    @property
    def parameters(self) -> np.ndarray:
        moment = self.r_G * self.W - self.r_B * self.B
        return pack_parameters(self.M, self.L, self.Q, self.W - self.B, moment)


class PlainVehicle(EconomicalVehicle):
    """The same model as the books and the public simulators write it."""

    @classmethod
    def m2c(cls, M: np.ndarray, nu: np.ndarray) -> np.ndarray:
        """Coriolis matrix of a mass matrix, Fossen (3.60), as in the Marine Systems Simulator's `m2c`."""
        M = 0.5 * (M + M.T)
        M11, M12, M21, M22 = M[:3, :3], M[:3, 3:], M[3:, :3], M[3:, 3:]
        nu1, nu2 = nu[:3], nu[3:]
        nu1_dot, nu2_dot = M11 @ nu1 + M12 @ nu2, M21 @ nu1 + M22 @ nu2
        upper = np.hstack([np.zeros((3, 3)), -cls.skew(nu1_dot)])
        lower = np.hstack([-cls.skew(nu1_dot), -cls.skew(nu2_dot)])
        return np.vstack([upper, lower])

    def rate(self, x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        phi, theta, psi = x[3], x[4], x[5]
        nu = x[6:]
        C = self.m2c(self.M_RB, nu) + self.m2c(self.M_A, nu)
        D = self.damping(nu)
        g = self.restoring(phi, theta)
        nu_dot = np.linalg.inv(self.M_RB + self.M_A) @ (tau - C @ nu - D @ nu - g)
        p_dot = self.rotation(phi, theta, psi) @ nu[:3]
        theta_dot = self.rates(phi, theta) @ nu[3:]
        return np.concatenate([p_dot, theta_dot, nu_dot])


def vehicle(kind: type[EconomicalVehicle], coupled: bool) -> EconomicalVehicle:
    """A BlueROV2-class vehicle; coupled: with every off-diagonal element that a file may give."""
    M_A = np.diag([6.0, 7.0, 15.0, 0.2, 0.25, 0.3])
    r_G = np.zeros(3)
    if coupled:
        A = np.random.default_rng(0).normal(size=(6, 6))
        scale = np.array([2.0, 3.0, 3.5, 0.3, 0.3, 0.3])
        M_A += 0.05 * np.outer(scale, scale) * (A + A.T)
        r_G = np.array([0.01, 0.0, 0.02])
    return kind(12.0, r_G, np.diag([0.2, 0.25, 0.3]), M_A, coupled)


def thrust(n: int) -> np.ndarray:
    t = DT * np.arange(n)[:, None]
    return np.array([20.0, 15.0, 10.0, 0.5, 0.5, 2.0]) * np.sin(t * [0.9, 0.7, 1.1, 1.3, 0.8, 0.6] + np.arange(6))


def start() -> tuple[np.ndarray, np.ndarray]:
    """The same start for plain NumPy (12,) and for the kernel (13,)."""
    eta, nu = np.array([0.0, 0.0, 2.0, 0.1, -0.1, 0.5]), np.array([0.3, 0.1, 0.0, 0.1, 0.0, 0.2])
    return np.append(eta, nu), np.concatenate([eta[:3], quaternions_from_eulers(eta[None, 3:])[0], nu])


def prove_parity() -> None:
    n = 1_000
    plain, quaternions = start()
    for coupled in (False, True):
        kinds = (PlainVehicle, EconomicalVehicle)
        references = [vehicle(kind, coupled).simulate(plain, thrust(n), DT) for kind in kinds]
        p = vehicle(PlainVehicle, coupled).parameters
        single = simulate_run(p, quaternions, thrust(n)[:, None], DT, STILL)[-1]
        batch = simulate_runs(np.stack([p, p]), np.stack([quaternions] * 2), thrust(n)[None], DT, STILL, n)[:, 0]
        for name, end in (("single run", single), ("batch", batch[0]), ("batch", batch[1])):
            found = np.concatenate([end[:3], eulers_from_quaternions(end[None, 3:7])[0], end[7:]])
            for reference in references:
                angles = (found[3:6] - reference[3:6] + np.pi) % (2.0 * np.pi) - np.pi
                worst = max(np.abs(angles).max(), np.abs(np.delete(found - reference, [3, 4, 5])).max())
                if not worst < 1e-6:
                    raise SystemExit(f"no parity, nothing timed: {name} differs from plain NumPy by {worst:.1e}")


def measure() -> list[Figure]:
    prove_parity()
    few = 200
    plain, quaternions = start()
    textbook, economical = vehicle(PlainVehicle, False), vehicle(EconomicalVehicle, False)
    p, tau, tau_few = textbook.parameters, np.ascontiguousarray(thrust(20_000)[:, None]), thrust(few)
    p_coupled = vehicle(PlainVehicle, True).parameters
    rng = np.random.default_rng(1)
    many = p * np.ones((RUNS, 1))
    many[:, 108:144] *= rng.uniform(0.8, 1.2, (RUNS, 1))
    starts = np.repeat(quaternions[None], RUNS, axis=0)
    shared = thrust(STEPS)[None]
    own = shared * rng.uniform(0.8, 1.2, (RUNS, 1, 1))
    seconds = interleaved(
        {
            "numpy": lambda: textbook.simulate(plain, tau_few, DT),
            "economical": lambda: economical.simulate(plain, tau_few, DT),
            "single": lambda: simulate_run(p, quaternions, tau, DT, STILL),
            "coupled": lambda: simulate_run(p_coupled, quaternions, tau, DT, STILL),
            "shared": lambda: simulate_runs(many, starts, shared, DT, STILL, STEPS),
            "own": lambda: simulate_runs(many, starts, own, DT, STILL, STEPS),
        },
        repeats=9,
    )
    numpy_step, single_step = seconds["numpy"] / few, seconds["single"] / len(tau)
    return [
        Figure("numpy_step", 1e6 * numpy_step, "us"),
        Figure("economical_numpy_step", 1e6 * seconds["economical"] / few, "us"),
        Figure("single_step", 1e9 * single_step, "ns"),
        Figure("single_step_coupled", 1e9 * seconds["coupled"] / len(tau), "ns", note="all matrices full"),
        Figure("single_ratio", numpy_step / single_step, "x", 2000.0, at_least=True, note="plain NumPy RK4 step"),
        Figure("economical_ratio", seconds["economical"] / few / single_step, "x", note="economical NumPy RK4 step"),
        Figure(
            "batch_1000_shared_wrench",
            RUNS * STEPS / seconds["shared"] / 1e6,
            "million steps/s",
            15.0,
            at_least=True,
            note=f"plain NumPy {1e-6 / numpy_step:.4f}",
        ),
        Figure(
            "batch_1000_own_wrench",
            RUNS * STEPS / seconds["own"] / 1e6,
            "million steps/s",
            note="a wrench per run, 48 MB read",
        ),
    ]


def main(argv: Sequence[str] | None = None) -> int:
    return report("dynamics", measure, argv)


def test_figures_are_met() -> None:
    assert main([]) == 0


if __name__ == "__main__":
    sys.exit(main())
