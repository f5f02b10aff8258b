"""How hard the vehicle is driven: the forces that were asked for over the last seconds."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.vehicle import Vehicle, thruster_wrench

__all__ = ["Excitation"]

_STEP, _SPAN = 0.1, 10.0  # s
_NOTHING = 1e-9  # of the strongest: rounding


class Excitation:
    """Looks at the commands ten times a second of the samples' time, over the last ten seconds."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._seen: deque[Array] = deque(maxlen=round(_SPAN / _STEP))
        self._last = -np.inf

    def see(self, t: float, arguments: dict[str, Any]) -> None:
        """Take the inputs among the learner's arguments of time t [s]."""
        if t - self._last < _STEP and t >= self._last:
            return
        if "commands" in arguments:
            self._seen.append(thruster_wrench(self._vehicle, arguments["commands"], arguments.get("voltage")))
        elif "wrench" in arguments:
            self._seen.append(np.nan_to_num(arguments["wrench"]))
        else:
            return
        self._last = t

    @property
    def rms(self) -> tuple[float, ...]:
        """Root mean square (6,) of X Y Z [N] K M N [N m] over the last ten seconds; empty where nothing was asked."""
        if not self._seen:
            return ()
        level = np.sqrt(np.mean(np.array(self._seen) ** 2, axis=0))
        return tuple(np.where(level > _NOTHING * level.max(), level, 0.0).tolist())
