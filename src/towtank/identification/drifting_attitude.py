"""Roll and pitch where nothing measures them: gyros integrated, kept upright by an accelerometer where there is one.

Good enough to say which way is up where a free run begins. Gyros alone start level and drift, so they are believed for
two minutes only.
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.identification.chain import Sources
from towtank.identification.motion_state import (
    ABSENT,
    ATTITUDE_ACCELEROMETER,
    ATTITUDE_GYRO,
    MEASURED,
    Motion,
    motion_step,
    new_motion,
)
from towtank.recording import Grid
from towtank.recording.channel import in_one_block

__all__ = ["drifting_attitude", "gravity_directions"]

_BELIEVED = 120.0  # s
_CLOSE = 0.5  # s


def drifting_attitude(grid: Grid, sources: Sources, t: Array) -> Array:
    """Return roll and pitch (n, 2) [rad] at times t (n,), NaN where they are measured anyhow or not known."""
    out = np.full((t.size, 2), np.nan)
    if sources.attitude == "measured" or "measured" not in sources.velocity[3:]:
        return out
    rates = np.array([MEASURED if i > 2 and sources.velocity[i] == "measured" else ABSENT for i in range(6)])
    kind = ATTITUDE_ACCELEROMETER if sources.attitude == "accelerometer" else ATTITUDE_GYRO
    motion = new_motion(rates, kind, 0.0, np.inf)
    k = gravity_directions(
        motion, grid.t, in_one_block(grid.pose), np.array(grid.velocity), in_one_block(grid.acceleration)
    )
    known = np.isfinite(k).all(axis=1)
    if kind == ATTITUDE_GYRO:
        known &= grid.t <= grid.t[0] + _BELIEVED
    if not known.any():
        return out
    at, k = grid.t[known], k[known]
    near = np.array([np.interp(t, at, k[:, j]) for j in range(3)]).T
    fine = np.abs(at[np.clip(np.searchsorted(at, t), 0, at.size - 1)] - t) <= _CLOSE
    out[fine, 0] = np.arctan2(near[fine, 1], near[fine, 2])
    out[fine, 1] = np.arctan2(-near[fine, 0], np.hypot(near[fine, 1], near[fine, 2]))
    return out


@kernel
def gravity_directions(motion: Motion, t: Array, pose: Array, velocity: Array, acceleration: Array) -> Array:
    """Return the direction of gravity in the body (n, 3) at every sample; NaN where it is not known."""
    out = np.full((t.shape[0], 3), np.nan)
    nothing = np.zeros(6)
    for i in range(t.shape[0]):
        if motion_step(motion, t[i], pose[i], velocity[i], acceleration[i], nothing) >= 0.0:
            for j in range(3):
                out[i, j] = motion.last[14 + j]
    return out
