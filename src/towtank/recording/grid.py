"""A recording on one common grid of times: what regressors and filters work on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.recording.channel import read_only
from towtank.recording.held import held_at, held_mean
from towtank.recording.repairs import Repairs

__all__ = ["Grid"]

Flags = NDArray[np.bool_]

_IN_TIME = 1e-3  # of a step: a stamp that comes this little late counts as in time


@dataclass(frozen=True, eq=False)
class Grid:
    """Motion and inputs of a recording at uniform times. Immutable; NaN where unknown.

    Attributes:
        t: times (n,) [s], uniform at `rate` [Hz].
        pose: x y z [m, NED] and phi theta psi [rad] (n, 6), phi and psi unwrapped.
        velocity: u v w [m/s] p q r [rad/s] (n, 6), body FRD.
        acceleration: specific force ax ay az (n, 3) [m/s^2], body FRD. Where nothing of one of these three is known,
            it is a single NaN, broadcast; kernels take it by `in_one_block`.
        fresh: (n, 15) columns as pose, velocity, acceleration; True in the row nearest to an actual sample,
            False where
            the value only lies between samples: a slow sensor says nothing new there.
        voltage: (n,) [V], interpolated over gaps too, held beyond its ends.
        thrusters: names of the columns of `commands`.
        command_t, command_values: the stamps (k,) of the commands and the values (k, m) from each on.
        wrench_t, wrench_values: likewise for the wrench (j,), (j, 6).
        repairs: what was mended, on reading and here.
    """

    t: Array
    rate: float
    pose: Array
    velocity: Array
    acceleration: Array
    fresh: Flags
    voltage: Array
    thrusters: tuple[str, ...]
    command_t: Array
    command_values: Array
    wrench_t: Array
    wrench_values: Array
    source: str = ""
    repairs: Repairs = Repairs()

    def __post_init__(self) -> None:
        for name in ("pose", "velocity", "acceleration"):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            known = values.size == 0 or np.isfinite(values).any()
            object.__setattr__(self, name, read_only(values) if known else np.broadcast_to(np.nan, values.shape))
        for name in ("t", "voltage", "command_t", "command_values", "wrench_t", "wrench_values"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        fresh = np.asarray(self.fresh, dtype=np.bool_)
        fresh = fresh.copy() if fresh.flags.writeable or fresh.base is not None else fresh
        fresh.flags.writeable = False
        object.__setattr__(self, "fresh", fresh)

    def __len__(self) -> int:
        return int(self.t.size)

    @property
    def dt(self) -> float:
        """Step of the grid [s]."""
        return 1.0 / self.rate

    @cached_property
    def quaternion(self) -> Array:
        """Attitude (n, 4) [w x y z], body to NED, no jumps of sign; NaN rows where an angle is unknown."""
        return read_only(quaternions_from_eulers(self.pose[:, 3:]))

    @cached_property
    def tilt_known(self) -> Flags:
        """True (n,) where roll and pitch are known, and so the direction of gravity."""
        known: Flags = np.isfinite(self.pose[:, 3] + self.pose[:, 4])
        return known

    @cached_property
    def attitude_known(self) -> Flags:
        """True (n,) where roll, pitch and yaw are known."""
        known: Flags = self.tilt_known & np.isfinite(self.pose[:, 5])
        return known

    @property
    def commands(self) -> Array:
        """Commands (n, m), held from their own stamps; NaN before the first, held after the last."""
        return held_at(self.command_t, self.command_values, self.t, tolerance=_IN_TIME / self.rate)

    @property
    def wrench(self) -> Array:
        """Recorded wrench X Y Z [N] K M N [N m] (n, 6), held likewise."""
        return held_at(self.wrench_t, self.wrench_values, self.t, tolerance=_IN_TIME / self.rate)

    def command_means(self, delay: float = 0.0) -> Array:
        """Exact means (n - 1, m) over each grid interval of the commands, `delay` [s] after their stamps."""
        return _means(self.command_t, self.command_values, self.t, delay)

    def wrench_means(self, delay: float = 0.0) -> Array:
        """Exact means (n - 1, 6) over each grid interval of the held wrench, `delay` [s] after its stamps."""
        return _means(self.wrench_t, self.wrench_values, self.t, delay)


def _means(t_held: Array, values: Array, t: Array, delay: float) -> Array:
    if not t_held.size:
        return np.full((max(t.size - 1, 0), values.shape[1]), np.nan)
    return held_mean(t_held, values, t, float(delay))
