"""Charts as inline SVG: lines, bands and marks over one axis, coloured by the page's own style sheet.

Of a long series every column of pixels shows the least and the greatest, in the order they came.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.printable import escaped

__all__ = ["Band", "Chart", "Line", "Point", "Stem", "chart_svg", "decimated", "pieces", "ticks"]

_GAP = 6.0  # typical steps without a sample, beyond which a line is broken
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 10, 8, 30
_ROOM = 0.06  # of the height, above and below


def pieces(x: Array, y: Array) -> list[tuple[Array, Array]]:
    """Return the stretches (x, y) of a series without its NaN, cut where there is a gap."""
    known = np.isfinite(x) & np.isfinite(y)
    x, y = np.asarray(x, dtype=np.float64)[known], np.asarray(y, dtype=np.float64)[known]
    if x.size < 2:
        return [(x, y)] if x.size else []
    steps = np.diff(x)
    cuts = np.flatnonzero(steps > _GAP * float(np.median(steps))) + 1
    return list(zip(np.split(x, cuts), np.split(y, cuts), strict=True))


def decimated(x: Array, y: Array, columns: int, span: tuple[float, float]) -> tuple[Array, Array]:
    """Return at most two points for each of `columns` equal parts of `span`; all where there are no more than that.

    No extreme is lost: the envelope of the line stays what it was.
    """
    if x.size <= 2 * columns:
        return x, y
    low, high = span
    column = np.clip(((x - low) / (high - low) * columns).astype(np.intp), 0, columns - 1)
    starts = np.flatnonzero(np.concatenate([[True], np.diff(column) > 0]))
    ends = np.concatenate([starts[1:], [x.size]])
    rows: list[int] = []
    for first, last in zip(starts, ends, strict=True):
        least, most = int(first + np.argmin(y[first:last])), int(first + np.argmax(y[first:last]))
        rows += [min(least, most), max(least, most)] if least != most else [least]
    return x[rows], y[rows]


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """Return about `count` round numbers within [low, high].

    >>> ticks(0.0, 10.0)
    [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]
    """
    span = high - low
    if not (math.isfinite(span) and span > 0.0):
        return []
    rough = span / max(count, 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= rough * 0.999)
    first = math.ceil(low / step - 1e-9)
    last = math.floor(high / step + 1e-9)
    return [float(f"{k * step:.12g}") + 0.0 for k in range(first, last + 1)]


def tick_text(value: float) -> str:
    """Return the number beside a tick.

    >>> tick_text(-0.25), tick_text(120000.0)
    ('−0.25', '1.2e5')
    """
    text = f"{value:.6g}" if abs(value) < 1e5 else f"{value:.3g}".replace("e+0", "e").replace("e+", "e")
    return text.replace("-", "−")


@dataclass(frozen=True, eq=False)
class Line:
    """A line through x (n,), y (n,), broken where y is NaN; `style` is a class of the style sheet."""

    x: Array
    y: Array
    style: str


@dataclass(frozen=True, eq=False)
class Band:
    """The area between low (n,) and high (n,)."""

    x: Array
    low: Array
    high: Array
    style: str = "band"


@dataclass(frozen=True)
class Point:
    """A value at x with its interval."""

    x: float
    y: float
    low: float
    high: float
    style: str = "result"


@dataclass(frozen=True, eq=False)
class Stem:
    """Stems from zero to y (n,) at x (n,)."""

    x: Array
    y: Array
    style: str = "stem"


@dataclass(frozen=True, eq=False)
class Chart:
    """One chart.

    Attributes:
        label: what a screen reader says. parts: drawn in their order. x_name: beneath the axis.
        y_range: of the axis; all parts by default. x_range: likewise. levels: y and style of level lines; they do not
            widen the range. cuts: x of vertical lines.
        width, height: in pixels of a screen; the page scales it. columns: of decimation, the width by default.
    """

    label: str
    parts: Sequence[Line | Band | Point | Stem]
    x_name: str = ""
    y_range: tuple[float, float] | None = None
    x_range: tuple[float, float] | None = None
    levels: Sequence[tuple[float, str]] = ()
    cuts: Sequence[float] = ()
    width: int = 420
    height: int = 190
    columns: int = 0


@dataclass(frozen=True)
class _Frame:
    """Where values lie on the canvas."""

    x: tuple[float, float]
    y: tuple[float, float]
    width: int
    height: int

    def across(self, x: Array) -> Array:
        low, high = self.x
        return np.asarray(_LEFT + (x - low) / (high - low) * (self.width - _LEFT - _RIGHT))

    def down(self, y: Array) -> Array:
        low, high = self.y
        inside = self.height - _TOP - _BOTTOM
        return np.asarray(np.clip(_TOP + (high - y) / (high - low) * inside, -self.height, 2 * self.height))


def chart_svg(chart: Chart) -> str:
    """Return the chart as an `<svg>` element; an empty text where there is nothing to draw."""
    xs = chart.x_range or _range(_xs(chart.parts), 0.0)
    ys = chart.y_range or _range(_ys(chart.parts), _ROOM)
    if xs is None or ys is None:
        return ""
    frame = _Frame(xs, ys, chart.width, chart.height)
    columns = chart.columns or chart.width - _LEFT - _RIGHT
    right, floor = chart.width - _RIGHT, chart.height - _BOTTOM
    out = [
        f'<svg class="chart" viewBox="0 0 {chart.width} {chart.height}" role="img" '
        f'aria-label="{escaped(chart.label)}">',
    ]
    out += _grid(frame, chart.x_name)
    box = f"{_LEFT} {_TOP} {right - _LEFT} {floor - _TOP}"  # an inner <svg> clips what it holds
    sides = f'x="{_LEFT}" y="{_TOP}" width="{right - _LEFT}" height="{floor - _TOP}"'
    out.append(f'<svg {sides} viewBox="{box}">')
    for x in chart.cuts:
        out.append(f'<path class="cut" d="M{float(frame.across(np.array(x))):.1f} {_TOP}V{floor}"/>')
    for part in chart.parts:
        out += _drawn(part, frame, columns)
    for y, style in chart.levels:
        if ys[0] <= y <= ys[1]:
            out.append(f'<path class="{style}" d="M{_LEFT} {float(frame.down(np.array(y))):.1f}H{right}"/>')
    return "".join([*out, "</svg></svg>"])


def _grid(frame: _Frame, x_name: str) -> list[str]:
    right, floor = frame.width - _RIGHT, frame.height - _BOTTOM
    out = []
    for value in ticks(*frame.y, count=4):
        y = float(frame.down(np.array(value)))
        out.append(f'<path class="{"zero" if value == 0.0 else "rule"}" d="M{_LEFT} {y:.1f}H{right}"/>')
        out.append(f'<text class="ty" x="{_LEFT - 6}" y="{y + 4:.1f}">{tick_text(value)}</text>')
    places = ticks(*frame.x, count=5)
    for value in places:
        x = float(frame.across(np.array(value)))
        unit = f" {x_name}" if x_name and value == places[-1] else ""
        anchor = " end" if unit and x > right - 14 else ""
        x = min(x, right) if anchor else x
        out.append(f'<text class="tx{anchor}" x="{x:.1f}" y="{floor + 17}">{tick_text(value)}{unit}</text>')
    return out


def _drawn(part: Line | Band | Point | Stem, frame: _Frame, columns: int) -> list[str]:
    if isinstance(part, Line):
        paths = [_path(*decimated(x, y, columns, frame.x), frame) for x, y in pieces(part.x, part.y)]
        return [f'<path class="{part.style}" d="{"".join(paths)}"/>'] if paths else []
    if isinstance(part, Band):
        out = []
        known = np.isfinite(part.low) & np.isfinite(part.high)
        for x, high in pieces(part.x, np.where(known, part.high, np.nan)):
            low = part.low[np.searchsorted(part.x, x)]
            there, back = _path(x, high, frame), _path(x[::-1], low[::-1], frame)
            out.append(f'<path class="{part.style}" d="{there}L{back[1:]}Z"/>')
        return out
    if isinstance(part, Stem):
        zero = float(frame.down(np.array(0.0)))
        tops = zip(frame.across(part.x), frame.down(part.y), strict=True)
        lines = "".join(f"M{a:.1f} {zero:.1f}V{b:.1f}" for a, b in tops if b == b)
        return [f'<path class="{part.style}" d="{lines}"/>']
    at = float(frame.across(np.array(part.x)))
    middle, bottom, top = (float(v) for v in frame.down(np.array([part.y, part.low, part.high])))
    return [
        f'<path class="{part.style}" d="M{at:.1f} {bottom:.1f}V{top:.1f}"/>',
        f'<circle class="{part.style}" cx="{at:.1f}" cy="{middle:.1f}" r="3"/>',
    ]


def _path(x: Array, y: Array, frame: _Frame) -> str:
    points = [f"{a:.1f} {b:.1f}" for a, b in zip(frame.across(x), frame.down(y), strict=True)]
    if len(points) == 1:
        return f"M{points[0]}h.5"
    return f"M{points[0]}L{' '.join(points[1:])}"


def _xs(parts: Iterable[Line | Band | Point | Stem]) -> list[Array]:
    return [np.atleast_1d(np.asarray(part.x, dtype=np.float64)) for part in parts]


def _ys(parts: Iterable[Line | Band | Point | Stem]) -> list[Array]:
    out: list[Array] = []
    for part in parts:
        if isinstance(part, Band):
            out += [part.low, part.high]
        elif isinstance(part, Point):
            out.append(np.array([part.low, part.high]))
        elif isinstance(part, Stem):
            out += [part.y, np.zeros(1)]
        else:
            out.append(part.y)
    return out


def _range(values: Sequence[Array], room: float) -> tuple[float, float] | None:
    """Return the range of all finite values with some room; None where there is none."""
    every = np.concatenate([np.ravel(each) for each in values]) if values else np.empty(0)
    every = every[np.isfinite(every)]
    if not every.size:
        return None
    low, high = float(every.min()), float(every.max())
    if high - low <= 1e-12 * max(abs(low), abs(high), 1e-12):
        half = 0.5 * abs(low) if low else 1.0
        return low - half, high + half
    return low - room * (high - low), high + room * (high - low)
