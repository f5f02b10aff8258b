"""A vehicle that swings: is its stiffness found by gyros and depth alone, where nobody said anything of it?

    python benchmarks/studies/swing_study.py [--runs 20] [--only stiff] [--output swing.json]

A hull of 35 kg, 1.7 m long, with a propeller and four tunnels and without fins, is driven along all axes but roll for
60 s in water that stirs it; gyros at 50 Hz and a depth sensor at 10 Hz measure. Told are mass, inertia and thrusters.
`stiff`: the centre of buoyancy lies 3 cm above that of gravity, and roll swings once a second; `soft`: 5 mm, once in
2 s; `short`: the stiff one for 25 s; `rolled`: the stiff one, which the water rolls by a degree or two against its
weight, before a camera. Of every coefficient that is called identified: how far from the truth, in deviations that are
stated.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from by_case import by_case
from summary import Check
from undriven_study import errors, row_of_errors, told

from towtank.identification import learn_recordings
from towtank.identification.model.terms import AHEAD
from towtank.recording import Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, simulate
from towtank.vehicle import Vehicle, load_vehicle


class Case(NamedTuple):
    """A run: the centre of buoyancy above that of gravity [m], seconds, moment in roll by the water [N m], sensors, and
    which of their channels are kept."""

    above: float
    seconds: float = 60.0
    rolls: float = 0.013
    sensors: Ins | Mocap = Ins()
    measured: tuple[str, ...] = ("p", "q", "r", "z")


CASES = {
    "stiff": Case(0.03),
    "soft": Case(0.005),
    "short": Case(0.03, 25.0),
    "rolled": Case(0.03, rolls=0.3, sensors=Mocap(rate=50.0), measured=("x", "y", "z", "phi", "theta", "psi")),
}
_DT = 0.02
_TUNNELS = ("up_bow", "up_stern")


def hull(above: float) -> Vehicle:
    """Return the vehicle as it is, its centre of buoyancy so far [m] above that of gravity."""
    vehicle = load_vehicle(Path(__file__).with_name("torpedo.toml"))
    upright = tuple(
        each.model_copy(update={"name": name, "direction": (0.0, 0.0, 1.0)})
        for each, name in zip(vehicle.thrusters[1:], _TUNNELS, strict=True)
    )
    buoyancy = vehicle.buoyancy.model_copy(update={"centre": (0.0, 0.0, -above)})
    terms = {name: value for name, value in vehicle.hydrodynamics.items() if name not in AHEAD}
    given = {"hydrodynamics": terms, "thrusters": (*vehicle.thrusters, *upright), "buoyancy": buoyancy}
    return vehicle.model_copy(update=given)


def driven(case: Case, seed: int) -> Recording:
    """Return a run: every thruster rests, or pushes for a second or so; commands, gyros and depth, or the pose."""
    vehicle, random = hull(case.above), np.random.default_rng(seed)
    levels = np.zeros((round(case.seconds / _DT), len(vehicle.thrusters)))
    for column in levels.T:
        k = round(1.0 / _DT)
        while k < column.size:
            held = int(random.uniform(0.7, 4.0) / _DT)
            column[k : k + held] = random.choice([-1.0, 1.0]) * random.choice([40.0, 60.0, 80.0, 100.0])
            column[k : k + held] *= random.random() < 0.6
            k += held
    water = OrnsteinUhlenbeck((0.4, 0.6, 0.6, case.rolls, 0.2, 0.2), 2.0, ("X", "Y", "Z", "K", "M", "N"))
    run = simulate(vehicle, commands=levels, dt=_DT, disturbance=water, sensors=case.sensors, seed=seed)
    return run.without(*(name for name in run if name not in case.measured and not name.startswith("cmd_")))


def learned(case: str, seed: int) -> dict[str, float]:
    """Return the error of every coefficient that is identified, in deviations that are stated."""
    truth = hull(CASES[case].above)
    return errors(truth, learn_recordings(told(truth), [driven(CASES[case], seed)]))


def checks(case: str, found: Sequence[dict[str, float]]) -> list[Check]:
    """Return what must hold of one case."""
    off = np.abs([deviations for run in found for deviations in run.values()])
    return [
        Check(f"{case}: 95 % intervals that hold", float(np.mean(off < 1.96)), 0.9, 0.99),
        Check(f"{case}: beyond 4 deviations", float(np.mean(off > 4.0)), -math.inf, 0.005),
        Check(f"{case}: identified a run", float(off.size / len(found))),
    ]


if __name__ == "__main__":
    sys.exit(by_case("swing", __doc__ or "", CASES, learned, row_of_errors, checks))
