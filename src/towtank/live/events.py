"""What happens in a live session: a list that any thread may add to, and the watch over sensors that lose sight."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from towtank.recording.event import Event

__all__ = ["EventLog", "Sight"]

_MOST = 1000  # events that are kept
_BLIND = 0.5  # s without a measurement, after which a sensor has lost sight,
_SLOW = 5.0  # or so many of its usual intervals
_FOLLOWS = 0.1  # share of the latest interval in the usual one


class EventLog:
    """Events in the order of noticing.

    Attributes:
        listener: called with each event that is new or has changed, by the thread that adds it.
    """

    def __init__(self, listener: Callable[[Event], None] | None = None) -> None:
        self.listener = listener
        self._events: deque[Event] = deque(maxlen=_MOST)
        self._foreign: list[Event] = []
        self._lock = threading.Lock()

    def add(self, event: Event) -> None:
        """Add one."""
        with self._lock:
            self._events.append(event)
        if self.listener is not None:
            self.listener(event)

    def take(self, events: Iterable[Event]) -> None:
        """Take a learner's events in their order; one that has changed takes the place of what it was before."""
        for k, event in enumerate(events):
            if k == len(self._foreign):
                self._foreign.append(event)
                self.add(event)
            elif event is not self._foreign[k]:
                before, self._foreign[k] = self._foreign[k], event
                with self._lock:
                    self._events = deque((event if each is before else each for each in self._events), maxlen=_MOST)
                if self.listener is not None:
                    self.listener(event)

    @property
    def all(self) -> tuple[Event, ...]:
        """Those that are kept, in the order of noticing."""
        with self._lock:
            return tuple(self._events)


class Sight:
    """Notices that position or velocity were not measured for a while, once they are back.

    A sensor that is slow by nature has lost sight when five of its usual intervals have passed.
    """

    _WATCHED = (("pose", "position"), ("velocity", "velocity"))

    def __init__(self) -> None:
        self._last: dict[str, float] = {}
        self._usual: dict[str, float] = {}

    def see(self, t: float, arguments: Mapping[str, Any]) -> Event | None:
        """Take the learner's arguments of time t [s]; return the event of a sensor that sees again."""
        found = None
        for group, word in self._WATCHED:
            values = arguments.get(group)
            if values is None or values[0] != values[0]:
                continue
            last = self._last.get(group)
            self._last[group] = t
            if last is None or t <= last:
                continue
            gap, usual = t - last, self._usual.get(group)
            if usual is not None and gap > max(_BLIND, _SLOW * usual):
                found = Event(last, "occlusion", f"no {word} for {gap:.1f} s", {"seconds": gap, "measured": word})
            else:
                self._usual[group] = gap if usual is None else usual + _FOLLOWS * (gap - usual)
        return found
