"""Table I of the paper, and B (z_G - z_B), which the paper could not identify.

    python examples/paper/table1.py [--json]

Six experiments on the simulated Seamor, with continuous and with held input, for three filter constants. The learner
starts from the rigid body alone. Exit code 0: all twelve coefficients agree with the published truth to every printed
digit and to 1e-6, the righting moment to 1e-6 N m/rad, in every case; else 1.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from seamor import EXPERIMENTS, RIGHTING, TABLE_I, Inputs, Run, learn, perform, rigid_body_only, truth

from towtank import Vehicle

FILTERS = (0.1, 2.0, 10.0)  # 1/s
TOLERANCE = 1e-6
INPUTS: dict[Inputs, str] = {"smooth": "continuous sine", "held": "held sine, 100 Hz"}


@dataclass(frozen=True)
class Row:
    """One coefficient: the truth and the paper's estimate as printed, ours, how many printed digits each matches."""

    name: str
    unit: str
    truth: str
    paper: str
    paper_digits: int
    estimate: float
    error: float  # relative; absolute for the righting moment
    digits: int
    printed: int


@dataclass(frozen=True)
class Case:
    """One way of running the experiments, and what came of it."""

    inputs: Inputs
    a: float
    rows: tuple[Row, ...]
    righting: Row

    @property
    def exact(self) -> int:
        """Return how many coefficients agree to every printed digit."""
        return sum(row.digits == row.printed for row in self.rows)

    @property
    def worst(self) -> float:
        """Largest relative error of the coefficients."""
        return max(row.error for row in self.rows)

    @property
    def holds(self) -> bool:
        """Whether everything that is claimed holds."""
        return self.exact == len(TABLE_I) and self.worst <= TOLERANCE and self.righting.error <= TOLERANCE


def digits(value: float, printed: str) -> int:
    """Return how many significant digits of a printed number a value reproduces, from the left."""
    decimals = len(printed.partition(".")[2])
    found, expected = f"{value:.{decimals}f}", printed
    if len(found) != len(expected):
        return 0
    count, begun = 0, False
    for ours, theirs in zip(found, expected, strict=True):
        if ours != theirs:
            break
        begun = begun or theirs in "123456789"
        count += begun and theirs.isdigit()
    return count


def fly(vehicle: Vehicle, inputs: Inputs) -> list[Run]:
    """Return the six experiments in the paper's order."""
    return [perform(vehicle, experiment, inputs) for experiment in EXPERIMENTS]


def identify(runs: Sequence[Run], inputs: Inputs, a: float) -> Case:
    """Learn everything from the runs and set it beside Table I."""
    learner = learn(rigid_body_only(), runs, inputs=inputs, a=a, free=(*TABLE_I, "BG_z"))
    estimate = learner.estimate
    rows = []
    for name, (true, paper) in TABLE_I.items():
        found = estimate[name]
        error = abs(found.value / float(true) - 1.0)
        printed = digits(float(true), true)
        matched = digits(found.value, true), digits(float(paper), true)
        rows.append(Row(name, found.unit, true, paper, matched[1], found.value, error, matched[0], printed))
    found, text = estimate["BG_z"], f"{RIGHTING:.6f}"
    error, matched = abs(found.value - RIGHTING), (digits(found.value, text), digits(RIGHTING, text))
    righting = Row("BG_z", found.unit, text, "-", 0, found.value, error, *matched)
    return Case(inputs, a, tuple(rows), righting)


def show(case: Case, console: Console) -> None:
    """Print one case."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("coefficient")
    for heading in ("truth", "paper", "digits", "towtank", "digits", "error"):
        table.add_column(heading, justify="right")
    table.add_column("unit")
    for row in (*case.rows, case.righting):
        of = f"of {row.printed}"
        name, paper = ("B (zG - zB)", "-") if row is case.righting else (row.name, f"{row.paper_digits} {of}")
        ours = f"{row.estimate:.9f}", f"{row.digits} {of}"
        table.add_row(name, row.truth, row.paper, paper, *ours, f"{row.error:.1e}", row.unit)
    console.print(f"{INPUTS[case.inputs]}, a = {case.a:g} 1/s", style="bold")
    console.print(table)
    verdict = f"{case.exact} of {len(case.rows)} to every printed digit"
    console.print(f"{verdict}, largest relative error {case.worst:.1e}\n\n")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run every case; return 0 where all hold."""
    parser = argparse.ArgumentParser(description="Reproduce Table I of the paper.")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(arguments)
    vehicle = truth()
    cases = []
    for inputs in INPUTS:
        runs = fly(vehicle, inputs)
        cases += [identify(runs, inputs, a) for a in FILTERS]
    good = all(case.holds for case in cases)
    if options.json:
        print(json.dumps({"holds": good, "tolerance": TOLERANCE, "cases": [asdict(case) for case in cases]}, indent=2))
        return 0 if good else 1
    console = Console(width=110)
    for case in cases:
        show(case, console)
    verdict = "every case holds" if good else "NOT every case holds"
    worst = max(case.worst for case in cases), max(case.righting.error for case in cases)
    console.print(f"{verdict}: coefficients within {worst[0]:.1e}, B (zG - zB) within {worst[1]:.1e} N m/rad")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
