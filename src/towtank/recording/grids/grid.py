"""A recording on one common grid of times, as regressors and filters take it; a command acts until the next one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import quaternions_from_eulers
from towtank.recording.channel import Channel, read_only
from towtank.recording.grids.stretches import input_rows
from towtank.recording.repairs import Repairs

__all__ = ["Flags", "Grid", "held_at", "held_mean", "stack_held"]

Flags = NDArray[np.bool_]
_IN_TIME = 1e-3  # of a step: a stamp that comes this little late counts as in time


def stack_held(channels: Sequence[Channel]) -> tuple[Array, Array]:
    """Return the distinct stamps (k,) of all channels and the values held then (k, m); NaN before a first."""
    known = [channel.measured for channel in channels]
    stamps = {id(channel.t): channel.t for channel in known}
    if not stamps:
        return np.empty(0), np.empty((0, 0))
    times = np.unique(np.concatenate(list(stamps.values()))) if len(stamps) > 1 else next(iter(stamps.values()))
    return times, np.column_stack([held_at(channel.t, channel.values[:, None], times)[:, 0] for channel in known])


def held_at(t_command: Array, values: Array, at: Array, delay: float = 0.0, tolerance: float = 0.0) -> Array:
    """Return the held values (n, m) in force at the times `at` (n,); NaN before the first stamp.

    Args:
        t_command: stamps (k,) [s], strictly increasing.
        values: commands (k, m).
        at: times (n,) [s].
        delay: from a stamp to its effect [s].
        tolerance: a stamp that comes this little late [s] counts as in time; rounding is always allowed for.
    """
    if not t_command.size:
        return np.full((at.size, values.shape[1]), np.nan)
    latest = at - delay + (tolerance + 4.0 * np.spacing(np.abs(at)))
    index = np.searchsorted(t_command, latest, "right") - 1
    result: Array = np.where(index[:, None] >= 0, values[np.maximum(index, 0)], np.nan)
    return result


@kernel
def held_mean(t_command: Array, values: Array, t: Array, delay: float) -> Array:
    """Return the exact mean (n - 1, m) of held commands over each interval t[i] .. t[i+1].

        mean_i = 1 / (t[i+1] - t[i]) * integral from t[i] to t[i+1] of command(s - delay) ds

    NaN where part of the interval lies before the first stamp (by more than a millionth of the interval).

    Args:
        t_command: stamps (k,) [s], strictly increasing; each row of `values` holds from its stamp to the
            next.
        values: commands (k, m).
        t: times (n,) [s], increasing.
        delay: from a stamp to its effect [s].
    """
    k, m, n = t_command.shape[0], values.shape[1], t.shape[0]
    out = np.empty((max(n - 1, 0), m))
    row = -1  # the last stamp at or before the start of the interval
    for i in range(n - 1):
        start, end = t[i] - delay, t[i + 1] - delay
        slack = 1e-6 * (end - start)
        while row + 1 < k and t_command[row + 1] <= start + slack:
            row += 1
        if row + 1 >= k or t_command[row + 1] >= end - slack:
            for j in range(m):
                out[i, j] = values[row, j] if row >= 0 else np.nan
            continue
        for j in range(m):
            out[i, j] = 0.0
        at, current = start, row
        while at < end:
            until = end
            if current + 1 < k and t_command[current + 1] < end:
                until = t_command[current + 1]
            share = (until - at) / (end - start)
            for j in range(m):
                out[i, j] += share * (values[current, j] if current >= 0 else np.nan)
            at = until
            current += 1
    return out


@dataclass(frozen=True, eq=False)
class Grid:
    """Motion and inputs of a recording at uniform times. Immutable; NaN where unknown.

    Attributes:
        t: times (n,) [s], uniform at `rate` [Hz].
        pose: x y z [m, NED] and phi theta psi [rad] (n, 6), phi and psi unwrapped.
        velocity: u v w [m/s] p q r [rad/s] (n, 6), body FRD.
        acceleration: specific force ax ay az (n, 3) [m/s^2], body FRD.
        further: channels `standard.FURTHER` (n, k) of the sensors beyond these. Where nothing of one of these four is
            known, it is a single NaN, broadcast; kernels take it by `in_one_block`.
        fresh: (n, 18) columns as pose, velocity, acceleration, further; True in the row nearest to an actual
            sample, False where the value only lies between samples: a slow sensor says nothing new there.
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
    further: Array
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
        for name in ("pose", "velocity", "acceleration", "further"):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            known = values.size == 0 or np.isfinite(values).any()
            object.__setattr__(self, name, read_only(values) if known else np.broadcast_to(np.nan, values.shape))
        for name in ("t", "voltage", "command_t", "command_values", "wrench_t", "wrench_values"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
        fresh = np.asarray(self.fresh, dtype=np.bool_)
        fresh = fresh.copy() if fresh.flags.writeable or fresh.base is not None else fresh
        fresh.flags.writeable = False
        object.__setattr__(self, "fresh", fresh)

    def stretch(self, first: int, last: int, since: float | None = None) -> Grid:
        """Return the rows [first, last) with the inputs that matter to them.

        since: only inputs after this time [s], as of one who has had those before.
        """
        rows = ("t", "pose", "velocity", "acceleration", "further", "fresh", "voltage")
        taken = {name: getattr(self, name)[first:last] for name in rows}
        for kind in ("command", "wrench"):
            stamps, end = getattr(self, f"{kind}_t"), float(self.t[last - 1])
            inputs = input_rows(stamps, float(self.t[first]), end)
            if since is not None:
                inputs = slice(int(np.searchsorted(stamps, since, "right")), int(np.searchsorted(stamps, end, "right")))
            taken |= {f"{kind}_{name}": getattr(self, f"{kind}_{name}")[inputs] for name in ("t", "values")}
        return replace(self, **taken)

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
