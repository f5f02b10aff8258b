"""The last minute of what was learned from, as a recording: what the model of a session is judged on."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from towtank.recording import Recording
from towtank.recording.channel import Channel
from towtank.recording.standard import is_standard, standard_of

__all__ = ["Recent"]

_SPAN = 60.0  # s
_MOST = 30_000  # instants

_Row = tuple[float, tuple[str, ...], tuple[float, ...]]


class Recent:
    """Keeps the instants of the current stretch, and of the one before while that is the longer one."""

    def __init__(self) -> None:
        self._rows: deque[_Row] = deque(maxlen=_MOST)
        self._before: deque[_Row] = deque()

    def add(self, t: float, sample: Mapping[str, float]) -> None:
        """Take what belongs to one instant."""
        self._rows.append((t, tuple(sample), tuple(sample.values())))
        while t - self._rows[0][0] > _SPAN:
            self._rows.popleft()

    def break_off(self) -> None:
        """Begin a new stretch."""
        if _span(self._rows) >= _span(self._before):
            self._before = self._rows
        self._rows = deque(maxlen=_MOST)

    def copy(self) -> Recent:
        """Return what is kept by now, for another thread."""
        out = Recent()
        out._rows, out._before = self._rows.copy(), self._before.copy()
        return out

    def recording(self) -> Recording | None:
        """Return the longer stretch; None where nothing stands in it."""
        rows = max(self._rows, self._before, key=_span)
        times: dict[str, list[float]] = {}
        values: dict[str, list[float]] = {}
        for t, names, numbers in rows:
            for name, value in zip(names, numbers, strict=True):
                if is_standard(name) and np.isfinite(value) and not (times.get(name) and t <= times[name][-1]):
                    times.setdefault(name, []).append(t)
                    values.setdefault(name, []).append(value)
        channels = {}
        for name, own in times.items():
            told = standard_of(name)
            channels[name] = Channel(name, np.array(own), np.array(values[name]), told.unit, told.frame)
        return Recording(channels, "the session's last minute") if channels else None


def _span(rows: deque[_Row]) -> float:
    return rows[-1][0] - rows[0][0] if rows else 0.0
