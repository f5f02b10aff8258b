"""One run of one experiment through one estimator, with whatever may go wrong as a value."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from adapter import learn_batch, learn_stream
from experiments import Experiment, experiment

from towtank.core.arrays import Array

__all__ = ["Mode", "Outcome", "Trial", "perform"]

Mode = Literal["batch", "stream"]
_DIVERGED = 1.0  # relative error of an identified coefficient at the end of a run


@dataclass(frozen=True)
class Trial:
    """What to run.

    Attributes:
        mode: "batch" learns anew from the first seconds up to each of `times`; "stream" goes through the run sample
            by sample and is read every `times[0]` seconds.
        until: only the first seconds of the run; None for all of it.
    """

    experiment: str
    seed: int
    mode: Mode
    times: tuple[float, ...]
    method: str = "joint"
    until: float | None = None


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of it.

    Attributes:
        t: (m,) [s]. values, std: (m, k) of what is judged (total inertias), NaN where not identified.
        delay: (m,) [s]. failure: why the run does not count as sound, None where it does. seconds: taken.
    """

    trial: Trial
    t: Array
    values: Array
    std: Array
    delay: Array
    failure: str | None
    seconds: float


def perform(trial: Trial) -> Outcome:
    """Run a trial. Never raises for what an estimator does."""
    case = experiment(trial.experiment)
    recording = case.record(trial.seed)
    if trial.until is not None:
        recording = recording.window(0.0, trial.until)
    began = time.perf_counter()
    k = len(case.free)
    t, values, std, delay = np.array(trial.times), np.empty((0, k)), np.empty((0, k)), np.empty(0)
    failure: str | None = None
    try:
        options: dict[str, Any] = {"delay_known": case.delay_known, "method": trial.method}
        if trial.mode == "stream":
            t, values, std, delay = learn_stream(case.start, recording, case.free, trial.times[0], **options)
        else:
            found = [learn_batch(case.start, recording.window(0.0, T), case.free, **options) for T in trial.times]
            values, std = (np.array([getattr(each, name) for each in found]) for name in ("values", "std"))
            delay = np.array([each.delay for each in found])
    except Exception as error:
        first = (str(error).splitlines() or [""])[0]
        failure = f"{type(error).__name__}: {first}"
        m = 0 if trial.mode == "stream" else len(t)
        t, values, std, delay = t[:m], np.full((m, k), np.nan), np.full((m, k), np.nan), np.full(m, np.nan)
    seconds = time.perf_counter() - began
    values = np.column_stack([case_quantity(case, i, values[:, i]) for i in range(k)]) if k else values
    return Outcome(trial, t, values, std, delay, failure or unsound(case, values, std), seconds)


def case_quantity(case: Experiment, i: int, values: Array) -> Array:
    """Return what is judged for the values (m,) of free coefficient i."""
    return np.array([case.quantity(case.free[i], float(value)) for value in values])


def unsound(case: Experiment, values: Array, std: Array) -> str | None:
    """Return what is wrong with the numbers themselves: not finite where identified, or gone astray at the end."""
    half = np.isfinite(values) != np.isfinite(std)
    if np.isinf(values).any() or half.any() or (std[np.isfinite(std)] < 0.0).any():
        return "a value or a deviation is not finite"
    if len(values):
        away = np.abs(values[-1] / case.true_quantities - 1.0)
        worst = int(np.argmax(np.where(np.isfinite(away), away, -1.0)))
        if away[worst] > _DIVERGED:
            return f"{case.free[worst]} is off by {100.0 * away[worst]:.0f} % at the end"
    return None
