"""How coefficients settled over a log: one more pass over it, read along the way.

It is a pass of the joint filter, linearised about what was learned, and started from the values known before with
deviations wide enough to owe them nothing; or, where the paper's method learned, of least squares with the terms and
the couplings that it chose. It shows how the information came in; where free runs or instruments had the last word,
their values may lie beside its end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import Samples, prepared, samples_of
from towtank.identification.kalman.filter import joint_events, rows_of
from towtank.identification.kalman.iterated import inputs_of, next_recording, prior_deviation, uses_biases
from towtank.identification.kalman.noise_adaptation import common_noise_levels, filter_settings
from towtank.identification.kalman.state import JointState, coefficient_std, new_joint_state
from towtank.identification.least_squares.chain import PaperChain, Settings, uses_commands
from towtank.identification.least_squares.solution import (
    AxisFindings,
    absent,
    estimate_of,
    merge_information,
    solve_axis,
)
from towtank.identification.model.parameters import DELAY, LAG, UNTRANSFORMED, FreeParameters, free_parameters
from towtank.identification.model.prior import size_of, start_theta
from towtank.identification.model.terms import Candidates, candidates, paper_names
from towtank.identification.posterior.assembly import LogLearning
from towtank.recording import Recording

__all__ = ["Convergence", "convergence"]

_READINGS, _READINGS_PAPER = 200, 60  # of least squares each is a solution
_WIDE = 1.0  # deviation of a logarithm at the start,
_OWES_NOTHING = 2.0  # and at least so many times the way from start to end
_ADAPT = 10.0  # s over which the disturbance is estimated where no level of it was learned


@dataclass(frozen=True, eq=False)
class Convergence:
    """Estimates over the time learned from.

    Attributes:
        names: of the coefficients. t: times (k,) [s]; several logs follow each other. values, std: (k, n), NaN where
            nothing is known yet. ends: where each log but the last ends [s].
    """

    names: tuple[str, ...]
    t: Array
    values: Array
    std: Array
    ends: tuple[float, ...] = ()


def convergence(learning: LogLearning, recordings: Sequence[Recording]) -> Convergence:
    """Return how what was learned from `recordings` settled; with no reading where nothing was identified."""
    names = tuple(each.name for each in learning.estimate.coefficients if each.identified)
    if not names:
        return Convergence((), np.empty(0), np.empty((0, 0)), np.empty((0, 0)))
    if learning.method == "paper" and set(names) <= set(paper_names()):
        return _by_least_squares(learning, names)
    return _by_filter(learning, recordings, names)


def _by_filter(learning: LogLearning, recordings: Sequence[Recording], names: tuple[str, ...]) -> Convergence:
    samples = [samples_of(prepared(recording, learning.model), learning.model) for recording in recordings]
    delay = [DELAY] if learning.delay_scan is not None and any(each.commands for each in samples) else []
    free = free_parameters(learning.model, [*names, *delay, *([LAG] if math.isfinite(learning.lag) else [])])
    state, linearised_at = _start(learning, recordings, samples, free)
    kept = [k for k, name in enumerate(free.names) if name in names]
    every = max(1, sum(len(each) for each in samples) // _READINGS)
    rows: list[tuple[float, Array, Array]] = []
    ends: list[float] = []
    for each in samples:
        passed = ends[-1] if ends else 0.0
        state = next_recording(state, each)
        held = inputs_of(each, free, linearised_at, learning.delay)
        taken = 0
        for first in range(0, len(each), every):
            last = min(first + every, len(each))
            taken = joint_events(state, held, rows_of(each), first, last, taken)
            values, std = _reading(state, free)
            rows.append((passed + float(each.t[last - 1] - each.t[0]), values[kept], std[kept]))
        ends.append(passed + each.duration)
    return _gathered(tuple(free.names[k] for k in kept), rows, ends)


def _gathered(names: tuple[str, ...], rows: list[tuple[float, Array, Array]], ends: list[float]) -> Convergence:
    t, values, std = (np.array(column) for column in zip(*rows, strict=True))
    known = np.where(np.isfinite(values) & np.isfinite(std), 1.0, np.nan)
    return Convergence(names, t, values * known, std * known, tuple(ends[:-1]))


def _start(
    learning: LogLearning, recordings: Sequence[Recording], samples: Sequence[Samples], free: FreeParameters
) -> tuple[JointState, Array]:
    """Return the filter before the first sample, and the point (n,) that it is linearised about."""
    lag = learning.lag if math.isfinite(learning.lag) else 0.05
    linearised_at = free.theta(learning.model, delay=learning.delay, lag=lag)
    start = start_theta(learning.vehicle, learning.vehicle, free, delay=learning.delay, lag=lag)
    scale = size_of(learning.vehicle, free)
    deviation = prior_deviation(free, scale)
    deviation = np.where(free.codes[:, 3] == UNTRANSFORMED, deviation, _WIDE * deviation / deviation.max())
    deviation = np.maximum(deviation, _OWES_NOTHING * np.abs(start - linearised_at))
    settings = replace(filter_settings(learning.vehicle), relinearise=False, biases=uses_biases(samples))
    levels = learning.levels
    if levels is None:
        levels, settings = common_noise_levels(recordings, samples, learning.vehicle), replace(settings, adapt=_ADAPT)
    else:  # from forces to accelerations
        levels = replace(levels, disturbance=levels.disturbance / np.diag(learning.model.mass_matrix))
    state = new_joint_state(
        np.array(learning.model.parameters),
        free,
        start,
        np.diag(deviation**2),
        samples[0].B,
        levels,
        settings,
        linearised_at,
    )
    return state, linearised_at


def _reading(state: JointState, free: FreeParameters) -> tuple[Array, Array]:
    """Return the coefficients (n,) and their deviations (n,)."""
    std = coefficient_std(state)
    with np.errstate(over="ignore", invalid="ignore"):
        theta = np.where(free.codes[:, 3] == UNTRANSFORMED, state.theta, np.clip(state.theta, -50.0, 50.0))
        return free.values(theta), std * np.abs(free.slopes(theta))


def _by_least_squares(learning: LogLearning, names: tuple[str, ...]) -> Convergence:
    chosen = candidates(learning.model, names)
    known = np.array([candidate.known for candidate in chosen])
    free = np.array([candidate.to_learn for candidate in chosen], dtype=np.float64)
    settings = Settings(delay=learning.delay)
    chains: list[PaperChain] = []
    every = max(1, sum(len(grid) for grid in learning.grids) // _READINGS_PAPER)
    rows: list[tuple[float, Array, Array]] = []
    ends: list[float] = []
    for grid, sources in zip(learning.grids, learning.sources, strict=True):
        passed = ends[-1] if ends else 0.0
        commands = uses_commands(learning.model, grid)
        chains.append(PaperChain(learning.model, sources, settings, free, known, commands=commands))
        for first in range(0, len(grid), every):
            before = float(grid.t[first - 1]) if first else -math.inf
            part = grid.stretch(first, min(first + every, len(grid)), since=before)
            chains[-1].run(part)
            findings = [_finding(candidate, chains) for candidate in chosen]
            estimate = estimate_of(learning.model, findings, 0.0, 0)
            pairs = [estimate[name] for name in names]
            values = np.array([each.value if each.identified else np.nan for each in pairs])
            rows.append((passed + float(part.t[-1] - grid.t[0]), values, np.array([each.std for each in pairs])))
        ends.append(passed + float(grid.t[-1] - grid.t[0]))
    return _gathered(names, rows, ends)


def _finding(candidate: Candidates, chains: Sequence[PaperChain]) -> AxisFindings:
    """Return what the chains have gathered of one axis so far, all its terms free."""
    i = candidate.axis.index
    used = [chain.information(i) for chain in chains if chain.sources.velocity[i] != "absent"]
    if not used or not any(candidate.to_learn):
        return absent(candidate, "")
    solution = solve_axis(merge_information(used), candidate.to_learn, candidate.known)
    if solution is None:
        return absent(candidate, "")
    return AxisFindings(candidate.axis, solution, candidate.to_learn, (None,) * 5, (False,) * 5)
