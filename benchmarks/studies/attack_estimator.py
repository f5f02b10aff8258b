"""Logs that are wrong in every way that logs are: nothing may come out as NaN, nothing wrong may be called known.

    python benchmarks/studies/attack_estimator.py [--runs 3] [--only "degrees,frozen u"] [--seconds 40]

A vehicle of which everything is known is driven on all axes at once under two sets of sensors (motion capture; DVL,
gyro, attitude, depth and accelerometer), and the log is spoiled in one way (`ABUSES`). It is read by the CSV reader and
learned by every method as `towtank learn` does, and streamed row by row, as it stands in the log, into every streaming
method, which is read forty times. A coefficient that is called identified and is off by more than four of its own
deviations is wrong. Wrong is allowed only where the program says that the log contradicts itself or its numbers cannot
be right; it is then counted as "said". What is wrong and is not said, an exception other than a refusal in one line,
and a number that is not finite are faults: the study ends with 1 where there is one.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from excitation import coupled_commands
from experiments import chosen, experiment
from report import show
from rich.table import Table
from runner import arguments, over, write_json

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification import Estimate, Learner
from towtank.identification.logs import learn_recordings
from towtank.methods import METHODS, STREAMING_METHODS
from towtank.readers import read
from towtank.recording import Recording, align
from towtank.recording.standard import ACCELERATIONS, LINEAR_VELOCITY, POSE, RATES, VELOCITIES
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, simulate
from towtank.vehicle import COEFFICIENTS, Vehicle

WRONG = 4.0  # deviations beyond which what is called identified is wrong
_WRENCH = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05), time_constant=2.0)
_START = np.array([0.0, 0.0, 5.0, 0.0, 0.0, 0.0])
_STEP, _READINGS = 0.02, 40  # s; of a stream
_SENSORS: dict[str, Mocap | Ins] = {"mocap": Mocap(rate=50.0), "ins": Ins()}
_ANGLES = ("phi", "theta", "psi")
_WAYS = (*(f"learn {name}" for name in METHODS), *(f"stream {name}" for name in STREAMING_METHODS))


class Log(NamedTuple):
    """Rows in the order of the file: t (n,) [s], and columns by name (n,), NaN where a cell is empty."""

    t: Array
    columns: dict[str, Array]

    def changed(self, names: Sequence[str], change: Callable[[Array], Array]) -> Log:
        """Return the log with some of its columns changed."""
        return Log(self.t, {name: change(x) if name in names else x for name, x in self.columns.items()})

    @property
    def late(self) -> np.ndarray:
        """Rows of the second half."""
        return np.asarray(self.t > 0.5 * (self.t[0] + self.t[-1]))

    @property
    def commands(self) -> list[str]:
        """Names of the columns of commands."""
        return [name for name in self.columns if name.startswith("cmd_")]

    @property
    def motion(self) -> list[str]:
        """Names of all other columns."""
        return [name for name in self.columns if not name.startswith("cmd_")]


Spoil = Callable[[Log, np.random.Generator], Log]


def _kept(x: Array, value: float) -> Array:
    """Return a column with one value wherever it has any."""
    return np.where(np.isnan(x), np.nan, value)


def _constant(log: Log, _: np.random.Generator) -> Log:
    return Log(log.t, {name: _kept(x, float(x[~np.isnan(x)][0])) for name, x in log.columns.items()})


def _steady_commands(log: Log, _: np.random.Generator) -> Log:
    return log.changed(log.commands, lambda x: _kept(x, 30.0))


def _frozen(*names: str) -> Spoil:
    """Sensors that show one value for the whole log."""
    return lambda log, _: log.changed(names, lambda x: _kept(x, float(x[~np.isnan(x)][0])))


def _stuck(*names: str) -> Spoil:
    """Sensors that repeat the value of the middle of the log from there on."""

    def spoil(log: Log, _: np.random.Generator) -> Log:
        late = log.late
        last = {name: float(x[~late & ~np.isnan(x)][-1]) for name, x in log.columns.items() if name in names}
        return Log(log.t, {n: np.where(late, _kept(x, last[n]), x) if n in last else x for n, x in log.columns.items()})

    return spoil


def _ends(value: float, *names: str) -> Spoil:
    """Sensors that show a fixed value, or nothing (NaN), from the middle of the log on."""
    return lambda log, _: log.changed(names, lambda x: np.where(log.late, _kept(x, value), x))


def _scaled(factor: float, *names: str) -> Spoil:
    return lambda log, _: log.changed(names, lambda x: factor * x)


def _reversed(which: slice) -> Spoil:
    return lambda log, _: log.changed(log.commands[which], np.negative)


def _swapped(log: Log, _: np.random.Generator) -> Log:
    first, second = log.commands[:2]
    return Log(log.t, {**log.columns, first: log.columns[second], second: log.columns[first]})


def _times(change: Callable[[Array, np.random.Generator], Array]) -> Spoil:
    return lambda log, random: Log(change(log.t, random), log.columns)


def _noisy(factor: float) -> Spoil:
    """Noise as large as so many times the motion of each channel."""

    def spoil(log: Log, random: np.random.Generator) -> Log:
        return log.changed(log.motion, lambda x: x + factor * np.nanstd(x) * random.standard_normal(x.size))

    return spoil


def _spikes(log: Log, random: np.random.Generator) -> Log:
    def spiked(x: Array) -> Array:
        return np.where(random.random(x.size) < 0.01, x + 1e6 * random.standard_normal(x.size), x)

    return log.changed(log.motion, spiked)


def _holes(log: Log, random: np.random.Generator) -> Log:
    return log.changed([*log.columns], lambda x: np.where(random.random(x.size) < 0.5, np.nan, x))


def _shuffled(log: Log, random: np.random.Generator) -> Log:
    order = np.argsort(np.arange(log.t.size) + random.integers(-3, 4, log.t.size), kind="stable")
    return Log(log.t[order], {name: x[order] for name, x in log.columns.items()})


def _silent_commands(log: Log, _: np.random.Generator) -> Log:
    return log.changed(log.commands, lambda x: np.where(log.late, np.nan, x))


ABUSES: dict[str, Spoil] = {
    "nothing": lambda log, _: log,
    "all constant": _constant,
    "commands constant": _steady_commands,
    "frozen u v w": _frozen("u", "v", "w"),
    "frozen p q r": _frozen("p", "q", "r"),
    "frozen attitude": _frozen(*_ANGLES),
    "frozen x y": _frozen("x", "y"),
    "frozen z": _frozen("z"),
    "stuck u v w": _stuck("u", "v", "w"),
    "stuck attitude": _stuck(*_ANGLES),
    "stuck pose": _stuck(*POSE),
    "stuck p q r": _stuck("p", "q", "r"),
    "all stuck": _stuck(*POSE, *VELOCITIES, *ACCELERATIONS),
    "u v w end": _ends(np.nan, "u", "v", "w"),
    "u v w to zero": _ends(0.0, "u", "v", "w"),
    "pose ends": _ends(np.nan, *POSE),
    "pose to zero": _ends(0.0, *POSE),
    "commands end": _silent_commands,
    "degrees: rates": _scaled(np.degrees(1.0), *RATES),
    "degrees: angles": _scaled(np.degrees(1.0), *_ANGLES),
    "degrees: both": _scaled(np.degrees(1.0), *RATES, *_ANGLES),
    "mm for m": _scaled(1e3, "x", "y", "z", *LINEAR_VELOCITY),
    "ms for s": _times(lambda t, _: 1e3 * t),
    "s for ms": _times(lambda t, _: 1e-3 * t),
    "one thruster reversed": _reversed(slice(0, 1)),
    "all thrusters reversed": _reversed(slice(None)),
    "two outputs swapped": _swapped,
    "commands saturated": lambda log, _: log,  # of the vehicle, see `log_of`
    "repeated stamps": _times(lambda t, _: t[5 * (np.arange(t.size) // 5)]),
    "all stamps alike": _times(lambda t, _: np.zeros_like(t)),
    "stamps of 0.1 s": _times(lambda t, _: np.floor(10.0 * t) / 10.0),
    "an hour's gap": _times(lambda t, _: np.where(t > 0.5 * t[-1], t + 3600.0, t)),
    "an hour back": _times(lambda t, _: np.where(t > 0.5 * t[-1], t - 3600.0, t)),
    "jittered stamps": _times(lambda t, random: np.sort(t + 0.02 * random.standard_normal(t.size))),
    "out of order": _shuffled,
    "noise as motion": _noisy(1.0),
    "noise 30 times motion": _noisy(30.0),
    "spikes of 1e6": _spikes,
    "half of all cells empty": _holes,
}  # fmt: skip


@cache
def vehicles() -> tuple[Vehicle, Vehicle]:
    """Return the vehicle that is driven, and what a learner is told of it: rigid body and thrusters."""
    case = experiment("coupled-pose")
    return case.truth, case.start


def log_of(sensors: str, abuse: str, seconds: float, seed: int) -> Log:
    """Return a run with what is wrong with it."""
    truth, _ = vehicles()
    asked = coupled_commands(truth, seconds, _STEP)
    given = np.clip(asked, -25.0, 25.0) if abuse == "commands saturated" else asked
    own = _SENSORS[sensors]
    run = simulate(truth, commands=given, dt=_STEP, eta0=_START, sensors=own, disturbance=_WRENCH, seed=seed)
    t = np.unique(np.concatenate([channel.t for channel in run.channels.values()]))
    columns = {}
    for name, channel in run.channels.items():
        columns[name] = np.full(t.size, np.nan)
        columns[name][np.searchsorted(t, channel.t)] = channel.values
    for k, name in enumerate(name for name in run if name.startswith("cmd_")):
        rows = ~np.isnan(columns[name])
        columns[name][rows] = asked[np.minimum((t[rows] / _STEP + 0.5).astype(np.intp), len(asked) - 1), k]
    return ABUSES[abuse](Log(t, columns), np.random.default_rng(seed))


def as_read(log: Log, folder: Path) -> Recording:
    """Write a log as CSV, and read it."""
    path = folder / "log.csv"
    names = list(log.columns)
    table = np.column_stack([log.t, *log.columns.values()])
    lines = [",".join("" if np.isnan(x) else f"{x:.9g}" for x in row) for row in table]
    path.write_text("\n".join([",".join(["t", *names]), *lines]) + "\n")
    return read(path)


@dataclass(frozen=True)
class Tried:
    """What came of one log by one way.

    Attributes:
        known: coefficients called identified at the end. wrong: those that are off by more than four deviations at the
            end; ever: at any reading. worst: deviations by which the worst is off, at any reading.
        said: what the program says cannot be right. refused: the line of a refusal.
        fault: an exception or a number that is not finite; "" where there is none.
    """

    abuse: str
    sensors: str
    way: str
    seed: int
    known: int = 0
    wrong: tuple[str, ...] = ()
    ever: tuple[str, ...] = ()
    worst: float = 0.0
    said: str = ""
    refused: str = ""
    fault: str = ""
    seconds: float = 0.0

    @property
    def silent(self) -> bool:
        """Whether something wrong was called known, and nothing was said."""
        return bool(self.ever) and not self.said


def judged(estimate: Estimate, truth: Vehicle) -> tuple[int, dict[str, float], str]:
    """Return how many coefficients are identified, by how many deviations those that are wrong are off, and a fault."""
    known, wrong, fault = 0, {}, ""
    for each in estimate.coefficients:
        if not each.identified or each.name not in COEFFICIENTS:
            continue
        known += 1
        if not (np.isfinite(each.value) and np.isfinite(each.std) and each.std >= 0.0):
            fault = f"{each.name} is called identified and is {each.value} ± {each.std}"
            continue
        off = abs(each.value - truth.coefficient(each.name)) / max(each.std, 1e-300)
        if off > WRONG:
            wrong[each.name] = off
    if not np.isfinite(estimate.covariance[np.ix_(*2 * [np.flatnonzero(estimate.identified)])]).all():
        fault = fault or "the covariance is not finite"
    return known, wrong, fault


def tried(abuse: str, sensors: str, way: str, seconds: float, seed: int) -> Tried:
    """Spoil a log, and learn from it in one way. Never raises for what an estimator does."""
    began, log = time.perf_counter(), log_of(sensors, abuse, seconds, seed)
    out = Tried(abuse, sensors, way, seed)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            out = _learned(log, out) if way.startswith("learn") else _streamed(log, out)
    except InputError as error:
        out = replace(out, refused=str(error))
    except Exception as error:
        out = replace(out, fault=f"{type(error).__name__}: {error}")
    return replace(out, seconds=time.perf_counter() - began)


def _learned(log: Log, out: Tried) -> Tried:
    truth, start = vehicles()
    with tempfile.TemporaryDirectory() as folder:
        recording = as_read(log, Path(folder))
    learning = learn_recordings(start, [recording], method=out.way.split()[1])
    known, wrong, fault = judged(learning.estimate, truth)
    said = "; ".join([*(each.text for each in learning.findings if not each.allowed_for), *_dead(recording)])
    names = tuple(sorted(wrong))
    worst = max(wrong.values(), default=0.0)
    return replace(out, known=known, wrong=names, ever=names, worst=worst, said=said, fault=fault)


def _dead(recording: Recording) -> list[str]:
    """Return that sensors are dead, as `learn` says it."""
    dead = align(recording).repairs.dead
    return [f"dead: {', '.join(dead)}"] if dead else []


def _streamed(log: Log, out: Tried) -> Tried:
    truth, start = vehicles()
    learner = Learner(start, out.way.split()[1])
    groups = {"pose": POSE, "velocity": VELOCITIES, "acceleration": ACCELERATIONS, "commands": tuple(log.commands)}
    empty = np.full(log.t.size, np.nan)
    tables = {key: np.column_stack([log.columns.get(n, empty) for n in names]) for key, names in groups.items()}
    held = np.full(len(groups["commands"]), np.nan)
    every = max(1, log.t.size // _READINGS)
    known, ever, fault = 0, dict[str, float](), ""
    wrong: dict[str, float] = {}
    for i, t in enumerate(log.t):
        row = {key: table[i] for key, table in tables.items()}
        new = row.pop("commands")
        held = np.where(np.isnan(new), held, new)
        commanded = not np.isnan(new).all() and not np.isnan(held).any()
        learner.update(float(t), **row, commands=held if commanded else None)
        if i % every == every - 1 or i == log.t.size - 1:
            known, wrong, bad = judged(learner.estimate, truth)
            ever = {name: max(off, ever.get(name, 0.0)) for name, off in (ever | wrong).items()}
            fault = fault or bad
    worst = max(ever.values(), default=0.0)
    return replace(out, known=known, wrong=tuple(sorted(wrong)), ever=tuple(sorted(ever)), worst=worst, fault=fault)


def table_of(found: Sequence[Tried], abuses: Sequence[str]) -> Table:
    """Return one row for each abuse, and a column for each way."""
    table = Table(title="wrong and not said / wrong and said / withheld or refused / right, runs", title_justify="left")
    for name in ("abuse", *_WAYS, "worst, std", "faults"):
        table.add_column(name, justify="left" if name == "abuse" else "right")
    for abuse in abuses:
        own = [each for each in found if each.abuse == abuse]
        cells = []
        for way in _WAYS:
            some = [each for each in own if each.way == way]
            silent = sum(each.silent for each in some)
            said = sum(bool(each.ever) and bool(each.said) for each in some)
            none = sum(not each.ever and not each.known for each in some)
            cells.append(f"{silent} / {said} / {none} / {len(some) - silent - said - none}")
        worst = max((each.worst for each in own if each.silent), default=0.0)
        table.add_row(abuse, *cells, f"{worst:.3g}" if worst else "", str(sum(bool(each.fault) for each in own)))
    return table


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where there is no fault and nothing wrong was called known without a word."""
    own = [*(sys.argv[1:] if argv is None else argv)]
    mine = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    mine.add_argument("--seconds", type=float, default=40.0)
    mine.add_argument("--sensors", choices=tuple(_SENSORS))
    about, own = mine.parse_known_args(own)
    seconds, sets = about.seconds, [about.sensors] if about.sensors else [*_SENSORS]
    options = arguments(__doc__ or "", 3, own)
    abuses = chosen(ABUSES, options.only)
    tasks = [
        (abuse, sensors, way, seconds, options.seed + k)
        for abuse in abuses for sensors in sets for way in _WAYS for k in range(options.runs)
    ]  # fmt: skip
    found = over("abuses", tried, tasks, options.workers, failed=lambda each: each.silent or bool(each.fault))
    show(table_of(found, abuses))
    for each in found:
        where = f"{each.abuse}, {each.sensors}, {each.way}, seed {each.seed}"
        if each.fault:
            print(f"FAULT {where}: {each.fault}")
        elif each.silent:
            late = "" if each.wrong else " (on the way; withheld or right at the end)"
            print(f"WRONG {where}: {', '.join(each.ever)}, up to {each.worst:.3g} deviations{late}")
    runs = [{name: getattr(each, name) for name in Tried.__dataclass_fields__} for each in found]
    write_json(options.output, {"study": "attack_estimator", "seconds": seconds, "runs": runs})
    return 1 if any(each.silent or each.fault for each in found) else 0


if __name__ == "__main__":
    sys.exit(main())
