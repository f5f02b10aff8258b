"""From messages of ROS 2 as they come to samples in standard channels, by what they mean in bags or by a mapping."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.live.links.ros2.transports import Message
from towtank.live.links.source import Sample
from towtank.live.pipeline.clock import SourceClock
from towtank.live.pipeline.frames import BodyVelocity, MarkerArm, to_ned_frd
from towtank.live.pipeline.quantities import Quantities
from towtank.readers.ardupilot.states import mavros_channels, mavros_modes, modes_text
from towtank.readers.common.raw_messages import RawMessages, Topic
from towtank.readers.common.tables import Table
from towtank.readers.ros.doubts import judged
from towtank.readers.ros.meaning import meaning_of, thruster_order, thruster_sources
from towtank.readers.ros.tables import STATE, table_of
from towtank.recording.mapping import ColumnMapping
from towtank.recording.standard import COMMAND_PREFIX

__all__ = ["Ros2Samples"]

_HISTORY = 6.0  # s
_MOST_ROWS, _MOST_TOPICS = 1500, 200
_SAME = 0.05  # s within which two topics' clocks are one


class Ros2Samples:
    """Keeps the last seconds of messages, decides what they are used for, and turns new ones into samples."""

    def __init__(self, mapping: ColumnMapping | None) -> None:
        self._mapping = mapping
        self._columns = {} if mapping is None else mapping.channels()
        self._arm = None if mapping is None or mapping.marker is None else MarkerArm(mapping.marker)
        self._history: dict[tuple[str, str], deque[Message]] = {}
        self._clocks: dict[str, SourceClock] = {}
        self._velocity = BodyVelocity()
        self._origin = 0
        self._thrusters: dict[str, int] = {}  # topic -> number of its thruster, where each has its own
        self._modes: dict[str, int] = {}
        self.quantities = Quantities()
        self.notes: tuple[str, ...] = ()
        self.decided = mapping is not None
        self.bad = self.strange = 0

    @property
    def attributes(self) -> dict[str, str]:
        """What the samples are, as of a recording: names of the autopilot's modes, where MAVROS tells them."""
        return {"modes": modes_text(mavros_modes(self._modes))} if self._modes else {}

    def take(self, messages: Sequence[Message]) -> list[Sample]:
        """Return the samples in some messages, once it has been decided what is used."""
        groups: dict[tuple[str, str], list[int]] = {}
        for i, message in enumerate(messages):
            key = message.topic, message.kind
            if key not in self._history:
                if len(self._history) >= _MOST_TOPICS:
                    continue
                self._history[key] = deque(maxlen=_MOST_ROWS)
                self._origin = self._origin or int(message.received) * 10**9
            if self._mapping is None:
                self._history[key].append(message)
            groups.setdefault(key, []).append(i)
        found: list[tuple[int, Sample]] = []
        for rows in groups.values():
            found += self._samples(messages, rows)
        found.sort(key=lambda each: each[0])
        return [self._velocity.of(sample) for _, sample in found]

    def _samples(self, messages: Sequence[Message], rows: list[int]) -> Iterator[tuple[int, Sample]]:
        """Yield each row's sample; all rows are of one topic."""
        topic, kind = messages[rows[0]].topic, messages[rows[0]].kind
        wanted = self.quantities.of(topic) or topic in self._thrusters or kind == STATE
        if self.decided and self._mapping is None and not wanted:
            return
        table, damaged = self._table([messages[i] for i in rows])
        self.bad += damaged
        if damaged:  # which row is which is told by the messages one by one
            good = [i for i in rows if not self._table([messages[i]])[1]]
            rows = good if len(good) == len(table) else []
        if not rows:
            return
        received = [messages[i].received for i in rows]
        stamps = self._stamps(table, received)
        if not self.decided:
            return
        channels = self._channels(table)
        names = tuple(channels)
        for k, i in enumerate(rows):
            values = tuple(float(each[k]) for each in channels.values())
            if names and not all(map(math.isnan, values)) and not math.isinf(stamps[k]):
                yield i, self._standard(Sample("ros2", topic, stamps[k], received[k], names, values))

    def _table(self, messages: Sequence[Message]) -> tuple[Table, int]:
        """Return messages of one topic as a table, and how many could not be decoded."""
        times = np.array([round(1e9 * message.received) for message in messages], dtype=np.int64)
        raw = RawMessages.of([message.data for message in messages])
        first = messages[0]
        table, _, damaged = table_of(Topic(first.topic, first.kind, "cdr", times, raw), self._origin)
        return table, damaged

    def _channels(self, table: Table) -> dict[str, Array]:
        if table.kind == STATE:
            return mavros_channels(table, self._modes)
        if self._mapping is None:
            if table.name in self._thrusters:
                return {f"{COMMAND_PREFIX}{self._thrusters[table.name]}": table["data"]}
            wanted = self.quantities.of(table.name)
            return {
                name: values
                for source in meaning_of(table)
                if source.quantity in wanted and not source.refused
                for name, values in source.channels.items()
            }
        found = {}
        for name, column in self._columns.items():
            path = column.source.removeprefix(f"{table.name}.")
            if path != column.source and path in table:
                found[name] = column.apply(table[path])
        return found

    def _standard(self, sample: Sample) -> Sample:
        """Return a mapped sample in NED and FRD, at the body origin."""
        if self._mapping is None:
            return sample
        known = to_ned_frd(dict(zip(sample.names, sample.values, strict=True)), self._mapping.body, self._mapping.world)
        if self._arm is not None:
            known = self._arm.to_origin(known)
        return Sample(sample.source, sample.topic, sample.t, sample.received, tuple(known), tuple(known.values()))

    def _stamps(self, table: Table, received: Sequence[float]) -> list[float]:
        """Return the messages' own stamps [s] on our clock, NaN where there is none, infinity where one cannot be.

        Topics stamped by one computer get one offset, so that what separates them in time is kept.
        """
        if table.stamp is None:
            return [math.nan] * len(received)
        clock = self._clocks.setdefault(table.name, SourceClock())
        base = self._origin * 1e-9
        stamps = [base + each for each in table.stamp.tolist()]
        known = [clock.believes(t, at) for t, at in zip(stamps, received, strict=True)]
        self.strange += len(known) - sum(known)
        near = [each.offset for each in self._clocks.values() if abs(each.offset - clock.offset) < _SAME]
        offset = min(near, default=clock.offset)
        return [t + offset if good else math.inf for t, good in zip(stamps, known, strict=True)]

    @property
    def restarts(self) -> int:
        """How often a topic's clock has started anew."""
        return max((each.restarts for each in self._clocks.values()), default=0)

    def decide(self, now: float) -> None:
        """Look at the last seconds and decide what is used for what; a mapping has decided before."""
        if self._mapping is not None:
            return
        tables: dict[str, Table] = {}
        for key, messages in list(self._history.items()):
            while messages and messages[0].received < now - _HISTORY:
                messages.popleft()
            if not messages:
                del self._history[key]
                continue
            table, _ = self._table(list(messages))
            if len(table):
                tables[table.name] = table
        sources = [source for table in tables.values() for source in meaning_of(table)]
        single = thruster_sources(tables)
        self.quantities.decide(judged([*sources, *single], tables))
        sources += single
        alone = bool(single) and self.quantities.used.get("commands") == single[0].table
        self._thrusters = thruster_order((name, table.kind) for name, table in tables.items()) if alone else {}
        used = {(quantity, table) for quantity, table in self.quantities.used.items()}
        self.notes = tuple(
            dict.fromkeys(each.note for each in sources if (each.quantity, each.table) in used and each.note)
        )
        self.decided = True
