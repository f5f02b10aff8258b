"""How far speeds wander off the pose beside them: their noise where samples are too smooth to show any.

A sensor's noise is that which its samples show. A speed that was smoothed afterwards, or by a filter on board, shows
next to none: it is late and early at once, its errors go together, and forces that are fitted to it need inertias ten
times too large. But it can be summed over a time T and compared with the way between two poses. What differs, V(T), is
twice the square of the poses' noise and what the speed errs by: as white noise it grows with T (a random walk, as in
the Allan variance of a gyro), as errors that go together with T^2 for as long as they last. So the largest
(V(T) - V(T_0)) / (T - T_0), T_0 being a step of the slower of both, is the white noise that makes as much of it. Bias,
scale and lag are taken out before.

What differs does not say which of both is wrong: a heading may wander, too. So a speed that shows noise of its own is
believed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.recording.consistency.accounts import Pair, of_heading, of_rates, of_velocity
from towtank.recording.grids.timing import sampling_rate
from towtank.recording.noise import noise_level, robust_size
from towtank.recording.recording import Recording
from towtank.recording.standard import EULER, MEASURED, POSE, QUANTITIES

__all__ = ["SmoothSpeeds", "noise_of_smooth_speeds", "smooth_speeds", "wander_of"]

_LONGEST = 2.0  # s: longer than filters remember, shorter than currents and magnets change
_BEYOND_POSES = 3.0  # times what the noise of the poses makes
_FEWEST = 50  # sums
_SMOOTH = 0.1  # of a usual sensor's noise: no sensor shows less
_USUAL = {name: each.noise for each in QUANTITIES for name in each.channels}


class SmoothSpeeds(NamedTuple):
    """Columns of one sensor that show no noise of their own, what contradicts them, and the noise it speaks for."""

    names: tuple[str, ...]
    source: str
    noise: float


def noise_of_smooth_speeds(recordings: Sequence[Recording]) -> Array:
    """Return the noise (18,) of each sample of speeds that show none of their own, as their pose has it; 0 of others.

    It is given twice: innovations of errors that go together look small, and levels that follow them fall to half of
    what they began at. Who smoothed speeds may have smoothed the pose: where it shows no noise either, it has that of a
    usual sensor.
    """
    out = np.zeros(len(MEASURED))
    found = smooth_speeds(recordings)
    for each in found:
        out[[MEASURED.index(name) for name in each.names]] = 2.0 * each.noise
    for name in POSE if found else ():
        if any(_shows_none(recording, name) for recording in recordings if name in recording):
            out[MEASURED.index(name)] = _USUAL[name]
    return out


def _shows_none(recording: Recording, name: str) -> bool:
    channel = recording[name].measured
    return noise_level(channel.t, channel.values, "angle" if name in EULER else "linear").std < _SMOOTH * _USUAL[name]


def smooth_speeds(recordings: Sequence[Recording]) -> list[SmoothSpeeds]:
    """Return the speeds that were smoothed, sensor by sensor, as their pose shows.

    All numbers of a sensor and all recordings were smoothed alike: the largest noise counts. Where the speeds of one
    sensor were, those of another that show no noise were, too, and the noise of their pose may hide as much as it can.
    """
    found: dict[str, SmoothSpeeds] = {}
    for recording in recordings:
        pairs = [pair for make in (of_velocity, of_rates, of_heading) if (pair := make(recording)) is not None]
        shown = {pair.source: _smooth(pair, recording, wander_of(pair, recording)) for pair in pairs}
        if any(shown.values()):
            hidden = {pair.source: _smooth(pair, recording, wander_of(pair, recording, most=True)) for pair in pairs}
            for each in (shown[source] or hidden[source] for source in shown):
                if each is not None and (each.source not in found or each.noise > found[each.source].noise):
                    found[each.source] = each
    return list(found.values())


def _smooth(pair: Pair, recording: Recording, wander: dict[str, float]) -> SmoothSpeeds | None:
    if not any(noise > _USUAL[name] for name, noise in wander.items()):
        return None
    smooth = [name for name in pair.names if _shows_none(recording, name)]
    noise = max((wander[name] for name in smooth if wander[name] > _USUAL[name]), default=0.0)
    return SmoothSpeeds(tuple(smooth), pair.source, noise) if noise > 0.0 else None


def wander_of(pair: Pair, recording: Recording, *, most: bool = False) -> dict[str, float]:
    """Return the noise of each sample of a pair's speeds that their pose speaks for: 0 where the pose's own hides it,
    or the most that it can hide; NaN where there is too little of both."""
    rates = {name: sampling_rate(recording[name].measured.t) for name in pair.names}
    return {name: math.sqrt(_growth(pair, k, most=most) * rates[name]) for k, name in enumerate(pair.names)}


def _growth(pair: Pair, column: int, *, most: bool) -> float:
    """Return how fast the square grows that sums of a speed differ by from the way between poses; NaN where unknown."""
    shortest = max(1, round(pair.cells.step / pair.cells.dt))
    doublings = int(math.log2(max(_LONGEST / pair.cells.dt / shortest, 1.0)))
    cells = [shortest << k for k in range(doublings + 1)]
    first, *more = [_left_over(pair, column, n) for n in cells]
    if not (more and math.isfinite(first)):
        return math.nan
    if most:
        return (_BEYOND_POSES - 1.0) * first / (pair.cells.dt * (cells[-1] - shortest))
    growth = [
        (square - first) / (pair.cells.dt * (n - shortest)) if square > _BEYOND_POSES * first else 0.0
        for n, square in zip(cells[1:], more, strict=True)
    ]
    return max(growth)


def _left_over(pair: Pair, column: int, n: int) -> float:
    """Return the mean square that sums of a speed over n cells differ by from the way between the poses, beside a bias,
    a scale and a lag; NaN where too few are known."""
    measured, moved = pair.measured[..., column], pair.derived[..., column]
    if measured.shape[1] <= n + 1:
        return math.nan
    sums = [np.cumsum(np.pad(pair.cells.dt * each, ((0, 0), (1, 0))), axis=1) for each in (moved - measured, measured)]
    off, way = ((each[:, n:] - each[:, :-n])[:, 1:-1] for each in sums)
    faster = (measured[:, n:] - measured[:, :-n])[:, :-1]
    known = np.isfinite(off) & np.isfinite(way) & np.isfinite(faster)
    if known.sum() < _FEWEST:
        return math.nan
    columns = np.column_stack([way[known], faster[known], np.ones(int(known.sum()))])
    fit, *_ = np.linalg.lstsq(columns, off[known], rcond=None)
    return robust_size(off[known] - columns @ fit) ** 2
