"""What each error of the real chain does to the surge coefficients, one at a time, then all of them together.

    python examples/paper/errors.py [--runs N] [--json]

The paper's two surge experiments on the vlbv300: stairs (commands 13 18 23 28 ahead, then astern, 2 s each) and square
(+-30, period 5 s). Filter constant 0.3 1/s, low-passes of 2 Hz. Where chance plays a part: mean and standard deviation
of N runs. The real chain: pose noise of 1 mm, occlusion jumps, a delay of 200 ms, a disturbance of 0.5 N.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from chain import Array, Chain
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from tank import (
    DELAY,
    PUSH,
    REAL,
    Conditions,
    TankRun,
    percent,
    run,
    tank_vehicle,
    true_values,
    without_coefficients,
)

from towtank import Vehicle, load_vehicle
from towtank.identification import PaperLearner, learn_paper
from towtank.simulation import Mocap

RUNS = 20
MANOEUVRES = ("paper-stairs", "paper-square")
FILTERS = (0.1, 0.3, 1.0, 3.0)  # 1/s

EXACT = Chain()
ONE_SIDED = Chain(lowpass=2.0)
BOTH_SIDES = Chain(lowpass=2.0, lowpass_thrust=True)
PERFECT = Conditions()

Estimator = Callable[[TankRun, Vehicle], tuple[float, float]]


def by(chain: Chain) -> Estimator:
    """Return the chain as an estimator."""
    return lambda found, vehicle: chain.learn(found.t, found.velocity(chain), found.force)


AS_IS = by(EXACT)


def by_stream(found: TankRun, vehicle: Vehicle) -> tuple[float, float]:
    """Estimate with towtank's learner in one pass, the delay known."""
    learner = PaperLearner(without_coefficients(vehicle, "surge"), free=("X_udot", "X_uu"), delay=DELAY)
    learner.run(found.recording)
    return true_values(learner.model(), "surge")


def by_log(found: TankRun, vehicle: Vehicle) -> tuple[float, float]:
    """Estimate as `towtank learn` does, the delay found from the run."""
    unknown = without_coefficients(vehicle, "surge")
    return true_values(learn_paper(unknown, [found.recording], free=("X_udot", "X_uu")).model, "surge")


@dataclass(frozen=True)
class Case:
    """One error: what the tank does, and what the estimator makes of it.

    Attributes:
        scale: the thrust as it is known over the true one.
        tilting: the thrusters are where they really are, below the centre.
    """

    name: str
    estimator: Estimator = AS_IS
    conditions: Conditions = PERFECT
    scale: float = 1.0
    tilting: bool = False


CASES = (
    Case("none: exact velocity, exact regressors"),
    Case("drag held from sample to sample (Euler)", by(replace(EXACT, held_state=True))),
    Case("commands joined by straight lines", by(replace(EXACT, joined_commands=True))),
    Case("low-pass on the velocity only", by(ONE_SIDED)),
    Case("low-pass on velocity and thrust", by(BOTH_SIDES)),
    Case("delay of 200 ms, not known", conditions=Conditions(delay=DELAY)),
    Case("delay of 200 ms, known", by(replace(EXACT, delay=DELAY)), Conditions(delay=DELAY)),
    Case("thruster lag of 100 ms, not known", conditions=Conditions(lag=0.1)),
    Case("thrust curve 5 % too strong", scale=1.05),
    Case("thrusters 8 cm below the centre", tilting=True),
    Case("pose noise 1 mm, low-pass on both", by(BOTH_SIDES), Conditions(Mocap(jump_fraction=0.0))),
    Case("pose noise 5 mm, low-pass on both", by(BOTH_SIDES), Conditions(Mocap(noise_mm=5.0, jump_fraction=0.0))),
    Case("occlusion jumps, low-pass on both", by(BOTH_SIDES), Conditions(Mocap(noise_mm=0.0))),
    Case("disturbance force 0.5 N, exact velocity", conditions=Conditions(disturbance=PUSH)),
    Case("all of the real chain, the paper's way", by(ONE_SIDED), REAL),
    Case("all, PaperLearner, delay known", by_stream, REAL),
    Case("all, towtank learn, delay found", by_log, REAL),
)


@dataclass(frozen=True)
class Bias:
    """Errors of mass and drag in percent: mean and standard deviation over the runs, per manoeuvre."""

    name: str
    mean: dict[str, tuple[float, float]]
    spread: dict[str, tuple[float, float]]
    runs: int


def examine(case: Case, runs: int = RUNS) -> Bias:
    """Return the bias of one case."""
    vehicle = load_vehicle("vlbv300") if case.tilting else tank_vehicle()
    true = true_values(vehicle, "surge")
    count = runs if case.conditions.random else 1
    mean, spread = {}, {}
    for name in MANOEUVRES:
        errors = []
        for seed in range(count):
            found = run(vehicle, "surge", name, case.conditions, seed)
            M, D = case.estimator(found, vehicle)
            errors.append(percent((case.scale * M, case.scale * D), true))
        mean[name] = _pair(np.mean(errors, axis=0))
        spread[name] = _pair(np.std(errors, axis=0))
    return Bias(case.name, mean, spread, count)


def by_filter() -> list[Bias]:
    """Return how the biases of low-pass and delay depend on the filter constant."""
    found = []
    for title, chain, conditions in (
        ("low-pass on the velocity only", ONE_SIDED, PERFECT),
        ("delay of 200 ms, not known", EXACT, Conditions(delay=DELAY)),
    ):
        for a in FILTERS:
            found.append(examine(Case(f"{title}, a = {a:g} 1/s", by(replace(chain, a=a)), conditions)))
    return found


def _pair(values: Array) -> tuple[float, float]:
    return float(values[0]), float(values[1])


def show(rows: Sequence[Bias], console: Console) -> None:
    """Print biases below each other."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("error [%]")
    for name in MANOEUVRES:
        for quantity in ("mass", "drag"):
            table.add_column(f"{name.removeprefix('paper-')} {quantity}", justify="right")
    for row in rows:
        cells = []
        for name in MANOEUVRES:
            for value, spread in zip(row.mean[name], row.spread[name], strict=True):
                cells.append(f"{value:+.1f}" + (f" ± {spread:.1f}" if row.runs > 1 else "      "))
        table.add_row(row.name, *cells)
    console.print(table)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description="Errors of the real chain, one by one.")
    parser.add_argument("--runs", type=int, default=RUNS, help=f"runs where chance plays a part (default {RUNS})")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args(arguments)
    rows, filters = [examine(case, options.runs) for case in CASES], by_filter()
    if options.json:
        tables = {"errors": rows, "by_filter": filters}
        print(json.dumps({key: [vars(row) for row in value] for key, value in tables.items()}, indent=2))
        return
    console = Console(width=130)
    show(rows, console)
    show(filters, console)


if __name__ == "__main__":
    main()
