"""The page around the sections: head, style sheet, title, verdict, list of contents."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from functools import cache
from html import escape, unescape
from importlib.resources import files

from towtank.report.elements import sentence
from towtank.report.verdict import Verdict

__all__ = ["page"]

_HEADING = re.compile(r'<section id="([^"]+)"><h2>(.*?)</h2>')


@cache
def _style() -> str:
    """Return the style sheet, without the room between its rules."""
    text = files("towtank.report").joinpath("report.css").read_text(encoding="utf-8")
    return re.sub(r"\n\s*", "\n", text).strip()


def page(
    kind: str,
    title: str,
    verdict: Verdict,
    sums: Iterable[tuple[str, str]],
    sections: Sequence[str],
    footer: str,
) -> str:
    """Return the whole document; it needs nothing but itself.

    Args:
        kind: of report, in two or three words. title: whose. sums: the few numbers to see first (HTML).
    """
    boxes = "".join(f"<div><dt>{escape(name)}</dt><dd>{html}</dd></div>" for name, html in sums if html)
    links = "".join(
        f'<a href="#{found[1]}">{escape(unescape(found[2]))}</a>'
        for part in sections
        for found in _HEADING.finditer(part)
    )
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="color-scheme" content="light dark">\n<link rel="icon" href="data:,">',
            f"<title>{escape(title)}: {escape(kind)}</title>\n<style>{_style()}</style>\n</head>\n<body>\n<main>",
            f'<div class="kind">{escape(kind)}</div>\n<h1>{escape(title)}</h1>',
            f'<div class="verdict {verdict.grade}"><p class="lead">{sentence(verdict.text)}</p></div>',
            f'<dl class="sums">{boxes}</dl>',
            f'<nav aria-label="Contents">{links}</nav>',
            *[part for part in sections if part],
            f"<footer>{escape(footer)}</footer>\n</main>\n</body>\n</html>\n",
        ]
    )
