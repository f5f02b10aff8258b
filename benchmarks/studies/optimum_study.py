"""Do passes come to the likeliest vehicle where nothing is known beforehand, or do they stop short of it?

    python benchmarks/studies/optimum_study.py [--runs 4] [--only tank-session] [--output optimum.json]

A BlueROV2 Heavy and a VideoRay Pro 4 are driven for 60 s in five ways, in calm water, with the sensors of an INS.
Each log is learned twice with the same prior, mass, inertia and thrusters alone: from the prior, as everybody does, and
from the truth, as nobody can. How much likelier is what the second comes to, and how much more does it know?
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from by_case import by_case
from summary import Check

import towtank as tt
from towtank.identification.data.samples import prepared, samples_of
from towtank.identification.kalman.passes import joint_fit
from towtank.identification.model.terms import DISTURBANCE
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.simulation import OrnsteinUhlenbeck, manoeuvre, simulate

VEHICLES = ("bluerov2_heavy", "vlbv300")
WAYS = ("tank-session", "all-telegraph", "all-multisine", "surge-square", "yaw-stairs")
CASES = tuple(f"{vehicle}, {way}" for vehicle in VEHICLES for way in WAYS)
DURATION, STEP = 60.0, 0.05  # s
STIRRED = OrnsteinUhlenbeck(std=0.5)  # N
SHORT = 100.0  # nats, that passes may stop short of the other optimum


class Learned(NamedTuple):
    """By how many nats the truth's side is likelier, how much wider deviations are than there, and how much larger the
    disturbance along the axis where it is most so; passes of both sides."""

    short: float
    wider: float
    pushed: float
    passes: tuple[int, int]


def learned(case: str, seed: int) -> Learned:
    """Learn one log from the prior and from the truth."""
    name, way = case.split(", ")
    truth = tt.load_vehicle(name)
    driven = manoeuvre(way, truth, duration=DURATION, dt=STEP, seed=seed)
    run = simulate(truth, **driven.inputs, sensors="ins", disturbance=STIRRED, seed=seed)
    bare = truth.model_copy(update={"hydrodynamics": {}})
    recording = prepared(run, bare)
    samples = (samples_of(recording, bare),)
    problem, known = (joint_problem(LearningRequest(each, [recording], samples)) for each in (bare, truth))
    place = {unknown: k for k, unknown in enumerate(known.free.names)}
    about = problem.prior.mean.copy()
    for k, unknown in enumerate(problem.free.names):
        about[k] = known.prior.mean[place[unknown]] if unknown in place else about[k]
    calm = replace(problem.rough, disturbance=np.array(DISTURBANCE))
    known_nothing, knew_all = joint_fit(problem), joint_fit(problem, since=(about, calm))
    wider = float(np.exp(np.mean(np.log(known_nothing.std / knew_all.std))))
    pushed = float(np.max(known_nothing.levels.disturbance / knew_all.levels.disturbance))
    passes = known_nothing.passes, knew_all.passes
    return Learned(knew_all.likelihood - known_nothing.likelihood, wider, pushed, passes)


def row(found: Learned) -> dict[str, str]:
    """Return a log as its table shows it."""
    return {
        "nats short of it": f"{found.short:+.0f}",
        "deviations": f"{found.wider:.2f} times",
        "largest push": f"{found.pushed:.3g} times",
        "passes, from the prior and from the truth": "{} and {}".format(*found.passes),
    }


def checks(case: str, found: Sequence[Learned]) -> list[Check]:
    """Return what must hold of one case."""
    return [
        Check(f"{case}: median nats short", float(np.median([each.short for each in found])), high=SHORT),
        Check(f"{case}: most nats short", float(np.max([each.short for each in found]))),
        Check(f"{case}: deviations, times those there", float(np.mean([each.wider for each in found])), high=1.1),
    ]


if __name__ == "__main__":
    sys.exit(by_case("optimum", __doc__ or "", CASES, learned, row, checks))
