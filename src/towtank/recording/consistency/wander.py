"""Speeds that show no noise and contradict their pose, as those do that were smoothed: their noise, as the pose has it.

A sensor's noise is that which its samples show. A speed that is a mean over a second about each sample shows next to
none: it is late and early at once, its errors go together, and forces that are fitted to it need inertias many times
too large. But it can be summed over a time T and compared with the way between two poses. What differs, V(T), is twice
the square of the poses' noise and what the speed errs by: as white noise it grows with T (a random walk, as in the
Allan variance of a gyro), as errors that go together with T^2 for as long as they last. So the largest
(V(T) - V(T_0)) / (T - T_0), T_0 being a step of the slower of both, is the white noise that makes as much of it. Bias
and scale are taken out before, and the lag (with a filter of first order, which is late and nothing else) where both
have stamps of their own: learning finds that. In the same rows both count as one device, and a lag is an error.

What differs does not say which of both is wrong: a sensor may be turned or off the origin. A speed that shows noise of
its own is believed; one that shows none is doubted, which costs accuracy where it is right, and truth where it is not.
But a heading that wanders, as a compass near thrusters does, goes on doing so: V grows evenly from a third of a second
to five. What was smoothed differs more and more evenly in neither: a filter's errors go together at first, and none
lasts longer than what was smoothed over. Then the gyro is believed beside a whole attitude, of whose heading the
filter asks whether it is off; beside a heading alone it is doubted all the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.recording.consistency.accounts import ATTITUDE, Pair, of_heading, of_rates, of_velocity
from towtank.recording.grids.timing import sampling_rate
from towtank.recording.noise import NoiseLevel, noise_level, noise_levels, robust_size
from towtank.recording.recording import Recording
from towtank.recording.standard import MEASURED, POSE, QUANTITIES, RATES, STANDARD

__all__ = ["SmoothSpeeds", "noise_of_smooth_speeds", "smooth_speeds", "wander_of"]

_LONGEST = 2.0  # s: longer than filters remember, shorter than currents and magnets change
_BEYOND_POSES = 3.0  # times what the noise of the poses makes
_FEWEST = 50  # sums
_SOON, _LATE = 0.3, (3.0, 4.0, 5.0)  # s: before and after `_LONGEST`; a heading that wanders differs in
_EVENLY = (0.65, 0.12)  # both by as much a second as in between: by this share at least, for few sums are so long
_SMOOTH = 0.1  # of a usual sensor's noise: few sensors show less
_USUAL = {name: each.noise for each in QUANTITIES for name in each.channels}


class SmoothSpeeds(NamedTuple):
    """Columns of one sensor that show no noise of their own, what contradicts them, and the noise of a sample that it
    speaks for [m/s or rad/s]."""

    names: tuple[str, ...]
    source: str
    noise: float

    @property
    def said(self) -> str:
        """All of it in a sentence."""
        off = f"{self.noise:.2g} {STANDARD[self.names[0]].unit}"
        return (
            f"samples of {' '.join(self.names)} show no noise of their own, and differ from {self.source} as by noise "
            f"of {off}: were they smoothed, or does that wander? They count as so noisy at least"
        )


def noise_of_smooth_speeds(recordings: Sequence[Recording]) -> Array:
    """Return the noise (18,) of each sample of speeds that show none of their own, as their pose has it; 0 of others.
    In the order and the units of `standard.MEASURED`.

    It is given twice: innovations of errors that go together look small, and levels that follow them fall to half of
    what they began at. Who smoothed speeds may have smoothed the pose: where it shows no noise either, it has that of a
    usual sensor.
    """
    out = np.zeros(len(MEASURED))
    found = smooth_speeds(recordings)
    for each in found:
        out[[MEASURED.index(name) for name in each.names]] = 2.0 * each.noise
    for levels in (noise_levels(recording) for recording in recordings if found):
        for name in (name for name in POSE if name in levels and _shows_none(name, levels[name])):
            out[MEASURED.index(name)] = _USUAL[name]
    return out


def smooth_speeds(recordings: Sequence[Recording]) -> list[SmoothSpeeds]:
    """Return the speeds that were smoothed, sensor by sensor, as their pose shows.

    All numbers of a sensor and all recordings were smoothed alike: the largest noise counts. Where the speeds of one
    sensor were, those of another that show no noise were, too, and the noise of their pose may hide as much as it can.
    """
    found: dict[str, SmoothSpeeds] = {}
    for recording in recordings:
        pairs = [pair for make in (of_velocity, of_rates, of_heading) if (pair := make(recording)) is not None]
        shown = {pair.source: _smooth(pair, recording) for pair in pairs}
        if any(shown.values()):
            hidden = {pair.source: _smooth(pair, recording, most=True) for pair in pairs}
            for each in (shown[source] or hidden[source] for source in shown):
                if each is not None:
                    before = found.get(each.source, each)
                    names = tuple(name for name in MEASURED if name in (*before.names, *each.names))
                    found[each.source] = SmoothSpeeds(names, each.source, max(before.noise, each.noise))
    return list(found.values())


def _smooth(pair: Pair, recording: Recording, *, most: bool = False) -> SmoothSpeeds | None:
    wander = wander_of(pair, recording, most=most)
    off = [name for name, noise in wander.items() if noise > _USUAL[name] and (most or not _wanders(pair, name))]
    if not off:
        return None
    channels = {name: recording[name].measured for name in pair.names}
    smooth = [name for name, x in channels.items() if _shows_none(name, noise_level(x.t, x.values))]
    told = [name for name in off if name in smooth]
    return SmoothSpeeds(tuple(smooth), pair.source, max(wander[name] for name in told)) if told else None


def _shows_none(name: str, level: NoiseLevel) -> bool:
    return level.std < _SMOOTH * _USUAL[name]


def wander_of(pair: Pair, recording: Recording, *, most: bool = False) -> dict[str, float]:
    """Return the noise of each sample of a pair's speeds [m/s or rad/s] that their pose speaks for: 0 where the pose's
    own hides it, or the most that it can hide; NaN where there is too little of both."""
    rates = {name: sampling_rate(recording[name].measured.t) for name in pair.names}
    return {name: math.sqrt(_growth(pair, k, most=most) * rates[name]) for k, name in enumerate(pair.names)}


def _growth(pair: Pair, column: int, *, most: bool) -> float:
    """Return how fast the square [m^2 or rad^2 in a second] grows that sums of a speed differ by from the way between
    poses; NaN where unknown."""
    dt, shortest = pair.cells.dt, max(1, round(pair.cells.step / pair.cells.dt))
    doublings = int(math.log2(max(_LONGEST / dt / shortest, 1.0)))
    longer = [shortest << k for k in range(1, doublings + 1)]
    first = _left_over(pair, column, shortest)
    if not (longer and math.isfinite(first)):
        return math.nan
    if most:
        return (_BEYOND_POSES - 1.0) * first / (dt * (longer[-1] - shortest))
    squares = [_left_over(pair, column, n) for n in longer]
    return max(
        (square - first) / (dt * (n - shortest)) if square > _BEYOND_POSES * first else 0.0
        for n, square in zip(longer, squares, strict=True)
    )


def _wanders(pair: Pair, name: str) -> bool:
    """Return whether an attitude differs from a rate evenly more and more: by its heading, whatever way it leans."""
    if name not in RATES or pair.source != ATTITUDE:
        return False
    shortest, times = pair.cells.step, (max(_SOON, 2.0 * pair.cells.step), _LONGEST, *_LATE)
    column, dt = pair.names.index(name), pair.cells.dt
    first, soon, within, *late = (_left_over(pair, column, max(1, round(each / dt))) for each in (shortest, *times))
    whole = (within - first) / (_LONGEST - shortest)
    after = np.mean([(square - within) / (each - _LONGEST) for square, each in zip(late, _LATE, strict=True)])
    return bool((soon - first) / (times[0] - shortest) > _EVENLY[0] * whole and after > _EVENLY[1] * whole > 0.0)


def _left_over(pair: Pair, column: int, n: int) -> float:
    """Return the mean square [m^2 or rad^2] that sums of a speed over n cells differ by from the way between the poses,
    beside a bias, a scale and, with stamps of its own, a lag; NaN where too few are known."""
    measured, moved, dt = pair.measured[..., column], pair.derived[..., column], pair.cells.dt
    if measured.shape[1] <= n + 1:
        return math.nan
    sums = [np.cumsum(np.pad(dt * each, ((0, 0), (1, 0))), axis=1) for each in (moved - measured, measured)]
    off, way = ((each[:, n:] - each[:, :-n])[:, 1:-1] for each in sums)
    middle = 0.5 * (measured[:, 1:] + measured[:, :-1])  # at the edges of cells
    faster = middle[:, n:] - middle[:, :-n]
    known = np.isfinite(off) & np.isfinite(way) & np.isfinite(faster)
    if known.sum() < _FEWEST:
        return math.nan
    late = faster[known] if pair.own_clock else np.zeros(int(known.sum()))
    columns = np.column_stack([way[known], late, np.ones(int(known.sum()))])
    fit, *_ = np.linalg.lstsq(columns, off[known], rcond=None)
    return robust_size(off[known] - columns @ fit) ** 2
