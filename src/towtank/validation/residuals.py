"""What the errors of a prediction are: white, slow, or the command's own trace; with a verdict in plain words."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.validation.autocorrelation import Autocorrelation, Portmanteau, autocorrelation, portmanteau
from towtank.validation.command_trace import CommandTrace, command_trace
from towtank.validation.error_memory import Memory, Samples, memory_of, whiten
from towtank.validation.error_series import ErrorSeries, error_series
from towtank.validation.prediction import CHANNELS, Prediction
from towtank.validation.verdicts import Verdict, verdict_of

__all__ = ["Residual", "residuals"]

_SHOWN = 40  # lags of the autocorrelation
_NEGLIGIBLE = 1e-3  # of the spread of the measurement: nothing worth reading from it


@dataclass(frozen=True, eq=False)
class Residual:
    """The errors of one channel, over all recordings.

    Attributes:
        channel: its name. samples: errors there are.
        free: autocorrelation of the errors of the free-running prediction. free_test: that they are white.
        one_step: autocorrelation of the errors one step ahead, of someone who has seen all errors before: what is
            left when `memory` is taken out. one_step_test: that these are white.
        memory: of the errors; None where there are too few or none to speak of.
        time: correlation time of the errors' slow part [s]; None where they have none that can be told from noise.
        time_std: its standard deviation [s].
        command: trace of the axis' commanded force in the errors; None where it was not commanded.
        verdict: what to make of it.
    """

    channel: str
    samples: int
    free: Autocorrelation
    free_test: Portmanteau | None
    one_step: Autocorrelation
    one_step_test: Portmanteau | None
    memory: Memory | None
    time: float | None
    time_std: float | None
    command: CommandTrace | None
    verdict: Verdict


def residuals(
    predictions: Sequence[Prediction], *, progress: Callable[[str, float], None] | None = None
) -> dict[str, Residual]:
    """Return what the errors of each measured channel are, over all predictions."""
    out: dict[str, Residual] = {}
    names = [name for name in CHANNELS if any(name in prediction.channels for prediction in predictions)]
    for k, name in enumerate(names):
        if progress is not None:
            progress(f"errors of {name}", k / len(names))
        series = error_series(predictions, name)
        if series is not None:
            out[name] = _residual(series, _spread(predictions, name))
    return out


def _spread(predictions: Sequence[Prediction], name: str) -> float:
    """Return the standard deviation of what was measured, or its size where it rests."""
    y = np.concatenate([prediction.channels[name][0] for prediction in predictions if name in prediction.channels])
    known = y[~np.isnan(y)]
    return max(float(known.std()), 1e-6 * float(np.abs(known).max()), 1e-300)


def _residual(series: ErrorSeries, spread: float) -> Residual:
    errors = series.errors
    finite = bool(np.isfinite(errors).all())
    parts = [(stretch.error, stretch.dt) for stretch in series.stretches] if finite else [(np.full(1, np.nan), 1.0)]
    free_test = portmanteau(parts, series.step)
    memory, samples, command = None, None, None
    negligible = finite and float(np.sqrt(np.mean(errors**2))) <= _NEGLIGIBLE * spread
    if finite and not negligible:
        samples, memory = memory_of(series)
    one_step, step = parts, series.step
    if memory is not None and samples is not None:
        command = command_trace(series, samples, memory)
        one_step, step = _one_step(series, samples, memory), samples.step
    time = memory.time if memory is not None and memory.believable else None
    return Residual(
        channel=series.name,
        samples=series.samples,
        free=autocorrelation(parts, *_lags(series, time)),
        free_test=free_test,
        one_step=autocorrelation(one_step, step, min(20, max(series.samples // 5, 1))),
        one_step_test=portmanteau(one_step, step),
        memory=memory,
        time=time,
        time_std=None if time is None else time * math.sqrt(min(2.0 * time / series.duration, 1.0)),
        command=command,
        verdict=verdict_of(series, memory, free_test, command, finite=finite, negligible=negligible),
    )


def _lags(series: ErrorSeries, time: float | None) -> tuple[float, int]:
    """Return width [s] and number of the lags to show: a few correlation times, at most a quarter of the recording."""
    longest = max(20.0 * series.step, 5.0 * (time or 0.0))
    slot = max(series.step, min(longest, 0.25 * series.duration) / _SHOWN)
    return slot, max(1, min(_SHOWN, int(longest / slot)))


def _one_step(series: ErrorSeries, samples: Samples, memory: Memory) -> list[tuple[Array, float]]:
    """Return the errors one step ahead, over their deviations, at the rows of their stretches."""
    W, _ = whiten(samples, np.column_stack([samples.value - memory.bias]), memory)
    firsts = np.cumsum([0, *(stretch.t.size for stretch in series.stretches)])
    rows = np.full(int(firsts[-1]), np.nan)
    rows[firsts[samples.stretch] + samples.row] = W[:, 0]
    return [(x, stretch.dt) for x, stretch in zip(np.split(rows, firsts[1:-1]), series.stretches, strict=True)]
