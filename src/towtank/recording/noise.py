"""How noisy a channel is, from its own samples alone: no model, no filter to tune.

A difference of order k, scaled to unit weights, takes out every polynomial below degree k and leaves white noise with
its own deviation: d = sum w_i x_i, sum w_i t_i^j = 0 for j < k, sum w_i^2 = 1 (for regular samples the third difference
over sqrt(20)). The robust size of these differences is the noise plus whatever of the motion a polynomial over k + 1
samples misses. Motion only ever adds, so of the orders 2 to 5 the smallest counts (von Neumann's difference estimator;
Gasser, Sroka and Jennen-Steinmetz, Biometrika 73, 1986). The figure is that of the white part: drift, bias and noise
that a filter on board has smoothed are invisible to it.

Only fresh samples count. A logger repeats the last value, draws straight lines between values, or the instrument knows
only multiples of a quantum. Taken for independent samples, each of these seems far less noisy than it is.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.attitude import eulers_from_quaternions
from towtank.errors import InputError
from towtank.recording import Recording
from towtank.recording.grids.timing import gap_limit, median_step, quaternion_samples, sampling_rate
from towtank.recording.standard import EULER, MEASURED, QUATERNION

__all__ = [
    "NoiseLevel",
    "fresh_samples",
    "noise_level",
    "noise_levels",
    "noise_of_rows",
    "quantum_of",
    "robust_size",
]

_FEWEST = 12  # samples
_REPEATED = 0.2  # share of repeats from which samples may be repeated
_MOVES = 2.5  # quanta of a usual increment from which standing still is no coincidence
_COARSE = 30.0  # quanta of a usual increment beyond which the quantum does not matter
_WHOLE = 0.1  # of a quantum that increments may be off a multiple
_ROUNDED = 1e-9  # of the range; what is smaller is rounding within the machine
_ROUNDINGS = 2.0  # last digits by which a line may bend
_STRAIGHT = 0.4  # least share of the samples that lie within lines
_SHARP = 3.0  # times what rounding explains that a usual knot bends
_SHORT = 3  # samples that one knot may bend
_LONGEST = 4  # usual lengths of a line that knots may hide in
_MOSTLY = 0.8  # share of the knots that must be so short
_ORDERS = (2, 3, 4, 5)  # of the differences
_MOST, _BLOCK = 60_000, 2_000  # samples that count of a long channel, in blocks spread over it
_BULK, _BULK_SIZE = 0.8, 1.2815515655446004  # that share of standard normal numbers is smaller than this
_ROUNDS = 3  # of clipping
_CLIP, _CLIPPED_VARIANCE = 3.0, 0.9733369246625416  # deviations; variance of a standard normal within +-3
_JITTER = 1e-3  # share of a step
_STANDS_OUT = 5.0  # deviations
_FEWEST_ROWS = 30  # of a column, from which it shows its noise
_OF_ROUNDING = 5.0  # quanta of noise, up to which it may be that of rounding
_PLATEAU = 1.0  # s; the longest that an offset counts as an outlier
_PEAK = 1.4  # times its own size that a jump may have beside it: the two of a single wrong sample have one size
_RETURN = 0.5  # of its height that an offset must come back


def quantum_of(steps: Array) -> float:
    """Return the common step of a coarse channel's increments (n,); 0 where there is none that would show.

    Looked for in the differences of the increments, which are multiples too and know nothing of a steady rise.
    """
    change = np.abs(np.diff(steps))
    change[change <= _ROUNDED * change.max(initial=0.0)] = 0.0
    size = change[change > 0.0][:20_000]
    if size.size < 3:
        return 0.0
    usual, quantum = float(np.median(size)), float(size.min())
    if usual > _COARSE * quantum:
        return 0.0
    small = size[size <= _COARSE * quantum]
    multiple = np.rint(small / quantum)
    if size.size == change.size and multiple.max() == 1.0:
        return 0.0
    quantum = float(np.dot(small, multiple) / np.dot(multiple, multiple))
    off = np.abs(small / quantum - np.rint(small / quantum))
    return quantum if np.mean(off < _WHOLE) > 0.99 else 0.0


def fresh_samples(t: Array, x: Array, quantum: float = 0.0) -> tuple[Array, Array]:
    """Return times and values of the samples that were measured, without repeats and without drawn lines.

    Args:
        t: times (n,) [s], strictly increasing.
        x: values (n,), finite.
        quantum: of `quantum_of`; a coarse channel may stand still for a while and be fresh.
    """
    steps = np.diff(x)
    if _is_repeated(steps, quantum):
        changed = np.append(True, steps != 0.0)
        return t[changed], x[changed]
    knots = _knots(t, x)
    return (t, x) if knots is None else knots


def _is_repeated(steps: Array, quantum: float) -> bool:
    """Return whether samples are repeated, not merely equal: many stand still, and the others move far."""
    moving = np.abs(steps[steps != 0.0])
    if moving.size > (1.0 - _REPEATED) * steps.size or not moving.size:
        return False
    return quantum == 0.0 or float(np.median(moving)) > _MOVES * quantum


def _knots(t: Array, x: Array) -> tuple[Array, Array] | None:
    """Return the knots of a channel drawn in straight lines, where these lines meet; None for any other channel.

    Such a channel bends at one sample, or at two where a knot lies between them, and then not at all for some samples,
    but for the rounding of printed values.
    """
    if t.size < 5 * _FEWEST:
        return None
    steps = np.diff(t)
    slope = np.diff(x) / steps
    bend = np.abs(np.diff(slope))  # bend[k] is at sample k + 1
    rounding = 0.51 * _ROUNDINGS * _resolution(np.diff(x), float(np.ptp(x))) * (1.0 / steps[1:] + 1.0 / steps[:-1])
    sharp = bend > rounding
    if sharp.mean() > 1.0 - _STRAIGHT or sharp.sum() < _FEWEST:
        return None
    first, last = _runs(sharp)
    usual = float(np.median(np.maximum.reduceat(bend / rounding, first)))
    short = np.mean(last - first < _SHORT)
    if usual < _SHARP or short < _MOSTLY or first.size < _FEWEST or first.size > 0.5 * t.size:
        return None
    left, right = first + 1, last + 1  # the line before ends at `left`, the one behind begins at `right`
    starts, ends = np.append(0, right), np.append(left, t.size - 1)
    long = ends > starts
    line = slope[np.minimum(starts, slope.size - 1)].copy()
    line[long] = (x[ends[long]] - x[starts[long]]) / (t[ends[long]] - t[starts[long]])
    before, after = line[:-1], line[1:]
    turn = after - before
    with np.errstate(divide="ignore", invalid="ignore"):
        meet = (x[left] - x[right] - before * t[left] + after * t[right]) / turn
    meet = np.clip(np.nan_to_num(meet), t[left], t[right])
    value = x[left] + before * (meet - t[left])
    apart = np.append(True, np.diff(meet) > 0.0)
    return _with_unseen(meet[apart], value[apart])


def _with_unseen(t: Array, x: Array) -> tuple[Array, Array]:
    """Put back the knots at which the line happened to go straight on: where a line is some usual lengths long."""
    lengths = np.diff(t)
    parts = np.rint(lengths / np.median(lengths)).astype(np.intp)
    parts[(parts < 1) | (parts > _LONGEST)] = 1
    first = np.repeat(np.arange(lengths.size), parts)
    within = np.arange(first.size) - np.repeat(np.cumsum(parts) - parts, parts)
    share = within / parts[first]
    return np.append(t[first] + share * lengths[first], t[-1]), np.append(x[first] + share * np.diff(x)[first], x[-1])


def _resolution(steps: Array, span: float) -> float:
    """Return the last digit of the values, in whatever unit they are now: the least that a line's increments change."""
    change = np.abs(np.diff(steps))
    least = _ROUNDED * span
    return float(change[change > least].min(initial=span)) if least > 0.0 and change.max() > least else least


def _runs(flags: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first and the last index of each run of set flags."""
    edges = np.diff(np.concatenate([[0], flags.astype(np.int8), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1


@dataclass(frozen=True)
class NoiseLevel:
    """The white noise of one channel, in the channel's unit.

    Attributes:
        std: standard deviation of a fresh sample; 0 where dead, NaN where there are too few samples.
        rate: fresh samples per second [Hz]; below the channel's own rate where each is repeated or lines are drawn
            between them. See `of_each`.
        share_of_outliers: share of the fresh samples on an offset (a spike, a lost marker) of more than about 10 std.
        quantum: step of a channel so coarse that it shows; 0 otherwise.
        samples: fresh samples that count.
        white: the orders agree, so that this is noise. Otherwise it is an upper limit (motion that no polynomial
            fits) or the floor of a stair; a channel that was smoothed on board ends up here too.
        dead: not one sample differs from another.
    """

    std: float
    rate: float
    share_of_outliers: float
    quantum: float
    samples: int
    white: bool = True
    dead: bool = False

    def of_each(self, rate: float) -> float:
        """Return the deviation to give every sample of a channel at `rate` [Hz], so that repeats do not count twice."""
        return self.std * max(1.0, (rate / self.rate) ** 0.5) if self.rate > 0.0 and rate > 0.0 else self.std


def noise_level(t: Array, values: Array, kind: Literal["linear", "angle"] = "linear") -> NoiseLevel:
    """Return the noise level of one channel.

    Args:
        t: times (n,) [s], strictly increasing.
        values: (n,), NaN where not measured.
        kind: "angle" compares modulo 2 pi.

    Raises:
        InputError: times and values differ in length.
    """
    t, values = np.asarray(t, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if t.ndim != 1 or t.shape != values.shape:
        raise InputError(f"noise: found times {t.shape} and values {values.shape}, expected two arrays of one length")
    known = np.isfinite(values)
    if not known.all():
        t, values = t[known], values[known]
    if t.size < 3:
        return NoiseLevel(np.nan, sampling_rate(t), 0.0, 0.0, int(t.size), white=False)
    gap = gap_limit(t)
    t, values = _blocks(t, values)
    if kind == "angle":
        values = np.unwrap(values)
    steps = np.diff(values)
    if not steps.any():
        return NoiseLevel(0.0, sampling_rate(t), 0.0, 0.0, int(t.size), white=False, dead=True)
    quantum = quantum_of(steps)
    samples = t.size
    t, values = fresh_samples(t, values, quantum)
    if t.size < samples:
        gap = max(gap, gap_limit(t))
    rate = sampling_rate(t)
    sizes, white = _by_order(t, values, gap)
    std = min(sizes, default=float("nan"))
    floor = quantum / np.sqrt(12.0)
    if quantum > 0.0 and not std > floor:
        std, white = float(floor), False
    outliers = _outliers(t, values, std, gap) / t.size if std > 0.0 else 0.0
    return NoiseLevel(float(std), rate, outliers, quantum, int(t.size), white)


def noise_levels(recording: Recording) -> dict[str, NoiseLevel]:
    """Return the noise level of every motion channel; an attitude in quaternions as phi, theta, psi [rad]."""
    levels = {
        name: noise_level(recording[name].t, recording[name].values, "angle" if name in EULER else "linear")
        for name in MEASURED
        if name in recording
    }
    if all(name in recording for name in QUATERNION):
        t, q = quaternion_samples(recording)
        angles = eulers_from_quaternions(q) if t.size else np.empty((0, 3))
        for j, name in enumerate(EULER):
            if name not in levels:
                levels[name] = noise_level(t, angles[:, j], "angle")
    return levels


def _blocks(t: Array, values: Array) -> tuple[Array, Array]:
    """Return all samples, or of a long channel whole blocks spread evenly; between them lie gaps."""
    if t.size <= _MOST:
        return t, values
    starts = np.linspace(0, t.size - _BLOCK, _MOST // _BLOCK).astype(np.intp)
    at = np.unique(starts[:, None] + np.arange(_BLOCK))
    return t[at], values[at]


def _by_order(t: Array, values: Array, gap: float) -> tuple[list[float], bool]:
    """Return the deviations by order, up to the last that is surely smaller, and whether the orders then agree."""
    sizes: list[float] = []
    agree = False
    for order in _ORDERS:
        d = _differences(t, values, order, gap)
        if d.size < _FEWEST:
            break
        size = robust_size(d)
        if not sizes or size < sizes[-1] * (1.0 - 2.0 / np.sqrt(d.size)):
            sizes.append(size)
            agree = False
        else:
            agree = size > 0.0
    return sizes, agree


def _differences(t: Array, x: Array, order: int, gap: float) -> Array:
    """Return the scaled differences of every order + 1 samples without a gap between them."""
    steps = np.diff(t)
    n = steps.size - order + 1
    if n < 1:
        return np.empty(0)
    usual = median_step(t)
    regular = np.abs(steps - usual) <= _JITTER * usual
    close = _every(steps <= gap, order)
    if _every(regular, order)[close].all():
        differences = np.diff(x, order)[close]
        weights = np.array([_binomial(order, i) for i in range(order + 1)], dtype=np.float64)
        regularly: Array = differences / np.linalg.norm(weights)
        return regularly
    at = np.flatnonzero(close)
    since = [t[at + i] - t[at] for i in range(order + 1)]
    total, square = np.zeros(at.size), np.zeros(at.size)
    for i in range(order + 1):
        weight = np.full(at.size, usual**order)
        for j in range(order + 1):
            if j != i:
                weight /= since[i] - since[j]
        total += weight * x[at + i]
        square += weight * weight
    irregularly: Array = total / np.sqrt(square)
    return irregularly


def _every(flags: NDArray[np.bool_], length: int) -> NDArray[np.bool_]:
    """Return whether all of each `length` neighbouring flags are set."""
    out = flags[: flags.size - length + 1].copy()
    for k in range(1, length):
        out &= flags[k : flags.size - length + 1 + k]
    return out


def _binomial(n: int, k: int) -> float:
    out = 1.0
    for i in range(k):
        out *= (n - i) / (i + 1)
    return out


def robust_size(d: Array) -> float:
    """Return the deviation of the bulk of `d`: a quantile of its size, then the mean square within three of these."""
    size = np.abs(d)
    std = float(np.quantile(size, _BULK)) / _BULK_SIZE
    for _ in range(_ROUNDS):
        if std > 0.0:
            inside = size[size <= _CLIP * std] / std
            std *= float(np.sqrt(np.dot(inside, inside) / (inside.size * _CLIPPED_VARIANCE)))
    return std


def _outliers(t: Array, x: Array, std: float, gap: float) -> int:
    """Return how many samples lie on an offset that appears in one step and goes in one.

    A step beside its two neighbours' mean, s_i - (s_i-1 + s_i+1) / 2, has the deviation sqrt(5) std.
    """
    steps = np.diff(x)
    if steps.size < 5:
        return 0
    jump = steps[1:-1] - 0.5 * (steps[:-2] + steps[2:])
    size = np.abs(jump)
    limit = _STANDS_OUT * np.sqrt(5.0) * std
    peak = np.append(True, _PEAK * size[1:] >= size[:-1]) & np.append(_PEAK * size[:-1] >= size[1:], True)
    at = np.flatnonzero((size > limit) & peak & _every(np.diff(t) <= gap, 3)) + 1  # between samples at and at + 1
    count, k = 0, 0
    while k + 1 < at.size:
        here, back = int(at[k]), int(at[k + 1])
        height, fall = jump[here - 1], jump[back - 1]
        returns = height * fall < 0.0 and abs(height + fall) < _RETURN * max(abs(height), abs(fall))
        if returns and t[back] - t[here] <= _PLATEAU:
            count += back - here
            k += 2
        else:
            k += 1
    return count


def noise_of_rows(
    t: Array, values: Array, typical: Sequence[float], least: Sequence[float], latest: int | None = None
) -> Array:
    """Return the noise (18,) that rows show by themselves, or the `latest` of them.

    Args:
        t: times (n,) [s]. values: (n, 18), in the order of `standard.MEASURED`, NaN where not measured.
        typical, least: noise (18,) of a usual sensor, and the least that is believed.
    """
    first = 0 if latest is None else max(0, len(t) - latest)
    told = {}
    for j, name in enumerate(MEASURED):
        column = values[first:, j]
        known = np.isfinite(column)
        if known.sum() < _FEWEST_ROWS:
            continue
        stamps = t[first:][known]
        regular = np.concatenate([[True], np.diff(stamps) > 0.0])
        level = noise_level(stamps[regular], column[known][regular], "angle" if name in ("phi", "psi") else "linear")
        span = float(stamps[-1] - stamps[0])
        told[j] = level, (len(stamps) - 1) / span if span > 0.0 else level.rate
    return _noise_told_by(told, typical, least)


def _noise_told_by(
    shown: Mapping[int, tuple[NoiseLevel, float]], typical: Sequence[float], least: Sequence[float]
) -> Array:
    """Return the noise (18,) of each sample from what columns show by themselves, and their rates [Hz].

    A sensor that has smoothed most of its numbers shows next to no noise, or that of their last digit, and its errors
    go together: then they are taken for those of a usual sensor.
    """
    noise = np.array(typical)
    for first in range(0, noise.size, 3):
        own = {
            j: each
            for j, each in shown.items()
            if first <= j < first + 3 and np.isfinite(each[0].std) and each[0].std > 0.0 and not each[0].dead
        }
        smooth = {j for j, (level, _) in own.items() if not level.white or level.std < _OF_ROUNDING * level.quantum}
        for j, (level, rate) in own.items():
            shows = max(level.of_each(rate), level.quantum / math.sqrt(12.0), float(least[j]))
            noise[j] = max(shows, noise[j]) if j in smooth or len(smooth) > 0.5 * len(own) else shows
    return noise
