"""Which of several sources of one quantity is used: the one nearest the sensor, unless another is much faster."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from towtank.core.arrays import Array
from towtank.recording.columns import MINIMUM_SAMPLES
from towtank.recording.standard import QUANTITIES as MOTION_QUANTITIES
from towtank.recording.standard import QuantityName
from towtank.recording.tables.gate import is_plausible

__all__ = ["QUANTITIES", "Choice", "Quantity", "Source", "choose"]

Quantity = QuantityName | Literal["wrench", "commands", "voltage"]
QUANTITIES: tuple[Quantity, ...] = (*(each.name for each in MOTION_QUANTITIES), "wrench", "commands", "voltage")
_WORTH = 4.0  # a source one step farther from the sensor has to be this many times as fast
_EQUAL = 0.9  # of the best score is as good


@dataclass(frozen=True, eq=False)
class Source:
    """One quantity as one table tells it.

    Attributes:
        table: name of the table.
        quantity: what it is; of each quantity one source is used. "position" is x y, "depth" is z, "velocity" is u v w
            or vn ve vd, "attitude" phi theta psi or qw qx qy qz; the others as `standard.QUANTITIES` says.
        t: times (n,) [s] in the order received.
        channels: standard name -> values (n,), NaN where not measured; units and frames are the standard ones.
        distance: steps between the sensor and this table: 0 the sensor's own reading, 1 a reading that was corrected
            or filtered, 2 the state of a filter that draws on several sensors, 3 what was sent to such a filter or
            came from it by detours.
        refused: why this is no measurement, where it is none.
        note: to be said among the recording's notes where it is used.
    """

    table: str
    quantity: Quantity
    t: Array
    channels: Mapping[str, Array]
    distance: int = 0
    refused: str = ""
    note: str = ""

    @property
    def samples(self) -> int:
        """Rows with a finite time in which something is measured that can be."""
        known = np.zeros(self.t.shape, dtype=np.bool_)
        for name, values in self.channels.items():
            known |= is_plausible(name, values)
        return int(np.count_nonzero(known & np.isfinite(self.t)))


@dataclass(frozen=True)
class Choice:
    """What is used, in the order of `QUANTITIES`, and why the others are not."""

    used: tuple[Source, ...]
    reasons: Sequence[tuple[Source, str]] = field(default_factory=tuple)


def choose(sources: Sequence[Source]) -> Choice:
    """Choose one source of each quantity, looking at the whole log.

    Refused sources and those with fewer than 4 samples are left out. Of the others the one with the largest
    samples / 4^distance is used: one that covers part of the log only counts as slow. Of those that are within a tenth
    of it the first is.
    """
    used: list[Source] = []
    reasons: list[tuple[Source, str]] = []
    for quantity in QUANTITIES:
        able: list[tuple[Source, int]] = []
        for source in (each for each in sources if each.quantity == quantity):
            samples = source.samples
            if source.refused:
                reasons.append((source, source.refused))
            elif samples < MINIMUM_SAMPLES:
                reasons.append((source, f"{samples} samples, fewer than {MINIMUM_SAMPLES}" if samples else "no value"))
            else:
                able.append((source, samples))
        if not able:
            continue
        scores = [samples / _WORTH**source.distance for source, samples in able]
        best, most = next(each for each, score in zip(able, scores, strict=True) if score >= _EQUAL * max(scores))
        used.append(best)
        reasons += [(each, _why(each, samples, best, most)) for each, samples in able if each is not best]
    return Choice(tuple(used), tuple(reasons))


def _why(source: Source, samples: int, best: Source, most: int) -> str:
    if best.distance < source.distance:
        return f"{best.table} is nearer the sensor"
    if _EQUAL * most > samples:
        return f"{best.table} is faster" if best.distance > source.distance else f"{best.table} has more samples"
    return f"{best.table} is used"
