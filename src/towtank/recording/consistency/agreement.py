"""Whether a recording agrees with itself: speeds with the pose that they should be the derivative of, a wrench with the
commands that should have made it, one clock with another.

Both sides become means over short cells: the speed measured, and the way between two poses over its time, turned into
the body. Both go through the same window, so that neither is later than the other, and are compared at lags up to half
a second: m(t + lag) = g d(t). Both have noise. Regression of m on d makes g too small by it, that of d on m makes 1/g
too small, and the truth lies between: a gain is wrong where all between is wrong. Deviations come from leaving out one
stretch of the recording at a time (jackknife). Where nothing moves, where noise is more than motion, or where there is
little data nothing is said.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.digits import joined, short
from towtank.recording.consistency.accounts import (
    LEAST_STRETCHES,
    Cells,
    Pair,
    of_depth,
    of_heading,
    of_rates,
    of_velocity,
    of_wrench,
)
from towtank.recording.consistency.rates import rate_scales
from towtank.recording.consistency.sizes import impossible_sizes
from towtank.recording.consistency.tracks import FEWEST
from towtank.recording.recording import Recording
from towtank.recording.standard import RATES

__all__ = ["Finding", "inconsistencies"]

_ROUGH = 0.5  # energy between neighbouring cells, of that of the motion: more is noise
_SURE = 5.0  # deviations
_FOLLOWS, _UNRELATED = 0.6, 0.2  # share of a speed's square that the other side explains
_AGAINST = 0.5  # of what one sign explains, that the other may explain for it to be told
_GAIN, _FORCE_GAIN = 0.12, 0.2  # that a gain may be off
_TOLERATED, _STEPS = 0.04, 0.75  # s; of the steps of a table whose rows are filled as values come: what a lag may be
_SHORT_GAIN, _NO_VEHICLE = 1.5, 4.0 * math.pi  # that a gain may be off, told by single angles; rad/s
_LEAST_TIME = 20.0  # s
_DRIFT = 0.05  # s over the recording
_TURN = math.radians(6.0)
_WORSE, _BETTER = 3.0, 0.03  # times what another frame leaves, and share, that the body's must leave beyond it
_UNITS = (
    (math.degrees(1.0), "degrees, not radians", "scale = 0.0174533"),
    (math.radians(1.0), "turned from degrees into radians twice", "leave its scale out"),
    (1000.0, "millimetres, not metres", "scale = 0.001"),
    (100.0, "centimetres, not metres", "scale = 0.01"),
    (3.6, "km/h, not m/s", "scale = 0.27778"),
    (1.94384, "knots, not m/s", "scale = 0.51444"),
    (0.3048, "scaled from feet once too often", "leave its scale out"),
    (3.28084, "feet, not metres", "scale = 0.3048"),
)


@dataclass(frozen=True)
class Finding:
    """What cannot be right.

    Attributes:
        what: channels, axis or unknown. text: in plain words, with what to check.
        allowed_for: learning finds it too and reckons with it, so that its result may be right all the same.
        of_model: of what was learned or mended, not of the recording: it may predict all the same.
    """

    what: str
    text: str
    allowed_for: bool = False
    of_model: bool = False


def inconsistencies(recording: Recording, commanded: tuple[Array, Array] | None = None) -> tuple[Finding, ...]:
    """Return what in a recording contradicts itself, gravest first: frames, signs, units, lags, clocks.

    Args:
        commanded: times (n,) [s] and the wrench (n, 6) that the recorded commands make on the vehicle, to compare a
            recorded wrench with.
    """
    found: list[tuple[int, Finding]] = []
    pairs = [make(recording) for make in (of_velocity, of_depth, of_rates, of_heading)]
    for pair in pairs:
        if pair is not None:
            found += _judged(pair)
    if pairs[2] is None and pairs[3] is None:  # only some of the angles, or none
        found += _scales(recording)
    pair = None if commanded is None else of_wrench(recording, *commanded)
    if pair is not None:
        found += _judged_wrench(pair)
    named = {name for _, finding in found for name in finding.what.split()}
    sizes = [(0, Finding(*each)) for each in impossible_sizes(recording) if not named & set(each[0].split())]
    found = [*sizes, *found]  # where a log contradicts itself, that says more
    return tuple(finding for _, finding in sorted(found, key=lambda each: each[0]))


@dataclass(frozen=True, eq=False)
class _Sums:
    """Products of deviations from the mean by stretch, lag and column (s, l, k), and those of the derived (s, k)."""

    md: Array
    mm: Array
    dd: Array

    def over(self, rows: NDArray[np.bool_]) -> _Reading:
        """Return what these stretches say together."""
        return _reading(self.md[rows].sum(axis=0), self.mm[rows].sum(axis=0), self.dd[rows].sum(axis=0))

    def each_left_out(self, of: Callable[[_Sums, NDArray[np.bool_]], Array]) -> Array:
        """Return the deviation of a number (or several) by leaving out one stretch at a time."""
        n = self.md.shape[0]
        values = np.array([of(self, np.arange(n) != k) for k in range(n)])
        return np.asarray(np.sqrt((n - 1) / n * np.sum((values - values.mean(axis=0)) ** 2, axis=0)))


class _Reading(NamedTuple):
    """What both accounts say of each other.

    Attributes:
        lag: of the measured [cells]; at_edge: it is as long as any that was tried. low, high: gains (k,) between which
            the true one lies. share: of the square (k,) explained. against: that the other sign explains at any lag.
    """

    lag: float
    at_edge: bool
    low: Array
    high: Array
    share: Array
    against: Array


def _reading(md: Array, mm: Array, dd: Array) -> _Reading:
    shares = np.sign(md) * md**2 / np.maximum(mm * dd, 1e-300)
    total = (np.abs(shares) * (dd / dd.max(initial=1e-300))).sum(axis=1)
    best = int(np.argmax(total))
    middle = (len(total) - 1) // 2
    at_edge = best in (0, len(total) - 1)
    shift = 0.0
    if not at_edge:
        a, b, c = total[best - 1 : best + 2]
        shift = 0.5 * float(a - c) / float(a - 2.0 * b + c) if a - 2.0 * b + c < 0.0 else 0.0
    at = md[best], mm[best], dd
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = at[0] / at[2], at[1] / at[0]
    sign = np.sign(md[best])
    against = np.maximum(-sign * shares, 0.0).max(axis=0)
    return _Reading(best - middle + shift, at_edge, low, high, np.abs(shares[best]), against)


def _sums(measured: Array, derived: Array, cells: Cells) -> _Sums:
    """Return the sums of what is smooth alike: measured (s, n, k) at all lags beside derived."""
    core, lags = slice(cells.lags, cells.lags + cells.core), 2 * cells.lags + 1
    d = derived[:, core]
    good: NDArray[np.bool_] = np.asarray(np.isfinite(d).all(axis=-1))
    whole: NDArray[np.bool_] = np.asarray(np.isfinite(measured).all(axis=-1))
    for k in range(lags):
        good &= whole[:, k : k + cells.core]
    count = np.maximum(good.sum(axis=1), 1)[:, None]
    good &= count >= FEWEST
    weight = good[..., None]
    d = np.where(weight, d, 0.0)
    d = np.where(weight, d - d.sum(axis=1, keepdims=True) / count[:, None], 0.0)
    md, mm = np.empty((2, d.shape[0], lags, d.shape[2]))
    for k in range(lags):
        m = np.where(weight, measured[:, k : k + cells.core], 0.0)
        md[:, k] = (m * d).sum(axis=1)
        mm[:, k] = (m**2).sum(axis=1) - m.sum(axis=1) ** 2 / count
    return _Sums(md, mm, (d**2).sum(axis=1))


class _Judged(NamedTuple):
    """A pair as sums over the columns that move (`moving`, (k,)), with the stretches that count."""

    sums: _Sums
    reading: _Reading
    moving: NDArray[np.bool_]
    smooth: NDArray[np.bool_]
    rows: NDArray[np.bool_]


def _compared(pair: Pair, *, smooth_only: bool) -> _Judged | None:
    """Return what a pair says; None where nothing moves, or too few stretches are whole."""
    smooth_of = pair.cells.smooth
    m, d = smooth_of(pair.measured), smooth_of(pair.derived)
    sums = _sums(m, d, pair.cells)
    rows = sums.dd.sum(axis=1) > 0.0
    if rows.sum() < LEAST_STRETCHES:
        return None
    used = max(1.0, float(rows.sum()) * pair.cells.core)
    moving = np.sqrt(sums.dd.sum(axis=0) / used) > pair.floor
    moving &= sums.mm[:, pair.cells.lags].sum(axis=0) > 0.0
    smooth = _roughness(pair.derived, d) < _ROUGH
    if smooth_only:
        moving &= smooth
        smooth = smooth & (_roughness(pair.measured, m) < _ROUGH)
    if not moving.any():
        return None
    kept = _Sums(sums.md[rows][..., moving], sums.mm[rows][..., moving], sums.dd[rows][:, moving])
    return _Judged(kept, kept.over(np.ones(len(kept.dd), dtype=np.bool_)), moving, smooth[moving], rows)


def _roughness(cells: Array, smooth: Array) -> Array:
    """Return the energy (k,) that smoothing takes out, as a share of what it leaves: large of noise."""
    half = (cells.shape[1] - smooth.shape[1]) // 2
    detail = cells[:, half : cells.shape[1] - half] - smooth
    known: NDArray[np.bool_] = np.asarray(np.isfinite(detail).all(axis=-1))
    left = smooth - np.nanmean(np.where(known[..., None], smooth, np.nan), axis=(0, 1))
    return np.asarray(np.sum(detail[known] ** 2, axis=0) / np.maximum(np.sum(left[known] ** 2, axis=0), 1e-300))


_Ranked = tuple[int, Finding]


def _judged(pair: Pair) -> list[_Ranked]:
    """Return what is wrong with speeds, ranked by how grave it is."""
    compared = _compared(pair, smooth_only=True)
    if compared is None:
        return []
    names = [name for name, moves in zip(pair.names, compared.moving, strict=True) if moves]
    other = _other_frame(pair, compared)
    if other:
        return [(0, Finding(" ".join(pair.names), other))]
    turned = _turned(pair, compared)
    found: list[_Ranked] = [(1, Finding("u v", turned))] if turned else []
    plane = {"u", "v"} if turned else set()
    reading = compared.reading
    found += _gains(pair, names, compared, plane)
    wrong = {name for _, finding in found for name in finding.what.split()}
    for name, share, against, smooth in zip(names, reading.share, reading.against, compared.smooth, strict=True):
        if smooth and max(share, against) < _UNRELATED and name not in wrong | plane:
            text = f"{name} is not what {pair.source} does (it explains {100.0 * share:.0f} % of it)"
            found.append((2, Finding(name, f"{text}: check columns, frames and where the sensor sits")))
    if not found or turned:
        found += _lag(pair, compared)
    return found


def _scales(recording: Recording) -> list[_Ranked]:
    """Return the findings on signs and units of rates by the little attitude that there is, or by their size alone."""
    scales = rate_scales(recording) if recording.duration > _LEAST_TIME else []
    found: list[_Ranked] = []
    for each in scales:
        if _SURE * each.std > abs(each.scale - 1.0) or 1.0 / _SHORT_GAIN < each.scale < _SHORT_GAIN:
            continue
        _, cure = _cause(each.scale, each.scale, each.scale)
        found.append((1, Finding(each.name, f"{each.name} is {each.text} times what the attitude does: {cure}")))
    if not scales:
        rates = {name: np.abs(recording[name].measured.values) for name in RATES if name in recording}
        wild = [name for name, x in rates.items() if x.size >= FEWEST and float(np.quantile(x, 0.995)) > _NO_VEHICLE]
        if wild:
            largest = max(float(rates[name].max()) for name in wild)
            text = f"{' '.join(wild)} reach {short(largest, 2)} rad/s, more than any underwater vehicle turns"
            found.append(
                (1, Finding(" ".join(wild), f"{text}: degrees, not radians? (scale = 0.0174533 in the mapping)"))
            )
    return found


def _gains(pair: Pair, names: Sequence[str], compared: _Judged, skipped: Collection[str]) -> list[_Ranked]:
    """Return the findings on signs and scales: columns with the same trouble in one line."""
    reading, sums = compared.reading, compared.sums
    spread = sums.each_left_out(lambda each, rows: np.stack([each.over(rows).low, each.over(rows).high]))
    said: dict[tuple[str, str], list[tuple[str, float]]] = {}
    told: dict[str, str] = {}
    for k, name in enumerate(names):
        low, high = sorted((float(reading.low[k]), float(reading.high[k])), key=abs)
        gain = math.copysign(math.sqrt(abs(low * high)), low)
        margin = _SURE * float(np.nanmax(spread[:, k]))
        if name in skipped or reading.share[k] < _FOLLOWS or not math.isfinite(gain + margin):
            continue
        if gain < 0.0 and (reading.against[k] > _AGAINST * reading.share[k] or margin > abs(gain)):
            continue
        large, small = abs(low) - margin > 1.0 + _GAIN, abs(high) + margin < 1.0 / (1.0 + _GAIN)
        if gain > 0.0 and not (large or small):
            continue
        said.setdefault(_cause(gain, low, high), []).append((name, gain))
        told[name] = f"{short(gain, 4)} ± {margin / _SURE:.1g}"
    found: list[_Ranked] = []
    for (cause, cure), members in said.items():
        which = " ".join(name for name, _ in members)
        verb = "are" if len(members) > 1 else "is"
        size = joined(list(dict.fromkeys(short(gain, 2) for _, gain in members)))
        if cause == "sign" and [name for name, _ in members] in (["v", "w"], ["q", "r"]):
            cure = 'FLU, not FRD (body = "FLU" in the mapping)'
        elif cause == "scale" and members[0][1] < 1.0 and pair.cells.dt * reading.lag > _TOLERATED:
            cure = f"{pair.cells.dt * reading.lag:.2f} s late and smaller: a low-pass filter"
        exact = joined([told[name] for name, _ in members])
        found.append((1, Finding(which, f"{which} {verb} {size} times what {pair.source} does: {cure}; found {exact}")))
    return found


def _cause(gain: float, low: float, high: float) -> tuple[str, str]:
    """Return what makes such a gain, and its cure; low and high as far as noise leaves it open."""
    near = [
        (abs(math.log(abs(gain) / unit)), name, cure)
        for unit, name, cure in _UNITS
        if abs(low) / 1.05 < unit < abs(high) * 1.05
    ]
    if near:
        _, name, cure = min(near)
        return name, f"{name} ({cure} in the mapping)"
    if gain < 0.0 and abs(low) / 1.3 < 1.0 < abs(high) * 1.3:
        return "sign", "its sign (scale = -1.0 in the mapping turns a column round)"
    return "scale", "check units, frames and the filter before it"


def _other_frame(pair: Pair, compared: _Judged) -> str:
    """Return in which other frame a velocity is; nothing where it is in the body's, or that cannot be told."""
    if not pair.others or compared.moving.sum() < 2:
        return ""
    m = pair.cells.smooth(pair.measured)
    both = {name: _sums(m, pair.cells.smooth(d), pair.cells) for name, d in (("", pair.derived), *pair.others.items())}

    def shares(rows: NDArray[np.bool_]) -> Array:
        out = []
        for sums in both.values():
            md, mm, dd = (x[compared.rows][rows].sum(axis=0) for x in (sums.md, sums.mm, sums.dd))
            explained = np.maximum(md.sum(axis=1), 0.0) ** 2 / np.maximum(mm.sum(axis=1) * dd.sum(), 1e-300)
            out.append(explained.max())
        return np.array(out)

    n = int(compared.rows.sum())
    whole = shares(np.ones(n, dtype=np.bool_))
    best = int(np.argmax(whole))
    left, left_in_body = 1.0 - whole[best], 1.0 - whole[0]
    if best == 0 or whole[best] < _FOLLOWS or left_in_body < _WORSE * left + _BETTER:
        return ""
    spread = compared.sums.each_left_out(lambda _, rows: np.asarray(shares(rows)[best] - shares(rows)[0]))
    if whole[best] - whole[0] < _SURE * float(spread):
        return ""
    frame = list(both)[best]
    return (
        f"{' '.join(pair.names)} are {frame}, not in the body's: so they agree with the derivative of {pair.source} to "
        f"{100.0 * whole[best]:.0f} %, as they are to {100.0 * whole[0]:.0f} %; name them vn ve vd in the mapping"
    )


def _turned(pair: Pair, compared: _Judged) -> str:
    """Return by how much u v are turned against the course; nothing where they are not, or are mirrored."""
    if not pair.level or not compared.moving[:2].all():
        return ""
    m, d = pair.cells.smooth(pair.measured)[..., :2], pair.cells.smooth(pair.derived)[..., :2]
    straight, crossed = (_sums(m, each, pair.cells) for each in (d, d[..., ::-1]))
    at = pair.cells.lags + round(compared.reading.lag)
    own = straight.md[compared.rows, at]  # u with u, v with v
    cross = crossed.md[compared.rows, at]  # u with v, v with u
    size = straight.mm[compared.rows, at].sum() * straight.dd[compared.rows].sum()

    def turn(rows: NDArray[np.bool_]) -> tuple[complex, complex]:
        (a, b), (c, e) = own[rows].sum(axis=0), cross[rows].sum(axis=0)
        return complex(a + b, e - c), complex(a - b, e + c)

    every = np.ones(len(own), dtype=np.bool_)
    rotation, reflection = turn(every)
    angle = math.atan2(rotation.imag, rotation.real)
    follows = abs(rotation) ** 2 > _FOLLOWS * float(size) and abs(rotation) > abs(reflection)
    if not follows or abs(angle) < _TURN:
        return ""
    spread = compared.sums.each_left_out(lambda _, rows: np.asarray(np.angle(turn(rows)[0] * np.conj(rotation))))
    if abs(angle) < _SURE * float(spread) + 0.5 * _TURN:
        return ""
    side = "clockwise" if angle > 0.0 else "counter-clockwise"
    return (
        f"u v are turned by {abs(math.degrees(angle)):.0f}° {side} (seen from above) against what {pair.source} does: "
        "check how the sensor is mounted, and the heading"
    )


def _lag(pair: Pair, compared: _Judged) -> list[_Ranked]:
    """Return by how much speeds come late, and whether that drifts."""
    reading, sums, dt = compared.reading, compared.sums, pair.cells.dt
    weight = sums.dd.sum(axis=0)
    if float((reading.share * weight).sum() / weight.sum()) < _FOLLOWS or reading.at_edge:
        return []
    spread = dt * float(sums.each_left_out(lambda each, rows: np.asarray(each.over(rows).lag)))
    lag = dt * reading.lag
    which, verb = " ".join(pair.names), "arrive" if len(pair.names) > 1 or " of " in pair.names[0] else "arrives"
    verb = "arrives" if pair.names[0].startswith("the ") else verb
    found: list[_Ranked] = []
    drift = _drift(pair, compared) if pair.own_clock else None
    if drift is not None:
        first, last = drift
        text = (
            f"the clocks of {which} and of {pair.source} drift apart: {first:+.2f} s at the beginning, {last:+.2f} s "
            "at the end; use the stamps of one clock"
        )
        found.append((3, Finding(which, text)))
    elif abs(lag) > max(_TOLERATED, 0.0 if pair.own_clock else _STEPS * pair.cells.step) + _SURE * spread:
        side = "after" if lag > 0.0 else "before"
        cure = "learning finds it" if pair.own_clock else "shift the column"
        text = f"{which} {verb} {abs(lag):.2f} s {side} {pair.source}: a filter, a slow link, other stamps; {cure}"
        found.append((4, Finding(which, text, allowed_for=pair.own_clock)))
    return found


def _drift(pair: Pair, compared: _Judged) -> tuple[float, float] | None:
    """Return the lag at the beginning and at the end [s], where a straight line through it is beyond chance."""
    sums = compared.sums
    n = len(sums.dd)
    own = [sums.over(np.arange(n) == k) for k in range(n)]
    good = np.array([not each.at_edge and float(each.share.max()) > _FOLLOWS for each in own])
    if good.sum() < 8:
        return None
    t = pair.cells.middle[compared.rows][good]
    lag = pair.cells.dt * np.array([each.lag for each in own])[good]
    root = np.sqrt(sums.dd.sum(axis=1)[good])
    columns = np.column_stack([np.ones(t.size), (t - t[0]) / (t[-1] - t[0])])
    fit, *_ = np.linalg.lstsq(columns * root[:, None], lag * root, rcond=None)
    left = (lag - columns @ fit) * root
    variance = (
        float(left @ left) / (t.size - 2) * np.linalg.inv((columns * root[:, None]).T @ (columns * root[:, None]))
    )
    change = float(fit[1])
    if abs(change) < _DRIFT + (_SURE + 1.0) * math.sqrt(variance[1, 1]):
        return None
    return float(fit[0]), float(fit.sum())


def _judged_wrench(pair: Pair) -> list[_Ranked]:
    """Return where a recorded wrench is not what the commands make."""
    compared = _compared(pair, smooth_only=False)
    if compared is None:
        return []
    reading, found = compared.reading, []
    names = [name for name, moves in zip(pair.names, compared.moving, strict=True) if moves]
    for k, name in enumerate(names):
        share, low, high = float(reading.share[k]), float(reading.low[k]), float(reading.high[k])
        cure = "check thruster curves, places, directions and order, voltage and units"
        if share < _FOLLOWS:
            text = f"the recorded {name} is not what the commands make of it ({100.0 * share:.0f} % in common)"
        elif low < 0.0 or abs(math.log(math.sqrt(low * high))) > math.log(1.0 + _FORCE_GAIN):
            gain = math.copysign(math.sqrt(low * high), low)
            text = f"the recorded {name} is {short(gain, 2)} times what the commands make of it"
        else:
            continue
        found.append((1, Finding(name, f"{text}: {cure}")))
    return found
