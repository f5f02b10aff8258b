"""Several models on the same recordings: which is best, and whether that is more than chance.

Two models are compared sample by sample, d = e_1^2 - e_2^2: what disturbs both cancels as far as it may. The errors
remember, so the samples are no independent votes; d is summed over blocks of time several correlation times long, and
a t-test over the blocks asks whether its mean is zero (Diebold and Mariano, 1995, with batch means).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.recording import Recording
from towtank.validation.error_memory import memory_of
from towtank.validation.error_series import ErrorSeries, error_series
from towtank.validation.prediction import CHANNELS
from towtank.validation.scores import Validation, validate
from towtank.vehicle import AnyVehicle

__all__ = ["ChannelComparison", "Comparison", "Contest", "compare", "difference"]

_REAL = 0.05
_MEMORIES = 2.0  # correlation times of the errors that a block is long, at least; squares forget twice as fast
_MOST, _FEWEST = 24, 5  # blocks


@dataclass(frozen=True)
class Contest:
    """One model against the best on one channel.

    Attributes:
        behind: how far its fit lies below the best one's, in points of percent.
        p: probability of such a difference by chance, times the number of models that the best is compared with; None
            where the recordings are too short to tell.
    """

    behind: float
    p: float | None

    @property
    def real(self) -> bool:
        """Whether the difference is more than chance (5 %)."""
        return self.p is not None and self.p < _REAL


@dataclass(frozen=True)
class ChannelComparison:
    """All models on one channel.

    Attributes:
        best: the model with the smallest error. against: every other model -> how it fares against the best.
    """

    best: str
    against: Mapping[str, Contest]

    @property
    def decided(self) -> bool:
        """Whether the best is really better than every other model."""
        return all(contest.real for contest in self.against.values())


@dataclass(frozen=True)
class Comparison:
    """Models judged on the same recordings.

    Attributes:
        validations: model -> its scores. channels: measured channel -> who is best and by how much.
    """

    validations: Mapping[str, Validation]
    channels: Mapping[str, ChannelComparison]


def compare(
    models: Mapping[str, AnyVehicle],
    recordings: Sequence[Recording],
    *,
    window: tuple[float, float] | None = None,
    horizon: float | None = None,
    delay: float | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Comparison:
    """Judge several models on the same recordings; the options are those of `validate`.

    Raises:
        InputError: fewer than two models, or what `validate` raises, with the model's name.
    """
    if len(models) < 2:
        raise InputError(f"compare: found {len(models)} model, expected at least two")
    told = progress or (lambda text, share: None)
    validations: dict[str, Validation] = {}
    for k, (name, model) in enumerate(models.items()):
        told(f"predicting with {name}", k / len(models))
        try:
            validations[name] = validate(model, recordings, window=window, horizon=horizon, delay=delay)
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
    channels: dict[str, ChannelComparison] = {}
    for channel in CHANNELS:
        series = {name: error_series(found.predictions, channel) for name, found in validations.items()}
        measured = {name: one for name, one in series.items() if one is not None}
        if len(measured) == len(models):
            channels[channel] = _channel(channel, measured, validations)
    told("done", 1.0)
    return Comparison(validations, channels)


def _channel(channel: str, series: Mapping[str, ErrorSeries], found: Mapping[str, Validation]) -> ChannelComparison:
    fits = {name: _number(found[name].fit[channel]) for name in series}
    best = max(fits, key=lambda name: fits[name])
    against = {}
    for name, one in series.items():
        if name != best:
            p = difference(series[best], one)
            against[name] = Contest(fits[best] - fits[name], None if p is None else min(1.0, p * (len(series) - 1)))
    return ChannelComparison(best, against)


def _number(fit: float | None) -> float:
    return -np.inf if fit is None else fit


def difference(first: ErrorSeries, second: ErrorSeries) -> float | None:
    """Return the probability that two models err alike and only chance made the difference; None if too short to tell.

    A model that diverges where the other does not is worse beyond chance; two that err the same are alike.
    """
    a, b = _at_common_times(first, second)
    both = ~np.isnan(a) & ~np.isnan(b)
    a, b = a[both], b[both]
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return 1.0 if np.isfinite(a).all() == np.isfinite(b).all() else 0.0
    with np.errstate(over="ignore"):
        d = a**2 - b**2
        if not np.isfinite(d).all():
            return 0.0
        if float(np.abs(d).max(initial=0.0)) <= 1e-9 * float(np.mean(a**2) + np.mean(b**2)):
            return 1.0
    remembered = max(_memory(first), _memory(second))
    blocks = min(_MOST, int(first.duration / (_MEMORIES * remembered)), d.size // 5)
    if blocks < _FEWEST:
        return None
    edges = np.linspace(0, d.size, blocks + 1).astype(np.intp)[:-1]
    sums = np.add.reduceat(d, edges)
    spread = float(sums.std(ddof=1))
    if spread <= 0.0:
        return 0.0
    return float(2.0 * stdtr(blocks - 1, -abs(float(sums.mean())) / spread * np.sqrt(blocks)))


def _at_common_times(first: ErrorSeries, second: ErrorSeries) -> tuple[Array, Array]:
    """Return the errors of both at the times that both have; models of other delays start at other times."""
    pairs = []
    for recording in {stretch.recording for stretch in first.stretches}:
        (t, a), (s, b) = (_of_recording(series, recording) for series in (first, second))
        _, i, j = np.intersect1d(t, s, assume_unique=True, return_indices=True)
        pairs.append((a[i], b[j]))
    return np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])


def _of_recording(series: ErrorSeries, recording: int) -> tuple[Array, Array]:
    """Return times and errors of one recording."""
    mine = [stretch for stretch in series.stretches if stretch.recording == recording]
    nothing = [np.empty(0)]
    return np.concatenate([s.t for s in mine] or nothing), np.concatenate([s.error for s in mine] or nothing)


def _memory(series: ErrorSeries) -> float:
    """Return the time that errors remember [s], one step at least."""
    _, memory = memory_of(series)
    return series.step if memory is None or not memory.believable else max(memory.time, series.step)
