"""Texts that others wrote, as they may be shown: what would steer a terminal or turn a line round is written out.

Names, units, status texts and file names come from logs and links. An escape character in one would move the cursor or
rename the window, a bidirectional control would turn round what stands behind it, half a surrogate cannot be encoded.
"""

from __future__ import annotations

import re
from html import escape

__all__ = ["escaped", "printable", "toml_escaped"]

_STEERING = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f"  # controls of terminals; tabs and ends of lines stay
    "\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069"  # direction of writing
    "\u200b\u2028\u2029\u2060-\u2064\ufeff\ufff9-\ufffb\U000e0000-\U000e007f"  # what is not seen
    "\ud800-\udfff]"  # halves of a character
)


def printable(text: str) -> str:
    r"""Return a text with every steering character written out, as Python and JSON write it; else as it is.

    What has been written out once stays as it is.

    >>> print(printable("depth\x1b[2J \u202ez"))
    depth\x1b[2J \u202ez
    """
    return _STEERING.sub(_written_out, text)


def escaped(text: str) -> str:
    """Return a text as HTML, for an element or a quoted attribute.

    >>> escaped('<b onclick="x">')
    '&lt;b onclick=&quot;x&quot;&gt;'
    """
    return escape(printable(text), quote=True)


def toml_escaped(document: str) -> str:
    """Return a TOML document whose texts are in double quotes, with what would steer a terminal as TOML's own escapes.

    Reading it gives the same texts; but for halves of a character, which TOML cannot hold and which stay written out.
    """

    def replaced(found: re.Match[str]) -> str:
        code = ord(found[0])
        half = 0xD800 <= code < 0xE000
        return f"\\\\u{code:04x}" if half else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"

    return _STEERING.sub(replaced, document)


def _written_out(found: re.Match[str]) -> str:
    code = ord(found[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
