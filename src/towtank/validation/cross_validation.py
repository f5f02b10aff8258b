"""Cross-validation over windows: learned on all but one, judged on that one, in turn.

The values learned without each window also say how sure they are: the delete-a-group jackknife,

    std^2 = (K - 1) / K sum_k (theta_k - mean theta)^2,

assumes nothing about noise and disturbances but that one window is like another. Beside the deviation that the learning
claims for the whole, it is a check of that claim; (K - 1) std^2 / claimed^2 is about chi-squared with K - 1 degrees of
freedom.

Recordings cut into windows one after the other, each left out once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from scipy.special import chdtrc

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification import Estimate, learn_recordings
from towtank.recording import Recording
from towtank.validation.prediction import CHANNELS, Prediction
from towtank.validation.scores import Validation, score, validate
from towtank.vehicle import AnyVehicle, Vehicle, vehicle_of

__all__ = ["CrossValidation", "Fold", "FoldedCoefficient", "Learn", "Learning", "cross_validate", "split"]

_SHORTEST = 1.0  # s, a piece that is worth learning from or predicting
_CHANCE = 0.01


@dataclass(frozen=True)
class Split:
    """One window left out.

    Attributes:
        windows: what is left out, as (number of the recording, start [s], end [s]) in the recording's own clock.
        kept: recordings to learn from. left_out: recordings to predict.
    """

    windows: tuple[tuple[int, float, float], ...]
    kept: tuple[Recording, ...]
    left_out: tuple[Recording, ...]


def split(recordings: Sequence[Recording], windows: int) -> tuple[Split, ...]:
    """Return `windows` splits; their windows are equally long, laid over the recordings one after the other.

    Raises:
        InputError: fewer than 2 windows, no recording, or windows shorter than a second.
    """
    if not recordings:
        raise InputError("no recording given, expected at least one")
    if windows < 2:
        raise InputError(f"folds: found {windows}, expected 2 windows or more")
    lengths = np.array([recording.duration for recording in recordings])
    ends = np.cumsum(lengths)
    total = float(ends[-1])
    if total / windows < _SHORTEST:
        raise InputError(
            f"folds: found {windows} windows of {total / windows:.2g} s, expected at least {_SHORTEST:g} s each; "
            "use fewer"
        )
    edges = np.linspace(0.0, total, windows + 1)
    return tuple(_split(recordings, ends - lengths, a, b) for a, b in pairwise(edges.tolist()))


def _split(recordings: Sequence[Recording], origins: Array, a: float, b: float) -> Split:
    windows, kept, left_out = [], [], []
    for k, recording in enumerate(recordings):
        start, end = recording.start, recording.end
        shift = start - float(origins[k])
        first, last = max(a + shift, start), min(b + shift, end)
        if last - first < _SHORTEST and last - first < 0.999 * recording.duration:  # a sliver: stays with its recording
            kept.append(recording)
            continue
        windows.append((k, first, last))
        left_out.append(recording.window(first, last if last >= end else float(np.nextafter(last, first))))
        if first - start >= _SHORTEST:
            kept.append(recording.window(start, float(np.nextafter(first, start))))
        if end - last >= _SHORTEST:
            kept.append(recording.window(last, end))
    return Split(tuple(windows), tuple(kept), tuple(left_out))


class Learning(Protocol):
    """What learning returns: coefficients, and the vehicle with them put in."""

    @property
    def estimate(self) -> Estimate:
        """The coefficients."""
        ...

    @property
    def model(self) -> Vehicle:
        """The vehicle with them put in."""
        ...


Learn = Callable[[Vehicle, Sequence[Recording]], Learning]


@dataclass(frozen=True)
class Fold:
    """One window left out.

    Attributes:
        windows: what was left out, as (number of the recording, start [s], end [s]).
        model: learned on the rest. fit, rmse: on the window, per channel, None where it is not measured.
        note: why the window could not be predicted; empty where it could.
    """

    windows: tuple[tuple[int, float, float], ...]
    model: Vehicle
    fit: dict[str, float | None]
    rmse: dict[str, float | None]
    note: str = ""


@dataclass(frozen=True)
class FoldedCoefficient:
    """One coefficient over the folds.

    Attributes:
        value, claimed: learned on everything, with the deviation that the learning claims.
        values: learned without each window (K,), NaN where it was not identified then.
        spread: deviation of `value` by the jackknife; NaN where fewer than three folds know it.
        p: probability of so much spread if the claimed deviation holds; NaN likewise.
    """

    name: str
    unit: str
    value: float
    claimed: float
    values: Array
    spread: float
    p: float

    @property
    def overconfident(self) -> bool:
        """Whether the folds spread more than the claimed deviation allows (1 %)."""
        return self.p < _CHANCE


@dataclass(frozen=True)
class CrossValidation:
    """A vehicle learned and judged in turn.

    Attributes:
        folds: one per window. whole: learned on everything.
        scores: of all windows together, each predicted by the model that has not seen it.
        seen: of the same windows, predicted by the model learned on everything.
        coefficients: those identified on everything.
    """

    folds: tuple[Fold, ...]
    whole: Learning
    scores: Validation
    seen: Validation
    coefficients: tuple[FoldedCoefficient, ...]


def cross_validate(
    vehicle: AnyVehicle,
    recordings: Sequence[Recording],
    *,
    windows: int = 5,
    learn: Learn = learn_recordings,
    horizon: float | None = None,
    delay: float | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> CrossValidation:
    """Learn a vehicle on all windows but one and predict that one, for each in turn.

    Args:
        vehicle: to start from. windows: how many, equally long, one after the other over all recordings.
        learn: takes the vehicle and recordings, returns what `learn_recordings` does.
        horizon, delay: of the predictions, see `validate`; a `learn` of your own decides itself about its delay.

    Raises:
        InputError: fewer than 2 windows or too short ones; nothing can be learned or predicted.
    """
    vehicle, told = vehicle_of(vehicle), progress or (lambda text, share: None)
    splits = split(recordings, windows)
    total = windows + 1
    told("learning on everything", 0.0)
    whole = learn(vehicle, recordings)
    folds: list[Fold] = []
    estimates: list[Estimate] = []
    unseen: list[Prediction] = []
    seen: list[Prediction] = []
    for k, each in enumerate(splits):
        told(f"learning without window {k + 1} of {windows}", (k + 1) / total)
        try:
            learning = learn(vehicle, each.kept)
        except InputError as error:
            raise InputError(f"without window {k + 1} of {windows} ({_where(each)}): {error}") from None
        estimates.append(learning.estimate)
        try:
            judged = validate(learning.model, each.left_out, horizon=horizon, delay=delay)
        except InputError as error:
            nothing: dict[str, float | None] = dict.fromkeys(CHANNELS)
            folds.append(Fold(each.windows, learning.model, nothing, dict(nothing), str(error)))
            continue
        folds.append(Fold(each.windows, learning.model, judged.fit, judged.rmse))
        unseen += judged.predictions
        seen += validate(whole.model, each.left_out, horizon=horizon, delay=delay).predictions
    if not unseen:
        raise InputError(f"none of the {windows} windows could be predicted: {folds[0].note}")
    told("done", 1.0)
    return CrossValidation(
        tuple(folds),
        whole,
        score(unseen, horizon=horizon),
        score(seen, horizon=horizon),
        tuple(_coefficients(whole.estimate, estimates)),
    )


def _where(each: Split) -> str:
    return ", ".join(f"{start:.5g} to {end:.5g} s" for _, start, end in each.windows)


def _coefficients(whole: Estimate, estimates: Sequence[Estimate]) -> list[FoldedCoefficient]:
    out = []
    for learned in whole.coefficients:
        if not learned.identified:
            continue
        name = learned.name
        values = np.array([e[name].value if name in e and e[name].identified else np.nan for e in estimates])
        known = values[np.isfinite(values)]
        n = known.size
        spread = float(np.sqrt((n - 1) / n * np.sum((known - known.mean()) ** 2))) if n >= 3 else float("nan")
        p = (
            float(chdtrc(n - 1, (n - 1) * (spread / learned.std) ** 2))
            if n >= 3 and learned.std > 0.0
            else float("nan")
        )
        out.append(FoldedCoefficient(name, learned.unit, learned.value, learned.std, values, spread, p))
    return out
