"""What notebooks show, and hand on: tables as HTML, small lines as SVG, libraries of the extra `notebook`."""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterable, Sequence
from typing import Any

from towtank.errors import InputError
from towtank.printable import escaped

__all__ = ["Drawing", "html_table", "library", "spark_svg"]

_WIDTH, _HEIGHT = 160, 26  # pixels
_CELL = "padding:2px 10px;vertical-align:middle"
_LONG = 30  # letters, from which a text may be broken into lines


class Drawing(str):
    """A cell of a table that is HTML already."""


def library(name: str, what: str) -> Any:
    """Return a library of the extra `notebook`. Raises InputError, which says how to get it, where it is missing."""
    try:
        return importlib.import_module(name)
    except ImportError:
        raise InputError(f'{what}: {name} is not installed; pip install "towtank[notebook]"') from None


def html_table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], notes: Iterable[str] = ()) -> str:
    """Return a table that reads on light and on dark pages.

    Args:
        title, notes: plain text above and below. head: plain text; with a leading `>` it stands over numbers.
        rows: plain text; a `Drawing` is left as it is.
    """
    right = [name.startswith(">") for name in head]
    cells = ["".join(_cell("td", *each) for each in zip(row, right, strict=True)) for row in rows]
    names = "".join(_cell("th", *each) for each in zip([name.removeprefix(">") for name in head], right, strict=True))
    said = "".join(f'<div style="opacity:.75">{escaped(note)}</div>' for note in notes)
    body = "".join(f"<tr>{row}</tr>" for row in cells)
    table = f"<table><thead><tr>{names}</tr></thead><tbody>{body}</tbody></table>" if cells else ""
    return f"<div><div><b>{escaped(title)}</b></div>{table}{said}</div>"


def _cell(tag: str, text: str, number: bool) -> str:
    broken = "" if len(text) > _LONG and not isinstance(text, Drawing) else ";white-space:nowrap"
    html = text if isinstance(text, Drawing) else escaped(text)
    return f'<{tag} style="{_CELL};text-align:{"right" if number else "left"}{broken}">{html}</{tag}>'


def spark_svg(values: Sequence[float], label: str) -> Drawing:
    """Return a small line through values that are evenly spaced; NaN is left out.

    Args:
        label: what a screen reader says.
    """
    known = [(k, value) for k, value in enumerate(values) if math.isfinite(value)]
    if not known:
        return Drawing()
    low, high = min(value for _, value in known), max(value for _, value in known)
    span, last = (high - low) or 1.0, max(len(values) - 1, 1)
    middle = 0.5 * (high + low)
    points = " ".join(
        f"{2 + (_WIDTH - 4) * k / last:.1f},{_HEIGHT / 2 - (_HEIGHT - 4) * (value - middle) / span:.1f}"
        for k, value in known
    )
    return Drawing(
        f'<svg width="{_WIDTH}" height="{_HEIGHT}" role="img" aria-label="{escaped(label)}">'
        f'<polyline points="{points}" fill="none" stroke="#0072b2" stroke-width="1.2"/></svg>'
    )
