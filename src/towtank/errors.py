"""Errors that a person at the keyboard can mend.

One clear line: the file, the place in it, what was found, what was expected, what to do. The command line turns an
`InputError` into exit code 2; every other exception is a fault of the program or of the machine.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

__all__ = ["InputError", "nearest"]


_LONGEST = 1500  # characters of a message; names from a broken file have no end


class InputError(ValueError):
    """The input or the arguments are wrong; the message is one line that says what to mend.

    What names from a file bring along that cannot be printed stands as escapes.
    """

    def __init__(self, message: str) -> None:
        line = "".join(each if each.isprintable() else _escaped(each) for each in " ".join(message.split()))
        super().__init__(line if len(line) <= _LONGEST else f"{line[: _LONGEST - 300]} [...] {line[-280:]}")


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


def nearest(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean "X_uu"?` for the known name closest to `name`, or an empty string.

    >>> nearest("X_uuu", ["X_uu", "N_rdot"])
    '; did you mean "X_uu"?'
    """
    known = list(known)
    match = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    if not match:
        folded = {other.lower(): other for other in known}
        if name.lower() in folded:
            match = [folded[name.lower()]]
    return f'; did you mean "{match[0]}"?' if match else ""
