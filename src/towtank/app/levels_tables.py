"""Levels of noise and disturbance that learning found, as a table and as a document."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from towtank.app.output import Output
from towtank.identification.axes import AXES
from towtank.identification.chain import Sources
from towtank.identification.log_learning import Levels
from towtank.recording import STANDARD, Grid
from towtank.recording.standard import MOTION

__all__ = ["disturbance_cells", "disturbance_document", "noise_document", "show_levels"]

_KINDS = (
    ("noise of pose", slice(0, 6), "m, rad"),
    ("noise of speed", slice(6, 12), "m/s, rad/s"),
    ("noise of force", slice(12, 15), "m/s^2"),
)


def noise_document(levels: Levels | None, grids: Sequence[Grid]) -> dict[str, Any]:
    """Return the noise of each channel that was measured: standard deviation of a sample, and its unit."""
    if levels is None:
        return {}
    return {
        name: {"std": float(levels.noise[j]), "unit": STANDARD[name].unit}
        for j, name in enumerate(MOTION)
        if _measured(grids)[j]
    }


def disturbance_document(levels: Levels | None, sources: Sequence[Sources]) -> dict[str, Any]:
    """Return the disturbance force of each axis whose speed is known: its standard deviation and its unit."""
    if levels is None:
        return {}
    return {
        axis.wrench: {"std": float(level), "unit": STANDARD[axis.wrench].unit}
        for axis, level, told in zip(AXES, levels.sigma, _moving(sources), strict=True)
        if told
    }


def show_levels(
    levels: Levels | None, grids: Sequence[Grid], sources: Sequence[Sources], output: Output, *, whose: str = ""
) -> None:
    """Print the levels of all axes side by side; nothing where there are none.

    Args:
        whose: picture of the disturbance it is, where that is not the model's.
    """
    if levels is None:
        return
    output.heading(f"Noise and disturbance{whose} (standard deviations)")
    table = output.table("", *(f">{axis.name}" for axis in AXES), "Unit")
    table.add_row("disturbance", *disturbance_cells(levels, sources), "N, N m")
    known = _measured(grids)
    for label, columns, unit in _KINDS:
        if known[columns].any():
            cells = [_brief(x) if told else "-" for x, told in zip(levels.noise[columns], known[columns], strict=True)]
            table.add_row(label, *cells, *[""] * (6 - len(cells)), unit)
    output.show(table)


def disturbance_cells(levels: Levels, sources: Sequence[Sources]) -> list[str]:
    """Return the disturbance of each axis as text, "-" where its speed is not known."""
    return [_brief(level) if told else "-" for level, told in zip(levels.sigma, _moving(sources), strict=True)]


def _moving(sources: Sequence[Sources]) -> list[bool]:
    """Return whether the speed of each axis is measured or derived in any recording."""
    return [any(each.velocity[i] != "absent" for each in sources) for i in range(6)]


def _brief(value: float) -> str:
    return f"{value:.2g}"


def _measured(grids: Sequence[Grid]) -> NDArray[np.bool_]:
    """Return which of the 15 columns are measured in any recording."""
    return np.asarray(np.any([grid.fresh.any(axis=0) for grid in grids], axis=0))
