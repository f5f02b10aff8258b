"""What the forward-speed terms of a torpedo are worth: free-running yaw rate of a run that was not learned from.

    python benchmarks/studies/torpedo_study.py [--runs 5] [--method joint] [--output torpedo.json]

The truth is `torpedo.toml`: 35 kg, tail propeller, tunnels at bow and stern. It zigzags by its tunnels for 3 minutes
at speeds ahead of 0 to 1.7 m/s, with an INS (gyro biases, DVL, heading) and a random force. Known are mass,
inertia, thrusters and what moves it up and down and in roll; the file has no hydrodynamics of the horizontal plane but
the forward-speed terms `Y_uv Y_ur N_uv N_ur`: as 0 with a deviation of its fins' size, wrong (half of them), or not at
all. Learned: everything plausible. Printed: share of yaw rate, sway and speed explained by a free run over
a minute with other commands, without noise; and how far the four terms are off.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from report import show
from rich.table import Table
from runner import arguments, over, write_json

from towtank.core.arrays import Array
from towtank.identification import learn_recordings
from towtank.recording import Recording
from towtank.simulation import Ins, OrnsteinUhlenbeck, simulate
from towtank.validation import fit_percent
from towtank.vehicle import Coefficient, Vehicle, load_vehicle

LIFT = ("Y_uv", "Y_ur", "N_uv", "N_ur")
FINS = (100.0, 50.0, 50.0, 30.0)  # deviations of LIFT before any data, kg/m, kg
PLANE = ("X_udot", "X_u", "X_uu", "Y_vdot", "Y_v", "Y_vv", "N_rdot", "N_r", "N_rr")
CASES = ("with", "wrong before", "without")
SEEN = ("r", "v", "u")
DT, DURATION, UNSEEN = 0.02, 180.0, 60.0  # s
LEAST_FIT = 90.0  # percent of the yaw rate of an unseen run
WATER = OrnsteinUhlenbeck(std=(0.3, 0.3, 0.3, 0.0, 0.1, 0.1), time_constant=2.0)  # N, N m; s
_START = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Found:
    """Percent of r, v and u explained in the unseen run, errors of the four terms by their truth, and who judged."""

    case: str
    fit: tuple[float, ...]
    errors: tuple[float, ...]
    deviations: tuple[float, ...]
    method: str


def torpedo() -> Vehicle:
    """Return the truth."""
    return load_vehicle(str(Path(__file__).with_name("torpedo.toml")))


def zigzag(duration: float, seed: int) -> Array:
    """Return commands (n, 3) at 50 Hz: the propeller in steps of 10 s, the tunnels of 2.5 s, these of either sign."""
    rng = np.random.default_rng(seed)
    ahead = np.repeat(rng.uniform(0.0, 95.0, round(duration / 10.0)), round(10.0 / DT))
    tunnels = np.repeat(rng.uniform(-100.0, 100.0, (round(duration / 2.5), 2)), round(2.5 / DT), axis=0)
    return np.column_stack([ahead, tunnels])


def known(truth: Vehicle, lift: float) -> Vehicle:
    """Return what is told of it: nothing of the horizontal plane but `lift` times its forward-speed terms, if any."""
    told = {name: each for name, each in truth.hydrodynamics.items() if name not in (*PLANE, *LIFT)}
    plain = truth.model_copy(update={"hydrodynamics": told})
    return plain.with_coefficients({name: lift * truth.coefficient(name) for name in LIFT}) if lift else plain


def finned(plain: Vehicle) -> Vehicle:
    """Return the vehicle with forward-speed terms of which nothing but the size is known."""
    sizes = zip(LIFT, FINS, strict=True)
    return plain.with_coefficients({name: Coefficient(value=0.0, std=size) for name, size in sizes})


def zigzags(truth: Vehicle, seed: int, duration: float = DURATION) -> Recording:
    """Return a run to learn from."""
    commands = zigzag(duration, seed)
    return simulate(truth, commands=commands, dt=DT, nu0=_START, sensors=Ins(), disturbance=WATER, seed=seed)


def explained(truth: Vehicle, model: Vehicle, seed: int) -> tuple[float, ...]:
    """Return percent of r, v and u that a free run of a model explains of a run of the truth, other commands."""
    commands = zigzag(UNSEEN, 1000 + seed)
    true, free = (simulate(each, commands=commands, dt=DT, nu0=_START) for each in (truth, model))
    return tuple(float(fit_percent(true[name].values, free[name].values)) for name in SEEN)


def learned(case: str, method: str, seed: int, duration: float = DURATION) -> Found:
    """Learn from one run."""
    truth = torpedo()
    start = known(truth, 0.5 if case == "wrong before" else 0.0)
    start = finned(start) if case == "with" else start
    learning = learn_recordings(start, [zigzags(truth, seed, duration)], method=method)
    errors, deviations = [], []
    for name in LIFT:
        off = learning.model.coefficient(name) - truth.coefficient(name)
        errors.append(100.0 * off / truth.coefficient(name))
        std = learning.estimate[name].std if name in learning.estimate else np.nan
        deviations.append(abs(off) / std)
    fit = explained(truth, learning.model, seed)
    return Found(case, fit, tuple(errors), tuple(deviations), learning.method)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study."""
    options = arguments(__doc__, 5, argv)
    cases = [case for case in CASES if not options.only or options.only in case]
    seeds = range(options.seed, options.seed + options.runs)
    tasks = [(case, options.method, seed) for case in cases for seed in seeds]
    found = over("torpedo", learned, tasks, options.workers)
    table = Table("terms", *(f"{name} explained %" for name in SEEN), *(f"{name} off %" for name in LIFT), "deviations")
    met = True
    for case in cases:
        own = [each for each in found if each.case == case]
        fit = np.array([each.fit for each in own])
        off = np.abs([each.errors for each in own]).max(axis=0)
        away = np.max([each.deviations for each in own])
        table.add_row(
            case,
            *(f"{np.median(column):.1f} ({column.min():.1f})" for column in fit.T),
            *(f"{each:.1f}" for each in off),
            f"{away:.1f}" if np.isfinite(away) else "-",
        )
        met = met and (case == "without" or float(fit[:, 0].min()) >= LEAST_FIT)
    show(
        f"\ntorpedo, {options.runs} runs of {DURATION:.0f} s, method {options.method}: median (worst); worst errors",
        table,
    )
    if options.output:
        write_json(options.output, {"runs": [asdict(each) for each in found]})
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
