"""The guard in the loop: random telegraphs on all axes at once in a tank, of vehicles that are not those supposed.

    python benchmarks/studies/guard_study.py [--runs 125] [--only bluerov2] [--output guard.json]

5 x 5 x 2.5 m, 0.2 m of margin, 12 s a run from the middle. On every axis that the thrusters can set, a telegraph of 0.2
to 1 of all they can give on it, switched every 0.4 to 2 s; together cut to what each thruster can do. `usual`: instead
the amplitudes of `simulate`'s manoeuvres, about half a metre per second. The true vehicle has every total inertia,
damping and righting moment 1.3 or 0.7 times that supposed, by chance, and the gain of each thruster 7 to 9 %; the
guard has 19 vehicles drawn around the one supposed, by 30 % (gains 7.5 %). A random force of 0.5 N and 0.05 N m on each
axis, 2 s (S2), or three times that; poses with 1 mm and 1 mrad of noise at 100 Hz.

Printed: runs that touch a wall, guarded and not; how close; tilt; how much of the time and of the thrust was changed;
for chatter, how often a second a thruster changes by more than a quarter of its range, given beside wanted; and what
is left of the information, (det/det)^(1/12), beside the same run in water without walls, limits and guard.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cache

import numpy as np
from experiments import chosen
from report import checks_table, show
from rich.table import Table
from runner import arguments, over, write_json
from summary import Check

from towtank.core.arrays import Array
from towtank.planning.braking import PERIOD
from towtank.planning.guard import LIMITS, Guard, drawn_around, scaled
from towtank.planning.guarded import DT, guarded_run
from towtank.planning.space import Space
from towtank.simulation import OrnsteinUhlenbeck, usual_amplitudes
from towtank.vehicle import load_vehicle

SPACE = "5x5x2.5"
VEHICLES = ("vlbv300", "bluerov2_heavy")
CASES = tuple(f"{vehicle}-{case}" for vehicle in VEHICLES for case in ("s2", "3xs2", "usual"))
DURATION = 12.0  # s
WRONG, GAINS = 0.3, 0.25  # of the coefficients; power of the factor for the gains of the thrusters
SWITCHED, AMPLITUDE = (0.4, 2.0), (0.2, 1.0)  # s; of what the thrusters can give
FORCE = (0.5, 0.5, 0.5, 0.05, 0.05, 0.05)  # N, N m
TOUCHES = {"s2": 0.0, "3xs2": 0.01, "usual": 0.0}


@dataclass(frozen=True)
class Run:
    """What came of one seed: guarded, and the clearance of the same run without a guard."""

    clearance: float
    unguarded: float
    tilt: float
    unguarded_tilt: float
    speed: float
    turn: float
    time_changed: float
    thrust_changed: float
    jumps: float
    jumps_wanted: float
    information: float
    shares: tuple[float, ...]
    seconds_a_step: float


@cache
def guard_of(name: str) -> Guard:
    vehicle = load_vehicle(name)
    return Guard.of(vehicle, Space.from_text(SPACE), drawn_around(vehicle, 19, WRONG), force_std=FORCE)


def telegraphs(guard: Guard, seed: int, usual: bool) -> Array:
    """Return the forces wanted of the thrusters (n, m) [N]."""
    rng, brake = np.random.default_rng(seed), guard.brake
    n = round(DURATION / PERIOD)
    wrench, gentle = np.zeros((n, 6)), usual_amplitudes(guard.vehicle)
    for axis in range(6):
        f = np.abs(brake.inverse[:, axis])
        if not f.any():
            continue
        used = f > 1e-9 * f.max()
        largest = float((np.minimum(-brake.low, brake.high)[used] / f[used]).min())
        amplitude = rng.uniform(*AMPLITUDE) * largest
        sign, at = rng.choice([-1.0, 1.0]), 0.0
        while at < DURATION:
            length = rng.uniform(*SWITCHED)
            first, last = round(at / PERIOD), round((at + length) / PERIOD)
            wrench[first:last, axis] = sign * (min(gentle[axis], largest) if usual else amplitude)
            at, sign = at + length, -sign
    return np.clip(wrench @ brake.inverse.T, brake.low, brake.high)


def jumps(guard: Guard, forces: Array) -> float:
    """Return how often a second a thruster's force changes by more than a quarter of its range."""
    large = np.abs(np.diff(forces, axis=0)) > 0.25 * (guard.brake.high - guard.brake.low)
    return float(large.mean()) / PERIOD


def information(nu: Array) -> float:
    """Return ln det of the information on inertia and drag of each axis, from its own acceleration and velocity."""
    rate, out = np.gradient(nu, DT, axis=0), 0.0
    for i in range(6):
        rows = np.column_stack([rate[:, i], np.abs(nu[:, i]) * nu[:, i]])
        out += float(np.linalg.slogdet(rows.T @ rows)[1])
    return out


def perform(case: str, seed: int) -> Run:
    name, kind = case.split("-")
    guard = guard_of(name)
    rng = np.random.default_rng([seed, 1])
    truth = scaled(guard.vehicle, lambda: 1.0 + WRONG * rng.choice([-1.0, 1.0]), GAINS)
    wanted = telegraphs(guard, seed, kind == "usual")
    size = 3.0 if kind == "3xs2" else 1.0
    force = OrnsteinUhlenbeck((0.5 * size,) * 3 + (0.05 * size,) * 3, time_constant=2.0)
    free = guarded_run(guard, truth, wanted, disturbance=force, seed=seed, guarded=False)
    began = time.process_time()
    run = guarded_run(guard, truth, wanted, disturbance=force, seed=seed)
    spent = time.process_time() - began
    return Run(
        clearance=float(run.clearance.min()),
        unguarded=float(free.clearance.min()),
        tilt=float(run.tilt.max()),
        unguarded_tilt=float(free.tilt.max()),
        speed=float(np.linalg.norm(run.nu[:, :3], axis=1).max()),
        turn=float(np.linalg.norm(run.nu[:, 3:], axis=1).max()),
        time_changed=float((run.shares > 0.0).any(axis=1).mean()),
        thrust_changed=float(np.abs(run.given - wanted).sum() / np.abs(wanted).sum()),
        jumps=jumps(guard, run.given),
        jumps_wanted=jumps(guard, wanted),
        information=math.exp((information(run.nu) - information(free.nu)) / 12.0),
        shares=tuple(run.shares.mean(axis=0).tolist()),
        seconds_a_step=spent / len(wanted),
    )


def table(found: dict[str, list[Run]], tilt: float) -> Table:
    out = Table(title=f"{SPACE} m, {DURATION:g} s a run", title_justify="left")
    out.add_column("")
    for case in found:
        out.add_column(case, justify="right")

    def row(title: str, figure: Callable[[list[Run]], str]) -> None:
        out.add_row(title, *(figure(runs) for runs in found.values()))

    def mean(name: str, unit: float = 1.0) -> Callable[[list[Run]], float]:
        return lambda runs: unit * float(np.mean([getattr(each, name) for each in runs]))

    row("runs", lambda runs: str(len(runs)))
    row("touch a wall", lambda runs: str(sum(each.clearance <= 0.0 for each in runs)))
    row("the same without a guard", lambda runs: percent(each.unguarded <= 0.0 for each in runs))
    row("least clearance, m", lambda runs: f"{min(each.clearance for each in runs):.3f}")
    row("beyond the limit of tilt", lambda runs: percent(each.tilt > tilt for each in runs))
    row("the same without a guard", lambda runs: percent(each.unguarded_tilt > tilt for each in runs))
    row("largest tilt, deg", lambda runs: f"{math.degrees(max(each.tilt for each in runs)):.0f}")
    row("largest speed, m/s", lambda runs: f"{max(each.speed for each in runs):.2f}")
    row("largest rate of turn, rad/s", lambda runs: f"{max(each.turn for each in runs):.2f}")
    row("time changed, %", lambda runs: f"{mean('time_changed', 100.0)(runs):.0f}")
    row("thrust changed, %", lambda runs: f"{mean('thrust_changed', 100.0)(runs):.0f}")
    row("large jumps of a thruster, 1/s", lambda runs: f"{mean('jumps')(runs):.2f}")
    row("those wanted", lambda runs: f"{mean('jumps_wanted')(runs):.2f}")
    row("information kept a coefficient, %", lambda runs: f"{mean('information', 100.0)(runs):.0f}")
    row("whole run by step, ms", lambda runs: f"{mean('seconds_a_step', 1e3)(runs):.1f}")
    for k, name in enumerate(LIMITS):
        row(f"mean share, {name}", lambda runs, k=k: f"{np.mean([each.shares[k] for each in runs]):.2f}")
    return out


def percent(which: Iterable[bool]) -> str:
    return f"{100.0 * float(np.mean(list(which))):.1f} %"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where everything that must hold holds."""
    options = arguments(__doc__ or "", 125, argv)
    names = chosen(CASES, options.only)
    seeds = range(options.seed, options.seed + options.runs)
    outcomes = over("guard", perform, [(name, seed) for name in names for seed in seeds], options.workers)
    found = {name: outcomes[k * options.runs : (k + 1) * options.runs] for k, name in enumerate(names)}
    tilt = Space.from_text(SPACE).tilt
    held = [
        Check(
            f"{name}: runs that touch a wall",
            float(np.mean([each.clearance <= 0.0 for each in runs])),
            high=TOUCHES[name.split("-")[1]],
            note=f"{len(runs)} runs",
        )
        for name, runs in found.items()
    ]
    show(table(found, tilt), checks_table("must hold", held))
    write_json(
        options.output,
        {
            "study": "guard",
            "runs": options.runs,
            "seed": options.seed,
            "cases": {name: [asdict(each) for each in runs] for name, runs in found.items()},
            "checks": [check.document() for check in held],
        },
    )
    return 0 if all(check.met for check in held) else 1


if __name__ == "__main__":
    sys.exit(main())
