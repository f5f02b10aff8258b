"""From MAVLink messages as they come to samples in standard channels.

The meanings are those of logs (`readers.mavlink_meaning`), a few rows at a time. What a log decides over its whole
length (which source of a quantity, which outputs drive thrusters, where the filter is aided, whose messages count) is
decided here from the last seconds, again and again. The stamps of each sender are put on the clock of receipt.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from towtank.core.arrays import Array
from towtank.live.links.mavlink.frames import Frame
from towtank.live.links.source import Sample
from towtank.live.pipeline.clock import SourceClock
from towtank.live.pipeline.frames import BodyVelocity
from towtank.live.pipeline.quantities import Quantities
from towtank.readers.ardupilot.aiding import Aiding
from towtank.readers.ardupilot.states import heartbeat_channels, heartbeat_modes, modes_text, tells_pressure
from towtank.readers.ardupilot.thruster_outputs import ThrusterOutputs, command_source, thruster_outputs
from towtank.readers.common.sources import Source
from towtank.readers.common.tables import Table, Tables
from towtank.readers.mavlink.autopilot import DVL
from towtank.readers.mavlink.format import MessageLayout
from towtank.readers.mavlink.meaning import (
    aiding_of_messages,
    mavlink_sources,
    pressures_of,
    pulses_of,
    sources_of_messages,
)
from towtank.readers.mavlink.senders import ANOTHER, Autopilot, Sender, autopilot_of, message_of, named_tables
from towtank.readers.mavlink.tables import tables_by_instance
from towtank.recording.grids.free_motion import DEPTH_BELOW_SURFACE

__all__ = ["Arrival", "MavlinkSamples"]

_BOOT = "time_boot_ms"
_FIELDS = {_BOOT: 1e-3, "time_usec": 1e-6, "usec": 1e-6}  # s
_TURN = 2.0**32  # counts after which a counter of 32 bits begins anew: 71 minutes of microseconds, 50 days of ms
_STEP = 0.1  # s of messages whose stamps are followed type by type, before the first decision,
_AT_ONCE = 32  # and messages afterwards; more would stand too far out of order
Arrival = tuple[Frame, float]  # a message and when it came [s]
_Key = tuple[int, Sender]
_HISTORY = 6.0  # s
_PAUSE = 1.0  # s without a word of the autopilot; what it said before counts until it has spoken for so long again
_MOST_ROWS, _MOST_KEYS = 1500, 200
_RATE_WINDOW = 3.0  # s
_HEARTBEAT = "HEARTBEAT"
_OUTPUTS, _STATUS = "SERVO_OUTPUT_RAW", ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS")
_PLACE = ("VISO_POS_X", "VISO_POS_Y", "VISO_POS_Z")


class MavlinkStamps:
    """Follows the clocks of all senders: of each the time since it started, and another one where it gives that.

    Attributes:
        strange: stamps that were not believed.
    """

    def __init__(self) -> None:
        self._clocks: dict[tuple[Sender, str], SourceClock] = {}
        self.strange = 0

    def of(self, table: Table, sender: Sender, received: Array) -> Array:
        """Return the stamps (n,) [s] of messages, NaN where there is none.

        A stamp that cannot be is infinite: what bears it is of another vehicle, or damaged.

        Args:
            table: messages of one type. sender: who sent them.
            received: when they came (n,) [s].
        """
        field = next((each for each in _FIELDS if each in table), None)
        if field is None:
            return np.full(received.shape, np.nan)
        unit = _FIELDS[field]
        clock = self._clocks.setdefault((sender, _BOOT), SourceClock())
        own = _unwrapped(unit * table[field], received - clock.offset, unit * _TURN)
        if field != _BOOT and not clock.is_of(own[-1], received[-1]):
            clock = self._clocks.setdefault((sender, field), SourceClock())
            own = _unwrapped(unit * table[field], received - clock.offset, unit * _TURN)
        stamps = [self._stamp(clock, *each) for each in zip(own.tolist(), received.tolist(), strict=True)]
        return np.array(stamps)

    def _stamp(self, clock: SourceClock, own: float, received: float) -> float:
        if not own > 0.0:
            return math.nan
        if clock.believes(own, received):
            return clock.place(own, received)
        self.strange += 1
        return math.inf

    def restarts(self, sender: Sender | None) -> int:
        """Return how often a sender's clock has started anew."""
        return self._clocks[sender, _BOOT].restarts if sender and (sender, _BOOT) in self._clocks else 0


def _unwrapped(own: Array, expected: Array, turn: float) -> Array:
    """Return stamps that begin anew every `turn` [s] as if they did not; others as they are."""
    known = np.isfinite(expected) & (own < turn)
    return np.where(known, own + turn * np.rint(np.where(known, expected - own, 0.0) / turn), own)


class MavlinkSamples:
    """Keeps the last seconds of messages, decides what they are used for, and turns new ones into samples.

    Args:
        layouts: of the messages. thrusters: how many the vehicle has.
    """

    def __init__(self, layouts: Mapping[int, MessageLayout], thrusters: int) -> None:
        self._layouts, self._thrusters = layouts, thrusters
        self._history: dict[_Key, deque[tuple[float, bytes]]] = {}
        self._origin = 0.0
        self._names: dict[tuple[int, Sender, str], str] = {}
        self._useful: set[_Key] = set()
        self._aiding: Aiding | None = None
        self._parameters: Mapping[str, float] = {}
        self._outputs = ThrusterOutputs({})
        self._stamps = MavlinkStamps()
        self._velocity = BodyVelocity()
        self._flags: float | None = None
        self.quantities = Quantities()
        self.autopilot = Autopilot(None, {})
        self._modes = ""
        self._beat: Arrival | None = None  # the latest heartbeat before anything was decided
        self._heard = self._before = self._again = -math.inf  # s: the autopilot last; before its last pause, after it
        self.decided = False
        self.hurry = False

    @property
    def attributes(self) -> dict[str, str]:
        """What the samples are, as of a recording: names of modes, and where z is the depth by pressure."""
        out = {"modes": self._modes} if self._modes else {}
        return out | dict([DEPTH_BELOW_SURFACE] if tells_pressure(self.quantities.used.get("depth", "")) else [])

    @property
    def restarts(self) -> int:
        """How often the autopilot's clock has started anew."""
        return self._stamps.restarts(self.autopilot.sender)

    @property
    def strange(self) -> int:
        """Messages that were passed over because their stamps cannot be."""
        return self._stamps.strange

    def take(self, arrivals: Sequence[Arrival]) -> list[Sample]:
        """Return the samples in some messages, once it has been decided what is used."""
        parts = (arrivals[k : k + _AT_ONCE] for k in range(0, len(arrivals), _AT_ONCE))
        return [sample for part in parts for sample in self._take(part)]

    def _take(self, arrivals: Sequence[Arrival]) -> list[Sample]:
        groups: dict[_Key, list[int]] = {}
        for i, (frame, received) in enumerate(arrivals):
            key = frame.number, frame.sender
            if frame.sender == self.autopilot.sender:
                if received - self._heard > _PAUSE:
                    self._before, self._again = self._heard, received
                self._heard = received
            if key not in self._history:
                if len(self._history) >= _MOST_KEYS and frame.sender != self.autopilot.sender:
                    continue
                self._history[key] = deque(maxlen=_MOST_ROWS)
                self._origin = self._origin or received
                self.hurry = self.hurry or self.decided
            self._history[key].append((received, frame.payload))
            groups.setdefault(key, []).append(i)
        if not self.decided:
            return []
        if self._beat is not None:  # what the autopilot said of itself before counts until it says something else
            arrivals, self._beat = [*arrivals, self._beat], None
            key = arrivals[-1][0].number, arrivals[-1][0].sender
            groups[key] = [len(arrivals) - 1, *groups.get(key, [])]
        found: list[tuple[int, Sample]] = []
        for (number, sender), rows in groups.items():
            found += self._samples(self._layouts[number], sender, rows, arrivals)
        found.sort(key=lambda each: each[0])
        return [self._in_body(sample) for _, sample in found]

    def _samples(
        self, layout: MessageLayout, sender: Sender, rows: list[int], arrivals: Sequence[Arrival]
    ) -> Iterable[tuple[int, Sample]]:
        own = sender == self.autopilot.sender
        if own and layout.name in _STATUS:
            self._watch(layout, arrivals[rows[-1]][0])
        if not (own and layout.name in (_OUTPUTS, _HEARTBEAT)) and (layout.number, sender) not in self._useful:
            return
        number = np.array(rows, dtype=np.float64)  # travels with the rows where instances part them
        payloads = [arrivals[i][0].payload for i in rows]
        for instance, table in tables_by_instance(layout, payloads, number):
            name = self._names.get((layout.number, sender, instance), layout.name)
            places = table.t.astype(np.intp)
            received = np.array([arrivals[i][1] for i in places])
            table = replace(table, name=name, t=received - self._origin)
            channels = self._channels(table, own=own)
            if channels:
                stamps = self._stamps.of(table, sender, received)
                names = tuple(channels)
                for k, i in enumerate(places):
                    values = tuple(float(each[k]) for each in channels.values())
                    stamp, at = float(stamps[k]), float(received[k])
                    if not np.isnan(values).all() and not math.isinf(stamp):
                        yield int(i), Sample("mavlink", layout.name, stamp, at, names, values)

    def _channels(self, table: Table, *, own: bool) -> dict[str, Array]:
        wanted = self.quantities.of(table.name)
        sources: list[Source] = []
        if own and message_of(table.name) == _OUTPUTS:
            source = command_source(table.name, table.t, pulses_of(table), self._outputs)
            return {} if source is None else dict(source.channels)
        for pressure in pressures_of([table], self._parameters) if own and "depth" in wanted else ():
            if pressure.depth is not None:
                sources.append(Source(table.name, "depth", table.t, {"z": pressure.depth}))
        if own and message_of(table.name) == _HEARTBEAT:
            return heartbeat_channels(table)
        if self._aiding is not None:
            sources += sources_of_messages(table, self._aiding, measured=not own)
        return {
            name: values
            for source in sources
            if source.quantity in wanted and not source.refused
            for name, values in source.channels.items()
        }

    def _watch(self, layout: MessageLayout, frame: Frame) -> None:
        """Decide anew at once where the filter's own status changes: what aids it may be lost."""
        flags = float(layout.rows([frame.payload])["flags"][0])
        self.hurry = self.hurry or self._flags not in (None, flags)
        self._flags = flags

    def _in_body(self, sample: Sample) -> Sample:
        place = None
        if sample.topic == DVL and any(self._parameters.get(name) for name in _PLACE):
            place = tuple(self._parameters.get(name, 0.0) for name in _PLACE)
        return self._velocity.of(sample, place)  # type: ignore[arg-type]

    def decide(self, now: float, parameters: Mapping[str, float], *, settled: bool) -> None:
        """Look at the last seconds and decide what is used for what.

        Args:
            now: time [s].
            parameters: of the autopilot, as far as they are known.
            settled: whether no more of them are to be expected.
        """
        pieces: list[tuple[Sender, str, Table]] = []
        keys: list[tuple[int, Sender, str]] = []
        since = self._since(now)
        for (number, sender), rows in list(self._history.items()):
            while rows and rows[0][0] < (since if sender == self.autopilot.sender else now - _HISTORY):
                rows.popleft()
            if not rows:
                del self._history[number, sender]
                continue
            t = np.array([received for received, _ in rows]) - self._origin
            for instance, table in tables_by_instance(self._layouts[number], [payload for _, payload in rows], t):
                pieces.append((sender, instance, table))
                keys.append((number, sender, instance))
        if not self.decided:
            self._settle_clocks(pieces)
        tables, senders = named_tables(pieces)
        undecided = not self.decided
        self._names = dict(zip(keys, tables, strict=True))
        self._parameters = dict(parameters)
        whole = Tables("MAVLink", tables, self._parameters)
        self.autopilot = self._autopilot(tables, senders)
        known = [each for each in mavlink_sources(whole, senders, self.autopilot) if each.quantity != "commands"]
        self.quantities.decide(known)
        self._useful = {key[:2] for key, name in self._names.items() if self.quantities.of(name)}
        self._aiding = aiding_of_messages(whole, senders, self.autopilot)
        self._outputs = self._thruster_outputs() if settled else ThrusterOutputs({})
        for (number, sender, _), name in self._names.items():
            if sender == self.autopilot.sender and self._layouts[number].name == _HEARTBEAT:
                self._modes = modes_text(heartbeat_modes(tables[name]))
                received, payload = self._history[number, sender][-1]
                self._beat = (Frame(number, sender, payload, 2), received) if undecided else None
        self.decided, self.hurry = True, False

    def _since(self, now: float) -> float:
        """Return from when on [s] the autopilot's messages count.

        A link that is silent, or has just held up a minute of them, tells nothing of what is sent: what was heard
        before goes on to count, unless another autopilot speaks.
        """
        if math.isinf(self._heard) or ANOTHER in self.autopilot.others.values():
            return now - _HISTORY
        if now - self._heard > _PAUSE:
            return self._heard - _HISTORY
        return (self._before if now - self._again < _PAUSE else now) - _HISTORY

    def _settle_clocks(self, pieces: Sequence[tuple[Sender, str, Table]]) -> None:
        """Follow the clocks through what came before the first decision, in its order."""
        ends = [float(t) for _, _, table in pieces for t in (table.t[0], table.t[-1])]
        for start in np.arange(min(ends, default=0.0), max(ends, default=0.0), _STEP):
            for sender, _, table in pieces:
                first, last = np.searchsorted(table.t, (start, start + _STEP)).tolist()
                if last > first:
                    part = table.rows(first, last)
                    self._stamps.of(part, sender, part.t + self._origin)

    def _autopilot(self, tables: Mapping[str, Table], senders: Mapping[str, Sender]) -> Autopilot:
        """Return the autopilot: the one that was followed while it is heard, however busy another one is."""
        found = autopilot_of(tables, senders)
        if self.autopilot.sender is None or found.others.get(self.autopilot.sender) != ANOTHER:
            return found
        rivals = {sender: what for sender, what in found.others.items() if what == ANOTHER}
        rivals = rivals | {found.sender: ANOTHER} if found.sender is not None else rivals
        del rivals[self.autopilot.sender]
        kept = autopilot_of({name: table for name, table in tables.items() if senders[name] not in rivals}, senders)
        return replace(kept, others={**kept.others, **rivals})

    def _thruster_outputs(self) -> ThrusterOutputs:
        """Return the outputs by the autopilot's parameters, else the first ones, as many as the vehicle has."""
        found = thruster_outputs(self._parameters, {})
        if found.outputs:
            return found
        which = "output 1 is" if self._thrusters == 1 else f"outputs 1 to {self._thrusters} are"
        note = f"no SERVOn_FUNCTION among the parameters: {which} taken for the thrusters in order, none mirrored"
        return ThrusterOutputs({n: n for n in range(1, self._thrusters + 1)}, note=note)

    def rates(self, now: float) -> dict[str, float]:
        """Return how often each message came lately [Hz]; those of others by message and sender."""
        found = {}
        window = min(_RATE_WINDOW, max(now - self._origin, 0.1))
        for (number, sender), rows in self._history.items():
            recent = sum(received > now - window for received, _ in rows)
            name = self._layouts[number].name
            if sender != self.autopilot.sender:
                name += f"@{sender}"
            if recent > 1:
                found[name] = recent / window
        return found

    def said(self) -> list[str]:
        """Return what is decided, in lines for a person."""
        if not self.decided:
            return []
        others = ", ".join(f"{what} ({sender})" for sender, what in sorted(self.autopilot.others.items()))
        who = "hears no autopilot" if self.autopilot.sender is None else f"hears autopilot {self.autopilot.sender}"
        found = [who + (f" and {others}" if others else ""), *self.quantities.said()]
        numbers = [str(thruster) for thruster in self._outputs.outputs]
        if numbers and self._outputs.note:
            found.append(self._outputs.note)
        if numbers and len(numbers) != self._thrusters:
            found.append(f"the autopilot drives {len(numbers)} thrusters, the vehicle has {self._thrusters}")
        return found
