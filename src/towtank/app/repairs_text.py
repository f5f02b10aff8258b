"""What was mended in recordings, and what learning warns of, as lines for a person."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath

from towtank.identification.logs import LogLearning
from towtank.recording import Recording

__all__ = ["file_name", "learning_warnings"]


def file_name(source: str) -> str:
    """Return the name of the file that a recording came from, without its folder."""
    return PurePath(source).name if source else "recording"


def learning_warnings(learning: LogLearning, recordings: Sequence[Recording], *, repairs: bool = True) -> list[str]:
    """Return the warnings, then (with `repairs`) one line for each kind of repair and each note of a log."""
    told = [text for text in learning.warnings if not any(_tells_repairs(text, grid) for grid in learning.grids)]
    if not repairs:
        return told
    for grid, recording in zip(learning.grids, recordings, strict=True):
        name = file_name(recording.source)
        told += [f"{name}: {line}" for line in (*grid.repairs.lines, *recording.notes)]
    return list(dict.fromkeys(told))


def _tells_repairs(text: str, grid: object) -> bool:
    """True for a line that only says what was mended, which is told line by line instead."""
    repairs = getattr(grid, "repairs", None)
    return repairs is not None and (text.endswith(str(repairs)) or text.endswith(repairs.summary))
