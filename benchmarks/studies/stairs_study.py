"""A plan beside the paper's stairs, in the same tank and the same time: what each makes known.

    python benchmarks/studies/stairs_study.py [--only bluerov2_heavy]

The paper drives one axis after the other in stairs: four steps up of two seconds each, then the same in reverse, 16 s
an axis. Here that is done on every axis that the vehicle drives, each as strong as keeps it within the tank
(5 x 5 x 2.5 m) and its limits, each begun in the middle. The plan is driven for the same time: it ends where
more of it would hardly tell more than the scale of the thrusters' force allows; from there on each segment is designed
from what is known by then, as the pilot's mode does where there is no plan. Both are forecast for the same vehicle
(pose, a random force of 0.5 N, coefficients on the diagonal known to 30 %). Asked: deviations at most a third of those
of the stairs, of inertias a fifth. The scale of the thrusters' force is in all deviations alike and no motion tells it:
so they are shown with it, and beside thrusters that are known.
"""

from __future__ import annotations

import sys

import numpy as np
from plan_study import FORCE, SPACE, supposed
from report import show
from rich.table import Table
from runner import arguments

from towtank.core.arrays import Array
from towtank.planning import RATE, Forecast, Outlook, Plan, draws_of, forecast, plan
from towtank.planning.design import design, excess
from towtank.planning.segments import commands_of
from towtank.simulation import available_rows, manoeuvre
from towtank.vehicle import Vehicle, allocate, thruster_wrench
from towtank.vehicle.posterior import GAIN_PREFIX

VEHICLES = ("bluerov2_heavy", "vlbv300")
AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
LENGTH = 16.0  # s an axis


def known(outlook: Outlook, vehicle: Vehicle, runs: list[Array]) -> Forecast:
    """Return what is known after runs of commands, one after the other, each from rest at the start."""
    for commands in runs:
        found = forecast(outlook, vehicle, commands, start=SPACE.eta0)
        outlook = outlook.after(found.covariance)
    return found


def with_known_thrusters(found: Forecast, wanted: tuple[str, ...]) -> Array:
    """Return the deviations of the wanted (k,) as shares, had the gains of the thrusters been known."""
    a = [found.names.index(name) for name in wanted]
    g = [k for k, name in enumerate(found.names) if name.startswith(GAIN_PREFIX)]
    P = found.covariance
    kept = P[np.ix_(a, a)] - P[np.ix_(a, g)] @ np.linalg.solve(P[np.ix_(g, g)], P[np.ix_(g, a)])
    return np.asarray(np.sqrt(np.diag(kept)) / np.array([found.quantities[name] for name in wanted]))


def stairs(outlook: Outlook, vehicle: Vehicle, axis: str, radius: float) -> Array:
    """Return the commands (n, m) of the strongest stairs of an axis that stay within the tank."""
    made = manoeuvre(f"{axis}-stairs", vehicle, duration=LENGTH, dt=1.0 / RATE)
    if made.commands is None:
        raise ValueError(f"{axis}: no commands")
    wrench = thruster_wrench(vehicle, made.commands)
    for share in np.geomspace(1.0, 0.02, 40):
        commands = allocate(vehicle, share * wrench)
        if excess(forecast(outlook, vehicle, commands, start=SPACE.eta0), SPACE, radius) == 0.0:
            return commands
    return commands


def driven_on(made: Plan, outlook: Outlook, vehicle: Vehicle, wanted: tuple[str, ...], seconds: float) -> list[Array]:
    """Return the commands of a plan, and of segments that go on from what is known until so many seconds are over."""
    runs = [commands_of(each.segment, outlook.vehicle) for each in made.segments]
    for _ in range(round(seconds / made.manoeuvring * len(runs)) - len(runs)):
        now = outlook.after(known(outlook, vehicle, runs).covariance)
        best = design(now, wanted, space=SPACE, duration=made.segments[0].segment.duration, seed=len(runs))
        runs.append(commands_of(best.segment, outlook.vehicle))
    return runs


def main() -> int:
    """Print the comparison; return 1 where a plan's deviation is beyond what is asked."""
    options = arguments(__doc__ or "", runs=1)
    missed = 0
    for name in VEHICLES:
        if options.only and options.only not in name:
            continue
        file = supposed(name)
        outlook = Outlook.of(file, force=FORCE)
        vehicle = draws_of(outlook, 1)[0]
        radius = SPACE.require_room(file)
        axes = [AXES[row] for row in available_rows(file)]
        theirs = known(outlook, vehicle, [stairs(outlook, vehicle, axis, radius) for axis in axes])
        minutes = LENGTH * len(axes) / 60.0
        made = plan(file, space=SPACE, force=FORCE, minutes=minutes, accuracy=1e-3, seed=1)
        wanted = tuple(each.name for each in made.expected)
        ours = known(outlook, vehicle, driven_on(made, outlook, vehicle, wanted, 60.0 * minutes))
        table = Table(title=f"{name}: stairs and plan, {60.0 * minutes:g} s each; the plan has {made.manoeuvring:g} s")
        for head in ("Coefficient", "stairs", "plan", "ratio", "stairs, gains known", "plan, gains known", "ratio"):
            table.add_column(head, justify="left" if head == "Coefficient" else "right")
        both = ours.relative(wanted), theirs.relative(wanted)
        bare = with_known_thrusters(ours, wanted), with_known_thrusters(theirs, wanted)
        for k, each in enumerate(wanted):
            cells = []
            for mine, other in (both, bare):
                cells += [f"{100.0 * other[k]:.2f} %", f"{100.0 * mine[k]:.2f} %", f"{mine[k] / other[k]:.2f}"]
            missed += bare[0][k] / bare[1][k] > (0.2 if each.endswith("dot") else 1.0 / 3.0)
            table.add_row(each, *cells)
        show(table)
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
