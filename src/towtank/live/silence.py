"""Commands that have stopped while motion still comes: the last ones are not in force for ever."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

from towtank.recording.event import Event

__all__ = ["Silence"]

_LEAST, _PERIODS = 1.0, 5.0  # s, and usual periods of the commands, without any
_FEWEST, _MOST = 10, 50  # periods that tell what is usual
_STEADY = 2.0  # times the usual period: nine of ten are shorter, else commands are sent when they change, and hold


class Silence:
    """Watches the commands, or wrenches, of a session.

    Where they came steadily, and none has come for a second and five of their periods, they are not known any more.
    Commands that are sent only when they change are never missed.

    Attributes:
        since: time of the last commands [s] while they are missed; None while they come.
    """

    def __init__(self) -> None:
        self.since: float | None = None
        self._last: float | None = None
        self._periods: deque[float] = deque(maxlen=_MOST)

    def see(self, t: float, arguments: Mapping[str, Any]) -> Event | None:
        """Take the learner's arguments of time t [s]; return the event where commands have just gone silent."""
        if "commands" in arguments or "wrench" in arguments:
            if self._last is not None and self.since is None and t > self._last:
                self._periods.append(t - self._last)
            self._last, self.since = t, None
            return None
        if self._last is None or self.since is not None:
            return None
        limit = self._limit()
        if limit is None or t - self._last <= limit:
            return None
        self.since = self._last
        text = f"no commands since {self._last:.1f} s while motion comes; learning waits for them"
        return Event(self._last, "occlusion", text, {"measured": "commands", "noticed": t})

    def forget(self) -> None:
        """Begin a new stretch: nothing is known of what was before, but the usual period."""
        self._last = self.since = None

    def _limit(self) -> float | None:
        """Return after how long [s] commands are missed; None where they do not come steadily."""
        if len(self._periods) < _FEWEST:
            return None
        ordered = sorted(self._periods)
        usual = ordered[len(ordered) // 2]
        if ordered[int(0.9 * (len(ordered) - 1))] > _STEADY * usual:
            return None
        return max(_LEAST, _PERIODS * usual)
