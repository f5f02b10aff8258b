"""How to make it again: commands, versions, hashes of the logs."""

from __future__ import annotations

from towtank.printable import escaped
from towtank.report.elements import cell, paragraph, section, table
from towtank.report.facts import Origin

__all__ = ["footer", "origin_section"]


def origin_section(origin: Origin) -> str:
    """Return what it takes to make the report again."""
    parts = []
    if origin.commands:
        lines = "\n".join(escaped(command) for command in origin.commands)
        parts.append(f"<pre><code>{lines}</code></pre>")
    if origin.logs:
        rows = [
            [
                cell(escaped(log.name), "name"),
                cell(f"{log.size / 1e6:.3g} MB", "n"),
                cell(f'<span class="hash">{escaped(log.sha256)}</span>'),
            ]
            for log in origin.logs
        ]
        parts.append(table(["Log", ">Size", "SHA-256"], rows))
    if origin.versions:
        versions = ", ".join(f"{name} {version}" for name, version in origin.versions.items())
        parts.append(paragraph(f"With {versions}.", "note"))
    return section("origin", "How to make it again", *parts)


def footer(origin: Origin) -> str:
    """Return the last line of the page."""
    version = origin.versions.get("towtank", "")
    made = f", {origin.made}" if origin.made else ""
    return (
        f"Made by towtank {version}{made}. All quantities in SI; body axes forward, starboard, down; world north, "
        "east, down."
    )
