"""Jobs on the processes of this machine, one thread each; one that dies takes nothing along.

Its job is tried once more, alone, and then its death is the answer.

A thread watches each process. While a job is tried again no other is performed, so that what died for want of memory
has all of it, and nobody else can be to blame for what happens.
"""

from __future__ import annotations

import contextlib
import os
import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from towtank.campaigns.engines.child import Answer, Child

__all__ = ["Local", "perform_all"]


@dataclass(frozen=True)
class Local:
    """The processes of this machine; by default as many as it has cores.

    Attributes:
        workers: processes.
    """

    workers: int

    @classmethod
    def usual(cls) -> Local:
        """Return as many as this process has cores."""
        return cls(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)

    def over(self, work: Callable[..., Any], jobs: Iterable[tuple[Any, ...]]) -> Iterator[Answer]:
        """Yield what comes of each job, in the order in which they are done."""
        return perform_all(work, jobs, self.workers)


def perform_all(work: Callable[..., Any], jobs: Iterable[tuple[Any, ...]], workers: int) -> Iterator[Answer]:
    """Yield the answer of every job as it comes, `number` counting the jobs from 0.

    Ending the iteration ends the processes.

    Args:
        work: a function that another process can import; jobs: its arguments. workers: processes.

    Raises:
        RuntimeError: no process can be started.
    """
    waiting, answers, gate = _Jobs(jobs), queue.Queue[Answer | BaseException | None](), _Gate()
    children = [Child(work) for _ in range(workers)]
    threads = [threading.Thread(target=_watch, args=(each, waiting, answers, gate), daemon=True) for each in children]
    for thread in threads:
        thread.start()
    try:
        running = len(threads)
        while running:
            answer = answers.get()
            if answer is None:
                running -= 1
            elif isinstance(answer, BaseException):
                raise answer
            else:
                yield answer
    finally:
        waiting.stop()
        for child in children:
            with contextlib.suppress(OSError):
                child.end()


class _Jobs:
    """Jobs with their numbers, handed out one by one to several threads."""

    def __init__(self, jobs: Iterable[tuple[Any, ...]]) -> None:
        self._jobs, self._lock, self._stopped = enumerate(jobs), threading.Lock(), False

    def next(self) -> tuple[int, tuple[Any, ...]] | None:
        with self._lock:
            return None if self._stopped else next(self._jobs, None)

    @property
    def stopped(self) -> bool:
        return self._stopped

    def stop(self) -> None:
        self._stopped = True


class _Gate:
    """Many pass together, or one alone; who wants to be alone lets no further one begin."""

    def __init__(self) -> None:
        self._changed, self._inside, self._alone = threading.Condition(), 0, 0
        self._one = threading.Lock()

    @contextlib.contextmanager
    def together(self) -> Iterator[None]:
        with self._changed:
            self._changed.wait_for(lambda: not self._alone)
            self._inside += 1
        try:
            yield
        finally:
            with self._changed:
                self._inside -= 1
                self._changed.notify_all()

    @contextlib.contextmanager
    def alone(self) -> Iterator[None]:
        with self._changed:
            self._alone += 1
        try:
            with self._one:
                with self._changed:
                    self._changed.wait_for(lambda: not self._inside)
                yield
        finally:
            with self._changed:
                self._alone -= 1
                self._changed.notify_all()


def _watch(child: Child, jobs: _Jobs, answers: queue.Queue[Answer | BaseException | None], gate: _Gate) -> None:
    """Perform jobs until there are none; the last word is None, or what keeps the process from starting."""
    try:
        while (given := jobs.next()) is not None:
            with gate.together():
                answer = child.answer(*given)
            if answer.died is not None and not jobs.stopped:
                with gate.alone():
                    answer = child.answer(*given)
            answers.put(answer)
        answers.put(None)
    except BaseException as error:
        answers.put(error)
