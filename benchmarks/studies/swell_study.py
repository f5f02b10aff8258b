"""A pilot in waves: how often is a change cried that never was, and how soon is one that was?

    python benchmarks/studies/swell_study.py [--runs 10] [--only waves] [--output swell.json]

A BlueROV2 Heavy, of which the learner is told rigid body and thrusters, is flown by stick: each axis rests or is pushed
to a level for some seconds, a hand needs a third of a second for full throw. Commands come late by 0.1 s, thrusters lag
by 0.08 s and give 5 % more or less than their curves say, a random force of 0.4 N acts, and in `waves` the water goes
to and fro with 0.03 to 0.1 m/s (standard deviation) at periods of 4 to 8 s. A `dvl` with gyros, depth and attitude, or
a `camera`, measures. Twenty minutes of one stream, in which nothing changes; ten, in which the same waves come up
after two or three (`rising`), or a current of 0.25 m/s begins to flow within 20 s (`flowing`), which must be told, and
no change be cried; or, by DVL, in still water, two minutes and then a `payload` of 8 % of the mass, which weighs
nothing in water, 0.1 m below the centre of gravity; or a centre of gravity `shifted` by 12 mm ahead. Of these it is
asked, too, whether what the event tells of each coefficient's step, as it stands at last, is within four of its
deviations.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from by_case import by_case
from place_study import BY_DVL
from summary import Check

from towtank.core.arrays import Array
from towtank.identification import Learner
from towtank.recording import Recording
from towtank.recording.event import Event
from towtank.recording.standard import POSE
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, RisingCurrent, Waves, simulate
from towtank.simulation.sensors.sensor import Sensors
from towtank.vehicle import Vehicle, allocate, index, load_vehicle

SENSORS: dict[str, tuple[Sensors, Sequence[str]]] = {"dvl": (Ins(), BY_DVL), "camera": (Mocap(), POSE)}
CASES = ("waves dvl", "waves camera", "rising dvl", "rising camera", "flowing dvl", "payload dvl", "shifted dvl")
OTHER_WATER = ("rising", "flowing")
MINUTES = 20.0  # of a stream in which nothing changes
CALM = (120.0, 180.0)  # s after which the water begins to move, in half that time
FLOWS, WITHIN = 0.25, 20.0  # m/s, s
BEFORE, AFTER = 120.0, 30.0  # s of one in which something does
HEAVIER, BELOW, AHEAD = 0.08, 0.1, 0.012  # of the mass, m, m
_DT = 0.01  # s
_WATER = OrnsteinUhlenbeck((0.4, 0.4, 0.4, 0.02, 0.02, 0.02), 2.0)
_FULL = (50.0, 45.0, 50.0, 3.0, 4.0, 7.0)  # N, N m: at full throw
_PUSHED = (0.75, 0.5, 0.45, 0.3, 0.35, 0.65)  # how often an axis is
_LEVELS = (0.25, 0.4, 0.6, 0.8, 1.0)
_THROW = 0.35  # s from rest to full throw


class Flight(NamedTuple):
    """What came of one stream.

    Attributes:
        seconds: how long it was. false: what was cried though nothing had changed. noticed: s from the change, or from
            when the water began to move, until it was, inf where it was not or none was. said: of the first true
            notice, as it stands at last. body: whether that blamed the body, not a thruster. right: share of the steps
            that it tells which lie within 4 of their deviations, NaN where it tells none.
    """

    seconds: float
    false: list[str]
    noticed: float
    said: str
    body: bool
    right: float = math.nan


def flown(case: str, seed: int, minutes: float = MINUTES) -> tuple[Vehicle, Recording, float]:
    """Return what the learner is told, the log, and when the vehicle or the water changed, inf for never."""
    random = np.random.default_rng([seed, 1])
    told, truth = _vehicles(random)
    seconds, begin = 60.0 * minutes, 0.0
    changes: list[tuple[float, Vehicle]] = []
    if case.split()[0] in OTHER_WATER:
        begin, seconds = np.random.default_rng([seed, 2]).uniform(*CALM), 0.5 * seconds
    if case.split()[0] in ("payload", "shifted"):
        when = round(BEFORE + 5.0 * random.random(), 2)
        changes, seconds = [(when, changed(case, truth))], when + AFTER
    size, period, heading = random.uniform(0.03, 0.1), random.uniform(4.0, 8.0), random.uniform(-math.pi, math.pi)
    water: Waves | RisingCurrent | None = None
    if case.split()[0] in ("waves", "rising"):
        water = Waves(size, period, heading, begin=begin)
    elif "flowing" in case:
        flow = (FLOWS * math.cos(heading), FLOWS * math.sin(heading), 0.0)
        water = RisingCurrent(flow, begin=begin, seconds=WITHIN)
    axes = range(6) if seed % 2 else (0, 1, 2, 5)
    trim = [0.0, 0.0, truth.weight_minus_buoyancy, 0.0, 0.0, 0.0]
    commands = allocate(told, sticks(seconds, axes, random) * _FULL - trim)
    sensors, measured = SENSORS[case.split()[1]]
    run = simulate(
        truth, commands=commands, dt=_DT, sensors=sensors, disturbance=_WATER, changes=changes, seed=seed,
        waves=water,
    )  # fmt: skip
    kept = run.without(*(name for name in run if name not in measured and not name.startswith("cmd_")))
    return told, kept, changes[0][0] if changes else begin or math.inf


def changed(case: str, vehicle: Vehicle) -> Vehicle:
    """Return what becomes of a vehicle in a case."""
    return _loaded(vehicle) if "payload" in case else _shifted(vehicle)


def right_steps(case: str, event: Event) -> float:
    """Return the share of the steps that an event tells which lie within 4 of their deviations."""
    before = load_vehicle("bluerov2_heavy")
    after = changed(case, before)
    off = []
    for name, step in event.details.items():
        if f"{name}_std" in event.details and not name.startswith("gain_"):
            kind, i, j = index(name)
            if kind == "mass":  # the learner knows of one rigid body: added mass stands for the other's
                true = before.mass_matrix[i, j] - after.mass_matrix[i, j]
            else:
                true = after.coefficient(name) - before.coefficient(name)
            off.append(abs(float(step) - true) / float(event.details[f"{name}_std"]))
    return float(np.mean(np.array(off) < 4.0)) if off else math.nan


def sticks(seconds: float, axes: Sequence[int] | range, random: np.random.Generator) -> Array:
    """Return where the sticks are (n, 6), -1 .. 1, every 10 ms."""
    wanted = np.zeros((round(seconds / _DT), 6))
    for axis in axes:
        t = 1.0
        while t < seconds:
            held = random.uniform(0.4, 2.5) if axis == 5 else random.uniform(0.7, 5.0)
            if random.random() < _PUSHED[axis]:
                wanted[round(t / _DT) : round((t + held) / _DT), axis] = random.choice((-1, 1)) * random.choice(_LEVELS)
            t += held
    out = wanted.copy()
    for k in range(1, len(out)):
        out[k] = out[k - 1] + np.clip(wanted[k] - out[k - 1], -_DT / _THROW, _DT / _THROW)
    return out


def _vehicles(random: np.random.Generator) -> tuple[Vehicle, Vehicle]:
    """Return the vehicle that the learner is told of, and the one that flies."""
    full = load_vehicle("bluerov2_heavy")
    thrusters = tuple(
        each.model_copy(update={"gain": each.gain * math.exp(0.05 * random.standard_normal()), "time_constant": 0.08})
        for each in full.thrusters
    )
    truth = full.model_copy(update={"thrusters": thrusters, "command_delay": 0.1})
    centre = full.rigid_body.centre_of_gravity
    told = full.model_copy(
        update={
            "hydrodynamics": {},
            "command_delay": 0.0,
            "buoyancy": full.buoyancy.model_copy(update={"force": None, "centre": centre}),
        }
    )
    return told, truth


def _loaded(vehicle: Vehicle) -> Vehicle:
    """Return it with a payload that displaces what it weighs, where it is: a point below the centre of gravity."""
    body, B = vehicle.rigid_body, vehicle.buoyant_force
    more = HEAVIER * body.mass
    r_G, r_B = np.array(body.centre_of_gravity), np.array(vehicle.buoyancy.centre)
    down = np.array([0.0, 0.0, BELOW])
    share, weight = HEAVIER / (1.0 + HEAVIER), more * vehicle.weight / body.mass
    heavier = body.model_copy(
        update={
            "mass": body.mass + more,
            "centre_of_gravity": tuple(r_G + share * down),
            "inertia": tuple(
                tuple(row) for row in body.tensor + np.diag([1.0, 1.0, 0.0]) * share * body.mass * BELOW**2
            ),
        }
    )
    centre = (r_B * B + (r_G + down) * weight) / (B + weight)
    floats = vehicle.buoyancy.model_copy(update={"force": B + weight, "centre": tuple(centre)})
    return vehicle.model_copy(update={"rigid_body": heavier, "buoyancy": floats})


def _shifted(vehicle: Vehicle) -> Vehicle:
    x, y, z = vehicle.rigid_body.centre_of_gravity
    body = vehicle.rigid_body.model_copy(update={"centre_of_gravity": (x + AHEAD, y, z)})
    return vehicle.model_copy(update={"rigid_body": body})


def learned(case: str, seed: int) -> Flight:
    """Return what a stream says of one flight."""
    told, run, when = flown(case, seed)
    learner = Learner(told)
    learner.run(run)
    events = [(float(each.details.get("noticed", each.t)), each) for each in learner.events]
    if "waves" in case:  # no alarm: they are there
        events = [(t, each) for t, each in events if each.kind != "water"]
    moves = case.split()[0] in OTHER_WATER
    true = [(t, each) for t, each in events if t > when and (each.kind == "water") == moves]
    false = [f"{t:.0f} s: {each.text}" for t, each in events if (t, each) not in true]
    if not true:
        return Flight(run.duration, false, math.inf, "", body=False)
    t, first = true[0]
    right = right_steps(case, first) if first.kind == "change" else math.nan
    return Flight(run.duration, false, t - when, first.text, body=first.kind == "change", right=right)


def checks(case: str, found: Sequence[Flight]) -> list[Check]:
    """Return what must hold of one case."""
    hours = sum(each.seconds for each in found) / 3600.0
    false = sum(len(each.false) for each in found)
    if "waves" in case:
        return [Check(f"{case}: false alarms an hour, in {hours:.1f} h", false / hours, high=1.0)]
    if case.split()[0] in OTHER_WATER:
        alike = float(np.mean([math.isfinite(each.noticed) for each in found]))
        return [
            Check(f"{case}: false alarms an hour, in {hours:.1f} h", false / hours, high=1.0),
            Check(f"{case}: told, share", alike, low=0.9),
        ]
    return [
        Check(f"{case}: noticed after, s, median", float(np.median([each.noticed for each in found])), high=5.0),
        Check(f"{case}: noticed, and the body blamed, share", float(np.mean([each.body for each in found])), low=0.9),
        Check(f"{case}: steps told within 4 deviations, share", _mean([each.right for each in found]), low=0.98),
        Check(f"{case}: false alarms before it, in {hours:.1f} h", false, high=1.0),
    ]


def row(found: Flight) -> dict[str, str]:
    """Return a run as its table shows it."""
    noticed = f"{found.noticed:.2f}" if math.isfinite(found.noticed) else ""
    right = f"{100.0 * found.right:.0f} %" if math.isfinite(found.right) else ""
    return {"false": "; ".join(found.false), "noticed after s": noticed, "right": right, "said": found.said}


def _mean(shares: Sequence[float]) -> float:
    told = [each for each in shares if math.isfinite(each)]
    return float(np.mean(told)) if told else math.nan


if __name__ == "__main__":
    options = sys.argv[1:]
    sys.exit(by_case("swell", __doc__ or "", CASES, learned, row, checks, ["--runs", "10", *options]))
