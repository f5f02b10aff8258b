"""The gate behind all readers: what no vehicle and no clock yields becomes "not measured" or is left out, and counted.

Readers need not know of it: whatever makes channels of columns passes here. What comes out is finite or NaN, lies
within what its unit can be, stands at times since 1970 and before 2100 or near 0, and has as many values as times. The
limits are so wide that a wrong unit still passes, so that it can be told and named; they hold off numbers that damage,
a broken sensor or an attacker left, whose squares no longer are numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.digits import short
from towtank.errors import InputError
from towtank.recording.standard import STATES, is_standard, standard_of

__all__ = ["LATEST", "LIMITS", "Admitted", "admitted", "is_plausible", "limit_of"]

LATEST = 4_102_444_800.0  # s, the year 2100 on the Unix clock
_APART = 30 * 86_400.0  # s between rows that are of one run at most
_FINEST = 1e-9  # s; what is nearer in time is one instant
# largest size of a value by unit; in brackets what a sensor, or its wrong unit, may still give
LIMITS: dict[str, float] = {
    "m": 2e7,  # half way round the earth
    "m/s": 1e4,  # (mm/s)
    "rad": 1e6,  # (turns of hours, hundredths of a degree)
    "rad/s": 1e6,  # (thousandths of rad/s)
    "m/s^2": 1e6,  # (mm/s^2, thousandths of g)
    "N": 1e9,
    "N m": 1e9,
    "V": 1e6,  # (mV)
    "1": 1e6,  # (quaternions as whole numbers)
    "command": 1e9,
}
_UNKNOWN = 1e100  # of a channel whose unit is not a standard one


class Admitted(NamedTuple):
    """What passed, and what did not.

    Attributes:
        t: times (n,) [s], finite, as they stand in the file. columns: values (n,) by name, finite or NaN.
        untimed: rows left out for their time. infinities, beyond: values taken as not measured.
        details: one line for each channel and each reason.
    """

    t: Array
    columns: Mapping[str, Array]
    untimed: int = 0
    infinities: int = 0
    beyond: int = 0
    details: tuple[str, ...] = ()


def limit_of(name: str) -> float:
    """Return the largest size that a value of a channel can have, in its unit."""
    if name in STATES:
        return LIMITS["1"]
    return LIMITS.get(standard_of(name).unit, _UNKNOWN) if is_standard(name) else _UNKNOWN


def is_plausible(name: str, values: Array) -> NDArray[np.bool_]:
    """Return which values (n,) of a channel can have been measured: finite, within the limit of its unit."""
    return np.asarray(np.abs(values) <= limit_of(name))


def admitted(t: Array, columns: Mapping[str, Array], *, place: str) -> Admitted:
    """Return what of a table can have been measured.

    Args:
        t: times (n,) [s], in any order, NaN or beyond all bounds.
        columns: values (n,) by channel name, NaN where not measured.
        place: the file, for messages.

    Raises:
        InputError: a column has more or fewer values than there are times, or no time can be one.
    """
    for name, column in columns.items():
        if column.shape != t.shape:
            raise InputError(
                f'{place}: "{name}" has {column.size} values for {t.size} times, expected one for each; '
                "the file is damaged, or they are not of one table"
            )
    timed, details = _timed(t, place)
    untimed = int(t.size - np.count_nonzero(timed))
    if untimed:
        t, columns = t[timed], {name: column[timed] for name, column in columns.items()}
    kept: dict[str, Array] = {}
    infinities = beyond = 0
    for name, column in columns.items():
        limit = limit_of(name)
        size = np.abs(column)
        infinite = np.isinf(size)
        large = (size > limit) & ~infinite
        if infinite.any():
            infinities += int(np.count_nonzero(infinite))
            details.append(f'{np.count_nonzero(infinite)} infinite in "{name}"')
        if large.any():
            beyond += int(np.count_nonzero(large))
            unit = standard_of(name).unit if is_standard(name) else ""
            most = f"{limit:.0e}".replace("e+0", "e").replace("e+", "e")
            details.append(f'{np.count_nonzero(large)} in "{name}" beyond {most} {unit}'.rstrip())
        kept[name] = np.where(infinite | large, np.nan, column) if infinite.any() or large.any() else column
    return Admitted(_distinct(t), kept, untimed, infinities, beyond, tuple(details))


def _timed(t: Array, place: str) -> tuple[NDArray[np.bool_], list[str]]:
    """Return which rows (n,) have a time that can be one, and what is to be said of the others."""
    finite = np.isfinite(t)
    possible = np.asarray(np.abs(t) <= LATEST)
    details: list[str] = []
    late = int(np.count_nonzero(finite & ~possible))
    if late and not possible.any():
        found = t[finite]
        raise InputError(
            f"{place}: found times from {float(found.min()):.6g} to {float(found.max()):.6g}, expected seconds, since "
            "1970 and before 2100 or near 0; where they are in other units map them: "
            't = { from = "...", scale = 0.001 }'
        )
    if late:
        details.append(f"{late} rows at times beyond the year 2100")
    kept = possible.copy()
    rows = np.flatnonzero(possible)
    if rows.size > 1:
        order = rows[np.argsort(t[rows], kind="stable")]
        cuts = np.flatnonzero(np.diff(t[order]) > _APART) + 1
        if cuts.size:
            parts = np.split(order, cuts)
            most = max(parts, key=lambda part: part.size)
            kept[:] = False
            kept[most] = True
            years = float(np.ptp(t[rows])) / (365.25 * 86_400.0)
            details.append(
                f"{rows.size - most.size} rows more than {_APART / 86_400.0:.0f} days off the others "
                f"(times span {short(years, 3)} years)"
            )
    return kept, details


def _distinct(t: Array) -> Array:
    """Return times (n,) of which none are nearer to one another than a nanosecond and yet different."""
    if t.size < 2:
        return t
    steps = np.diff(t)
    if not (steps > 0.0).all():
        steps = np.diff(np.sort(t))
    if not ((steps > 0.0) & (steps < _FINEST)).any():
        return t
    whole: Array = np.round(t / _FINEST) * _FINEST
    return whole
