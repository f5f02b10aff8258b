"""What was mended in recordings, and what learning warns of, as lines for a person."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath

from towtank.identification.logs import LogLearning
from towtank.recording import Recording

__all__ = ["file_name", "learning_warnings"]


_HARMLESS = "ignored columns"


def file_name(source: str) -> str:
    """Return the name of the file that a recording came from, without its folder."""
    return PurePath(source).name if source else "recording"


def learning_warnings(learning: LogLearning, recordings: Sequence[Recording], *, repairs: bool = True) -> list[str]:
    """Return the warnings, then (with `repairs`) what was mended and noted in each log."""
    told = [text for text in learning.warnings if not any(_tells_repairs(text, grid) for grid in learning.grids)]
    if not repairs:
        return told
    for grid, recording in zip(learning.grids, recordings, strict=True):
        name = file_name(recording.source)
        if grid.repairs:
            told.append(f"{name}: {grid.repairs.summary}")
        told += [f"{name}: {note}" for note in recording.notes if not note.startswith(_HARMLESS)]
    return list(dict.fromkeys(told))


def _tells_repairs(text: str, grid: object) -> bool:
    """True for a line that only says what was mended, which is told line by line instead."""
    repairs = getattr(grid, "repairs", None)
    return repairs is not None and (text.endswith(str(repairs)) or text.endswith(repairs.summary))
