"""Whether the velocity and position that an autopilot's filter tells are measured, or dead reckoning.

Without a velocity or position sensor the filter integrates accelerometers, or a model of its own: what it says of surge
and sway is then no measurement, however smooth it looks. Satellites do not reach under water. Depth is another matter:
a pressure sensor aids it always.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.readers.common.sources import Source

__all__ = ["Aiding", "Evidence", "aided", "aiding_of"]

_DEAD_RECKONING = "dead reckoning"
_HORIZONTAL_VELOCITY, _RELATIVE, _ABSOLUTE, _CONSTANT, _DEAD = (1 << bit for bit in (1, 3, 4, 7, 18))
_MOST_FLAGS = 2.0**53
_UNDER_WATER = 0.5  # m; deeper than that no satellite is heard


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a log tells of the aiding of its filter.

    Attributes:
        t, flags: the filter's own reports: times (n,) [s] and status bits (n,) of ArduPilot; None where it logs none.
        velocity: sensors of velocity that are heard, by name of table.
        position: sensors of position other than satellites that are heard.
        satellites: whether a receiver of satellites had a fix.
        depth_t, depth: times (k,) [s] and depth (k,) [m], None where unknown.
    """

    t: Array | None = None
    flags: Array | None = None
    velocity: tuple[str, ...] = ()
    position: tuple[str, ...] = ()
    satellites: bool = False
    depth_t: Array | None = None
    depth: Array | None = None


@dataclass(frozen=True, eq=False)
class Aiding:
    """Where the filter is aided: at `t` (n,) [s] and until the next one; why not, where it never is."""

    t: Array
    velocity: NDArray[np.bool_]
    position: NDArray[np.bool_]
    why_not: str


def aiding_of(evidence: Evidence) -> Aiding:
    """Judge the whole log."""
    if evidence.t is not None and evidence.flags is not None and evidence.t.size:
        order = np.argsort(evidence.t, kind="stable")
        reported = evidence.flags[order]
        t, flags = evidence.t[order], np.where(np.abs(reported) < _MOST_FLAGS, reported, 0.0).astype(np.int64)
        sane = ((flags & _HORIZONTAL_VELOCITY) > 0) & ((flags & (_CONSTANT | _DEAD)) == 0)
        velocity, position = sane & ((flags & (_RELATIVE | _ABSOLUTE)) > 0), sane & ((flags & _ABSOLUTE) > 0)
        why = "the filter reports that nothing aids it"
    else:
        t = np.array([-np.inf]) if evidence.depth_t is None else np.sort(evidence.depth_t)
        sensed = bool(evidence.velocity or evidence.position)
        velocity = np.full(t.size, sensed or evidence.satellites)
        position = np.full(t.size, bool(evidence.position) or evidence.satellites)
        why = "no sensor of velocity or position aids it"
    if not evidence.position and evidence.satellites and evidence.depth_t is not None and evidence.depth is not None:
        deep = _held(evidence.depth_t, evidence.depth, t) > _UNDER_WATER
        position = position & ~deep
        if not evidence.velocity:
            velocity = velocity & ~deep
            why = "satellites alone aid it, and are not heard under water"
    return Aiding(t, velocity, position, why)


def aided(source: Source, aiding: Aiding, *, position: bool = False) -> Source:
    """Return a horizontal velocity or position of the filter where it is aided, refused where it never is."""
    state = aiding.position if position else aiding.velocity
    held = _held(aiding.t, state.astype(np.float64), source.t) > 0.5
    if not held.any():
        reason = aiding.why_not
        if position and aiding.velocity.any():
            reason = "no position aids it, it is its velocity integrated"
        return replace(source, refused=f"{_DEAD_RECKONING}, {reason}")
    if held.all():
        return source
    channels = {name: np.where(held, values, np.nan) for name, values in source.channels.items()}
    share = 100.0 * np.count_nonzero(~held) / held.size
    note = f"{source.table}: {source.quantity} left out in {share:.0f} % of it, where it is dead reckoning"
    return replace(source, channels=channels, note=note)


def _held(t: Array, values: Array, at: Array) -> Array:
    """Return the latest value (n,) at the times `at`; before the first one, that one."""
    order = np.argsort(t, kind="stable")
    rows = np.searchsorted(t[order], at, "right") - 1
    latest: Array = values[order][np.maximum(rows, 0)]
    return latest
