"""Drawings of a plan: paths in the tank from above and from the side, what each axis is asked, ellipses."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import short
from towtank.planning import RATE, Segment, Space
from towtank.printable import escaped
from towtank.report.chart import tick_text, ticks

__all__ = ["Ellipse", "TankView", "ellipse_svg", "tank_svg", "time_line_svg"]

_WIDTH = 420
_LEFT, _RIGHT, _TOP, _BOTTOM = 46, 12, 10, 34
_GAP = 26  # between the two views
_BEYOND = 0.05  # m beyond the frame, that a path is drawn to
_STEP = 4  # rows between two points of a path: 0.16 s
_AXES = ("Surge", "Sway", "Heave", "Roll", "Pitch", "Yaw")
_UNITS = ("N", "N", "N", "N m", "N m", "N m")
_ROW, _HALF = 46, 17  # height of an axis of the time line, half of its largest block
_NAMES = 74  # width of their names
_CORNERS = 96  # of an ellipse


@dataclass(frozen=True, eq=False)
class TankView:
    """Paths of a segment in its tank.

    Attributes:
        path: of the middle vehicle (n, 3) [m], NED. cloud: of drawn vehicles (r, n, 3) [m]. space: None in open water.
        radius: of the vehicle [m], 0 where it does not count.
    """

    path: Array
    cloud: Array
    space: Space | None
    radius: float


def tank_svg(view: TankView, label: str) -> str:
    """Return the paths from above (x to the right, y down) and, beneath, from the side (x to the right, z down).

    A drawn vehicle's path ends where it touches a wall.
    """
    low, high = _box(view)
    scale = (_WIDTH - _LEFT - _RIGHT) / float(high[0] - low[0])
    heights = [float(high[row] - low[row]) * scale for row in (1, 2)]
    total = _TOP + heights[0] + _GAP + heights[1] + _BOTTOM
    out = [
        f'<svg class="chart tank" viewBox="0 0 {_WIDTH} {total:.0f}" role="img" aria-label="{escaped(label)}">',
        *_rulers(low, high, scale, heights),
    ]
    floor = float(_TOP)
    for row, height in zip((1, 2), heights, strict=True):
        out += _view(view, row, (low, high), scale, (floor, height))
        floor += height + _GAP
    return "".join([*out, "</svg>"])


def _box(view: TankView) -> tuple[Array, Array]:
    """Return the corners (3,) [m] of what is drawn: the tank, or in open water all paths with some room."""
    if view.space is not None:
        return view.space.lower, view.space.upper
    every = np.vstack([view.path, view.cloud.reshape(-1, 3)])
    every = every[np.isfinite(every).all(axis=1)]
    low, high = np.percentile(every, 1.0, axis=0), np.percentile(every, 99.0, axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low) + 0.3
    half[1:] = np.clip(half[1:], 0.4 * half[0], 1.5 * half[0])
    return middle - half, middle + half


def _rulers(low: Array, high: Array, scale: float, heights: Sequence[float]) -> list[str]:
    """Return the numbers along the edges [m]."""
    out, floor = [], float(_TOP)
    for row, name, height in zip((1, 2), "yz", heights, strict=True):
        for value in ticks(float(low[row]), float(high[row]), max(2, round(height / 60.0))):
            y = floor + (value - float(low[row])) * scale
            y = min(max(y + 4.0, floor + 9.0), floor + height)
            out.append(f'<text class="ty" x="{_LEFT - 6}" y="{y:.1f}">{tick_text(value)}</text>')
        out.append(f'<text class="tx" x="12" y="{floor + 0.5 * height + 4:.1f}">{name}</text>')
        floor += height + _GAP
    bottom, middle = floor - _GAP, 0.5 * (_LEFT + _WIDTH - _RIGHT)
    out += _across((float(low[0]), float(high[0])), (_LEFT, scale), bottom + 17.0, "m")
    out.append(f'<text class="tx" x="{middle:.0f}" y="{bottom + 31:.1f}">x, where it heads</text>')
    return out


def _across(span: tuple[float, float], place: tuple[float, float], y: float, unit: str) -> list[str]:
    """Return the numbers beneath an axis that begins at place[0] with place[1] pixels to the unit."""
    out = []
    places = ticks(*span, 5)
    for value in places:
        x = place[0] + (value - span[0]) * place[1]
        end = " end" if x > _WIDTH - _RIGHT - 12 else ""
        text = f"{tick_text(value)} {unit}" if value == places[-1] else tick_text(value)
        out.append(f'<text class="tx{end}" x="{x:.1f}" y="{y:.1f}">{text}</text>')
    return out


def _view(view: TankView, row: int, box: tuple[Array, Array], scale: float, place: tuple[float, float]) -> list[str]:
    low, high = box
    top, height = place
    width = float(high[0] - low[0]) * scale

    def at(points: Array) -> Array:
        seen = np.clip(points, low - _BEYOND, high + _BEYOND)
        return np.column_stack([_LEFT + (seen[:, 0] - low[0]) * scale, top + (seen[:, row] - low[row]) * scale])

    sides = f'x="{_LEFT}" y="{top:.1f}" width="{width:.1f}" height="{height:.1f}"'
    out = [
        f'<rect class="water" {sides}/><rect class="wall{"" if view.space is not None else " open"}" {sides}/>',
        f'<svg {sides} viewBox="{_LEFT} {top:.1f} {width:.1f} {height:.1f}">',  # clips what it holds
    ]
    if view.space is not None:
        inner = view.space.margin * scale
        out.append(
            f'<rect class="margin" x="{_LEFT + inner:.1f}" y="{top + inner:.1f}" width="{width - 2 * inner:.1f}" '
            f'height="{height - 2 * inner:.1f}"/>'
        )
    kept, ends, touched = [], [], []
    for each in view.cloud:
        last = _last(each, view)
        line = at(each[: last + 1 : _STEP] if last >= _STEP else each[:2])
        kept.append(_path(line))
        x, y = at(each[last : last + 1])[0]
        if last < len(each) - 1:
            touched.append(f'<path class="touch" d="M{x - 3.5:.1f} {y - 3.5:.1f}l7 7m0 -7l-7 7"/>')
        else:
            ends.append(f'<circle class="drawn" cx="{x:.1f}" cy="{y:.1f}" r="2"/>')
    out.append(f'<path class="cloud" d="{"".join(kept)}"/>')
    out += [*ends, *touched, f'<path class="middle" d="{_path(at(view.path[::2]))}"/>']
    x, y = at(view.path[:1])[0]
    if view.radius:
        out.append(f'<circle class="size" cx="{x:.1f}" cy="{y:.1f}" r="{view.radius * scale:.1f}"/>')
    out.append(f'<circle class="start" cx="{x:.1f}" cy="{y:.1f}" r="4.5"/>')
    x, y = at(view.path[-1:])[0]
    out.append(f'<circle class="end" cx="{x:.1f}" cy="{y:.1f}" r="4.5"/></svg>')
    return out


def _last(path: Array, view: TankView) -> int:
    """Return the row at which a path (n, 3) touches a wall or grows beyond all bounds; its last one where neither."""
    inside = np.isfinite(path).all(axis=1)
    if view.space is not None:
        inside &= view.space.clearance(path, view.radius) >= 0.0
    out = np.flatnonzero(~inside)
    return int(max(out[0], 1)) if out.size else len(path) - 1


def _path(points: Array) -> str:
    text = [f"{x:.1f} {y:.1f}" for x, y in points if math.isfinite(x) and math.isfinite(y)]
    return f"M{text[0]}L{' '.join(text[1:])}" if len(text) > 1 else ""


def time_line_svg(segment: Segment, label: str) -> str:
    """Return what each axis is asked over a segment: blocks above the line one way, below it the other way."""
    rows, wrench = segment.rows, segment.wrench
    height = _TOP + _ROW * len(rows) + _BOTTOM
    width = _WIDTH - _NAMES - _RIGHT
    span = float(segment.duration)
    out = [f'<svg class="chart line" viewBox="0 0 {_WIDTH} {height}" role="img" aria-label="{escaped(label)}">']
    out += _across((0.0, span), (_NAMES, width / span), height - 16.0, "s")
    sides = f'x="{_NAMES}" y="{_TOP}" width="{width}" height="{_ROW * len(rows)}"'
    names = []
    inner = [f'<svg {sides} viewBox="{_NAMES} {_TOP} {width} {_ROW * len(rows)}">']
    for value in ticks(0.0, span, 5):
        x = _NAMES + value / span * width
        inner.append(f'<path class="rule" d="M{x:.1f} {_TOP}V{height - _BOTTOM}"/>')
    for k, row in enumerate(rows):
        middle = _TOP + (k + 0.5) * _ROW
        amount = f"{short(float(np.abs(wrench[:, row]).max()), 3)} {_UNITS[row]}"
        names.append(f'<text class="axis" x="0" y="{middle - 1:.1f}">{_AXES[row]}</text>')
        names.append(f'<text class="amount" x="0" y="{middle + 13:.1f}">{amount}</text>')
        inner += _blocks(wrench[:, row], middle, width, span)
        inner.append(f'<path class="zero" d="M{_NAMES} {middle:.1f}h{width}"/>')
    return "".join([*out, *names, *inner, "</svg></svg>"])


def _blocks(values: Array, middle: float, width: float, span: float) -> list[str]:
    """Return the areas of one axis, each time it changes its sign a new one."""
    largest = float(np.abs(values).max()) or 1.0
    signs = np.sign(values)
    edges = [0, *(np.flatnonzero(np.diff(signs)) + 1).tolist(), values.size]
    out = []
    for first, last in itertools.pairwise(edges):
        part = values[first:last] / largest * _HALF
        if not signs[first]:
            continue
        x = _NAMES + np.arange(first, last + 1) / RATE / span * width
        style = "plus" if signs[first] > 0.0 else "minus"
        if np.ptp(part) < 1e-9:
            y, wide, tall = min(middle, middle - float(part[0])), max(x[-1] - x[0] - 1.0, 0.5), abs(float(part[0]))
            sides = f'x="{x[0] + 0.5:.1f}" y="{y:.1f}" width="{wide:.1f}" height="{tall:.1f}"'
            out.append(f'<rect class="{style}" {sides} rx="2"/>')
            continue
        top = " ".join(f"{a:.1f} {middle - b:.1f}" for a, b in zip(x, [*part, part[-1]], strict=True))
        out.append(f'<path class="{style}" d="M{x[0]:.1f} {middle:.1f}L{top} {x[-1]:.1f} {middle:.1f}Z"/>')
    return out


@dataclass(frozen=True, eq=False)
class Ellipse:
    """Deviations of two numbers: covariance (2, 2) as shares of their size, and the class of the style sheet."""

    covariance: Array
    style: str


def ellipse_svg(ellipses: Sequence[Ellipse], asked: float, names: tuple[str, str], label: str) -> str:
    """Return ellipses that hold 95 % of what is possible, across the first number, up the second, in percent.

    The frame holds the last one and what is asked, a deviation as a share; what was known before may be larger.
    """
    radius = 100.0 * math.sqrt(-2.0 * math.log(0.05))
    reach = 1.35 * radius * np.maximum(np.sqrt(np.diag(ellipses[-1].covariance)), asked)
    height = 260
    width, tall = _WIDTH - _LEFT - _RIGHT, height - _TOP - _BOTTOM
    middle = np.array([_LEFT + 0.5 * width, _TOP + 0.5 * tall])
    scale = np.array([0.5 * width, -0.5 * tall]) / reach
    out = [f'<svg class="chart ellipse" viewBox="0 0 {_WIDTH} {height}" role="img" aria-label="{escaped(label)}">']
    rules = []
    for k, style in ((1, "ty"), (0, "tx")):
        places = ticks(-float(reach[k]), float(reach[k]), 4)
        for value in places:
            at = float(middle[k] + scale[k] * value)
            text = f"{tick_text(value)}{' %' if value == places[-1] else ''}"
            where = f'x="{_LEFT - 6}" y="{at + 4:.1f}"' if k else f'x="{at:.1f}" y="{height - _BOTTOM + 16}"'
            out.append(f'<text class="{style}" {where}>{text}</text>')
            line = f"M{_LEFT} {at:.1f}h{width}" if k else f"M{at:.1f} {_TOP}v{tall}"
            rules.append(f'<path class="{"zero" if value == 0.0 else "rule"}" d="{line}"/>')
    out.append(f'<text class="tx" x="{middle[0]:.0f}" y="{height - 3}">{escaped(names[0])}</text>')
    out.append(
        f'<text class="tx" transform="translate(11 {middle[1]:.0f}) rotate(-90)">{escaped(names[1])}</text>'
        f'<svg x="{_LEFT}" y="{_TOP}" width="{width}" height="{tall}" viewBox="{_LEFT} {_TOP} {width} {tall}">'
    )
    around = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
    circle = np.column_stack([np.cos(around), np.sin(around)])
    shapes = []
    for each in ellipses:
        values, vectors = np.linalg.eigh(each.covariance)
        points = radius * circle * np.sqrt(np.maximum(values, 0.0)) @ vectors.T * scale + middle
        points = np.clip(points, (0.0, 0.0), (_WIDTH, height))  # what is outside of the frame is not seen
        shapes.append(f'<path class="{each.style}" d="{_path(points)}Z"/>')
    half = np.abs(scale) * radius * asked
    box = (
        f'<rect class="asked" x="{middle[0] - half[0]:.1f}" y="{middle[1] - half[1]:.1f}" width="{2 * half[0]:.1f}" '
        f'height="{2 * half[1]:.1f}"/>'
    )
    return "".join([*out, shapes[0], *rules, *shapes[1:], box, "</svg></svg>"])
