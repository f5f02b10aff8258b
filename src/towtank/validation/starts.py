"""The state that a prediction starts from, out of what was measured there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import quaternion_from_euler, rotation_from_quaternion
from towtank.identification.chain import Sources
from towtank.identification.drifting_attitude import gravity_directions
from towtank.identification.motion_state import (
    ABSENT,
    ATTITUDE_ACCELEROMETER,
    ATTITUDE_GYRO,
    ATTITUDE_MEASURED,
    MEASURED,
    new_motion,
)
from towtank.recording import Grid
from towtank.recording.channel import in_one_block

__all__ = ["Starts"]

_WINDOW = 0.2  # s to either side, for a velocity taken from the pose,
_EDGE = 0.6  # s on the one side there is, at the start and the end of a recording
_ATTITUDE = {"measured": ATTITUDE_MEASURED, "accelerometer": ATTITUDE_ACCELEROMETER, "gyro": ATTITUDE_GYRO}


@dataclass(frozen=True)
class Starts:
    """Measured states of one grid. What was not measured keeps the value that the prediction has reached."""

    grid: Grid
    sources: Sources
    gravity: Array

    @classmethod
    def of(cls, grid: Grid) -> Starts:
        """Prepare the states of a grid."""
        sources = Sources.of(grid.pose, grid.velocity, grid.acceleration)
        rates = np.array([MEASURED if i > 2 and sources.velocity[i] == "measured" else ABSENT for i in range(6)])
        motion = new_motion(rates, _ATTITUDE[sources.attitude], 0.0, np.inf)
        pose, acceleration = in_one_block(grid.pose), in_one_block(grid.acceleration)
        velocity = np.array(grid.velocity)
        return cls(grid, sources, gravity_directions(motion, grid.t, pose, velocity, acceleration))

    def known(self, row: int) -> bool:
        """Whether everything that the grid measures at all is measured in this row."""
        grid, sources = self.grid, self.sources
        measured = [i for i in range(6) if sources.velocity[i] == "measured"]
        if not np.isfinite(grid.velocity[row, measured]).all():
            return False
        if "derived" in sources.velocity and not np.isfinite(grid.pose[row]).all():
            return False
        return bool(np.isfinite(self.gravity[row]).all())

    def state(self, row: int, reached: Array) -> Array:
        """Return the state (13,) at a row; `reached` (13,) supplies what was not measured."""
        out = reached.copy()
        pose = self.grid.pose[row]
        for j in range(3):
            if np.isfinite(pose[j]):
                out[j] = pose[j]
        k = self.gravity[row]
        phi, theta = np.arctan2(k[1], k[2]), np.arctan2(-k[0], np.hypot(k[1], k[2]))
        psi = pose[5] if np.isfinite(pose[5]) else _heading(reached[3:7])
        out[3:7] = quaternion_from_euler(float(phi), float(theta), float(psi))
        derived = self._derived(row) if "derived" in self.sources.velocity else None
        for i, kind in enumerate(self.sources.velocity):
            if kind == "measured":
                out[7 + i] = self.grid.velocity[row, i]
            elif kind == "derived" and derived is not None:
                out[7 + i] = derived[i]
        return out

    def _derived(self, row: int) -> Array:
        """Return the body velocity (6,) from a quadratic through the poses around a row."""
        grid = self.grid
        measured = np.isfinite(grid.pose).all(axis=1)
        for window in (_WINDOW, _EDGE):
            near = np.flatnonzero((np.abs(grid.t - grid.t[row]) <= window + 1e-9) & measured)
            s = grid.t[near] - grid.t[row]
            if near.size and s[0] < -0.5 * window and s[-1] > 0.5 * window:
                break
        out = np.zeros(6)
        if near.size < 3:
            return out
        rate = np.linalg.lstsq(np.column_stack([np.ones_like(s), s, s * s]), grid.pose[near], rcond=None)[0][1]
        phi, theta, psi = grid.pose[row, 3:]
        R = rotation_from_quaternion(np.array(quaternion_from_euler(float(phi), float(theta), float(psi))))
        out[:3] = R.T @ rate[:3]
        s1, c1, s2, c2 = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
        out[3] = rate[3] - s2 * rate[5]
        out[4] = c1 * rate[4] + s1 * c2 * rate[5]
        out[5] = -s1 * rate[4] + c1 * c2 * rate[5]
        return out


def _heading(q: Array) -> float:
    w, x, y, z = q
    return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
