"""Runs that drive one axis alone: what the others claim to have learned, and whether it is true.

    python benchmarks/studies/single_axis_study.py [--runs 2] [--only yaw-square,mocap] [--output single_axis.json]

The vLBV300 for 30 s of one form on one axis; the learner is told rigid body and thrusters, everything else is unknown.
Motion capture or IMU with DVL and depth; thrusters without lag or with one of 0.1 s; with the random force of the
demo's tank or with none whatever, which is what an example out of the simulator shows. An axis that nobody drives has
no motion but the noise of its sensors, and must not learn from that: the share of identified coefficients within 95 %,
beyond four deviations, the error of the total inertia of driven axes, and findings ("cannot be right"), all of which
are false.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from report import checks_table, show
from rich.table import Table
from runner import arguments, over, write_json
from summary import Check

from towtank.identification import learn_recordings
from towtank.identification.model.terms import AXES
from towtank.simulation import manoeuvre, simulate
from towtank.simulation.tank import DISTURBANCE, MOCAP, tank_session

PLANS = ("surge-square", "yaw-square", "heave-sine", "surge-telegraph")
SENSORS = ("mocap", "ins")
LAGS = (0.0, 0.1)  # s
DURATION, DT = 30.0, 0.01  # s


@dataclass(frozen=True)
class Found:
    """What one run came to: deviations by which each identified coefficient is off, error of inertias, findings."""

    off: dict[str, float]
    inertia: dict[str, float]
    findings: tuple[str, ...]


def learned(plan: str, sensors: str, lag: float, disturbed: bool, seed: int) -> Found:
    """Learn from one run."""
    tank = tank_session(2.0)
    thrusters = [each.model_copy(update={"time_constant": lag}) for each in tank.truth.thrusters]
    truth = tank.truth.model_copy(update={"thrusters": thrusters})
    commands = manoeuvre(plan, truth, duration=DURATION, dt=DT, seed=seed).commands
    run = simulate(
        truth,
        commands=commands,
        dt=DT,
        eta0=(0.0, 0.0, 3.0, 0.0, 0.0, 0.0),
        sensors=MOCAP if sensors == "mocap" else sensors,
        disturbance=DISTURBANCE if disturbed else None,
        seed=seed,
    )
    learning = learn_recordings(tank.known.model_copy(update={"scale_std": None}), [run])
    off, inertia = {}, {}
    for each in learning.estimate.coefficients:
        if each.identified:
            error = each.value - truth.coefficient(each.name)
            off[each.name] = error / each.std
            for axis in AXES:
                if each.name == axis.added_mass:
                    inertia[each.name] = -error / truth.mass_matrix[axis.index, axis.index]
    return Found(off, inertia, tuple(finding.text for finding in learning.findings))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where everything that must hold holds."""
    options = arguments(__doc__ or "", 2, argv)
    requested = options.only.split(",") if options.only else []
    cases = list(itertools.product(PLANS, SENSORS, LAGS, (False, True)))
    cases = [each for each in cases if all(any(one == str(part) for part in each) for one in requested)]
    seeds = range(options.seed, options.seed + options.runs)
    found = over("runs of one axis", learned, [(*each, s) for each in cases for s in seeds], options.workers)
    table = Table(title=f"runs of one axis, {len(seeds)} each", title_justify="left")
    for name in ("plan", "sensors", "lag s", "disturbed", "identified", "within 95 %", "beyond 4", "findings", "worst"):
        table.add_column(name)
    for k, (plan, sensors, lag, disturbed) in enumerate(cases):
        runs = found[k * len(seeds) : (k + 1) * len(seeds)]
        off = np.abs([value for one in runs for value in one.off.values()])
        name, worst = max((item for one in runs for item in one.off.items()), key=lambda item: abs(item[1]))
        table.add_row(
            *(plan, sensors, f"{lag:g}", "yes" if disturbed else "no", str(off.size)),
            *(f"{100.0 * np.mean(off <= 1.96):.0f} %", str(int(np.sum(off > 4.0)))),
            *(str(sum(len(one.findings) for one in runs)), f"{name} {worst:+.1f}"),
        )
    off = np.abs([value for one in found for value in one.off.values()])
    inertia = np.abs([value for one in found for value in one.inertia.values()])
    held = [
        Check("share within 95 %", float(np.mean(off <= 1.96)), low=0.9),
        Check("share beyond four deviations", float(np.mean(off > 4.0)), high=0.005),
        Check("median error of total inertias", float(np.median(inertia)), high=0.03),
        Check("false findings", float(sum(len(one.findings) for one in found)), high=0.0),
    ]
    show(table)
    show(checks_table("must hold", held))
    every = [case for case in cases for _ in seeds]
    rows = [{"case": case, "found": asdict(one)} for case, one in zip(every, found, strict=True)]
    write_json(options.output, {"study": "single axis", "runs": rows, "checks": [each.document() for each in held]})
    return 0 if all(check.met for check in held) else 1


if __name__ == "__main__":
    sys.exit(main())
