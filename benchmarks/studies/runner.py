"""Runs trials on the processes of campaigns, with a line of progress, and writes what came of a study as JSON."""

from __future__ import annotations

import argparse
import json
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from experiments import experiment
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from trial import Outcome, Trial, perform

from towtank.campaigns.engines.local import perform_all
from towtank.outputs import write_text

__all__ = ["arguments", "over", "plain", "run", "write_json"]

T = TypeVar("T")


def arguments(description: str, runs: int, argv: Sequence[str] | None = None) -> argparse.Namespace:
    """Read the options that all studies share: runs, seed, only, method, workers, output."""
    parser = argparse.ArgumentParser(
        description=description.strip(), formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=runs, help=f"seeded runs (default {runs})")
    parser.add_argument("--seed", type=int, default=1, help="of the first run; the others count up (default 1)")
    parser.add_argument("--only", help="part of the names of the experiments, or patterns, separated by commas")
    parser.add_argument("--method", default="joint", help="of the estimator (default joint)")
    parser.add_argument("--workers", type=int, default=min(2, os.cpu_count() or 1), help="processes (default 2)")
    parser.add_argument("--output", type=Path, help="JSON file to write")
    options = parser.parse_args(argv)
    if options.runs < 1 or options.seed < 0 or options.workers < 1:
        parser.error("--runs and --workers: expected 1 or more; --seed: expected 0 or more")
    return options


def run(title: str, trials: Sequence[Trial], workers: int) -> list[Outcome]:
    """Perform the trials and return their outcomes in the same order."""

    def died(trial: Trial, how: str) -> Outcome:
        t = np.array(() if trial.mode == "stream" else trial.times)
        nothing = np.full((len(t), len(experiment(trial.experiment).free)), np.nan)
        return Outcome(trial, t, nothing, nothing, np.full(len(t), np.nan), f"its process ended twice: {how}", 0.0)

    tasks = [(trial,) for trial in trials]
    return over(title, perform, tasks, workers, failed=lambda each: each.failure is not None, died=died)


def over(
    title: str,
    work: Callable[..., T],
    tasks: Sequence[tuple[Any, ...]],
    workers: int,
    *,
    failed: Callable[[T], bool] | None = None,
    died: Callable[..., T] | None = None,
) -> list[T]:
    """Return what `work` makes of the arguments of each task, in the same order, with a line of progress.

    Args:
        failed: whether a result counts as failed. died: makes a result, of the arguments of a task and how its process
            ended; without it, a task that ends its process twice ends everything.
    """
    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn(),
        TextColumn("{task.fields[failed]}"),
    )  # fmt: skip
    found: dict[int, T] = {}
    failures = 0
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(title, total=len(tasks), failed="")

        def done(i: int, outcome: T) -> None:
            nonlocal failures
            found[i] = outcome
            failures += failed is not None and failed(outcome)
            progress.update(task, advance=1, failed=f"{failures} failed" if failures else "")

        if workers == 1:
            for i, arguments_ in enumerate(tasks):
                done(i, work(*arguments_))
        else:
            _in_processes(work, tasks, workers, done, died)
    return [found[i] for i in range(len(tasks))]


def _in_processes(
    work: Callable[..., T],
    tasks: Sequence[tuple[Any, ...]],
    workers: int,
    done: Callable[[int, T], None],
    died: Callable[..., T] | None,
) -> None:
    for answer in perform_all(work, tasks, workers):
        if answer.error is not None:
            raise answer.error
        if answer.died is None:
            done(answer.number, answer.value)
        elif died is None:
            raise RuntimeError(f"the process of task {answer.number} ended twice: {answer.died}")
        else:
            done(answer.number, died(*tasks[answer.number], answer.died))


def write_json(path: Path | None, document: dict[str, Any]) -> None:
    """Write the document of a study, if a path was asked for."""
    if path is not None:
        write_text(path, json.dumps(plain(document), indent=1, allow_nan=False) + "\n")


def plain(value: Any) -> Any:
    """Return the value as JSON has it: arrays as lists, numbers to six digits, what is not finite as null."""
    if isinstance(value, dict):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value
