"""When MAVLink messages were sent: the stamps of each sender, on the clock of receipt."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.live.clock import SourceClock
from towtank.readers.mavlink_senders import Sender
from towtank.readers.tables import Table

__all__ = ["MavlinkStamps"]

_BOOT = "time_boot_ms"
_FIELDS = {_BOOT: 1e-3, "time_usec": 1e-6, "usec": 1e-6}  # s
_WRAP = 2.0**32 * 1e-6  # s, where microseconds have 32 bits
_SAME = 2.0  # s within which a stamp is of the clock that is known


class MavlinkStamps:
    """Follows the clocks of all senders: of each the time since it started, and another one where it gives that."""

    def __init__(self) -> None:
        self._clocks: dict[tuple[Sender, str], SourceClock] = {}

    def of(self, table: Table, sender: Sender, received: Array) -> Array:
        """Return the stamps (n,) [s] of messages, NaN where there is none.

        Args:
            table: messages of one type. sender: who sent them.
            received: when they came (n,) [s].
        """
        field = next((each for each in _FIELDS if each in table), None)
        if field is None:
            return np.full(received.shape, np.nan)
        own = _FIELDS[field] * table[field]
        clock = self._clocks.setdefault((sender, _BOOT), SourceClock())
        if field != _BOOT:
            own = _unwrapped(own, received - clock.offset)
            if not abs(received[-1] - own[-1] - clock.offset) <= _SAME:
                clock = self._clocks.setdefault((sender, field), SourceClock())
                own = _unwrapped(_FIELDS[field] * table[field], received - clock.offset)
        told = zip(own.tolist(), received.tolist(), strict=True)
        return np.array([clock.ours(each, at) if each > 0.0 else np.nan for each, at in told])

    def restarts(self, sender: Sender | None) -> int:
        """Return how often a sender's clock has started anew."""
        return self._clocks[sender, _BOOT].restarts if sender and (sender, _BOOT) in self._clocks else 0


def _unwrapped(own: Array, expected: Array) -> Array:
    """Return stamps that begin anew every 4295 s as if they did not; others as they are."""
    known = np.isfinite(expected) & (own < _WRAP)
    return np.where(known, own + _WRAP * np.rint(np.where(known, expected - own, 0.0) / _WRAP), own)
