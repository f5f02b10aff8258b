"""Work that other processes import, and campaigns that cost next to nothing."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from towtank.campaigns import Failure, Outcome, Result, Store, Task
from towtank.campaigns.tasks import Options

__all__ = ["abrupt", "campaign", "log", "quick", "tasks"]

STUDY = """kind = "simulate-learn"
vehicle = "vlbv300"
method = "paper"
free = ["X_udot", "X_uu"]
delay = 0.0
[study]
manoeuvre = "surge-square"
duration = 6.0
rate = 20.0
sensors = "ins"
runs = {runs}
seed = {seed}
[study.within]
"X_*" = 0.05
"""
LEARN = """kind = "learn"
logs = ["archive/*/*.csv"]
vehicle = "vlbv300"
method = "{method}"
"""
POISON, WRONG = 3, 4  # tasks that kill their process, or hold wrong input


def campaign(folder: Path, text: str) -> Path:
    """Write the file of a campaign."""
    path = folder / "campaign.toml"
    path.write_text(text)
    return path


def log(folder: Path, name: str, content: str = "t,u\n0,1\n") -> Path:
    """Write something that stands for a log."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    return path


def tasks(count: int) -> list[Task]:
    """Return so many tasks of nothing."""
    first = Task("", "learn", "", "one", "none", "", Options())
    return [replace(first, id=f"{k:032x}", label=f"run-{k:03d}", number=(0, k)) for k in range(count)]


def quick(task: Task, uri: str) -> Outcome:
    """Write a row, and a line in a file that counts how often a task is done."""
    store = Store.at(uri)
    with Path(store.place.root, "begun").open("a") as stream:
        stream.write(f"{task.number[1]}\n")
    row = {"coefficient": "X_u", "unit": "kg/s", "value": -float(task.number[1]), "std": 1.0, "identified": True}
    store.put(task, Result([row], {"delay": 0.0}), 0.0)
    return Outcome(task.id, 0.0)


def abrupt(task: Task, uri: str) -> Outcome:
    """Do as `quick`, but for one task that kills its process and one of wrong input."""
    if task.number[1] == POISON:
        os.abort()
    if task.number[1] == WRONG:
        failure = Failure(task.id, task.label, f"towtank: {task.label}: empty", 2)
        Store.at(uri).fail(failure)
        return Outcome(task.id, 0.0, failure)
    return quick(task, uri)
