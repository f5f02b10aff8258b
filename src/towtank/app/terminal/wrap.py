"""Sentences broken into lines: between words, never within a number and its unit."""

from __future__ import annotations

import re
import textwrap

__all__ = ["wrapped"]

_UNITS = r"%|ms|s|Hz|N|N m|m|m/s|°|°/s|deg/s|kg|kB|MB|MHz|V|times"
_TOGETHER = re.compile(
    rf"(?<=\d) (?=(?:{_UNITS})(?:[\s,.;:)]|$))"  # 3.8 ms
    r"|(?<=±) | (?=±)|(?<=\+-) | (?=\+-)"  # 1.2 ± 0.1
    r"|(?<=\b[A-Za-z]) (?=[-−]?\d)"  # X 24
    r"|(?<=\bN) (?=m\b)"
)
_NO_BREAK = "\u00a0"


def wrapped(text: str, width: int, *, first: str = "", indent: str = "") -> list[str]:
    """Return a text in lines of at most `width` characters.

    Args:
        first, indent: what stands before the first line, and before the others.

    >>> wrapped("delay 3.8 ms, lag 46 ms", 16, indent="  ")
    ['delay 3.8 ms,', '  lag 46 ms']
    """
    kept = _TOGETHER.sub(_NO_BREAK, text)
    lines = textwrap.wrap(
        kept, max(width, 10), initial_indent=first, subsequent_indent=indent or " " * len(first), break_on_hyphens=False
    )
    return [line.replace(_NO_BREAK, " ") for line in lines] or [first]
