"""What all benchmarks share: fair timing of competitors side by side, figures to meet, and the report."""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version

from rich.console import Console
from rich.table import Table

__all__ = ["Figure", "interleaved", "report"]


@dataclass(frozen=True)
class Figure:
    """One measured number and what it must hold.

    Args:
        name: permanent identifier, never reused for something else.
        value: what was measured, in `unit`.
        limit: the figure to meet; None where the number is only for comparison.
        at_least: whether `value` must not be below `limit` (else not above it).
        note: what it was compared with.
    """

    name: str
    value: float
    unit: str
    limit: float | None = None
    at_least: bool = False
    note: str = ""

    @property
    def met(self) -> bool:
        if self.limit is None:
            return True
        return self.value >= self.limit if self.at_least else self.value <= self.limit


def interleaved(tasks: Mapping[str, Callable[[], object]], repeats: int = 9) -> dict[str, float]:
    """Median seconds of each task; the tasks take turns, so that a slow spell of the machine hits all alike."""
    seconds: dict[str, list[float]] = {name: [] for name in tasks}
    for task in tasks.values():
        task()  # compile and warm up
    for _ in range(repeats):
        for name, task in tasks.items():
            start = time.perf_counter()
            task()
            seconds[name].append(time.perf_counter() - start)
    return {name: statistics.median(times) for name, times in seconds.items()}


def _number(x: float) -> str:
    return f"{x:.4g}" if abs(x) < 1e6 else f"{x:,.0f}"


def report(title: str, run: Callable[[], Sequence[Figure]], argv: Sequence[str] | None = None) -> int:
    """Measure, print a table (or, with --json, one JSON document), and return 0 if every figure is met, else 1."""
    parser = argparse.ArgumentParser(description=title)
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of the table")
    as_json = parser.parse_args(argv).json
    figures = run()
    met = all(figure.met for figure in figures)
    machine = {
        "processor": platform.machine(),
        "cores": os.cpu_count() or 1,
        "python": platform.python_version(),
    }
    versions = {name: version(name) for name in ("numpy", "numba", "padasip")}
    if as_json:
        rows = [{**asdict(figure), "met": figure.met} for figure in figures]
        document = {"benchmark": title, "met": met, "machine": machine, "versions": versions, "figures": rows}
        print(json.dumps(document, indent=2))
        return 0 if met else 1
    console = Console()
    console.width = max(console.width, 120)
    table = Table(title=title, caption="  ".join(f"{k} {v}" for k, v in {**machine, **versions}.items()))
    table.add_column("figure", no_wrap=True)
    table.add_column("measured", justify="right", no_wrap=True)
    table.add_column("must hold", justify="right", no_wrap=True)
    table.add_column("")
    table.add_column("compared with")
    for f in figures:
        bound = "" if f.limit is None else f"{'>=' if f.at_least else '<='} {_number(f.limit)} {f.unit}"
        verdict = "" if f.limit is None else ("[green]pass[/]" if f.met else "[bold red]FAIL[/]")
        table.add_row(f.name, f"{_number(f.value)} {f.unit}", bound, verdict, f.note)
    console.print(table)
    return 0 if met else 1
