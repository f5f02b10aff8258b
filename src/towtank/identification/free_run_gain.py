"""How much nearer one model's free runs come than another's over the same windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array

__all__ = ["Gain", "columns_of", "fits", "gain"]

_FAILED, _FLOOR = 10.0, 0.1


@dataclass(frozen=True)
class Gain:
    """Share of the square error that one model saves beside another: mean over the windows, and its deviation."""

    mean: float
    std: float

    def beyond(self, deviations: float, least: float) -> bool:
        """Whether it is no accident, and worth something."""
        return bool(self.mean > max(deviations * self.std, least))


def gain(new: Array, old: Array, columns: Sequence[int]) -> Gain:
    """Compare errors (w, 15) of two models over the same windows in some columns, all of them alike.

    Of each window the logarithm of the ratio counts, with a tenth of the usual error put beside both: no window alone
    decides, and none in which nothing happens. A run that went nowhere (inf) counts as ten times as bad as usual; where
    all did, the gain is infinite.
    """
    new, old = np.array(new[:, list(columns)]), np.array(old[:, list(columns)])
    if not np.isfinite(new).any():
        return Gain(-np.inf, 0.0)
    if not np.isfinite(old).any():
        return Gain(np.inf, 0.0)
    usual = np.full(len(columns), np.nan)
    for j in range(len(columns)):
        both = np.concatenate([new[:, j], old[:, j]])
        if (fine := both[np.isfinite(both)]).size:
            for errors in (new[:, j], old[:, j]):
                errors[np.isposinf(errors)] = _FAILED * float(np.mean(fine))
        else:
            new[:, j] = old[:, j] = np.nan  # measured nowhere
        if (known := old[~np.isnan(old[:, j]), j]).size:
            usual[j] = float(np.mean(known))
    told = np.flatnonzero(np.nan_to_num(usual) > 0.0)
    least = _FLOOR * usual[told]
    share = np.log(old[:, told] + least) - np.log(new[:, told] + least)
    rows = share[~np.isnan(share).all(axis=1)]
    if not rows.size:
        return Gain(-np.inf, 0.0)
    each = np.nansum(rows, axis=1) / np.sum(~np.isnan(rows), axis=1)
    mean = float(each.mean())
    std = float(each.std(ddof=1) / np.sqrt(each.size)) if each.size > 1 else np.inf
    return Gain(1.0 - float(np.exp(-mean)), std * float(np.exp(-mean)))


def fits(errors: Array, spread: Array, columns: Sequence[int]) -> float:
    """Return the mean of 100 (1 - error / deviation) [%] over those columns that are speeds; NaN where none is."""
    out = []
    for j in columns:
        known = errors[~np.isnan(errors[:, j]), j]
        if 6 <= j < 12 and known.size and spread[j] > 0.0:
            out.append(100.0 * (1.0 - np.sqrt(np.mean(known) / spread[j])))
    return float(np.mean(out)) if out else float("nan")


def columns_of(names: Sequence[str]) -> tuple[int, ...]:
    """Return the columns that tell of the axes whose coefficients are free: pose and speed of each."""
    axes = set()
    for name in names:
        if name[0] in "XYZKMN" and name[1:2] == "_":
            axes.add("XYZKMN".index(name[0]))
        elif name.startswith("BG_"):
            axes |= {3, 4}
        elif name == "W_minus_B":
            axes.add(2)
    return (*sorted(axes), *(6 + i for i in sorted(axes)))
