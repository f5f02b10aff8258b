"""What other threads ask of the one that owns the learner, done between two samples."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

__all__ = ["Errands"]

_T = TypeVar("_T")


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
