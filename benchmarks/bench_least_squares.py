"""Recursive least squares beside padasip and beside a plain NumPy loop.

    python benchmarks/bench_least_squares.py [--json]

First all of them must give the same estimate. Then: one `update` from Python against padasip's `adapt`, `run` over a
million samples, and one row of `run` with each way of forgetting.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

import numpy as np
import padasip
from figures import Figure, interleaved, report

from towtank.identification.least_squares.rls import RecursiveLeastSquares

SCHEMES = ("directional", "exponential")
FORGETTING = 0.995
P0 = 1e4
SAMPLES = 2_000
MILLION = 1_000_000


def numpy_loop(Phi: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The textbook recursion, the paper's (36)-(37), as one writes it in NumPy."""
    n = Phi.shape[1]
    theta, P = np.zeros(n), P0 * np.eye(n)
    for phi, value in zip(Phi, y, strict=True):
        g = P @ phi
        K = g / (1.0 + phi @ g)
        theta = theta + K * (value - phi @ theta)
        P = P - np.outer(K, g)
    return theta


def padasip_loop(rows: Sequence[np.ndarray], values: Sequence[float], n: int) -> np.ndarray:
    rls = padasip.filters.FilterRLS(n, mu=1.0, eps=1.0 / P0, w="zeros")
    for phi, value in zip(rows, values, strict=True):
        rls.adapt(value, phi)
    return rls.w


def update_loop(rows: Sequence[np.ndarray], values: Sequence[float], n: int) -> np.ndarray:
    rls = RecursiveLeastSquares(n, P0=P0)
    for phi, value in zip(rows, values, strict=True):
        rls.update(phi, value)
    return rls.theta


def data(n: int, k: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(n)
    Phi = rng.normal(size=(k, n))
    return Phi, Phi @ np.linspace(-2.0, 5.0, n) + 0.1 * rng.normal(size=k)


def prove_parity(n: int) -> None:
    Phi, y = data(n, SAMPLES)
    rows, values = list(Phi), y.tolist()
    prior = np.eye(n) / np.sqrt(P0)
    batch = np.linalg.lstsq(np.vstack([Phi, prior]), np.append(y, np.zeros(n)), rcond=None)[0]
    found = {"padasip": padasip_loop(rows, values, n), "numpy": numpy_loop(Phi, y)}
    rls = RecursiveLeastSquares(n, P0=P0)
    rls.run(Phi, y)
    found |= {"update": update_loop(rows, values, n), "run": rls.theta}
    for name, theta in found.items():
        worst = float(np.abs(theta - batch).max())
        if worst > 1e-8:
            raise SystemExit(f"no parity, nothing timed: {name} differs from batch least squares by {worst:.1e}")


def updates(n: int) -> list[Figure]:
    Phi, y = data(n, SAMPLES)
    rows, values = list(Phi), y.tolist()
    tasks: dict[str, Callable[[], object]] = {
        "padasip": lambda: padasip_loop(rows, values, n),
        "numpy": lambda: numpy_loop(Phi, y),
        "qr": lambda: update_loop(rows, values, n),
    }
    each = {name: 1e6 * seconds / SAMPLES for name, seconds in interleaved(tasks).items()}
    note = f"padasip {each['padasip'] / each['qr']:.1f}x, NumPy loop {each['numpy'] / each['qr']:.1f}x as long"
    return [
        Figure(f"padasip_adapt_n{n}", each["padasip"], "us"),
        Figure(f"numpy_loop_n{n}", each["numpy"], "us"),
        Figure(f"update_qr_n{n}", each["qr"], "us", each["padasip"] / 12.0, note=note),
    ]


def runs() -> list[Figure]:
    n = 2
    Phi, y = data(n, MILLION)
    part = MILLION // 50

    tasks: dict[str, Callable[[], object]] = {
        "qr": lambda: RecursiveLeastSquares(n, P0=P0).run(Phi, y),
        "numpy": lambda: numpy_loop(Phi[:part], y[:part]),
    }
    seconds = interleaved(tasks, repeats=7)
    loop = seconds["numpy"] * MILLION / part
    return [Figure("run_qr_n2_1e6", seconds["qr"], "s", 0.05, note=f"NumPy loop {loop:.1f} s")]


def prove_forgetting(n: int) -> None:
    """All directions excited: every scheme is weighted least squares."""
    Phi, y = data(n, SAMPLES)
    weight = np.sqrt(FORGETTING ** np.arange(SAMPLES - 1, -1, -1.0))
    exact = np.linalg.lstsq(Phi * weight[:, None], y * weight, rcond=None)[0]
    for scheme in SCHEMES:
        rls = RecursiveLeastSquares(n, forgetting=FORGETTING, scheme=scheme, P0=1e8)
        rls.run(Phi, y)
        worst = float(np.abs(rls.theta - exact).max())
        if worst > 1e-6:
            raise SystemExit(f"no parity, nothing timed: {scheme} differs from weighted least squares by {worst:.1e}")


def schemes(n: int) -> list[Figure]:
    """One row by `run`, forgetting by each scheme, beside no forgetting."""
    Phi, y = data(n, MILLION // 10)

    def run(forgetting: float, scheme: str) -> None:
        RecursiveLeastSquares(n, forgetting=forgetting, scheme=scheme, P0=P0).run(Phi, y)

    tasks: dict[str, Callable[[], object]] = {"none": lambda: run(1.0, "exponential")}
    for scheme in SCHEMES:
        tasks[scheme] = lambda scheme=scheme: run(FORGETTING, scheme)
    each = {name: 1e9 * seconds / len(y) for name, seconds in interleaved(tasks, repeats=5).items()}
    limits = {"directional": 2.0 * each["none"] + 200.0}
    note = f"no forgetting {each['none']:.0f} ns"
    return [Figure(f"run_{scheme}_n{n}", each[scheme], "ns", limits.get(scheme), note=note) for scheme in SCHEMES]


def measure() -> list[Figure]:
    sizes = (2, 6, 12)
    for n in sizes:
        prove_parity(n)
        prove_forgetting(n)
    return [figure for n in sizes for figure in updates(n)] + runs() + [f for n in sizes for f in schemes(n)]


def main(argv: Sequence[str] | None = None) -> int:
    return report("recursive least squares", measure, argv)


def test_figures_are_met() -> None:
    assert main([]) == 0


if __name__ == "__main__":
    sys.exit(main())
