"""A pilot who is led through a plan: late by 0.4 s, off by 20 % of every movement, and never twice the same.

    python benchmarks/studies/pilot_study.py [--runs 50] [--seed 1] [--only vlbv300] [--workers 2]

For each vehicle a plan that can be driven by hand is made from its file (5 x 5 x 2.5 m, pose, a random force of 0.5 N
correlated over 2 s, 5 % asked), in which every coefficient on the diagonal bears a deviation of 30 %. In every run each
of them is drawn anew. A simulated pilot does what `towtank live --plan` shows: brings the vehicle back to the start,
holds the sticks still, and drives the movements that were shown 0.4 s before, each by a share that is off by 20 %
(standard deviation). The learner is that of a stream; after each segment the next is designed from its posterior, three
seconds of the session later. Shown are the manoeuvring that was planned and that it took until all was known to 5 %
(asked: at most 1.5 times the planned), the time of the session, the errors in the end, how many of them lie within the
stated 95 % intervals, and how often the vehicle touched a wall: nobody guards it but the pilot, who
is told to stop where a wall is near.
"""

from __future__ import annotations

import math
import sys
from collections import deque
from functools import cache
from typing import NamedTuple

import numpy as np
from plan_study import FORCE, SPACE, drawn, size_of, supposed
from report import show
from rich.table import Table
from runner import arguments, over

from towtank import Learner
from towtank.core.arrays import Array
from towtank.planning import Plan, plan
from towtank.planning.braking import PERIOD
from towtank.planning.coach import Coach, Stage, View, next_segment
from towtank.planning.guarded import DT, Tank
from towtank.simulation import OrnsteinUhlenbeck
from towtank.vehicle import Vehicle, allocate, thruster_forces

VEHICLES = ("bluerov2_heavy", "vlbv300")
REACTION, OFF_BY = 0.4, 0.2  # s, share
SEES = 5  # periods: how often a pilot who brings the vehicle back moves the sticks
DESIGN = 3.0  # s that a design takes
LONGEST = 600.0  # s of a session
NOISE = 1e-3  # m, rad
STEPS = round(PERIOD / DT)
NEAR, CALM = 0.25, 0.1  # m, m/s: back enough, at rest enough


class Run(NamedTuple):
    """What came of a session.

    Attributes:
        met: whether all was known in the end. seconds: of manoeuvring. session: time of it all [s]. segments: driven.
        errors, stated: of the wanted coefficients (k,), as shares of their size. touched: whether a wall was.
    """

    met: bool
    seconds: float
    session: float
    segments: int
    errors: Array
    stated: Array
    touched: bool


class Pilot:
    """Drives what is shown, late and not exactly, and brings the vehicle back in between."""

    def __init__(self, vehicle: Vehicle, seed: int) -> None:
        self._chance = np.random.default_rng(seed)
        self._inertia = np.diag(vehicle.mass_matrix)
        self._seen: deque[tuple[float, View]] = deque()
        self._shares: dict[tuple[int, int, float], float] = {}
        self._last, self._periods = np.zeros(6), 0

    def drive(self, t: float, view: View, eta: Array, nu: Array, home: Array) -> Array:
        """Return the wrench (6,) that the sticks ask for at t [s]."""
        self._seen.append((t, view))
        while len(self._seen) > 1 and self._seen[1][0] <= t - REACTION:
            self._seen.popleft()
        seen = self._seen[0][1]
        if seen.stage is Stage.DRIVE:
            wrench = np.zeros(6)
            for row in range(6):
                now, _ = seen.now_and_next(row)
                if now is not None:
                    key = (seen.number, row, now.start)
                    share = self._shares.setdefault(key, float(self._chance.normal(1.0, OFF_BY)))
                    wrench[row] = share * now.force
            return wrench
        self._periods += 1
        if self._periods % SEES:
            return self._last
        self._last = self._back(seen, eta, nu, home)
        return self._last

    def _back(self, seen: View, eta: Array, nu: Array, home: Array) -> Array:
        """Return what brings the vehicle back to its start (6,), nothing where it is there."""
        back = home[:3] - eta[:3]
        if seen.stage is Stage.COUNT or (np.linalg.norm(back) < NEAR and np.linalg.norm(nu) < CALM):
            return np.zeros(6)
        psi = eta[5]
        body = np.array(
            [
                math.cos(psi) * back[0] + math.sin(psi) * back[1],
                math.cos(psi) * back[1] - math.sin(psi) * back[0],
                back[2],
            ]
        )
        turn = math.remainder(home[5] - psi, 2.0 * math.pi)
        asked = np.zeros(6)
        asked[:3] = self._inertia[:3] * np.clip(0.4 * body - 1.0 * nu[:3], -0.4, 0.4)
        asked[5] = self._inertia[5] * np.clip(0.6 * turn - 1.2 * nu[5], -0.6, 0.6)
        return asked


@cache
def planned(name: str) -> Plan:
    """Return the plan of a vehicle."""
    return plan(supposed(name), space=SPACE, force=FORCE, seed=1, by_hand=True)


def perform(name: str, seed: int) -> Run:
    """Fly one session."""
    file, made = supposed(name), planned(name)
    wanted = tuple(each.name for each in made.expected)
    truth = drawn(file, wanted, seed)
    n = round(LONGEST / PERIOD)
    push = OrnsteinUhlenbeck(std=(FORCE,) * 3 + (0.1 * FORCE,) * 3, time_constant=2.0).sample(n * STEPS, DT, seed)
    noise = NOISE * np.random.default_rng([seed, 1]).standard_normal((n * STEPS + 1, 6))
    tank, home = Tank(truth, push, SPACE.eta0), SPACE.eta0
    learner = Learner(file, changes=False)
    coach = Coach(file, wanted, made.accuracy, tuple(each.segment for each in made.segments), space=SPACE)
    pilot, due, closest = Pilot(file, seed), math.inf, math.inf
    radius = SPACE.require_room(file)
    t, eta, nu = 0.0, SPACE.eta0, np.zeros(6)
    held, commands = np.zeros(6), allocate(file, np.zeros(6))
    for i in range(n):
        t = i * PERIOD
        view = coach.view(t)
        if view.stage in (Stage.MET, Stage.OVER):
            break
        wrench = pilot.drive(t, view, eta, nu, home)
        if not np.array_equal(wrench, held):
            held, commands = wrench, allocate(file, wrench)
        learner.update(t, commands=commands)
        coach.see(t, {"commands": commands})
        for row in tank.period(i, thruster_forces(truth, commands)):
            pose = tank.pose(row) + noise[row]
            learner.update(row * DT, pose=pose)
            coach.see(row * DT, {"pose": pose})
            eta = tank.pose(row)
        nu = tank.states[(i + 1) * STEPS, 7:]
        closest = min(closest, float(SPACE.clearance(eta[None, :3], radius)[0]))
        coach.tick(t)
        if coach.thinks and due == math.inf:
            due = t + DESIGN
        elif coach.thinks and t >= due:
            due = math.inf
            coach.offer(
                next_segment(learner.model(), wanted, made.accuracy, sensors="pose", plan=made, seed=1000 * seed + i)
            )
    view = coach.view(t)
    learned = {each.name: each for each in learner.estimate.coefficients}
    sizes = np.array([size_of(truth, key) for key in wanted])
    errors = np.array([learned[key].value - truth.coefficient(key) for key in wanted]) / sizes
    stated = np.array([learned[key].std for key in wanted]) / sizes
    return Run(view.stage is Stage.MET, view.seconds, t, view.number - 1, errors, stated, closest < 0.0)


def main() -> int:
    """Run the study; return 1 where more than one run in ten takes longer than 1.5 times the plan."""
    options = arguments(__doc__ or "", runs=50)
    failed = 0
    table = Table(title=f"Led by the plan, late by {REACTION:g} s, off by {100.0 * OFF_BY:.0f} %")
    heads = ("Vehicle", "runs", "planned", "driven (median)", "90 %", "within 1.5", "session", "all known")
    for head in (*heads, "error (median)", "in 95 %", "touched"):
        table.add_column(head, justify="left" if head == "Vehicle" else "right")
    for name in VEHICLES:
        if options.only and options.only not in name:
            continue
        plan_seconds = planned(name).manoeuvring
        found = over(name, perform, [(name, options.seed + k) for k in range(options.runs)], options.workers)
        seconds = np.array([each.seconds if each.met else np.inf for each in found])
        within = float(np.mean(seconds <= 1.5 * plan_seconds))
        failed += within < 0.9
        errors = np.array([each.errors for each in found])
        held = float(np.mean(np.abs(errors) <= 1.96 * np.array([each.stated for each in found])))
        table.add_row(
            name,
            str(len(found)),
            f"{plan_seconds:g} s",
            f"{np.quantile(seconds, 0.5, method='higher'):.0f} s",
            f"{np.quantile(seconds, 0.9, method='higher'):.0f} s",
            f"{100.0 * within:.0f} %",
            f"{np.median([each.session for each in found]):.0f} s",
            f"{sum(each.met for each in found)}",
            f"{100.0 * np.median(np.abs(errors)):.1f} %",
            f"{100.0 * held:.0f} %",
            str(sum(each.touched for each in found)),
        )
    show(table)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
