"""Values with deviations as intervals that hold the truth in 95 of 100 cases."""

from __future__ import annotations

import math

from towtank.digits import measured

__all__ = ["interval", "interval_text"]

_NORMAL_95 = 1.959963984540054  # deviations


def interval(value: float, std: float | None) -> tuple[float, float] | None:
    """Return the bounds of the 95 % interval, None where there is no deviation.

    >>> interval(-10.0, None) is None
    True
    """
    if std is None or not math.isfinite(std) or not math.isfinite(value):
        return None
    return value - _NORMAL_95 * std, value + _NORMAL_95 * std


def interval_text(value: float, std: float | None) -> str:
    """Return it as text with as many places as the value has beside its deviation.

    >>> interval_text(-40.421, 0.64)
    '-41.68 .. -39.17'
    """
    bounds = interval(value, std)
    if bounds is None:
        return ""
    return " .. ".join(measured(bound, std)[0] for bound in bounds)
