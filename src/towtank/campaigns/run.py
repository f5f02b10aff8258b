"""A campaign's run: list what is done, do the rest, and say how it goes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from towtank.campaigns.engines.child import Answer
from towtank.campaigns.store import Failure, Store
from towtank.campaigns.tasks import Task

__all__ = ["Engine", "Outcome", "Pace", "Perform", "Summary", "run_campaign"]

_FAULT = 1  # exit code of what is nobody's input


@dataclass(frozen=True)
class Outcome:
    """What a worker says of a task: its name, seconds taken, and the failure, None where there is none."""

    id: str
    seconds: float
    failure: Failure | None = None


Perform = Callable[[Task, str], Outcome]  # a task, and the URI of the store that takes its result


class Engine(Protocol):
    """Who performs tasks."""

    def over(self, work: Callable[..., Any], jobs: Sequence[tuple[Any, ...]]) -> Iterator[Answer]:
        """Yield what comes of each job, in the order in which they are done, `number` counting from 0."""


@dataclass(frozen=True)
class Pace:
    """How far a run is.

    Attributes:
        done, failed: tasks of this run so far. total: that it has to do. seconds: since it began.
    """

    done: int
    failed: int
    total: int
    seconds: float

    @property
    def rate(self) -> float:
        """Tasks in a second."""
        return self.done / self.seconds if self.seconds > 0.0 else 0.0

    @property
    def left(self) -> float:
        """Seconds that the rest takes at this rate, infinite as long as nothing is done."""
        return (self.total - self.done) / self.rate if self.rate > 0.0 else float("inf")


@dataclass(frozen=True)
class Summary:
    """What a run did.

    Attributes:
        total: tasks of the campaign. before: done before. performed: done now, those that failed among them.
        left: not tried yet. failures: all that came to nothing, of earlier runs too. seconds: taken.
    """

    total: int
    before: int
    performed: int
    left: int
    failures: tuple[Failure, ...]
    seconds: float


def run_campaign(
    tasks: Sequence[Task],
    store: Store,
    engine: Engine,
    perform: Perform,
    *,
    limit: int | None = None,
    again: bool = False,
    progress: Callable[[Pace], None] | None = None,
) -> Summary:
    """Do what is not done.

    Args:
        store: begun for these tasks. perform: what a task does; another process must be able to import it.
        limit: most tasks to do now. again: try once more what failed before.
        progress: called after each task.

    Raises:
        OSError: the store takes nothing more. What else workers cannot help is raised as it is.
    """
    began = time.monotonic()
    done = store.done()
    failed = {each.id: each for each in store.failures(done)}
    if again:
        store.forget(failed.values())
        failed = {}
    known = {task.id for task in tasks}
    rest = [task for task in tasks if task.id not in done and task.id not in failed]
    before, chosen = len(known & done), rest if limit is None else rest[:limit]
    count = bad = 0
    for answer in _answers(engine, perform, chosen, store):
        count += 1
        task = chosen[answer.number]
        failure = _failure(answer, task, store)
        if failure is not None:
            failed[task.id] = failure
            bad += 1
        if progress is not None:
            progress(Pace(count, bad, len(chosen), time.monotonic() - began))
    every = sorted((each for each in failed.values() if each.id in known), key=lambda each: each.label)
    return Summary(len(tasks), before, count, len(rest) - count, tuple(every), time.monotonic() - began)


def _answers(engine: Engine, perform: Perform, tasks: Sequence[Task], store: Store) -> Iterable[Answer]:
    return engine.over(perform, [(task, store.place.uri) for task in tasks]) if tasks else ()


def _failure(answer: Answer, task: Task, store: Store) -> Failure | None:
    """Return the failure of a task, None where it succeeded; raise what is not the task's own fault."""
    if answer.error is not None:
        raise answer.error
    if answer.died is None:
        outcome: Outcome = answer.value
        return outcome.failure
    line = (
        f"towtank: {task.label}: the process that worked on it ended twice ({answer.died}); look at this log alone "
        "with towtank inspect"
    )
    failure = Failure(task.id, task.label, line, _FAULT)
    store.fail(failure)
    return failure
