"""How the clocks of two files of one run lie to each other, by the motion that both saw.

    t = t2 + offset + drift (t2 - middle)

on the first file's clock, for t2 on the second's. What both measure is compared as means over cells of time: body
rates, measured or between attitudes; else the rate of depth; else velocity; else specific force. First everywhere: the
logarithm of the likelihood ratio of "the same motion" against "nothing in common", -N log(1 - rho^2) a column, at every
lag, where N counts independent cells (Bartlett). The highest peak has to be high, and well above every other one, which
that of a periodic motion is not. Then finely: Gauss-Newton on offset and drift, with the second file's samples read at
their own times. Its curvature comes from the slopes of both files together, so that the noise of neither enters, and
its deviations from blocks of time, so that noise may have any colour. The drift has a prior, quartz as it is sold.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.digits import joined
from towtank.errors import InputError
from towtank.recording.consistency.signals import (
    SMOOTHED,
    Signal,
    body_velocity,
    depth_rate,
    measured,
    memory_of,
    rates,
    smooth_means,
)
from towtank.recording.recording import Recording
from towtank.recording.standard import ACCELERATIONS

__all__ = ["ClockOffset", "clock_offset", "file_of"]

_CELL, _PER_STEP = 0.05, 2  # s, at least; cells in the step of the slowest channel, at most
_UNEVEN = 1.0787  # times that: cells in no whole ratio to samples, or noise between these would pull at the offset
_JUMP = 4.0  # times the 99 % quantile, at most, of a speed: markers that come and go; deviations of what is left
_MOVES = {"rates": 0.01, "depth": 0.01, "velocity": 0.01, "specific force": 0.05}  # rad/s, m/s, m/s^2: less is rest
_PEAK = 2.0  # times that, what moves does so at times
_OVERLAP = (10.0, 0.25)  # s, and share of the shorter file, that both must cover
_ALIKE, _RATIO = 0.5, 40.0  # correlation, and log likelihood ratio, of the same motion at least
_SECOND, _CLEARER = 20.0, 0.2  # by how much the best lag must beat any other one: in all, and for each independent cell
_LONG = 60.0  # s in common from which on a drift can be told
_QUARTZ = 1e-4  # deviation of a drift before any data
_WORTH_SAYING = 1e-6
_WIDTHS, _PER_WINDOW = (SMOOTHED, 17, 33, 65), 1.0 / 40.0  # cells of a window; at most of those that both cover
_CLEAR = 0.9  # share of the motion that both have in common, from which no longer window is needed
_BLOCK, _BLOCKS = 4.0, (8, 48)  # s; blocks at least and at most
_ROUNDS = 12
_UNSURE = 0.05  # s, deviation beyond which an offset is of no use, and may be a coincidence
_ASTRAY = 1.5  # s that the fine offset may lie off the coarse one
_NAMES = {
    **{"p": "roll rate", "q": "pitch rate", "r": "yaw rate", "z": "depth"},
    **{"u": "surge speed", "v": "sway speed", "w": "heave speed"},
    **{"ax": "surge acceleration", "ay": "sway acceleration", "az": "heave acceleration"},
}


@dataclass(frozen=True)
class ClockOffset:
    """Where the clock of a second file lies on that of a first one: t = t2 + offset + drift (t2 - middle).

    Attributes:
        offset, std: [s]; the deviation is 0 where the offset was given. drift, drift_std: relative.
        middle: of what both cover [s], on the second file's clock. by: what told it, best first.
    """

    offset: float
    std: float = 0.0
    drift: float = 0.0
    drift_std: float = 0.0
    middle: float = 0.0
    by: tuple[str, ...] = ()

    def times(self, t: Array) -> Array:
        """Return times (n,) [s] of the second file on the clock of the first."""
        return np.asarray(t + self.offset + self.drift * (t - self.middle))

    def own(self, t: Array) -> Array:
        """Return times (n,) [s] on the clock of the first file as the second file's own."""
        return np.asarray((t - self.offset + self.drift * self.middle) / (1.0 + self.drift))

    def text(self, first: str, second: str) -> str:
        """Return it in words, for the names of both files."""
        side = "after" if self.offset >= 0.0 else "before"
        if not self.by:
            return f"{second} lies {abs(self.offset):g} s {side} {first}, as was said"
        places = 3 if self.std >= 5e-4 else 4
        drift = ""
        if abs(self.drift) > max(3.0 * self.drift_std, _WORTH_SAYING):
            pace = "slow" if self.drift > 0.0 else "fast"
            drift = f"; its clock is {1e6 * abs(self.drift):.0f} ± {1e6 * self.drift_std:.0f} ppm {pace}"
        size = f"{abs(self.offset):.{places}f} ± {max(self.std, 10.0**-places):.{places}f} s"
        return f"{second} lies {size} {side} {first}, by {_told(self.by)}{drift}"


def _told(names: Sequence[str]) -> str:
    """Return names with a last word that all share said once: "yaw and pitch rate"."""
    words = [name.rpartition(" ") for name in names]
    if len({last for *_, last in words}) == 1 and all(first for first, *_ in words):
        return f"{joined([first for first, *_ in words])} {words[0][2]}"
    return joined(list(names))


def file_of(recording: Recording) -> str:
    """Return the name of the file that a recording came from, without its folder."""
    return PurePath(recording.source).name or "the other recording"


def clock_offset(first: Recording, second: Recording) -> ClockOffset:
    """Return where the clock of `second` lies on that of `first`.

    Raises:
        InputError: they measure nothing in common, or the motion in common does not tell the offset.
    """
    reasons = []
    for family, moves in _MOVES.items():
        a, b = _FAMILIES[family](first), _FAMILIES[family](second)
        names = [name for name in a if name in b]
        if not names:
            continue
        found = _by(_Signals.of(a, names), _Signals.of(b, names), names, moves)
        if isinstance(found, ClockOffset):
            return found
        reasons.append(f"by {family}: {found}")
    name, of = file_of(second), file_of(first)
    why = "; ".join(reasons) or "they measure nothing in common (rates, attitude, depth, velocity or specific force)"
    raise InputError(
        f"{second.source or name}: where its clock lies on that of {of} cannot be told: {why}; say it, "
        f"--merge {name}@+SECONDS (what to add to its times), or turn the vehicle back and forth in both"
    )


_FAMILIES: Mapping[str, Callable[[Recording], dict[str, Signal]]] = {
    "rates": rates,
    "depth": depth_rate,
    "velocity": body_velocity,
    "specific force": lambda recording: measured(recording, ACCELERATIONS),
}


class _Signals(NamedTuple):
    """Columns of one file: from when to when [s], the step [s] of the slowest channel, and each column."""

    start: float
    end: float
    step: float
    columns: tuple[Signal, ...]

    @classmethod
    def of(cls, signals: Mapping[str, Signal], names: Sequence[str]) -> _Signals:
        columns = tuple(signals[name] for name in names)
        tracks = [track for column in columns for track in column.tracks]
        start, end = min(float(track.t[0]) for track in tracks), max(float(track.t[-1]) for track in tracks)
        return cls(start, end, max(track.step for track in tracks), columns)

    def smooth(self, edges: Array, width: int = SMOOTHED) -> Array:
        """Return the means (n, k) over cells through a window of so many, NaN where one is unknown."""
        return smooth_means(self.columns, edges, width)


def _by(a: _Signals, b: _Signals, names: Sequence[str], moves: float) -> ClockOffset | str:
    """Return the offset by columns that both have; why it cannot be told otherwise."""
    dt = max(_CELL, max(a.step, b.step) / _PER_STEP)
    coarse = _coarse(a, b, dt, moves)
    if isinstance(coarse, str):
        return coarse
    offset, correlation = coarse
    fine = _fine(a, b, _UNEVEN * dt, offset)
    if isinstance(fine, str):
        return fine
    if not fine[1] < _UNSURE:
        return f"the motion in common tells it to no better than ± {fine[1]:.2g} s"
    order = sorted(range(len(names)), key=lambda k: -correlation[k])
    told = [names[k] for k in order if correlation[k] >= max(_ALIKE, 0.5 * correlation[order[0]])]
    return ClockOffset(*fine, tuple(_NAMES[name] for name in told))


def _known(x: Array) -> tuple[Array, Array]:
    """Return columns (n, k) without their means and jumps, 0 where unknown, and where they are known, as 0 and 1."""
    if not np.isfinite(x).any(axis=0).all():
        return np.zeros_like(x), np.zeros_like(x)
    limit = _JUMP * np.nanquantile(np.abs(x), 0.99, axis=0)
    known = np.isfinite(x)
    centred = x - np.nanmean(x, axis=0)
    return np.where(known, np.clip(centred, -limit, limit), 0.0), known.astype(np.float64)


def _liveliest(x: Array, known: Array) -> float:
    """Return the largest 99 % quantile of the columns' sizes (n, k); 0 where nothing is known."""
    sizes = (np.abs(column[there > 0.0]) for column, there in zip(x.T, known.T, strict=True))
    return max((float(np.quantile(size, 0.99)) for size in sizes if size.size), default=0.0)


def _coarse(a: _Signals, b: _Signals, dt: float, moves: float) -> tuple[float, Array] | str:
    """Return the offset [s] to a cell, and the correlation (k,) there; why there is none otherwise."""
    sides = [each.smooth(np.arange(each.start, each.end, dt)) for each in (a, b) if each.end - each.start > 20 * dt]
    if len(sides) < 2:
        return "one of them is too short"
    (x, mx), (y, my) = (_known(side) for side in sides)
    least = max(_OVERLAP[1] * min(len(x), len(y)), min(_OVERLAP[0] / dt, 0.8 * min(len(x), len(y))))
    still = [
        f"the {'first' if k == 0 else 'second'} file hardly moves"
        for k, (values, known) in enumerate(((x, mx), (y, my)))
        if _liveliest(values, known) < _PEAK * moves
    ]
    if still:
        return " and ".join(still)
    n = 1 << (len(x) + len(y) - 1).bit_length()
    lags = np.arange(-(len(y) - 1), len(x))

    def crossed(p: Array, q: Array) -> Array:
        both = np.fft.irfft(np.fft.rfft(p, n, axis=0) * np.conj(np.fft.rfft(q, n, axis=0)), n, axis=0)
        return np.asarray(both[lags % n])

    count = np.rint(crossed(mx, my))
    with np.errstate(divide="ignore", invalid="ignore"):
        rho = crossed(x, y) / np.sqrt(np.maximum(crossed(x**2, my), 1e-12) * np.maximum(crossed(mx, y**2), 1e-12))
    rho = np.where(count >= least, np.clip(rho, -0.9999, 0.9999), 0.0)
    independent = count / memory_of(x, y, dt)
    gain = -(independent * np.log1p(-(np.maximum(rho, 0.0) ** 2))).sum(axis=1)
    cells = np.maximum(np.where(count >= least, independent, 0.0).max(axis=1), 1.0)
    best = int(np.argmax(gain))
    if rho[best].max() >= _ALIKE and gain[best] < _RATIO:
        return "too short or too regular a motion in common"
    if rho[best].max() < _ALIKE or gain[best] < _RATIO:
        return f"no motion in common (correlation at most {max(rho[best].max(), 0.0):.2f})"
    outside = _outside(gain, best)
    if outside.any():
        other = int(np.flatnonzero(outside)[np.argmax(gain[outside])])
        clearer = gain[best] / cells[best] - gain[other] / cells[other]
        if gain[best] - gain[other] < _SECOND or (clearer < _CLEARER and gain[other] > 0.3 * gain[best]):
            apart = abs(float(lags[best] - lags[other])) * dt
            return f"ambiguous: a shift by another {apart:.1f} s fits about as well (a periodic motion)"
    return a.start - b.start + float(lags[best]) * dt, rho[best]


def _outside(gain: Array, best: int) -> NDArray[np.bool_]:
    """Return what lies outside the peak at `best`: beyond where it has fallen by half and rises again."""
    low = best
    while low > 0 and (gain[low - 1] < gain[low] or gain[low] > 0.5 * gain[best]):
        low -= 1
    high = best
    while high < gain.size - 1 and (gain[high + 1] < gain[high] or gain[high] > 0.5 * gain[best]):
        high += 1
    out = np.ones(gain.size, dtype=np.bool_)
    out[low : high + 1] = False
    return out


def _fine(a: _Signals, b: _Signals, dt: float, coarse: float) -> tuple[float, float, float, float, float] | str:
    """Return offset, its deviation, drift, its deviation, and the middle of what both cover; or why there are none."""
    start, end = max(a.start, b.start + coarse), min(a.end, b.end + coarse)
    edges = np.arange(start, end, dt)
    middle = 0.5 * (start + end) - coarse
    width = _width(a, b, edges, coarse)
    at = np.convolve(edges, np.full(width + 1, 1.0 / (width + 1)), mode="valid") - coarse - middle
    drifting = end - start >= _LONG
    x, slope_x = _with_slope(a, edges, width)
    theta = np.array([coarse, 0.0])
    used = slice(0, 2 if drifting else 1)
    information = blocks = np.zeros((2, 2))
    for _ in range(_ROUNDS):
        own = ClockOffset(float(theta[0]), drift=float(theta[1]), middle=middle).own(edges)
        y, slope_y = _with_slope(b, own, width)
        score, information = _score(x, slope_x, y, slope_y, at, end - start)
        blocks = score.T @ score
        if np.linalg.cond(information[used, used]) > 1e14 or information[0, 0] <= 0.0:
            return "too little motion in common"
        step = np.linalg.solve(information[used, used], score.sum(axis=0)[used])
        theta[used] += step
        if abs(theta[0] - coarse) > _ASTRAY:
            return "no lag at which the same motion is in both"
        if abs(step[0]) < 1e-6:
            break
    inverse = np.linalg.inv(information[used, used])
    number = len(score)
    cov = inverse @ blocks[used, used] @ inverse * (number - 1) / max(number - 3, 1)
    if not drifting:
        return float(theta[0]), float(np.sqrt(cov[0, 0])), 0.0, 0.0, middle
    gain = cov[:, 1] / (cov[1, 1] + _QUARTZ**2)  # the drift is 0 +- quartz, before any data
    theta = theta - gain * theta[1]
    cov = cov - np.outer(gain, cov[1])
    return float(theta[0]), float(np.sqrt(cov[0, 0])), float(theta[1]), float(np.sqrt(cov[1, 1])), middle


def _width(a: _Signals, b: _Signals, edges: Array, offset: float) -> int:
    """Return the cells of the shortest window in which noise is little beside the motion, else of the best one."""
    found = []
    for width in _WIDTHS:
        if width > max(SMOOTHED, _PER_WINDOW * edges.size):
            break
        x, y = _known(a.smooth(edges, width))[0], _known(b.smooth(edges - offset, width))[0]
        share = float((x * y).sum()) ** 2 / max(float((x**2).sum() * (y**2).sum()), 1e-300)
        found.append((share, width))
        if share > _CLEAR:
            return width
    return max(found)[1]


def _with_slope(signals: _Signals, edges: Array, width: int) -> tuple[Array, Array]:
    """Return columns (n, k) over cells, and their slopes by time."""
    dt = float(edges[1] - edges[0])
    later, earlier = signals.smooth(edges + 0.5 * dt, width), signals.smooth(edges - 0.5 * dt, width)
    return signals.smooth(edges, width), (later - earlier) / dt


def _score(x: Array, slope_x: Array, y: Array, slope_y: Array, at: Array, seconds: float) -> tuple[Array, Array]:
    """Return the scores (blocks, 2) of offset and drift, and their information (2, 2).

    Args:
        x, y: columns (n, k) of both files; slopes by time beside each. at: times (n,) [s] from the middle.
    """
    number = int(np.clip(seconds / _BLOCK, *_BLOCKS))
    block = np.minimum(np.arange(len(x)) * number // len(x), number - 1)
    score, information = np.zeros((number, 2)), np.zeros((2, 2))
    by = np.column_stack([np.ones(at.size), at])
    for k in range(x.shape[1]):
        known = np.isfinite(x[:, k]) & np.isfinite(y[:, k]) & np.isfinite(slope_x[:, k]) & np.isfinite(slope_y[:, k])
        if known.sum() < 4 * SMOOTHED:
            continue
        p, q, dp, dq, when = x[known, k], y[known, k], slope_x[known, k], slope_y[known, k], by[known]
        p, q = p - p.mean(), q - q.mean()
        gain = float(p @ q) / max(float(q @ q), 1e-300)
        if gain <= 0.0:
            continue
        left = p - gain * q
        scale = float(np.std(left)) + 1e-12
        left = np.clip(left, -_JUMP * scale, _JUMP * scale)
        weight = gain / float(np.mean(left**2) + 1e-24)
        each = -weight * (left * dq)[:, None] * when  # of t2 = t - offset: q falls by its slope as the offset grows
        for j in range(2):
            score[:, j] += np.bincount(block[known], each[:, j], minlength=number)
        information += weight * (when * (dp * dq)[:, None]).T @ when
    return score, information
