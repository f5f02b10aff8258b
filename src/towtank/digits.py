"""Numbers as text: as many digits as they are worth; names side by side."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

__all__ = ["estimate_text", "joined", "measured", "percent", "short", "signed_list", "some_of"]

_DIGITS = 6
_DIVERGES = -999.0
_NOTHING = 1e-15  # what is left of a coefficient that ends on its bound


def short(value: float | None, digits: int = 4) -> str:
    """Return a number with so many significant digits, no needless zeros; "-" where there is none.

    >>> short(0.034082), short(1100.0), short(None), short(-1e-19)
    ('0.03408', '1100', '-', '0')
    """
    if value is None or math.isnan(value):
        return "-"
    value = value if abs(value) > _NOTHING else 0.0
    if value != 0.0 and digits <= math.log10(abs(value)) < 7.0:
        return f"{value:.0f}"
    return f"{value:.{digits}g}"


def measured(value: float, std: float | None) -> tuple[str, str]:
    """Return value and deviation, the deviation with two digits and the value with as many places.

    >>> measured(-0.77105, 0.05246), measured(-1e-19, 0.52)
    (('-0.771', '0.052'), ('0.00', '0.52'))
    """
    if std is None or not math.isfinite(std) or not math.isfinite(value):
        return short(value, _DIGITS), ""
    if std <= 0.0:
        return short(value, _DIGITS), "0"
    value = value if abs(value) > _NOTHING else 0.0
    places = 1 - math.floor(math.log10(std))
    places = min(places, _DIGITS - 1 - math.floor(math.log10(abs(value)))) if value else places
    if places > 12 or places < -6:
        return short(value, _DIGITS), f"{std:.2g}"
    if places <= 0:
        return f"{value:.0f}", f"{std:.0f}"
    spread = f"{std:.{places}f}"
    return f"{value:.{places}f}", spread if float(spread) > 0.0 else f"{std:.1g}"


def estimate_text(value: float, std: float | None, *, ascii_only: bool = False) -> str:
    """Return value and deviation in one; "-" where there is no value.

    >>> estimate_text(40.4213, 0.2116), estimate_text(40.4213, None), estimate_text(math.nan, 0.1)
    ('40.42 ± 0.21', '40.4213', '-')
    """
    number, spread = measured(value, std)
    return f"{number} {'+-' if ascii_only else '±'} {spread}" if spread else number


def percent(value: float | None) -> str:
    """Return a fit in percent; "-" where there is none, "diverges" for the worst that is told."""
    if value is None:
        return "-"
    return "diverges" if value <= _DIVERGES else f"{value:.1f}"


def signed_list(values: tuple[float, ...]) -> str:
    """Return numbers side by side, as `0.1 -0.2 0`."""
    return " ".join(short(value) for value in values)


def joined(names: Sequence[str]) -> str:
    """Return one name or more, side by side.

    >>> joined(["surge"]), joined(["surge", "sway", "yaw"])
    ('surge', 'surge, sway and yaw')
    """
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def some_of(names: Iterable[str], most: int) -> str:
    """Return the first names, and how many more there are.

    >>> some_of("abcd", 2)
    'a, b and 2 more'
    """
    every = list(names)
    return ", ".join(every[:most]) + (f" and {len(every) - most} more" if len(every) > most else "")
