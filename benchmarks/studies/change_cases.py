"""The seeded experiments on vehicles that change while they are learned.

surge      surge of the vLBV300 under a square wave, 1 mm, a random force of 0.25 N: after 90 s and up to 5 more,
           +2 kg of inertia and +30 % of drag
alarms     the same for half an hour, and nothing changes
all axes   the coupled experiment's vehicle, commands and sensors, a random wrench of 0.25 N and 0.025 N m; all
           inertias, drags, righting moment and net weight are learned along; it has been learned from 150 s and goes
           on in another run of 27 s. After 12 to 15 s: ballast (W - B by 2 N, up or down), righting (z_G - z_B by a
           quarter less), payload (+2 kg in surge, sway, heave, +30 % of their drags), a thruster at 60 %
young      all axes from the first sample on, told rigid body and thrusters alone, everything plausible learned: a
           payload after 18 to 45 s, while the stream goes over what it saw time and again; 15 s more
known      all axes: the vehicle becomes one of six that are known, or a seventh one
station    all axes by a wrench at 20 Hz: learned from 150 s, then held in place by feedback for hours, changed unseen
           (payload), and moved again
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from change_vehicles import FREE, as_stored, changed_vehicle, heavier, payload
from excitation import coupled_commands
from experiments import DT, SURGE_FREE, experiment

from towtank.core.arrays import Array
from towtank.identification import Learner
from towtank.simulation import Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import Vehicle

__all__ = [
    "KINDS",
    "SIX",
    "WRENCH",
    "Changed",
    "alarms",
    "all_axes",
    "feed",
    "known",
    "learned_base",
    "surge",
    "surge_course",
    "young",
]

KINDS = ("ballast", "righting", "payload", "thruster")
SIX = 6
BEFORE, AFTER = 90.0, 12.0  # s of surge before the change at least, and after it
_BASE, _BASES = 150.0, 4  # s of all axes before, and how many different ones
_CALM, _JITTER, _RUN = 12.0, 3.0, 27.0  # s
_YOUNG, _YOUNG_RUN = (18.0, 45.0), 15.0  # s
WRENCH = OrnsteinUhlenbeck(std=(0.25, 0.25, 0.25, 0.025, 0.025, 0.025), time_constant=2.0)
_SURGE = OrnsteinUhlenbeck(std=0.25, time_constant=2.0, axes=("X",))


@dataclass(frozen=True)
class Changed:
    """What came of one run.

    Attributes:
        case, seed: which. noticed: s from the change to the first event after it, inf for none.
        onset: s from the change to when it is said to have begun. right: whether it was named rightly.
        wrongly_body: a thruster that was called a change of the body. early: events before the change.
        within: s after which every judged coefficient stays within 10 % and 5 %. before: error of each [%] before it.
        seconds: of the run. texts: what was said.
    """

    case: str
    seed: int
    noticed: float
    onset: float
    right: bool
    wrongly_body: bool
    early: int
    within: tuple[float, float]
    before: tuple[float, ...]
    seconds: float
    texts: tuple[str, ...]


def surge(seed: int) -> Changed:
    """Run the surge experiment."""
    learner, run, other, when = _surge_run(seed)
    course = _followed(learner, run, SURGE_FREE, start=0.0)
    return _outcome("surge", seed, learner, when, course, experiment("s1-1mm-square").truth, other, SURGE_FREE)


def surge_course(seed: int) -> tuple[Array, Array, float, float]:
    """Run it once to be drawn.

    Returns:
        Time, total inertia and drag and their deviations (m, 5); both (2, 2) before and after; when it changed [s];
        s from then until it was noticed.
    """
    learner, run, other, when = _surge_run(seed)
    out = []

    def read(t: float) -> None:
        if t > when - 5.0:
            estimate = learner.estimate
            std = {each.name: each.std for each in estimate.coefficients}
            out.append([t, *_quantities(learner, learner.vehicle, SURGE_FREE), *(std[name] for name in SURGE_FREE)])

    feed(learner, run, 0.0, read)
    truth = [
        [abs(_quantity(vehicle, name, vehicle.coefficient(name))) for name in SURGE_FREE]
        for vehicle in (experiment("s1-1mm-square").truth, other)
    ]
    noticed = min(float(event.details["noticed"]) for event in learner.events if "noticed" in event.details)
    return np.array(out), np.array(truth), when, noticed - when


def _surge_run(seed: int) -> tuple[Learner, Any, Vehicle, float]:
    case = experiment("s1-1mm-square")
    when = round(BEFORE + 5.0 * np.random.default_rng(seed).random(), 2)
    other = heavier(case.truth, ("X_udot",), ("X_uu",))
    commands = manoeuvre("paper-square", case.truth, duration=when + AFTER, dt=DT).commands
    run = simulate(
        case.truth, commands=commands, dt=DT, sensors=Mocap(), disturbance=_SURGE, seed=seed, changes=[(when, other)]
    )
    return Learner(case.start, free=SURGE_FREE, delay=0.0), run, other, when


def alarms(seed: int, seconds: float = 1800.0) -> Changed:
    """Run surge with no change; what is noticed is false."""
    case = experiment("s1-1mm-square")
    commands = manoeuvre("paper-square", case.truth, duration=seconds, dt=DT).commands
    run = simulate(case.truth, commands=commands, dt=DT, sensors=Mocap(), disturbance=_SURGE, seed=seed)
    learner = Learner(case.start, free=SURGE_FREE, delay=0.0)
    learner.run(run)
    texts = tuple(event.text for event in learner.events)
    none = (np.inf, np.inf)
    return Changed("alarms", seed, np.inf, np.inf, not texts, False, len(texts), none, (), seconds, texts)


def all_axes(kind: str, seed: int, folder: Path) -> Changed:
    """Run one of `KINDS`, from a base that `learned_base` left in the folder."""
    case = experiment("coupled-pose")
    random = np.random.default_rng(seed)
    other, thruster = changed_vehicle(kind, random)
    run, when = _coupled_run(other, seed, random)
    learner = Learner.load(learned_base(seed % _BASES, folder), case.start)
    learner.restart()
    judged = ("BG_z",) if kind == "righting" else ("X_udot", "Y_vdot", "Z_wdot")
    course = _followed(learner, run, judged, start=when - 1.0)
    found = _outcome(kind, seed, learner, when, course, case.truth, other, judged)
    said = next((event for event in learner.events if float(event.details.get("noticed", 0.0)) > when), None)
    blamed = None if said is None else said.details.get("thruster")
    right = said is not None and blamed == thruster
    return replace(found, right=right, wrongly_body=bool(thruster) and said is not None and blamed is None)


def young(seed: int) -> Changed:
    """Run a stream that takes up a payload soon after its beginning."""
    case, random = experiment("coupled-pose"), np.random.default_rng(20_000 + seed)
    other, _ = changed_vehicle("payload", random)
    when = round(random.uniform(*_YOUNG), 2)
    commands = np.roll(_commands(), -int(random.integers(0, 10_000)), axis=0)[: round((when + _YOUNG_RUN) / DT)]
    run = simulate(
        case.truth, commands=commands, dt=DT, eta0=case.eta0, sensors=case.sensors, disturbance=WRENCH, seed=seed,
        changes=[(when, other)],
    )  # fmt: skip
    learner, judged = Learner(case.start), ("X_udot", "Y_vdot", "Z_wdot")
    course = _followed(learner, run, judged, start=when - 1.0)
    return _outcome("young", seed, learner, when, course, case.truth, other, judged)


def known(index: int, seed: int, folder: Path) -> Changed:
    """Run a vehicle that becomes one of six known ones (index 0 .. 5), or another one (6)."""
    case = experiment("coupled-pose")
    random = np.random.default_rng(10_000 + seed)
    vehicles = [payload(np.random.default_rng([seed, k])) for k in range(SIX + 1)]
    stored = {f"configuration {k}": as_stored(vehicles[k], random) for k in range(SIX)}
    run, when = _coupled_run(vehicles[index], seed, random)
    learner = Learner.load(learned_base(seed % _BASES, folder), case.start, known=stored)
    learner.restart()
    learner.run(run)
    taken: dict[str, float] = {}
    for event in learner.events:
        if event.kind == "configuration" and event.t > when:
            name = str(event.details["configuration"])
            if float(event.details["taken"]) > 0.0:
                taken.setdefault(name, event.t - when)
            else:
                taken.pop(name, None)
    first = next((event for event in learner.events if float(event.details.get("noticed", 0.0)) > when), None)
    at = taken.get(f"configuration {index}", np.inf)
    right = set(taken) == {f"configuration {index}"} if index < SIX else not taken
    early = sum(float(event.details.get("noticed", event.t)) <= when for event in learner.events)
    noticed = np.inf if first is None else float(first.details["noticed"]) - when
    texts = tuple(event.text for event in learner.events)
    return Changed("known" if index < SIX else "unknown", seed, noticed, at, right, False, early,
                   (np.inf, np.inf), (), _RUN, texts)  # fmt: skip


def learned_base(index: int, folder: Path) -> Path:
    """Return the checkpoint of a learner that has seen 150 s of all axes, made where it is missing."""
    path = folder / f"base-{index}.npz"
    if not path.exists():
        case = experiment("coupled-pose")
        run = simulate(
            case.truth, commands=_commands(), dt=DT, eta0=case.eta0, sensors=case.sensors, disturbance=WRENCH,
            seed=100_000 + index,
        )  # fmt: skip
        learner = Learner(case.start, free=FREE)
        learner.run(run)
        part = folder / f"base-{index}.{os.getpid()}.npz"
        learner.save(part)
        part.replace(path)
    return path


# -- inside


@cache
def _commands() -> Array:
    return coupled_commands(experiment("coupled-pose").truth, _BASE, DT)


def _coupled_run(other: Vehicle, seed: int, random: np.random.Generator) -> tuple[Any, float]:
    case = experiment("coupled-pose")
    when = round(_CALM + _JITTER * random.random(), 2)
    commands = np.roll(_commands(), -int(random.integers(0, 10_000)), axis=0)[: round(_RUN / DT)]
    run = simulate(
        case.truth, commands=commands, dt=DT, eta0=case.eta0, sensors=case.sensors, disturbance=WRENCH, seed=seed,
        changes=[(when, other)],
    )  # fmt: skip
    return run, when


def _followed(learner: Learner, run: Any, names: tuple[str, ...], *, start: float) -> Array:
    """Feed a run row by row; return time and total inertias or coefficients (m, 1 + k), read every 0.25 s."""
    vehicle = learner.vehicle
    out, following = [], start

    def read(t: float) -> None:
        nonlocal following
        if t >= following:
            following = t + 0.25
            out.append([t, *_quantities(learner, vehicle, names)])

    feed(learner, run, 0.0, read)
    return np.array(out)


def feed(learner: Learner, run: Any, offset: float, each: Any = None) -> None:
    """Give a recording to `learner.update`, its times later by `offset` [s]."""
    poses = np.column_stack([run[name].values for name in ("x", "y", "z", "phi", "theta", "psi")])
    t = run["x"].t
    commands = [channel for channel in run if channel.startswith("cmd_")]
    inputs = commands or ["X", "Y", "Z", "K", "M", "N"]
    held = np.column_stack([run[name].values for name in inputs])
    key = "commands" if commands else "wrench"
    for k in range(t.size):
        more = {key: held[k]} if k < held.shape[0] else {}
        learner.update(offset + float(t[k]), pose=poses[k], **more)
        if each is not None:
            each(float(t[k]))


def _quantities(learner: Learner, vehicle: Vehicle, names: tuple[str, ...]) -> list[float]:
    estimate = learner.estimate
    out = []
    for name in names:
        found = {c.name: c.value for c in estimate.coefficients}.get(name, np.nan)
        out.append(_quantity(vehicle, name, float(found)))
    return out


def _quantity(vehicle: Vehicle, name: str, value: float) -> float:
    row = {"X_udot": 0, "Y_vdot": 1, "Z_wdot": 2}.get(name)
    return value if row is None else float(vehicle.rigid_body_matrix[row, row]) - value


def _outcome(
    case: str, seed: int, learner: Learner, when: float, course: Array, truth: Vehicle, other: Vehicle,
    names: tuple[str, ...],
) -> Changed:  # fmt: skip
    was, is_ = (
        np.array([_quantity(truth, name, vehicle.coefficient(name)) for name in names]) for vehicle in (truth, other)
    )
    after = course[course[:, 0] >= when]
    error = np.max(np.abs(after[:, 1:] / is_ - 1.0), axis=1)
    before = 100.0 * np.abs(course[course[:, 0] < when][-1, 1:] / was - 1.0)
    within = []
    for limit in (0.10, 0.05):
        bad = np.flatnonzero(~(error < limit))
        last = bad[-1] + 1 if bad.size else 0
        within.append(float(after[last, 0] - when) if last < len(after) else np.inf)
    told = [(float(event.details.get("noticed", event.t)) - when, event) for event in learner.events]
    late = [(t, event) for t, event in told if t > 0.0]
    return Changed(
        case=case,
        seed=seed,
        noticed=late[0][0] if late else np.inf,
        onset=late[0][1].t - when if late else np.inf,
        right=bool(late) and late[0][1].kind == "change",
        wrongly_body=False,
        early=len(told) - len(late),
        within=(within[0], within[1]),
        before=tuple(before),
        seconds=float(course[-1, 0]),
        texts=tuple(f"{t:+.2f} {event.kind}: {event.text}" for t, event in told),
    )
