"""How good a prediction is: fit in percent and root-mean-square error, per axis."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.recording import Recording, align, bind_thrusters
from towtank.validation.prediction import CHANNELS, Prediction, predict
from towtank.vehicle import AnyVehicle, vehicle_of

__all__ = ["CHANNELS", "Validation", "fit_percent", "score", "started", "validate"]

_WORST = -999.0
_RESTING = 1e-12  # a channel that varies less than this, relatively, is still: its spread is rounding


@dataclass(frozen=True, eq=False)
class Validation:
    """A model judged on recordings.

    Attributes:
        fit: 100 (1 - |y - yhat| / |y - mean y|) per channel over all recordings, None where it is not measured;
            100 is perfect, 0 no better than the mean, -999 the worst that is told.
        rmse: root-mean-square error in SI. window: first and last time [s]. horizon: of the restarts, None for none.
        predictions: one per recording.
    """

    fit: dict[str, float | None]
    rmse: dict[str, float | None]
    window: tuple[float, float]
    horizon: float | None
    predictions: tuple[Prediction, ...]

    def __repr__(self) -> str:
        fits = ", ".join(f"{name} {value:.1f}" for name, value in self.fit.items() if value is not None)
        return f"<Validation of {len(self.predictions)} predictions: fit {fits or 'unknown'} %>"


def fit_percent(measured: Array, predicted: Array) -> float:
    """Return 100 (1 - |y - yhat| / |y - mean y|) over the samples where y is finite; -999 where it diverged."""
    known = np.isfinite(measured)
    if not known.any():
        return _WORST
    y, yhat = measured[known], predicted[known]
    spread = float(np.linalg.norm(y - y.mean()))
    if not np.isfinite(yhat).all():
        return _WORST
    least = _RESTING * (1.0 + float(np.abs(y).max())) * float(np.sqrt(y.size))
    if spread <= least:
        return 100.0 if float(np.linalg.norm(y - yhat)) <= 1e3 * least else _WORST
    return max(_WORST, 100.0 * (1.0 - float(np.linalg.norm(y - yhat)) / spread))


def validate(
    model: AnyVehicle,
    recordings: Sequence[Recording],
    *,
    window: tuple[float, float] | None = None,
    horizon: float | None = None,
    delay: float | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Validation:
    """Predict recordings with a model, from their commands alone, and compare with what was measured.

    Args:
        model: or its name in the catalog, or the path of its file.
        window: start and end [s] in the recordings' own time; all of them where omitted.
        delay: from input to force [s]; where omitted the model's for commands, none for a recorded wrench.
        horizon: set the prediction back to the measured state every so many seconds; never where omitted.
        progress: called with a text and the share done, 0 .. 1.

    Raises:
        InputError: no recording, nothing measured, or no commands in a recording.
    """
    if not recordings:
        raise InputError("no recording given, expected at least one")
    model = vehicle_of(model)
    names = [thruster.name for thruster in model.thrusters]
    predictions = []
    for k, recording in enumerate(recordings):
        if progress is not None:
            progress("predicting", k / len(recordings))
        part = recording if window is None else recording.window(*window)
        predictions.append(predict(model, align(bind_thrusters(part, names)), horizon=horizon, delay=delay))
    if progress is not None:
        progress("done", 1.0)
    return score(predictions, horizon=horizon)


def score(predictions: Sequence[Prediction], *, horizon: float | None = None) -> Validation:
    """Return fit and error of predictions, all taken together. `horizon` is only noted."""
    fit: dict[str, float | None] = {}
    rmse: dict[str, float | None] = {}
    for name in CHANNELS:
        pairs = [prediction.channels[name] for prediction in predictions if name in prediction.channels]
        if not pairs:
            fit[name] = rmse[name] = None
            continue
        rows = [np.isfinite(y) & started(owner) for (y, _), owner in _with(pairs, predictions, name)]
        y = np.concatenate([pair[0][mask] for pair, mask in zip(pairs, rows, strict=True)])
        yhat = np.concatenate([pair[1][mask] for pair, mask in zip(pairs, rows, strict=True)])
        fit[name] = fit_percent(y, yhat)
        with np.errstate(over="ignore", invalid="ignore"):
            error = float(np.sqrt(np.mean((y - yhat) ** 2))) if y.size else float("nan")
        rmse[name] = error if np.isfinite(error) else None
    start = min(float(prediction.t[0]) for prediction in predictions)
    end = max(float(prediction.t[-1]) for prediction in predictions)
    return Validation(fit, rmse, (start, end), horizon, tuple(predictions))


def _with(
    pairs: Sequence[tuple[Array, Array]], predictions: Sequence[Prediction], name: str
) -> list[tuple[tuple[Array, Array], Prediction]]:
    owners = [prediction for prediction in predictions if name in prediction.channels]
    return list(zip(pairs, owners, strict=True))


def started(prediction: Prediction) -> Array:
    """Rows from the first instant on at which state and inputs were known; nothing is predicted before."""
    return np.asarray(prediction.t >= prediction.restarts[0])
