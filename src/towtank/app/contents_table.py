"""What a log held, table by table, for a person and as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from towtank.app.output import Output
from towtank.digits import short
from towtank.recording import Content, Recording

__all__ = ["contents_document", "show_contents"]

_TOGETHER = 3  # tables that are left out for one and the same reason share a line


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
