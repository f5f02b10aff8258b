"""The page around the sections: head, style sheet, title, verdict, list of contents.

The page needs no script, and its policy allows none: a browser takes the one style sheet, known by its hash, and
nothing else, whatever stands in the log that the report is of.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable, Sequence
from functools import cache
from html import unescape
from importlib.resources import files

from towtank.printable import escaped
from towtank.report.elements import sentence
from towtank.report.verdict import Verdict

__all__ = ["page"]

_HEADING = re.compile(r'<section id="([^"]+)"><h2>(.*?)</h2>')


@cache
def _style() -> str:
    """Return the style sheet, without the room between its rules."""
    text = files("towtank.report").joinpath("report.css").read_text(encoding="utf-8")
    return re.sub(r"\n\s*", "\n", text).strip()


@cache
def _policy() -> str:
    """Return what a browser may do for the page."""
    digest = base64.b64encode(hashlib.sha256(_style().encode()).digest()).decode()
    return f"default-src 'none'; style-src 'sha256-{digest}'; img-src data:; base-uri 'none'; form-action 'none'"


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
    boxes = "".join(f"<div><dt>{escaped(name)}</dt><dd>{html}</dd></div>" for name, html in sums if html)
    links = "".join(
        f'<a href="#{found[1]}">{escaped(unescape(found[2]))}</a>'
        for part in sections
        for found in _HEADING.finditer(part)
    )
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{_policy()}">',
            '<meta name="referrer" content="no-referrer">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta name="color-scheme" content="light dark">\n<link rel="icon" href="data:,">',
            f"<title>{escaped(title)}: {escaped(kind)}</title>\n<style>{_style()}</style>\n</head>\n<body>\n<main>",
            f'<div class="kind">{escaped(kind)}</div>\n<h1>{escaped(title)}</h1>',
            f'<div class="verdict {verdict.grade}"><p class="lead">{sentence(verdict.text)}</p></div>',
            f'<dl class="sums">{boxes}</dl>',
            f'<nav aria-label="Contents">{links}</nav>',
            *[part for part in sections if part],
            f"<footer>{escaped(footer)}</footer>\n</main>\n</body>\n</html>\n",
        ]
    )
