"""What a recording keeps of what was learned: pose for viewers ten times a second, coefficients once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from towtank.live.learning import Learnt
from towtank.live.messages import coefficients, pose
from towtank.live.told import Told

__all__ = ["Kept"]

_POSES, _COEFFICIENTS = 0.1, 1.0  # s between two of them


class Kept:
    """Listens to the instants of a session.

    Args:
        put: takes what is to be kept. learnt: tells where learning stands. epoch: Unix time of t = 0 [s].
    """

    def __init__(self, put: Callable[[Told], None], learnt: Callable[[], Learnt], epoch: float) -> None:
        self._put, self._learnt, self._epoch = put, learnt, epoch
        self._posed = self._told = -math.inf

    def see(self, t: float, arguments: Mapping[str, Any]) -> None:
        """Take the learner's arguments of time t [s]."""
        values = arguments.get("pose")
        if values is not None and not 0.0 <= t - self._posed < _POSES:
            found = pose(t, self._epoch, values)
            if found is not None:
                self._posed = t
                self._put(found)
        if not 0.0 <= t - self._told < _COEFFICIENTS:
            self._told = t
            told = coefficients(self._learnt())
            if told is not None:
                self._put(told)
