"""A ROS 2 system: its topics are listened to, by their types or by a mapping; nothing is published."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from towtank.live.links.ros2.samples import Ros2Samples
from towtank.live.links.ros2.transports import link_of
from towtank.live.links.source import Rates, Raw, Sample, SourceState
from towtank.live.pipeline.clock import steady_time
from towtank.readers.ros.tables import is_wanted
from towtank.recording.mapping import ColumnMapping

__all__ = ["Ros2Source"]

_FIRST, _EVERY = 1.5, 2.5  # s until the first decision, and between decisions
_LOOK = 1.0  # s between two looks at the topics that there are
_STATE = 0.5


class Ros2Source:
    """Topics of ROS 2.

    Args:
        text: ros2:[DOMAIN], ros2:[DOMAIN]@ENDPOINT for zenoh, or dds:[DOMAIN].
        mapping: names topics and fields, as "/dvl.velocity.x"; without it topics are known by their types.
    """

    name = "ros2"
    keeps_time, patient = True, False

    def __init__(self, text: str, mapping: ColumnMapping | None = None) -> None:
        self._text, self._mapping = text, mapping
        self._link = link_of(text)
        self._samples = Ros2Samples(mapping)
        self._rates = Rates()
        self._known: dict[str, str] = {}  # topic -> why it is not listened to, "" where it is
        self._first = math.nan
        self._looked = self._renewed = self._decided = -math.inf
        self._opened = False
        self._state = SourceState()

    def open(self) -> None:
        """Join the system. Raises InputError where that cannot be."""
        self._link.open()
        self._opened = True
        self._tell(steady_time())

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        """Return what has come, as bytes and as samples, their stamps on our clock."""
        now = steady_time()
        if now - self._looked >= _LOOK:
            self._looked = now
            self._look()
        messages = self._link.receive(timeout)
        found: list[Sample | Raw] = []
        for message in messages:
            self._rates.add(message.topic)
            found.append(Raw(self.name, f"{message.topic} {message.kind}", message.received, message.data))
        with np.errstate(all="ignore"):  # fields may hold anything
            if messages:
                self._first = messages[0].received if math.isnan(self._first) else self._first
                found += self._samples.take(messages)
            now = steady_time()
            if now - self._first >= _FIRST and now - self._decided >= _EVERY:
                self._decided = now
                self._samples.decide(now)
        if now - self._renewed >= _STATE:
            self._tell(now)
        return found

    def _look(self) -> None:
        """Listen to topics that are new."""
        for topic, kind in self._link.topics().items():
            if topic not in self._known and is_wanted(topic, kind, self._mapping) and len(self._known) < 200:
                self._known[topic] = self._link.subscribe(topic, kind)

    def _tell(self, now: float) -> None:
        """Write down how things stand, for whoever asks."""
        self._renewed = now
        said = [self._link.name]
        heard = [topic for topic, why in self._known.items() if not why]
        said.append(f"listens to {', '.join(heard)}" if heard else "no topic that could be used is published")
        said += [f"{topic}: not listened to: {why}" for topic, why in self._known.items() if why]
        if self._mapping is not None:
            topics = {column.source for column in self._mapping.channels().values()}
            silent = [each for each in topics if not any(each.startswith(f"{topic}.") for topic in heard)]
            said += [f"the mapping's {each} is not published" for each in sorted(silent)]
        said += [*self._samples.quantities.said(), *self._samples.notes]
        self._state = SourceState(
            said=tuple(said),
            rates=self._rates.now(),
            bad=self._samples.bad + self._samples.strange,
            restarts=self._samples.restarts,
            senders=tuple(heard),
            attributes=self._samples.attributes,
        )

    def state(self) -> SourceState:
        """Return how it fares, as of the last half second."""
        return self._state

    def close(self) -> None:
        """Leave the system."""
        if self._opened:
            self._opened = False
            self._tell(steady_time())
            self._link.close()
