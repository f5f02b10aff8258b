"""The way down: Gauss and Newton's steps, damped after Levenberg and Marquardt where one does not help.

First over short segments, in which not much can go wrong whatever the coefficients: an unstable vehicle's free run is
soon anywhere. From there the whole runs. At first all columns are weighed alike; then each by its noise, or by the
robust size of its own residuals where that is larger; once near, far residuals are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.output_error_problem import Point, Problem, residual_scale
from towtank.identification.output_error_solution import Step

__all__ = ["Descent", "descend", "warm_up"]

_FAR = 1e3  # standard deviations of the noise: scale of residuals of which nothing is known yet
_NEAR = 1.0  # decrease of the cost from which the gate is in force
_NEAR_SCALE, _NEAR_SHARE = 1.5, 0.05  # or the size of the residuals, and a decrease of this share of the cost
_FIXED = 2  # steps within the gate after which the scales stay as they are
_SETTLED = 0.03  # decrease of the cost, half of a squared deviation, whose step is taken without another run
_UNSURE = 0.5  # decrease within the coefficients' deviations: not borne out by a run, it is the derivatives' own error
_TOLERATED = 1e-3  # increase of the cost that a step may cause: the derivatives are of second order in the step
_MOST_DAMPED = 1e6
_WARM, _WARM_RUNS = 0.3, 12  # share of the cost that a step still lowers, and runs, after which the warm-up ends


@dataclass(frozen=True, eq=False)
class Descent:
    """Where it ended.

    Attributes:
        point: the last runs. step: the small one that would come next. scale: of the residuals (15,).
        runs: how many were made. converged: whether nothing was left to gain.
    """

    point: Point
    step: Step
    scale: Array
    runs: int
    converged: bool


def warm_up(problem: Problem, theta: Array, states: list[Array]) -> tuple[Array, list[Array], int]:
    """Return coefficients (n,) and initial states after some steps over short segments, and the runs made.

    The lag is held: while nothing else is right it would run away, and the delay does for it.
    """
    scale = np.full(15, _FAR)
    point = problem.evaluate(theta, states, scale, False)
    runs, damping = 1, 0.0
    if point is None:
        return theta, states, runs
    problem.narrow(point)
    while True:
        arrowhead, cost = problem.arrowhead(point), problem.cost(point, scale, False)
        step = arrowhead.step(damping, *problem.bounds(point.theta, lag=False))
        if step.decrease < _WARM * cost or runs >= _WARM_RUNS:
            break
        trial = problem.evaluate(*problem.moved(point, step), scale, False)
        runs += 1
        if trial is not None and problem.cost(trial, scale, False) < cost:
            point, damping = trial, 0.1 * damping
        else:
            damping = max(1e-3, 100.0 * damping)
    return *problem.moved(point, step), runs


def descend(problem: Problem, theta: Array, states: list[Array], most: int) -> Descent | None:
    """Return the best fit within `most` runs; None where already the first run is impossible."""
    scale, gated, fixed = np.full(15, _FAR), False, 0
    point = problem.evaluate(theta, states, scale, gated)
    if point is None:
        return None
    problem.narrow(point)
    damping, runs = 0.0, 1
    while True:
        arrowhead = problem.arrowhead(point)
        step = arrowhead.step(damping, *problem.bounds(point.theta))
        if gated and step.decrease < _SETTLED:
            return Descent(point, step, scale, runs, True)
        if runs >= most:
            return Descent(point, step, scale, runs, False)
        # The next run is weighed anew; whether its step helped is judged by what it was meant to lower.
        old_scale, old_gated = scale, gated
        if fixed < _FIXED:
            fixed += gated
            scale = residual_scale(point)
            if gated:
                problem.leave_out_jumps(point, scale)
            elif runs == 1:
                scale = np.full(15, scale.max())
            decrease = step.decrease * float(np.min(old_scale / scale)) ** 2
            near = scale.max() < _NEAR_SCALE and decrease < _NEAR_SHARE * problem.cost(point, scale, gated)
            gated = gated or near or decrease < _NEAR
        cost = problem.cost(point, old_scale, old_gated)
        while True:
            trial = problem.evaluate(*problem.moved(point, step), scale, gated)
            runs += 1
            if trial is not None and problem.cost(trial, old_scale, old_gated) <= cost + _TOLERATED:
                point, damping = trial, (0.0 if damping < 1e-6 else 0.1 * damping)
                break
            if old_gated and step.decrease < _UNSURE:
                nowhere = Step(np.zeros_like(step.theta), np.zeros_like(step.states), 0.0)
                return Descent(point, nowhere, old_scale, runs, True)
            damping = max(1e-3, 10.0 * damping)
            if runs >= most or damping > _MOST_DAMPED:
                return Descent(point, step, old_scale, runs, False)
            step = arrowhead.step(damping, *problem.bounds(point.theta))
