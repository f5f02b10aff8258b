"""Tasks that cost next to nothing, that last, or that kill their process; workers import this module."""

from __future__ import annotations

import os
import time

from towtank.campaigns import Failure, Outcome, Result, Store, Task
from towtank.campaigns.tasks import Options

__all__ = ["abrupt", "counted", "quick", "tasks"]

OPTIONS = Options(method="paper")
POISON = 7  # the task that kills its process, of `abrupt`


def tasks(count: int, name: str) -> list[Task]:
    """Return so many tasks of nothing."""
    return [
        Task(f"{name}{k:028x}", "learn", f"{name}/{k:05d}", name, "none", "", OPTIONS, number=(0, k))
        for k in range(count)
    ]


def quick(task: Task, uri: str) -> Outcome:
    """Write one row."""
    store = Store.at(uri)
    row = {"coefficient": "X_u", "unit": "kg/s", "value": -float(task.number[1]), "std": 1.0, "identified": True}
    store.put(task, Result([row], {"delay": 0.0, "duration": 1.0}), 0.0)
    return Outcome(task.id, 0.0)


def counted(task: Task, uri: str) -> Outcome:
    """Last a third of a second, and leave a mark for every time that the task is done."""
    store = Store.at(uri)
    if store.has(task.id):
        return Outcome(task.id, 0.0)
    time.sleep(0.3)
    outcome = quick(task, uri)
    store.place.write(f"marks/{task.id}.{os.getpid()}.{time.time_ns()}.done", b"")
    return outcome


def abrupt(task: Task, uri: str) -> Outcome:
    """End the process as a reader of broken files may, for one task; another is wrong input."""
    if task.number[1] == POISON:
        os.abort()
    if task.number[1] == POISON + 1:
        failure = Failure(task.id, task.label, f"towtank: {task.label}: no such file", 2)
        Store.at(uri).fail(failure)
        return Outcome(task.id, 0.0, failure)
    return quick(task, uri)
