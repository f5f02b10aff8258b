"""Pieces of HTML: numbers that carry their full value, tables, figures, sections."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

from towtank.digits import measured, percent, short
from towtank.printable import escaped

__all__ = [
    "Cell",
    "bullets",
    "cell",
    "facts",
    "figure",
    "fit_number",
    "grid",
    "number",
    "number_and_std",
    "paragraph",
    "section",
    "sentence",
    "table",
    "unit_text",
]

Cell = tuple[str, str]  # class, HTML
_MINUS = re.compile(r"(?<=[ (])-(?=\d)")


def _signed(text: str) -> str:
    """Return a number's text with a true minus sign."""
    return text.replace("-", "−") if any(c.isdigit() for c in text) else text


def unit_text(unit: str) -> str:
    """Return a unit as it is printed, `kg m^2` as `kg m²`."""
    return escaped(unit).replace("^2", "²").replace("^3", "³").replace(" ", "\u202f")


def number(value: float | None, text: str | None = None, *, key: str = "") -> str:
    """Return a number as HTML: its rounded text, and in `data-value` all of it as JSON has it.

    Args:
        text: as it is shown; four digits by default. key: where in the JSON document it stands, as
            `fit/u`; a `/` in a name is `~1`, as in a JSON pointer.
    """
    if value is None or not math.isfinite(value):
        return '<span class="none">–</span>'
    shown = _signed(escaped(short(value) if text is None else text))
    where = f' data-key="{escaped(key)}"' if key else ""
    return f'<data value="{value!r}" data-value="{value!r}"{where}>{shown}</data>'


def number_and_std(value: float, std: float | None, key: str) -> tuple[str, str]:
    """Return a value and its deviation with the places that the deviation is worth."""
    a, b = measured(value, std)
    return number(value, a, key=f"{key}/value"), number(std, b, key=f"{key}/std")


def fit_number(value: float | None, key: str) -> str:
    """Return a fit in percent."""
    return number(value, percent(value), key=key)


def cell(html: str, style: str = "") -> Cell:
    """Return a cell of a table; the class `n` is for numbers."""
    return style, html


def table(head: Sequence[str], rows: Iterable[Sequence[Cell]], *, caption: str = "", style: str = "") -> str:
    """Return a table; a head with a leading `>` stands over numbers. A row of one cell spans the table."""
    names = "".join(
        f'<th scope="col" class="{"n" if name.startswith(">") else "t"}">{escaped(name.removeprefix(">"))}</th>'
        for name in head
    )
    body = []
    for row in rows:
        if len(row) == 1:
            body.append(
                f'<tr class="span"><th colspan="{len(head)}" scope="rowgroup"><span>{row[0][1]}</span></th></tr>'
            )
            continue
        cells = [f'<td class="{kind}">{html}</td>' if kind else f"<td>{html}</td>" for kind, html in row]
        body.append(f"<tr>{''.join(cells)}</tr>")
    said = f"<caption>{escaped(caption)}</caption>" if caption else ""
    return (
        f'<div class="scroll" tabindex="0"><table class="{style}">{said}<thead><tr>{names}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


def figure(svg: str, title: str, *, right: str = "", caption: str = "", style: str = "") -> str:
    """Return a figure with a title above and a caption below; nothing where there is no drawing.

    Args:
        title, right: HTML, left and right above the drawing. caption: text beneath.
    """
    if not svg:
        return ""
    head = f'<div class="head"><b>{title}</b><span>{right}</span></div>'
    below = f"<figcaption>{escaped(caption)}</figcaption>" if caption else ""
    return f'<figure class="{style}">{head}{svg}{below}</figure>'


def grid(figures: Iterable[str], style: str = "") -> str:
    """Return figures side by side, as many as there is room for."""
    there = [each for each in figures if each]
    return f'<div class="grid {style}">{"".join(there)}</div>' if there else ""


def section(name: str, title: str, *parts: str) -> str:
    """Return a section with a heading; nothing where all of its parts are empty."""
    there = [part for part in parts if part]
    return f'<section id="{name}"><h2>{escaped(title)}</h2>{"".join(there)}</section>' if there else ""


def sentence(text: str) -> str:
    """Return a line of the program's as HTML: with a capital where it begins with a word, not with a name."""
    first = text.split(" ", 1)[0]
    capital = first.isalpha() and first.islower() and len(first) > 1
    said = (text[0].upper() + text[1:] if capital else text).replace("+-", "±")
    return escaped(_MINUS.sub("−", said))


def paragraph(text: str, style: str = "") -> str:
    """Return a paragraph of plain text."""
    return f'<p class="{style}">{sentence(text)}</p>' if style else f"<p>{sentence(text)}</p>"


def facts(pairs: Iterable[tuple[str, str]]) -> str:
    """Return names beside values (HTML)."""
    there = [f"<div><dt>{escaped(name)}</dt><dd>{html}</dd></div>" for name, html in pairs if html]
    return f'<dl class="facts">{"".join(there)}</dl>' if there else ""


def bullets(texts: Iterable[str], style: str = "") -> str:
    """Return texts one below the other."""
    items = "".join(f"<li>{sentence(text)}</li>" for text in texts)
    return f'<ul class="{style}">{items}</ul>' if items else ""
