"""Plans put to the test: a vehicle that is 30 % off its file is driven by the plan, and learned from.

    python benchmarks/studies/plan_study.py [--runs 20] [--seed 1] [--only vlbv300 | leaving | stream] [--workers 2]

For each vehicle one plan is made from its file (5 x 5 x 2.5 m, pose, a random force of 0.5 N correlated over 2 s, 5 %
asked), in which every coefficient on the diagonal bears a deviation of 30 %. In every run each of them is drawn anew,
the segments are driven from rest, each in a recording of its own, with motion capture of 1 mm and the random force, and
`learn` (joint) is asked, which knows the file alone. Shown are, for each coefficient, what the plan promises, what
learning states, the errors (their RMS, and the deviation that the middle one speaks for, which a run that went wrong
does not change), and the ratios: promised against achieved must be within 0.8 to 1.3.

Then (`--only leaving`) plans with a pose and without one say how likely each of their segments ends at a wall where
nobody steers, and that one of them does. Fifty times as many vehicles as runs are drawn anew, each with forces of its
own, and driven by the simulator at 100 Hz; the share that touches a wall must be within 0.05 of what the plan states.

Last (`--only stream`) the same drives are learned sample by sample, as one stream. Shown is after how much manoeuvring
the error of each coefficient is within 5 % of its size for good: asked is 20 s, in nine runs of ten, of all of them.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from report import show
from rich.table import Table
from runner import arguments, over

from towtank import Learner, load_vehicle, simulate
from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification import learn_recordings
from towtank.planning import RATE, Outlook, Plan, Space, draws_of, plan
from towtank.planning.segments import commands_of
from towtank.recording import Recording
from towtank.recording.standard import POSE
from towtank.simulation import Mocap, OrnsteinUhlenbeck
from towtank.vehicle import Coefficient, Vehicle, index

VEHICLES = ("vlbv300", "bluerov2_heavy")
HEADS = ("Coefficient", "promised", "stated", "error", "RMS error", "stated / promised", "error / promised", "95 %")
OFF, FORCE = 0.3, 0.5
SPACE = Space.from_text("5x5x2.5")


AT_ONCE, CLOSE = 50, 0.05
NEAR, SOON = 0.05, 20.0  # share of the size; s
PAUSE, LOOKED = 3.0, 25  # s between two segments of a stream; samples between two looks at it


class Run(NamedTuple):
    """Errors and stated deviations of the wanted coefficients (k,), as shares of their size."""

    errors: Array
    stated: Array


@cache
def supposed(name: str) -> Vehicle:
    """Return the file of a vehicle with a deviation of 30 % for what is on the diagonal."""
    vehicle = load_vehicle(name)
    values = {
        key: Coefficient(value=each.value, std=OFF * size_of(vehicle, key))
        for key, each in vehicle.hydrodynamics.items()
    }
    return vehicle.with_coefficients(values)


def size_of(vehicle: Vehicle, name: str) -> float:
    """Return what a share of a coefficient is of: the total inertia of an added mass, else the coefficient itself."""
    kind, i, j = index(name)
    return float(vehicle.mass_matrix[i, j]) if kind == "mass" else abs(vehicle.coefficient(name))


@cache
def planned(name: str) -> Plan:
    """Return the plan of a vehicle."""
    return plan(supposed(name), space=SPACE, force=FORCE, seed=1)


def drawn(file: Vehicle, wanted: Sequence[str], seed: int) -> Vehicle:
    """Return a vehicle whose wanted coefficients are up to 30 % off its file's."""
    chance = np.random.default_rng(seed)
    values = {}
    for key in wanted:
        size, value = size_of(file, key), file.coefficient(key)
        away = chance.uniform(-OFF, OFF)
        values[key] = value - away * size if index(key)[0] == "mass" else value * (1.0 + away)
    return file.with_coefficients(values)


def driven(name: str, seed: int) -> tuple[Vehicle, list[Recording]]:
    """Return a vehicle that is off its file, and a recording of each segment of its plan."""
    file, made = supposed(name), planned(name)
    truth = drawn(file, [each.name for each in made.expected], seed)
    push = OrnsteinUhlenbeck(std=(FORCE,) * 3 + (0.1 * FORCE,) * 3, time_constant=2.0)
    return truth, [
        simulate(
            truth,
            commands=np.repeat(commands_of(each.segment, file), round(100.0 / RATE), axis=0),
            dt=0.01,
            eta0=SPACE.eta0,
            sensors=Mocap(),
            disturbance=push,
            seed=1000 * seed + k,
        )
        for k, each in enumerate(made.segments)
    ]


def perform(name: str, seed: int) -> Run:
    """Drive a plan once and learn."""
    file, wanted = supposed(name), [each.name for each in planned(name).expected]
    truth, runs = driven(name, seed)
    learned = {each.name: each for each in learn_recordings(file, runs).estimate.coefficients}
    sizes = np.array([size_of(truth, key) for key in wanted])
    errors = np.array([learned[key].value - truth.coefficient(key) for key in wanted]) / sizes
    return Run(errors, np.array([learned[key].std for key in wanted]) / sizes)


def streamed(name: str, seed: int) -> Array:
    """Return after how much manoeuvring (k,) [s] each coefficient of a stream is near for good, inf for never."""
    file, wanted = supposed(name), [each.name for each in planned(name).expected]
    truth, runs = driven(name, seed)
    learner, sizes = Learner(file, changes=False), np.array([size_of(truth, key) for key in wanted])
    right = np.array([truth.coefficient(key) for key in wanted])
    before, when, errors = 0.0, list[float](), list[Array]()
    for k, run in enumerate(runs):
        if k:
            learner.restart()
        pose = np.column_stack([run[axis].values for axis in POSE])
        commands = np.column_stack([run[f"cmd_{each.name}"].values for each in file.thrusters])
        for i, t in enumerate(run["x"].t):
            now = before + k * PAUSE + float(t)
            learner.update(now, pose=pose[i], commands=commands[i] if i < len(commands) else None)
            if i % LOOKED == LOOKED - 1:
                found = {each.name: each.value for each in learner.estimate.coefficients}
                when.append(before + float(t))
                errors.append(np.abs(np.array([found[key] for key in wanted]) - right) / sizes)
        before += run.duration
    return for_good(np.array(when), np.array(errors) <= NEAR)


def for_good(t: Array, near: NDArray[np.bool_]) -> Array:
    """Return the first of times (n,) from which on each column of `near` (n, k) is true to the end, inf for none."""
    from_here_on = np.logical_and.accumulate(near[::-1], axis=0)[::-1]
    return np.where(from_here_on.any(axis=0), t[np.argmax(from_here_on, axis=0)], np.inf)


def streams(names: Sequence[str], runs: int, seed: int, workers: int) -> int:
    """Show how soon streams are right; return how many vehicles take longer than asked."""
    failed = 0
    for name in names:
        made = planned(name)
        found = np.array(over(f"{name}, streams", streamed, [(name, seed + k) for k in range(runs)], workers))
        table = Table(title=f"{name}: within {100.0 * NEAR:g} % for good after, of {made.manoeuvring:g} s, {runs} runs")
        for head in ("Coefficient", "median", "90 %", "never"):
            table.add_column(head, justify="left" if head == "Coefficient" else "right")
        columns = [(each.name, found[:, k]) for k, each in enumerate(made.expected)]
        for title, times in [*columns, ("all of them", found.max(axis=1))]:
            middle, late = (float(np.quantile(times, share, method="higher")) for share in (0.5, 0.9))
            shown = [f"{each:.1f} s" if np.isfinite(each) else "-" for each in (middle, late)]
            table.add_row(title, *shown, f"{100.0 * np.mean(np.isinf(times)):.0f} %")
        failed += late > SOON
        show(table)
    return failed


def touched(name: str, made: Plan, seed: int) -> Array:
    """Return whether each segment (s, AT_ONCE) of a plan touched a wall, by vehicles drawn anew that nobody steers."""
    file = load_vehicle(name)
    outlook, radius = Outlook.of(file, force=FORCE), SPACE.require_room(file)
    levels = tuple((np.array(outlook.disturbance) * np.diag(file.mass_matrix)).tolist())
    push = OrnsteinUhlenbeck(std=levels, time_constant=outlook.correlation)  # type: ignore[arg-type]
    out = np.ones((len(made.segments), AT_ONCE), dtype=np.bool_)
    for j, truth in enumerate(draws_of(outlook, AT_ONCE + 1, 10_000 + seed)[1:]):
        for i, each in enumerate(made.segments):
            commands = np.repeat(commands_of(each.segment, file), round(100.0 / RATE), axis=0)
            own = (seed * AT_ONCE + j) * 100 + i
            try:
                run = simulate(truth, commands=commands, dt=0.01, eta0=SPACE.eta0, disturbance=push, seed=own)
            except InputError:  # it grows beyond all bounds
                continue
            places = np.column_stack([run[axis].values for axis in "xyz"])
            out[i, j] = SPACE.clearance(places, radius).min() < 0.0
    return out


def leaving(runs: int, seed: int, workers: int) -> int:
    """Compare what plans state of leaving the space with what comes of them; return how often it is not close."""
    many, failed = runs * AT_ONCE, 0
    for pose, name in product((False, True), VEHICLES):
        made = plan(load_vehicle(name), space=SPACE, force=FORCE, pose=pose)
        tasks = [(name, made, seed + k) for k in range(runs)]
        title = f"{name}, {'with' if pose else 'without'} a pose"
        found = np.hstack(over(title, touched, tasks, workers))
        table = Table(title=f"{title}: ends at a wall, nobody steering, {many} runs")
        for head in ("Segment", "stated", "counted", "stated - counted"):
            table.add_column(head, justify="left" if head == "Segment" else "right")
        rows = [(f"{k}, {each.segment.duration:g} s", each.leaves) for k, each in enumerate(made.segments, 1)]
        counted = [*found.mean(axis=1), found.any(axis=0).mean()]
        for (segment, stated), share in zip([*rows, ("one of them", made.leaves)], counted, strict=True):
            failed += abs(stated - share) > CLOSE
            error = np.sqrt(share * (1.0 - share) / many)
            table.add_row(segment, f"{stated:.3f}", f"{share:.3f} ± {error:.3f}", f"{stated - share:+.3f}")
        show(table)
    return failed


def main() -> int:
    """Run the study; return 1 where a promise is out of its bounds."""
    options = arguments(__doc__ or "", runs=20)
    failed = 0
    for name in VEHICLES:
        if options.only and options.only not in name:
            continue
        made = planned(name)
        tasks = [(name, options.seed + k) for k in range(options.runs)]
        found = over(name, perform, tasks, options.workers)
        stated = np.median([each.stated for each in found], axis=0)
        rms = np.sqrt(np.mean([each.errors**2 for each in found], axis=0))
        middle = np.median([np.abs(each.errors) for each in found], axis=0) / 0.6745
        within = np.mean([np.abs(each.errors) <= 1.96 * each.stated for each in found], axis=0)
        table = Table(title=f"{name}: {len(made.segments)} segments, {made.manoeuvring:g} s, {options.runs} runs")
        for head in HEADS:
            table.add_column(head, justify="left" if head == "Coefficient" else "right")
        for k, each in enumerate(made.expected):
            ratios = stated[k] / each.after, middle[k] / each.after
            failed += any(not 0.8 <= ratio <= 1.3 for ratio in ratios)
            row = (each.after, stated[k], middle[k], rms[k])
            shares = [f"{100.0 * value:.1f} %" for value in row]
            table.add_row(each.name, *shares, *(f"{value:.2f}" for value in ratios), f"{100.0 * within[k]:.0f} %")
        show(table)
    if not options.only or options.only in "leaving":
        failed += leaving(options.runs, options.seed, options.workers)
    if not options.only or options.only in "stream":
        failed += streams(VEHICLES, options.runs, options.seed, options.workers)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
