"""What a log held and what was repaired in it, with what learning warns of, as lines for a person and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import PurePath
from typing import Any

from towtank.app.terminal.output import Output
from towtank.digits import short
from towtank.identification.posterior.assembly import LogLearning
from towtank.recording import Content, Recording

__all__ = ["contents_document", "file_name", "learning_warnings", "show_contents"]

_HARMLESS = "ignored columns"
_TOGETHER = 3  # tables that are left out for one and the same reason share a line


def file_name(source: str) -> str:
    """Return the name of the file that a recording came from, without its folder."""
    return PurePath(source).name if source else "recording"


def learning_warnings(learning: LogLearning, recordings: Sequence[Recording], *, repairs: bool = True) -> list[str]:
    """Return the warnings, then (with `repairs`) what was mended and noted in each log."""
    lines = [text for text in learning.warnings if not any(_is_of_repairs(text, grid) for grid in learning.grids)]
    if not repairs:
        return lines
    for grid, recording in zip(learning.grids, recordings, strict=True):
        name = file_name(recording.source)
        if grid.repairs:
            lines.append(f"{name}: {grid.repairs.summary}")
        lines += [f"{name}: {note}" for note in recording.notes if not note.startswith(_HARMLESS)]
    return list(dict.fromkeys(lines))


def _is_of_repairs(text: str, grid: object) -> bool:
    """True for a line that only says what was mended, which has a line of its own instead."""
    repairs = getattr(grid, "repairs", None)
    return repairs is not None and (text.endswith(str(repairs)) or text.endswith(repairs.summary))


def contents_document(recording: Recording) -> list[dict[str, Any]]:
    """Return the contents for a JSON document."""
    return [asdict(content) for content in recording.contents]


def show_contents(recording: Recording, output: Output) -> None:
    """Print what was used, what was not although it could have been, and the names of the rest; nothing for a table."""
    if not recording.contents:
        return
    shared: dict[str, list[str]] = {}
    for content in recording.contents:
        if not content.used:
            shared.setdefault(content.reason, []).append(content.name)
    together = {reason: names for reason, names in shared.items() if len(names) >= _TOGETHER}
    alone = [content for content in recording.contents if content.used or content.reason not in together]
    output.heading("What the log holds")
    table = output.table("Messages", ">Count", ">Hz", "Used for", wrap="Used for")
    for content in sorted(alone, key=lambda each: not each.used):
        rate = "-" if content.rate is None else short(content.rate, 3)
        table.add_row(content.name, str(content.count), rate, _use(content))
    output.show(table)
    for reason, names in together.items():
        output.item(f"not used, {reason}: {', '.join(names)}")


def _use(content: Content) -> str:
    used = " ".join(content.used)
    if not content.reason:
        return used
    return f"{used}; not {content.reason}" if used else f"not used: {content.reason}"
