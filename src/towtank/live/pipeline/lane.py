"""The queue from the links to the learner: bounded, so that one that cannot keep up costs learning and nothing else.

What other threads ask of the one that owns the learner is done between two samples.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, TypeVar

from towtank.live.pipeline.sorter import Arrival

__all__ = ["BREAK", "GAP", "Break", "Ended", "Errands", "Gap", "Item", "Lane"]

_T = TypeVar("_T")


class Break:
    """A new stretch begins here: what was in force before is not known any more."""


class Gap(Break):
    """Samples were passed over here."""


@dataclass(frozen=True, slots=True)
class Ended:
    """A source, by its place on the command line, sends no more."""

    rank: int


BREAK, GAP = Break(), Gap()


Item = Arrival | Ended | Break


class Lane:
    """A queue of samples between threads.

    When it is full, what comes is dropped and counted until half of it has been learned from, so that the learner sees
    a few long gaps rather than a stream full of holes. A `patient` sender waits instead.

    Attributes:
        dropped: samples passed over.
        gaps: how often that began.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity, self.dropped, self.gaps = capacity, 0, 0
        self._items: deque[Item] = deque()
        self._changed = threading.Condition()
        self._full = self._closed = False

    def __len__(self) -> int:
        return len(self._items)

    def put(self, arrivals: Sequence[Arrival], *, patient: bool = False) -> None:
        """Hand samples over."""
        if not arrivals:
            return
        with self._changed:
            while patient and len(self._items) >= self.capacity and not self._closed:
                self._changed.wait(0.1)
            if self._full and len(self._items) <= self.capacity // 2:
                self._full = False
            if not patient and not self._full and len(self._items) + len(arrivals) > self.capacity:
                self._full = True
                self._items.append(GAP)
                self.gaps += 1
            if self._full:
                self.dropped += len(arrivals)
            else:
                self._items.extend(arrivals)
            self._changed.notify_all()

    def ended(self, rank: int) -> None:
        """Say that a source sends no more."""
        self._say(Ended(rank))

    def break_off(self) -> None:
        """Say that a new stretch begins."""
        self._say(BREAK)

    def _say(self, item: Item) -> None:
        with self._changed:
            self._items.append(item)
            self._changed.notify_all()

    def close(self) -> None:
        """Say that nothing follows."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def get(self, timeout: float, most: int = 256) -> tuple[list[Item], bool]:
        """Return what is there, up to `most`, waiting for it at most `timeout` [s]; and whether more may come."""
        with self._changed:
            if not self._items and not self._closed:
                self._changed.wait(timeout)
            found = [self._items.popleft() for _ in range(min(most, len(self._items)))]
            if found:
                self._changed.notify_all()
            return found, bool(self._items) or not self._closed


class Errands:
    """A short queue of functions; the owner calls `run` as often as it can, and `close` when it ends."""

    def __init__(self) -> None:
        self._asked: deque[tuple[Callable[[], Any], Future[Any]]] = deque()
        self._lock = threading.Lock()
        self._closed = False

    def ask(self, errand: Callable[[], _T], timeout: float = 5.0) -> _T:
        """Have `errand` done by the owner's thread, here where that has ended; return its result.

        Raises:
            TimeoutError: the owner was too busy for `timeout` [s].
        """
        answer: Future[_T] = Future()
        with self._lock:
            gone = self._closed
            if not gone:
                self._asked.append((errand, answer))
        if gone:
            return errand()
        try:
            return answer.result(timeout)
        except TimeoutError:
            answer.cancel()
            raise

    def run(self) -> None:
        """Do what was asked for; by the owner."""
        while self._asked:
            with self._lock:
                if not self._asked:
                    return
                errand, answer = self._asked.popleft()
            if not answer.set_running_or_notify_cancel():
                continue
            try:
                answer.set_result(errand())
            except Exception as error:
                answer.set_exception(error)

    def close(self) -> None:
        """Do what is left; from now on whoever asks does it."""
        self.run()
        with self._lock:
            self._closed = True
        self.run()
