"""Output error: the coefficients whose free run, nothing measured correcting it on the way, fits a log best.

Gauss and Newton's steps, Levenberg's damping where one does not help, over the coefficients and the initial state of
every segment at once (`output_error_kernel`, `output_error_solution`). Each column is weighed by its noise, or by the
size of its own residuals where these are larger; Huber's weights at 2 of these from the start, a gate beyond 4.5 once
the run is near the data.

The best judge where nothing but the sensors' noise parts the model from the data; a random force, which a free run
cannot follow, spoils it: `OutputErrorFit.memory` tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.output_error_descent import Descent, descend, warm_up
from towtank.identification.output_error_deviations import coefficient_covariance
from towtank.identification.output_error_memory import Memory, residual_memory
from towtank.identification.output_error_problem import Problem
from towtank.identification.output_error_rows import GATE, robust_moments
from towtank.identification.output_error_start import free_run_of, starting_states, warm_up_of
from towtank.identification.parameters import IN_GAIN, FreeParameters
from towtank.identification.samples import N_MEASURED, Samples

__all__ = ["OutputErrorFit", "fit_output_error"]


@dataclass(frozen=True, eq=False)
class OutputErrorFit:
    """What a free run fitted to the data says.

    Attributes:
        theta: coefficients (n,) as `FreeParameters` writes them. covariance: (n, n), residuals not taken to be white.
        information: (n, n), the initial states being unknown, residuals taken to be white; the prior included.
        states: initial state (s, 13) of every segment of every recording in turn.
        cost: sum of the robust squares, halved.
        residual_std: (15,) in the columns' units, outliers left out; NaN for columns that are not measured.
        memory: of the residuals.
        iterations: free runs made. converged: whether nothing was left to gain.
        rejected: share of the measured numbers beyond the gate.
    """

    theta: Array
    covariance: Array
    information: Array
    states: Array
    cost: float
    residual_std: Array
    memory: Memory
    iterations: int
    converged: bool
    rejected: float


def fit_output_error(
    samples: Sequence[Samples],
    p: Array,
    free: FreeParameters,
    theta: Array,
    noise: Array,
    *,
    prior: tuple[Array, Array] | None = None,
    segment: float | None = None,
    gap: float = 0.5,
    delay: float = 0.0,
    iterations: int = 20,
) -> OutputErrorFit:
    """Fit free runs to recordings.

    Args:
        samples: one for each recording.
        p: kernel parameters (154,) of the vehicle; what is free is replaced.
        free: which coefficients are. theta: where they start (n,).
        noise: standard deviation (15,) of the columns of `Samples.values`; those that are not measured do not matter.
        prior: mean (n,) and information (n, n) of theta.
        segment: length [s] after which the run starts anew from a state of its own; None for one run per recording.
        gap: time [s] between rows over which no run goes.
        delay: of the inputs [s], where it is not free.
        iterations: free runs at most; those over a few short segments to begin with come on top.

    Raises:
        InputError: nothing is free, nothing is measured, or sizes and deviations that do not fit.
    """
    theta = np.array(theta, dtype=np.float64)
    noise = np.array(noise, dtype=np.float64)
    n = len(free)
    known = prior or (np.zeros(n), np.zeros((n, n)))
    _check(samples, free, theta, noise, known)
    noise[~np.isfinite(noise)] = 1.0
    gains = bool((free.codes[:, 0] == IN_GAIN).any())
    runs = [free_run_of(each, noise, segment, gap, gains) for each in samples]
    kept = [each for each, run in zip(samples, runs, strict=True) if run.first.size]
    runs = [run for run in runs if run.first.size]
    if not runs:
        raise InputError("output error: found no three measured rows without a gap between them")
    states, made = [starting_states(run) for run in runs], 0
    short = [warm_up_of(each, run, segment, gap) for each, run in zip(kept, runs, strict=True)]
    if any(part is not run for part, run in zip(short, runs, strict=True)):
        begin = [starting_states(run) for run in short]
        warm = Problem(short, p, free, known, delay)
        theta, begin, made = warm_up(warm, theta, begin)
        for run, start, other, found in zip(runs, states, short, begin, strict=True):
            _, here, there = np.intersect1d(run.first, other.first, return_indices=True)
            start[here] = found[there]
    problem = Problem(runs, p, free, known, delay)
    descent = descend(problem, theta, states, max(iterations, 1))
    return _failed(theta, states, made + 1) if descent is None else _result(problem, descent, made)


def _check(
    samples: Sequence[Samples], free: FreeParameters, theta: Array, noise: Array, prior: tuple[Array, Array]
) -> None:
    if not len(free):
        raise InputError("output error: no coefficient is free, so there is nothing to fit")
    if theta.shape != (len(free),) or not np.isfinite(theta).all():
        raise InputError(f"output error: found theta {theta}, expected {len(free)} finite numbers")
    n, (mean, information) = len(free), prior
    if mean.shape != (n,) or information.shape != (n, n) or not np.isfinite([*mean, *information.ravel()]).all():
        raise InputError(f"output error: the prior needs {n} finite means and a finite {n} x {n} information")
    if noise.shape != (N_MEASURED,):
        raise InputError(f"output error: found noise of shape {noise.shape}, expected {N_MEASURED} deviations")
    if not samples:
        raise InputError("output error: no recording")
    measured = np.any([each.measured for each in samples], axis=0)
    if not measured.any():
        raise InputError("output error: nothing is measured")
    if not (noise[measured] > 0.0).all() or not np.isfinite(noise[measured]).all():
        raise InputError("output error: every measured column needs a positive noise deviation")


def _result(problem: Problem, descent: Descent, made: int) -> OutputErrorFit:
    point, scale = descent.point, descent.scale
    k, n = problem.estimated.size, len(problem.free)
    information, eliminated = problem.arrowhead(point).information()
    scores, moments, begin = [], np.zeros(5), 0
    for run, each in zip(problem.runs, point.sums, strict=True):
        counts = np.diff(np.append(run.block[run.first], len(each.scores)))
        of_block = begin + np.repeat(np.arange(run.first.size), counts)
        scores.append(each.scores[:, k : k + n] - np.einsum("bk,bkn->bn", each.scores[:, :k], eliminated[of_block]))
        begin += run.first.size
        part = np.empty(5)
        robust_moments(each.residuals, scale, part)
        moments += part
    memory = residual_memory(
        [(run.t, each.residuals) for run, each in zip(problem.runs, point.sums, strict=True)], GATE * scale
    )
    total = sum(float(np.sum(run.t[run.last - 1] - run.t[run.first])) for run in problem.runs)
    reach = np.where(memory.reach > memory.step, memory.reach, 0.0)
    covariance = coefficient_covariance(
        information,
        problem.prior[1],
        np.concatenate(scores),
        begin,
        moments,
        float(np.nanmax(reach, initial=0.0)),
        total / sum(len(each) for each in scores),
    )
    theta, states = point.theta, point.states
    if descent.converged and problem.possible(theta + descent.step.theta):
        theta, states = problem.moved(point, descent.step)
    return OutputErrorFit(
        theta=theta,
        covariance=covariance,
        information=information,
        states=np.concatenate(states),
        cost=problem.cost(point, scale, True),
        residual_std=memory.std * problem.runs[0].noise,
        memory=memory,
        iterations=made + descent.runs,
        converged=descent.converged,
        rejected=float((moments[4] + problem.left_out) / max(moments[0] + problem.left_out, 1.0)),
    )


def _failed(theta: Array, states: list[Array], made: int) -> OutputErrorFit:
    """Return the start, of which nothing is known: already its free run is impossible."""
    n, unknown = len(theta), np.full(N_MEASURED, np.nan)
    return OutputErrorFit(
        theta=theta,
        covariance=np.diag(np.full(n, np.inf)),
        information=np.zeros((n, n)),
        states=np.concatenate(states),
        cost=np.inf,
        residual_std=unknown,
        memory=Memory(unknown, unknown, unknown, unknown, unknown, unknown),
        iterations=made,
        converged=False,
        rejected=0.0,
    )
