"""Velocity over ground in the world, as satellites and EKFs give it, turned into the body: v_body = R^T v_NED."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.recording.channel import standard_channel
from towtank.recording.frames.rotations import align_signs, conjugate, rotate
from towtank.recording.grids.timing import common_samples, interpolation_weights, quaternion_samples
from towtank.recording.recording import Recording
from towtank.recording.standard import EULER, LINEAR_VELOCITY, QUATERNION, WORLD_VELOCITY

__all__ = ["with_body_velocity"]

_TURNED = "u v w are vn ve vd turned into the body"


def with_body_velocity(recording: Recording) -> Recording:
    """Return the recording with `u v w` from `vn ve vd`, at their own times, where it has no measured `u v w`.

    The attitude may have other times: it is interpolated, never over a gap, and samples where it is unknown are left
    out. A note says what was done, or what it takes where nothing could be.
    """
    present = [name for name in WORLD_VELOCITY if name in recording and len(recording[name].measured)]
    if not present or any(note.startswith(_TURNED) for note in recording.notes):
        return recording
    if any(name in recording and len(recording[name].measured) for name in LINEAR_VELOCITY):
        return _noted(recording, f"{' '.join(present)} not used: u v w are measured")
    if len(present) < len(WORLD_VELOCITY):
        return _noted(recording, f"{' '.join(present)} not used: to become u v w it takes all of vn ve vd")
    t, velocity = common_samples([recording[name] for name in WORLD_VELOCITY])
    attitude = _attitude(recording)
    if attitude is None:
        return _noted(recording, "vn ve vd not used: to become u v w they need roll, pitch and yaw")
    stamps, q = attitude
    turned = rotate(conjugate(interpolation_weights(stamps, t).rotation(align_signs(q))), velocity)
    known = np.isfinite(turned).all(axis=1)
    if not known.any():
        return _noted(recording, "vn ve vd not used: the attitude is unknown wherever they are measured")
    left_out = int(np.count_nonzero(~known))
    lost = f", {left_out} samples left out where the attitude is unknown" if left_out else ""
    own = t[known]
    body = [standard_channel(name, own, turned[known, j]) for j, name in enumerate(LINEAR_VELOCITY)]
    return _noted(recording.replace(body), f"{_TURNED}{lost}")


def _noted(recording: Recording, note: str) -> Recording:
    return recording if note in recording.notes else recording.with_notes(note)


def _attitude(recording: Recording) -> tuple[Array, Array] | None:
    """Return times (n,) and quaternions (n, 4) [w x y z], body to NED; None where they are not recorded."""
    if all(name in recording for name in QUATERNION):
        t, q = quaternion_samples(recording)
    elif all(name in recording for name in EULER):
        t, angles = common_samples([recording[name] for name in EULER])
        q = quaternions_from_eulers(angles)
    else:
        return None
    return (t, q) if t.size else None
