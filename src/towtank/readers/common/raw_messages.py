"""Messages as they stand in a file: one buffer of bytes, and where each message begins and ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["Bytes", "Collector", "Integers", "RawMessages", "Topic", "gather", "in_order"]

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class RawMessages:
    """The bytes (m,) of n messages, one behind the other, and their sizes (n,)."""

    data: Bytes
    size: Integers

    @classmethod
    def of(cls, messages: Sequence[bytes]) -> RawMessages:
        """Return messages given one by one."""
        return cls(
            np.frombuffer(b"".join(messages), dtype=np.uint8),
            np.fromiter((len(each) for each in messages), dtype=np.int64, count=len(messages)),
        )

    def __len__(self) -> int:
        return int(self.size.size)

    @property
    def start(self) -> Integers:
        """Where each message begins (n,)."""
        return np.cumsum(self.size) - self.size

    def message(self, i: int) -> bytes:
        """Return one message."""
        start = int(self.size[:i].sum())
        return self.data[start : start + int(self.size[i])].tobytes()

    def messages(self) -> list[bytes]:
        """Return all of them."""
        data, ends = self.data.tobytes(), np.cumsum(self.size).tolist()
        return [data[end - size : end] for end, size in zip(ends, self.size.tolist(), strict=True)]

    def matrix(self, rows: NDArray[np.intp]) -> Bytes:
        """Return the bytes (k, size) of some messages, all of one size."""
        return gather(self.data, self.start[rows], int(self.size[rows[0]]))

    def ordered(self, order: NDArray[np.intp]) -> RawMessages:
        """Return the messages in another order, or some of them."""
        start = self.start
        if order.size and (self.size == self.size[0]).all():
            return RawMessages(gather(self.data, start[order], int(self.size[0])).reshape(-1), self.size[order])
        pieces = [self.data[start[i] : start[i] + self.size[i]] for i in order]
        return RawMessages(np.concatenate(pieces) if pieces else self.data[:0], self.size[order])


@dataclass(frozen=True, eq=False)
class Topic:
    """What was recorded under one name.

    Attributes:
        name: of the topic.
        kind: type of its messages: "sensor_msgs/msg/Imu".
        encoding: "cdr", "ros1", "json", ...
        log_time: times (n,) of recording [ns].
        raw: the messages (n); None where they were not wanted.
        definition: text that defines the type, and its language: "ros2msg", "ros2idl", "ros1msg", "jsonschema", "".
        metadata: what the file says of the topic.
    """

    name: str
    kind: str
    encoding: str
    log_time: Integers
    raw: RawMessages | None
    definition: tuple[str, str] = ("", "")
    metadata: dict[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.log_time.size)


def in_order(topic: Topic) -> tuple[Topic, int]:
    """Return the topic in order of time, and how many messages were out of it."""
    times = topic.log_time
    late = int(np.count_nonzero(times < np.maximum.accumulate(times))) if times.size else 0
    if not late:
        return topic, 0
    order = np.argsort(times, kind="stable")
    return replace(topic, log_time=times[order], raw=None if topic.raw is None else topic.raw.ordered(order)), late


class Collector:
    """Collects the messages of one topic one by one; keeps their bytes only where they are wanted."""

    def __init__(self, topic: Topic, *, wanted: bool) -> None:
        self._topic, self._wanted = topic, wanted
        self._times: list[int] = []
        self._messages: list[bytes] = []

    def add(self, log_time: int, message: bytes) -> None:
        """Add one message, recorded at `log_time` [ns]."""
        self._times.append(min(log_time, 2**63 - 1))
        if self._wanted:
            self._messages.append(message)

    def topic(self) -> tuple[Topic, int]:
        """Return the topic in order of time, and how many messages were out of it."""
        raw = RawMessages.of(self._messages) if self._wanted else None
        return in_order(replace(self._topic, log_time=np.array(self._times, dtype=np.int64), raw=raw))


def gather(data: Bytes, start: Integers, size: int) -> Bytes:
    """Return the pieces (n, size) of `data` that begin at `start` (n,); all lie within it."""
    if not start.size or not size:
        return np.empty((start.size, size), dtype=np.uint8)
    result: Bytes = np.lib.stride_tricks.sliding_window_view(data, size)[start]
    return result
