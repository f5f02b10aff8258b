"""Errors with known properties, and runs whose prediction has them."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.signal import lfilter

from towtank.recording import Recording
from towtank.recording.channel import Channel
from towtank.simulation import simulate
from towtank.validation.error_series import ErrorSeries, Stretch
from towtank.validation.prediction import Prediction
from towtank.vehicle import Vehicle

__all__ = ["as_prediction", "as_series", "boat", "noisy_run", "remembering"]

DT = 0.05
INDEPENDENT = (1.0, 0.0, 0.0, 0.0, 0.0, 0.15)  # of the disturbance, on the axes that move: no couplings between them


def remembering(rng: np.random.Generator, n: int, time: float, dt: float = DT, std: float = 1.0) -> np.ndarray:
    """Return an Ornstein-Uhlenbeck process (n,), stationary from the start on."""
    a = np.exp(-dt / time)
    drive = std * np.sqrt(1.0 - a * a) * rng.standard_normal(n)
    drive[0] = std * rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -a], drive))


def as_series(error: np.ndarray, dt: float = DT, force: np.ndarray | None = None) -> ErrorSeries:
    """Return errors (n,), NaN where not sampled, as those of u in one stretch."""
    t = np.arange(error.size) * dt
    force = np.zeros(error.size) if force is None else force
    samples = int(np.count_nonzero(~np.isnan(error)))
    step = float(np.median(np.diff(t[~np.isnan(error)])))
    return ErrorSeries("u", (Stretch(t, error, force, 0.0 * force, dt, 0),), samples, step, error.size * dt)


def as_prediction(error: np.ndarray, dt: float = DT, force: np.ndarray | None = None) -> Prediction:
    """Return a prediction of u that errs by (n,), NaN where not measured."""
    n = error.size
    wrench = np.zeros((n, 6))
    wrench[:, 0] = 0.0 if force is None else force
    y = np.where(np.isnan(error), np.nan, np.sin(np.arange(n) * dt))
    return Prediction(np.arange(n) * dt, {"u": (y, y - error)}, (0.0,), "made up", wrench, np.zeros((n, 13)))


def boat(**hydrodynamics: float) -> Vehicle:
    """Return a vehicle that moves in surge and yaw."""
    known = {
        "X_udot": -10.0, "Y_vdot": -20.0, "Z_wdot": -25.0, "K_pdot": -0.5, "M_qdot": -0.6, "N_rdot": -0.8,
        "X_u": -10.0, "Y_v": -10.0, "Z_w": -10.0, "N_r": -0.5, "K_p": -1.0, "M_q": -1.0,
        "X_uu": -30.0, "N_rr": -2.0,
    }  # fmt: skip
    return Vehicle(
        name="boat",
        rigid_body={"mass": 20.0, "inertia": (1.0, 1.2, 1.5)},  # type: ignore[arg-type]
        buoyancy={"centre": (0.0, 0.0, -0.02)},  # type: ignore[arg-type]
        hydrodynamics={**known, **hydrodynamics},  # type: ignore[arg-type]
    )


def noisy_run(seed: int, *, seconds: float = 60.0, noise: float = 0.02, missing: float = 0.0, **more: Any) -> Recording:
    """Return a run of the boat, pushed to and fro at random in surge and yaw; u and r measured with white noise."""
    rng = np.random.default_rng(seed)
    n = round(seconds / DT)
    wrench = np.zeros((n, 6))
    for axis, size in ((0, 20.0), (5, 3.0)):
        wrench[:, axis] = size * np.sign(np.repeat(rng.standard_normal(n // 100 + 1), 100)[:n])
    log = simulate(boat(), wrench=wrench, dt=DT, seed=seed, **more)
    measured = []
    for name in ("u", "r"):
        channel = log[name]
        kept = rng.random(len(channel)) >= missing
        values = channel.values + noise * rng.standard_normal(len(channel))
        measured.append(Channel(name, channel.t[kept], values[kept], channel.unit, channel.frame))
    return log.with_channels([*measured, *(log[name] for name in "XYZKMN")])
