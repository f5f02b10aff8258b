"""Samples that carry news: what a slow or coarse instrument shows once it was logged faster or in small integers.

A logger repeats the last value (held), draws straight lines between values (interpolated), or the instrument knows only
multiples of a quantum. Taken for independent samples, each of these looks like far less noise than there is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array

__all__ = ["fresh_samples", "quantum_of"]

_FEWEST = 12
_HELD = 0.2  # share of repeats from which they are looked into
_FAR = 2.5  # quanta of a usual increment from which standing still is no coincidence
_COARSE = 30.0  # quanta of a usual increment beyond which the quantum does not matter
_WHOLE = 0.1  # of a quantum that increments may be off a multiple
_ROUNDED = 1e-9  # of the range; what is smaller is rounding within the machine
_ROUNDINGS = 2.0  # last digits by which a line may bend
_STRAIGHT = 0.4  # least share of the samples that lie within lines
_SHARP = 3.0  # times what rounding explains that a usual knot bends
_SHORT = 3  # samples that one knot may bend
_LONGEST = 4  # usual lengths of a line that knots may hide in
_MOSTLY = 0.8  # share of the knots that must be so short


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
    if _is_held(steps, quantum):
        changed = np.append(True, steps != 0.0)
        return t[changed], x[changed]
    knots = _knots(t, x)
    return (t, x) if knots is None else knots


def _is_held(steps: Array, quantum: float) -> bool:
    """Return whether samples are repeated, not merely alike: many stand still, and the others move far."""
    moving = np.abs(steps[steps != 0.0])
    if moving.size > (1.0 - _HELD) * steps.size or not moving.size:
        return False
    return quantum == 0.0 or float(np.median(moving)) > _FAR * quantum


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
