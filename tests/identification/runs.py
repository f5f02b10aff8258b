"""Vehicles whose truth is known, runs of them as plain arrays, and learners that follow a run sample by sample."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from towtank.identification import Learner
from towtank.recording import Recording
from towtank.simulation import simulate
from towtank.vehicle import Vehicle

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from pushed_box import BOX

POSE = ("x", "y", "z", "phi", "theta", "psi")
VELOCITY = ("u", "v", "w", "p", "q", "r")
TRUTH: dict[str, float] = BOX["hydrodynamics"]


def box(**more: Any) -> Vehicle:
    """A neutral vehicle of 20 kg without thrusters, quadratic drag, its centre of buoyancy 2 cm above its origin."""
    return Vehicle(**{**BOX, **more})


def unknown(vehicle: Vehicle, **hydrodynamics: float) -> Vehicle:
    """The same rigid body, of whose hydrodynamics nothing is known, or only what is given."""
    return vehicle.model_copy(update={"hydrodynamics": hydrodynamics})


def waves(n: int, dt: float, *rows: tuple[int, float, float], square: bool = False) -> np.ndarray:
    """Wrench (n, 6) with amplitude x sin(frequency t) (or its sign) on some rows: (row, amplitude, rad/s)."""
    t = np.arange(n) * dt
    out = np.zeros((n, 6))
    for row, amplitude, frequency in rows:
        wave = np.sin(frequency * t + 0.3 * row)
        out[:, row] += amplitude * (np.sign(wave) if square else wave)
    return out


@dataclass(frozen=True, eq=False)
class Run:
    """Times (n,), pose (n, 6), velocity (n, 6) and the wrench (n, 6) from each time on."""

    t: np.ndarray
    pose: np.ndarray
    velocity: np.ndarray
    wrench: np.ndarray


def table(run: Recording, names: tuple[str, ...]) -> np.ndarray:
    """Channels side by side; NaN columns for those that are not there."""
    n = max(len(channel) for channel in run.channels.values())
    return np.column_stack([run[name].values if name in run else np.full(n, np.nan) for name in names])


def fly(vehicle: Vehicle, wrench: np.ndarray, dt: float = 0.01, **more: Any) -> Run:
    """Simulate a held wrench (n, 6) with perfect sensors."""
    log = simulate(vehicle, wrench=wrench, dt=dt, **more)
    return Run(log["u"].t, table(log, POSE), table(log, VELOCITY), np.vstack([wrench, wrench[-1:]]))


def follow(learner: Learner, run: Run, *, pose: bool = True, velocity: bool = True) -> Learner:
    """Give a learner every sample of a run, one after the other."""
    for k in range(run.t.size):
        learner.update(
            run.t[k],
            pose=run.pose[k] if pose else None,
            velocity=run.velocity[k] if velocity else None,
            wrench=run.wrench[k],
        )
    return learner


def errors(learner: Learner, truth: dict[str, float]) -> dict[str, float]:
    """Relative error of each coefficient; infinite where it is not identified."""
    estimate = learner.estimate
    return {
        name: abs(estimate[name].value / value - 1.0) if estimate[name].identified else np.inf
        for name, value in truth.items()
    }
