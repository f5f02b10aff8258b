"""Linear damping, quadratic or both, on all axes, when the vehicle's file says nothing.

    python benchmarks/studies/damping_study.py [--runs 10] [--only linear] [--output damping.json]

The vLBV300 on all axes for 60 s, motion capture of 1 mm, a random force of 0.25 N and 0.02 N m. Its drag in truth is
`quadratic`, `linear`, `both` in equal parts at usual speeds, or `some`: quadratic with 15 % of the linear. What moves
it is all thrusters at once (telegraph signals) or one axis after the other (tank session). No name is given to the
learner: axes whose terms are those of the truth, errors of the drag at a quarter, a half and three quarters of 0.5 m/s
(0.6 rad/s in roll and pitch, 0.8 in yaw), and changes reported though there was none; of the log and of the stream.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from report import checks_table, show
from rich.table import Table
from runner import arguments, over, write_json
from summary import Check

from towtank.core.arrays import Array
from towtank.identification import Learner, learn_recordings
from towtank.identification.model.terms import AXES
from towtank.recording import Recording
from towtank.simulation import manoeuvre, simulate
from towtank.simulation.tank import DISTURBANCE, MOCAP, tank_session
from towtank.vehicle import Vehicle

SHARES = {"quadratic": (0.0, 1.0), "linear": (1.0, 0.0), "both": (0.5, 0.5), "some": (0.15, 0.85)}
MANOEUVRES = ("all-telegraph", "tank-session")
SPEEDS = np.array([0.5, 0.5, 0.5, 0.6, 0.6, 0.8])
LINEAR, QUADRATIC = [axis.linear for axis in AXES], [axis.quadratic for axis in AXES]
DURATION, DT = 60.0, 0.01  # s


@dataclass(frozen=True, eq=False)
class Found:
    """Whether the terms of each axis are right (6,), relative errors of its drag (3, 6), and changes reported."""

    right: Array
    errors: Array
    changes: int


def drags(vehicle: Vehicle) -> tuple[Array, Array]:
    """Return linear and quadratic damping (6,) of a vehicle."""
    linear, quadratic = (np.array([vehicle.coefficient(name) for name in names]) for names in (LINEAR, QUADRATIC))
    return linear, quadratic


def session(case: str, plan: str, seed: int) -> tuple[Vehicle, Vehicle, Recording]:
    """Return the truth, what is known of it, and a run."""
    tank = tank_session(2.0)
    whole, (a, b) = drags(tank.truth)[1], SHARES[case]
    terms = dict(zip(LINEAR, a * whole * SPEEDS, strict=True)) | dict(zip(QUADRATIC, b * whole, strict=True))
    truth = tank.truth.with_coefficients(terms)
    commands = manoeuvre(plan, truth, duration=DURATION, dt=DT, seed=seed).commands
    start = (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)
    run = simulate(truth, commands=commands, dt=DT, eta0=start, sensors=MOCAP, disturbance=DISTURBANCE, seed=seed)
    return truth, tank.known, run


def learned(case: str, plan: str, mode: str, seed: int) -> Found:
    """Learn from one run."""
    truth, known, run = session(case, plan, seed)
    if mode == "log":
        model, changes = learn_recordings(known, [run]).model, 0
    else:
        learner = Learner(known)
        learner.run(run)
        model, changes = learner.model(), len(learner.events)
    (linear, quadratic), (true_linear, true_quadratic) = drags(model), drags(truth)
    right = ((linear != 0.0) == (true_linear != 0.0)) & ((quadratic != 0.0) == (true_quadratic != 0.0))
    at = np.multiply.outer((0.25, 0.5, 0.75), SPEEDS)
    errors = (linear * at + quadratic * at**2) / (true_linear * at + true_quadratic * at**2) - 1.0
    return Found(right, errors, changes)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where everything that must hold holds."""
    options = arguments(__doc__ or "", 10, argv)
    requested = options.only.split(",") if options.only else [""]
    cases = [(case, plan, mode) for mode in ("log", "stream") for plan in MANOEUVRES for case in SHARES]
    cases = [each for each in cases if any(one in " ".join(each) for one in requested)]
    seeds = range(options.seed, options.seed + options.runs)
    held: list[Check] = []
    documents = {}
    table = Table(title=f"damping terms, {len(seeds)} runs each", title_justify="left")
    for name in ("learned from", "manoeuvre", "truth", "axes with the right terms", "RMSE of the drag %", "changes"):
        table.add_column(name)
    tasks = [(*each, seed) for each in cases for seed in seeds]
    outcomes = over("damping terms", learned, tasks, options.workers)
    for k, (case, plan, mode) in enumerate(cases):
        found = outcomes[k * len(seeds) : (k + 1) * len(seeds)]
        right = float(np.mean([one.right for one in found]))
        rmse = np.sqrt(np.mean(np.square([one.errors for one in found]), axis=(0, 1)))
        changes = sum(one.changes for one in found)
        worst = " ".join(f"{100.0 * each:.1f}" for each in rmse)
        table.add_row(mode, plan, case, f"{100.0 * right:.0f} %", worst, str(changes))
        where, limit = f"{mode}, {plan}, {case}", 0.1 if case in ("quadratic", "linear") else 0.3
        documents[where] = [asdict(one) for one in found]
        held += [
            Check(f"{where}: largest RMSE of an axis' drag", float(rmse.max()), high=limit),
            Check(f"{where}: changes reported", changes, high=0.0),
        ]
    show(table)
    show(checks_table("must hold", held))
    write_json(options.output, {"study": "damping", "cases": documents, "checks": [each.document() for each in held]})
    return 0 if all(check.met for check in held) else 1


if __name__ == "__main__":
    sys.exit(main())
