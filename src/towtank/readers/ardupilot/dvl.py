"""A DVL as it speaks to an autopilot: displacement in the body, and the time that it took."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.common.sources import Source
from towtank.recording.frames.lever_arm import marker_to_origin
from towtank.recording.recording import Recording

__all__ = ["at_the_origin", "displacement_source"]

_PLACE = ("VISO_POS_X", "VISO_POS_Y", "VISO_POS_Z")  # m, body FRD


def displacement_source(table: str, t: Array, moved: Sequence[Array], dt: Array, confidence: Array | None) -> Source:
    """Return u v w: displacement over time, body FRD, at the message's time.

    Args:
        table: name of the table.
        t: times (n,) [s].
        moved: forward, to starboard and down (n,) [m].
        dt: the time that it took (n,) [s].
        confidence: (n,) [%]. A message with neither confidence nor motion tells that the bottom was lost.
    """
    distance = np.column_stack(list(moved))
    valid = np.isfinite(dt) & (dt > 0.0)
    if confidence is not None:
        valid &= (confidence > 0.0) | np.any(distance != 0.0, axis=1)
    velocity = np.divide(distance, dt[:, None], out=np.full(distance.shape, np.nan), where=valid[:, None])
    return Source(table, "velocity", t, dict(zip("uvw", velocity.T, strict=True)))


def at_the_origin(recording: Recording, parameters: Mapping[str, float], messages: Sequence[str]) -> Recording:
    """Return the recording with the DVL's velocity moved to the body origin, where the autopilot knows its place.

    Args:
        recording: as read.
        parameters: of the autopilot; VISO_POS_X, _Y, _Z are where the DVL sits.
        messages: the types by which a DVL speaks.
    """
    place = [parameters.get(name, 0.0) for name in _PLACE]
    speaks = any(
        "u" in content.used and content.name.partition("@")[0].partition("[")[0] in messages
        for content in recording.contents
    )
    if not speaks or not any(place) or not np.isfinite(place).all() or not all(name in recording for name in "pqr"):
        return recording
    return marker_to_origin(recording, place, ("velocity",)).with_notes("the DVL sits where VISO_POS_X, _Y, _Z say")
