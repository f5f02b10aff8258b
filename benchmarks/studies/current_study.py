"""Whether a current that nobody knows, and a speed that is not known at first, pass for information about the vehicle.

    python benchmarks/studies/current_study.py [--runs 40] [--only flows] [--output current.json]

A vLBV300 whose thrusters answer in 0.1 s, multisine on all axes for 30 s, a random force of 0.25 N and 0.02 N m, 2 s;
an accelerometer, gyros, attitude, depth and a DVL, 8 a second: once the thrusters are known, after half a second, a log
begins in full motion between two of its samples. `still`: in still water; `flows`: in a current of 0.18 m/s; `changes`:
in one that begins to flow after 10 s and is 0.18 m/s 10 s later. Nobody is told. Of three total inertias, three
quadratic drags and the lag, in their deviations: one pass of the filter, linearised about the truth and told the true
levels of noise and force, whose errors must have the deviations that it states; and what is learned.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from by_case import by_case
from summary import Check

from towtank.core.arrays import Array
from towtank.identification import learn_recordings
from towtank.identification.data.samples import NoiseLevels, prepared
from towtank.identification.kalman.passes import one_pass
from towtank.identification.kalman.state import coefficient_std
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.recording import Recording
from towtank.simulation import Ins, OrnsteinUhlenbeck, RisingCurrent, manoeuvre, simulate
from towtank.vehicle import load_vehicle

CASES = {"still": (0.0, 0.0, 0.0), "flows": (0.15, -0.1, 0.0), "changes": (0.15, -0.1, 0.0)}  # m/s, NED
RISES = 10.0, 10.0  # s: when that of `changes` begins, and until it flows in full
WALKS = {"changes": 0.03}  # m/s per root of a second: what makes as much of 30 s
SECONDS, PIECE = 30, 1  # of a run; that are linearised about one current
FREE = ("X_udot", "Y_vdot", "N_rdot", "X_uu", "Y_vv", "N_rr")
LAG = 0.1  # s
FORCE = np.array([0.25, 0.25, 0.25, 0.02, 0.02, 0.02])  # N, N m
NOISE = np.array([2e-3, 2e-3, 5e-3, 2e-3, 2e-3, 5e-3, *[5e-3] * 3, *[2e-3] * 3, *[0.02] * 3, *[0.01] * 3])
Found = tuple[dict[str, float], dict[str, float]]

_FILE = load_vehicle("vlbv300")
TRUTH = _FILE.model_copy(
    update={"thrusters": tuple(each.model_copy(update={"time_constant": LAG}) for each in _FILE.thrusters)}
)


def dive(case: str, seed: int) -> Recording:
    """Return a run in the water of a case."""
    push = OrnsteinUhlenbeck(std=tuple(FORCE), time_constant=2.0)
    commands = manoeuvre("all-multisine", TRUTH, duration=float(SECONDS), dt=0.01).commands
    flows = {"waves": water(case)} if case == "changes" else {"current": CASES[case]}
    return simulate(TRUTH, commands=commands, dt=0.01, sensors=Ins(), seed=seed, disturbance=push, **flows)


def water(case: str) -> RisingCurrent:
    """Return how the water of a case moves."""
    return RisingCurrent(CASES[case], *(RISES if case == "changes" else (0.0, 1e-9)))


def pieces(case: str) -> Array:
    """Return what the water of a case does as `NoiseLevels.currents` has it."""
    t = np.arange(0, SECONDS + PIECE, PIECE, dtype=np.float64)
    return np.column_stack([0.0 * t, t, t + PIECE, water(case).motion(t + 0.5 * PIECE, 0).velocity])


def learned(case: str, seed: int) -> Found:
    """Return errors in their deviations: of one pass about the truth, and of what is learned."""
    recording = prepared(dive(case, seed), TRUTH)
    problem = joint_problem(LearningRequest(TRUTH, [recording], free=FREE, delay=0.0))
    truth = problem.free.theta(TRUTH, delay=0.0, lag=LAG)
    levels = replace(
        problem.rough,
        noise=NOISE,
        disturbance=FORCE / np.diag(TRUTH.mass_matrix),
        currents=pieces(case),
        current_walk=WALKS.get(case, NoiseLevels.current_walk),
    )
    state, *_ = one_pass(problem, truth, levels)
    off = (state.theta - truth) / coefficient_std(state)
    estimate = learn_recordings(TRUTH, [recording], free=FREE, delay=0.0).estimate
    told = {name: (estimate[name].value - TRUTH.coefficient(name)) / estimate[name].std for name in FREE}
    return dict(zip(problem.free.names, off.tolist(), strict=True)), told


def checks(case: str, found: Sequence[Found]) -> list[Check]:
    """Return what must hold of one case."""
    told = np.abs([list(each.values()) for _, each in found])
    spread = np.sqrt(np.mean(np.square([list(each.values()) for each, _ in found]), axis=0))
    worst = int(spread.argmax())
    largest, name = float(spread[worst]), list(found[0][0])[worst]
    return [
        Check(f"{case}: RMS of the filter's errors, in deviations", float(np.sqrt(np.mean(spread**2))), high=1.1),
        Check(f"{case}: the largest of one unknown", largest, high=1.0 + 3.0 / math.sqrt(2.0 * len(found)), note=name),
        Check(f"{case}: learned, intervals that hold", float(np.mean(told < 1.96)), low=0.90),
        Check(f"{case}: learned, beyond 4 deviations", float(np.mean(told > 4.0)), high=0.005),
    ]


def row(found: Found) -> dict[str, str]:
    """Return a run as its table shows it."""
    filtered, told = found
    return {
        "filter, off in deviations": " ".join(f"{value:+.1f}" for value in filtered.values()),
        "learned": " ".join(f"{value:+.1f}" for value in told.values()),
    }


if __name__ == "__main__":
    sys.exit(by_case("current", __doc__ or "", CASES, learned, row, checks))
