"""A box of known coefficients that is pushed and turned at random: what pushes it, and how its motion is recorded."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from towtank.core.arrays import Array
from towtank.recording import Recording
from towtank.recording.standard import WRENCH
from towtank.simulation import OrnsteinUhlenbeck, simulate
from towtank.vehicle import Vehicle

__all__ = ["BOX", "CASES", "FORCES", "STEP", "flight", "mean_over", "true_box"]

STEP, ROWS, HELD = 0.05, 1600, 24  # s; rows; of them a wrench is held
NOISE = {"x": 5e-3, "y": 5e-3, "z": 5e-3, "phi": 2e-3, "theta": 2e-3, "psi": 2e-3, "p": 1e-3, "q": 1e-3, "r": 1e-3}
SPEED_NOISE = {"u": 1e-2, "v": 1e-2, "w": 1e-2}
STIRRED = OrnsteinUhlenbeck(std=(0.3, 0.3, 0.3, 0.01, 0.01, 0.02))
QUICK = OrnsteinUhlenbeck(std=(3.0, 3.0, 3.0, 0.1, 0.1, 0.3), time_constant=0.1)
WALK = 0.03  # rad in a second
LATER = 4  # rows by which a part of the force is late


class Case(NamedTuple):
    """Means of rates and time constant of their filter [s], walk of the heading [rad in a second], times the noise;
    share of the force that acts 0.2 s late, and whether what stirs the water is quick."""

    mean: float = 0.0
    filtered: float = 0.0
    walk: float = 0.0
    noise: float = 1.0
    late: float = 0.0
    quick: bool = False


FORCES = {
    "as recorded": Case(),
    "quick water": Case(quick=True),
    "a tenth late": Case(late=0.1),
    "a third late": Case(late=1 / 3),
    "overshoots": Case(late=-1 / 3),
}
CASES = {
    "raw": Case(),
    "smooth 0.3": Case(mean=0.3),
    "smooth 1.2": Case(mean=1.2),
    "filtered 0.3": Case(filtered=0.3),
    "filtered 0.05": Case(filtered=0.05),
    "heading wanders": Case(walk=WALK),
    "so beside a quiet gyro": Case(walk=WALK, noise=0.1),
}
BOX = {
    "name": "box",
    "rigid_body": {"mass": 20.0, "inertia": (1.0, 1.2, 1.5)},
    "buoyancy": {"centre": (0.0, 0.0, -0.02)},
    "hydrodynamics": {
        "X_udot": -10.0, "Y_vdot": -20.0, "Z_wdot": -25.0, "K_pdot": -0.5, "M_qdot": -0.6, "N_rdot": -0.8,
        "X_uu": -30.0, "Y_vv": -60.0, "Z_ww": -70.0, "K_pp": -1.0, "M_qq": -1.5, "N_rr": -2.0,
    },
}  # fmt: skip


def true_box() -> Vehicle:
    """A neutral vehicle of 20 kg without thrusters, quadratic drag, its centre of buoyancy 2 cm above its origin."""
    return Vehicle.model_validate(BOX)


def mean_over(x: Array, seconds: float) -> Array:
    """Return means over a time about each sample (n,)."""
    n = round(seconds / STEP) | 1
    return np.convolve(np.pad(x, n // 2, mode="edge"), np.ones(n) / n, mode="valid")


def flight(case: str, seed: int, *, speeds: bool = False) -> Recording:
    """Return a run as it was recorded, a case of `CASES` or `FORCES`: wrench, pose, rates, and the speeds."""
    chosen = {**CASES, **FORCES}[case]
    noise = {**NOISE, **(SPEED_NOISE if speeds else {})}
    noise |= {name: chosen.noise * noise[name] for name in "pqr"}
    rng = np.random.default_rng(seed)
    wrench = np.zeros((ROWS, 6))
    for first in range(0, ROWS, HELD):
        wrench[first : first + HELD, 5] = rng.choice([-3.0, 3.0])
        wrench[first : first + HELD, 0] = rng.choice([-15.0, 0.0, 15.0])
    acts = wrench.copy()
    acts[LATER:] += chosen.late * (wrench[:-LATER] - wrench[LATER:])
    run = simulate(true_box(), wrench=acts, dt=STEP, disturbance=QUICK if chosen.quick else STIRRED, seed=seed)
    columns = {name: run[name].values + std * rng.normal(size=len(run[name])) for name, std in noise.items()}
    columns["psi"] += np.cumsum(chosen.walk * np.sqrt(STEP) * rng.normal(size=len(run["psi"])))
    if chosen.mean:
        columns |= {name: mean_over(columns[name], chosen.mean) for name in "pqr"}
    if chosen.filtered:
        kept = np.exp(-STEP / chosen.filtered)
        columns |= {name: lfilter([1.0 - kept], [1.0, -kept], columns[name]) for name in "pqr"}
    columns |= {name: wrench[: len(run[name]), i] for i, name in enumerate(WRENCH)}
    channels = [run[name].with_values(values) for name, values in columns.items()]
    return run.without(*"uvwpqr").replace(channels)
