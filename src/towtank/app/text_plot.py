"""A small plot of characters: measured points and a curve through them."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array

__all__ = ["text_plot"]

_WIDTH, _HEIGHT = 60, 15
_MARGIN = 9


def text_plot(points: tuple[Array, Array], curve: tuple[Array, Array], *, x_name: str, y_name: str) -> list[str]:
    """Return the lines of a plot, 70 characters wide.

    Args:
        points: x (n,) and y (n,), drawn as `o`. curve: x (m,) and y (m,), drawn as `.` beneath the points.
    """
    x = np.concatenate([points[0], curve[0]])
    y = np.concatenate([points[1], curve[1]])
    left, right = float(x.min()), float(x.max())
    low, high = float(min(y.min(), 0.0)), float(max(y.max(), 0.0))
    if not (right > left and high > low):
        return []
    canvas = [[" "] * _WIDTH for _ in range(_HEIGHT)]
    zero = _place(0.0, low, high, _HEIGHT)
    canvas[zero] = ["-"] * _WIDTH
    for (xs, ys), sign in ((curve, "."), (points, "o")):
        for px, py in zip(xs, ys, strict=True):
            canvas[_place(py, low, high, _HEIGHT)][_place(px, left, right, _WIDTH)] = sign
    labels = {_HEIGHT - 1: high, 0: low, zero: 0.0}
    lines = [f"{y_name:>{_MARGIN}}"]
    for row in reversed(range(_HEIGHT)):
        label = f"{labels[row]:.4g}" if row in labels else ""
        lines.append(f"{label:>{_MARGIN}} |{''.join(canvas[row])}".rstrip())
    ends = f"{left:.5g}", f"{right:.5g}"
    room = _WIDTH - len(ends[0]) - len(ends[1])
    lines.append(f"{'':>{_MARGIN}}  {ends[0]}{x_name:^{room}}{ends[1]}")
    return lines


def _place(value: float, low: float, high: float, cells: int) -> int:
    return int(np.clip(round((value - low) / (high - low) * (cells - 1)), 0, cells - 1))
