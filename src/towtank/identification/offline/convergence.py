"""How coefficients settled over a log: the last pass over it once more, read along the way.

Of the joint filter it is a pass from the prior, linearised about what was learned; of the paper's method, least squares
with the terms that it chose. It shows how the information came in. Where free runs had the last word, or the posterior
was widened by what windows disagree about, that lies beside its end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.samples import prepared, samples_of
from towtank.identification.kalman.noise_adaptation import filter_settings
from towtank.identification.kalman.passes import one_pass
from towtank.identification.kalman.problem import JointProblem, settings_for
from towtank.identification.least_squares.chain import PaperChain, Settings, uses_commands
from towtank.identification.least_squares.solution import (
    AxisFindings,
    absent,
    estimate_of,
    merge_information,
    solve_axis,
)
from towtank.identification.model.terms import Candidates, candidates
from towtank.identification.posterior.assembly import LogLearning, Mode
from towtank.recording import Recording

__all__ = ["Convergence", "convergence"]

_READINGS, _READINGS_PAPER = 200, 60  # of least squares each is a solution


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
    if learning.mode is None:
        return _by_least_squares(learning, names)
    return _by_filter(learning, learning.mode, recordings, names)


def _by_filter(
    learning: LogLearning, mode: Mode, recordings: Sequence[Recording], names: tuple[str, ...]
) -> Convergence:
    samples = [samples_of(prepared(recording, learning.vehicle), learning.vehicle) for recording in recordings]
    settings = settings_for(samples, filter_settings())
    if math.isfinite(learning.wave_period):
        settings = replace(settings, wave_period=learning.wave_period)
    free = mode.prior.free
    problem = JointProblem(samples, learning.model, mode.prior, settings, mode.levels.noise, learning.delay)
    problem = problem.between_looks() if mode.looked_at else problem
    _, _, readings, _ = one_pass(problem, mode.theta, mode.levels, windows=_READINGS)
    kept = [free.names.index(name) for name in names]
    rows = []
    for each in readings[1:]:
        std = np.sqrt(np.maximum(np.diag(each.covariance), 0.0))
        rows.append((each.t, free.values(each.theta)[kept], (std * np.abs(free.slopes(each.theta)))[kept]))
    ends = np.cumsum([each.duration for each in samples])
    return _gathered(names, rows, ends.tolist())


def _gathered(names: tuple[str, ...], rows: list[tuple[float, Array, Array]], ends: list[float]) -> Convergence:
    t, values, std = (np.array(column) for column in zip(*rows, strict=True))
    known = np.where(np.isfinite(values) & np.isfinite(std), 1.0, np.nan)
    return Convergence(names, t, values * known, std * known, tuple(ends[:-1]))


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
