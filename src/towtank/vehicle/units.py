"""Units of coefficients as text, compared by meaning: `N s/m` and `kg/s` are one unit."""

from __future__ import annotations

import re

from towtank.errors import InputError

__all__ = ["same_unit"]

# kg, m, s; a radian counts nothing
_BASE = {
    "kg": (1, 0, 0),
    "m": (0, 1, 0),
    "s": (0, 0, 1),
    "N": (1, 1, -2),
    "Nm": (1, 2, -2),
    "rad": (0, 0, 0),
    "1": (0, 0, 0),
}
_TOKEN = re.compile(r"([A-Za-z]+|1)(?:\^?(-?\d+))?$")
_SUPERSCRIPTS = str.maketrans({"²": "^2", "³": "^3", "·": " ", "*": " ", "⋅": " ", "/": " / ", "(": " ( ", ")": " ) "})


def _dimensions(unit: str) -> tuple[int, int, int]:
    """Return the exponents of (kg, m, s); all that follows a slash is below it. Raises InputError if not understood."""
    total = [0, 0, 0]
    sign, in_group, group_sign = 1, False, 1
    for token in unit.translate(_SUPERSCRIPTS).split():
        if token == "/":
            sign = -1
        elif token == "(":
            in_group, group_sign = True, sign
        elif token == ")":
            in_group = False
        else:
            match = _TOKEN.match(token)
            if match is None or match[1] not in _BASE:
                raise InputError(f'unit "{unit}" is not understood at "{token}"')
            power = int(match[2] or 1) * (group_sign if in_group else sign)
            for axis, exponent in enumerate(_BASE[match[1]]):
                total[axis] += power * exponent
    return total[0], total[1], total[2]


def same_unit(first: str, second: str) -> bool:
    """Return whether two units have the same dimensions (radians ignored); False where one is not understood.

    >>> same_unit("kg m^2/(s rad)", "N m s/rad")
    True
    """
    try:
        return _dimensions(first) == _dimensions(second)
    except InputError:
        return False
