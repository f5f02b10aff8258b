"""`replay:FILE[@SPEED]`: a log of any kind, once more in its own time, faster, or as fast as it can be learned from."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from towtank.errors import InputError
from towtank.live.links.source import Rates, Raw, Sample, SourceState
from towtank.live.pipeline.clock import steady_time
from towtank.live.pipeline.instants import Row, rows_of
from towtank.recording.grids.free_motion import DEPTH_BELOW_SURFACE
from towtank.recording.mapping import ColumnMapping
from towtank.vehicle import Vehicle

__all__ = ["ReplaySource"]

_TOPIC = "replay"
_BATCH = 256


class ReplaySource:
    """Hands over the samples of a log at SPEED times the pace of their times; 0 is as fast as they are taken.

    Its first sample stands at the moment at which it was opened, the others as far apart as in the log.
    """

    name = "replay"
    keeps_time = True

    def __init__(self, text: str, vehicle: Vehicle, mapping: ColumnMapping | None = None) -> None:
        self._text = text
        self._path, self._speed = _parts(text)
        self._thrusters = [each.name for each in vehicle.thrusters]
        self._mapping = mapping
        self._rows: Iterator[Row] = iter(())
        self._next: Row | None = None
        self._start = self._base = self._begun = 0.0
        self._said: tuple[str, ...] = ()
        self._attributes: dict[str, str] = {}
        self._rates = Rates()
        self.patient = self._speed == 0.0

    def open(self) -> None:
        """Read the file. Raises InputError."""
        from towtank.readers import read
        from towtank.recording import bind_thrusters, with_body_velocity

        recording = with_body_velocity(bind_thrusters(read(self._path, self._mapping), self._thrusters))
        self._rows = rows_of(recording)
        self._next = next(self._rows, None)
        self._start = 0.0 if self._next is None else self._next[0]
        self._base = round(steady_time(), 6)
        self._begun = time.monotonic()
        told = ("modes", DEPTH_BELOW_SURFACE[0])
        self._attributes = {key: recording.attributes[key] for key in told if key in recording.attributes}
        self._said = (f"{self._path.name}: {recording.duration:.5g} s", *recording.repairs.lines)

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        """Return what is due; waits at most `timeout` [s] for it."""
        out: list[Sample | Raw] = []
        give_up = time.monotonic() + timeout
        while self._next is not None and len(out) < _BATCH:
            t, names, values = self._next
            if not self.patient:
                due = self._begun + (t - self._start) / self._speed
                now = time.monotonic()
                if due > now:
                    if out or due > give_up:
                        if not out:
                            time.sleep(max(give_up - now, 0.0))
                        break
                    time.sleep(due - now)
            out.append(Sample(self.name, _TOPIC, self._base + (t - self._start), steady_time(), names, values))
            self._next = next(self._rows, None)
        self._rates.add(_TOPIC, len(out))
        return out

    def state(self) -> SourceState:
        """Return how it fares."""
        return SourceState(
            said=self._said, rates=self._rates.now(), attributes=self._attributes, ended=self._next is None
        )

    def close(self) -> None:
        """End."""
        self._rows, self._next = iter(()), None


def _parts(text: str) -> tuple[Path, float]:
    """Return file and speed of "replay:FILE[@SPEED]"."""
    rest = text.removeprefix("replay:")
    name, at, speed = rest.rpartition("@")
    if not at or Path(rest).exists():
        name, speed = rest, "1"
    try:
        pace = float(speed)
    except ValueError:
        pace = math.nan
    if not (math.isfinite(pace) and pace >= 0.0):
        raise InputError(
            f'source "{text}": found speed "{speed}", expected a number of 0 or more (0: as fast as possible)'
        )
    if not name:
        raise InputError(f'source "{text}": expected replay:FILE or replay:FILE@SPEED')
    return Path(name), pace
