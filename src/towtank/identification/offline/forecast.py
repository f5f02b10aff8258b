"""What a learning will know of each coefficient: predicted accuracy (Cramer and Rao) of a recording, before it is
learned.

Two judges: least squares, whose deviations account for coloured residuals and stay true where the disturbance is of any
kind; and a few passes of the joint filter, whose covariance is the bound where its picture of the disturbance is right.
The filter is believed where its coefficients and its delay agree with those of least squares.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from towtank.identification.data.samples import NoiseLevels, held_forces, prepared, samples_of
from towtank.identification.kalman.iterated import FilterProblem, joint_passes, prior_deviation
from towtank.identification.kalman.noise_adaptation import filter_settings, initial_noise_levels
from towtank.identification.least_squares.chain import uses_commands
from towtank.identification.model.parameters import DELAY, UNTRANSFORMED, free_parameters
from towtank.identification.model.prior import size_of, start_theta
from towtank.identification.posterior.assembly import LogLearning
from towtank.identification.posterior.estimate import Estimate
from towtank.identification.posterior.identifiability import excitation, excitation_words
from towtank.identification.posterior.statistics import deviations, information_of_data, relative
from towtank.identification.posterior.wording import phrase, role
from towtank.recording import Grid, Recording
from towtank.vehicle import Vehicle, configuration_matrix, index, unit

__all__ = ["Forecast", "PredictedAccuracy", "best_excited", "forecast"]

_MOST_ROWS = 24_000  # of a recording that are used,
_STRETCHES = 6  # cut into so many where there are more
_PASSES = 3
_APART = 4.0  # deviations of least squares, up to which both agree,
_CLOSE = 0.05  # and share of the value that its filters may bias it by,
_CLOSE_DELAY = 0.01  # s; of the delay
_MAY_BE_NOTHING = 25.0  # %, above which a term that may as well be 0 is given in its own unit


@dataclass(frozen=True)
class PredictedAccuracy:
    """One coefficient: to how many percent it will be known (inf: not), its deviation in its own unit, a sentence."""

    percent: float
    std: float
    unit: str
    text: str


@dataclass(frozen=True, eq=False)
class Forecast:
    """What a recording will make known.

    Attributes:
        known: by name. delay, delay_std: [s], the deviation NaN where it cannot be told.
        agrees: whether the filter is believed. levels: of noise and disturbance, as the filter sees them.
    """

    known: dict[str, PredictedAccuracy]
    delay: float
    delay_std: float
    agrees: bool
    levels: NoiseLevels


def forecast(
    vehicle: Vehicle,
    recordings: Sequence[Recording],
    first: LogLearning,
    *,
    progress: Callable[[float], None] | None = None,
) -> Forecast | None:
    """Return how well recordings determine the coefficients that least squares found in them; None where it found none.

    Args:
        recordings: with thrusters bound to the vehicle's. first: what least squares found in them.
        progress: called with the share done, 0 .. 1.
    """
    estimate = first.estimate
    names = [each.name for each in estimate.coefficients if each.identified]
    if not names:
        return None
    samples = [samples_of(prepared(recording, vehicle), vehicle) for recording in recordings]
    free = free_parameters(vehicle, [*names, *([DELAY] if any(each.commands for each in samples) else [])])
    known = vehicle.with_coefficients({name: estimate[name].value for name in names})
    scale = size_of(vehicle, free)
    deviation = prior_deviation(free, scale)
    fit = joint_passes(
        FilterProblem(samples, np.array(first.model.parameters), free, deviation, delay=first.delay),
        start_theta(vehicle, known, free, delay=first.delay, lag=0.05),
        initial_noise_levels(recordings[0], vehicle),
        filter_settings(vehicle),
        most=_PASSES,
        progress=progress,
    )
    size = np.where(free.codes[:, 3] == UNTRANSFORMED, np.maximum(np.abs(fit.theta), 1e-9 * scale), 1.0)
    information = information_of_data(fit.covariance, np.diag(deviation**-2.0))
    std = deviations(relative(information, size)) * size * np.abs(free.slopes(fit.theta))
    values = dict(zip(free.names, free.values(fit.theta), strict=True))
    spread = dict(zip(free.names, std, strict=True))
    delay_std = float("nan") if first.delay_scan is None else first.delay_scan.std
    agrees = all(
        abs(values[name] - estimate[name].value)
        <= _APART * estimate[name].std + _CLOSE * abs(_total(vehicle, name, estimate[name].value))
        for name in names
    )
    delay = first.delay
    if DELAY in values:
        agrees = agrees and not abs(values[DELAY] - delay) > _APART * delay_std + _CLOSE_DELAY
        if agrees:
            delay, delay_std = max(0.0, float(values[DELAY])), float(spread[DELAY])
    learned = {name: float(spread[name]) if agrees else estimate[name].std for name in names}
    return Forecast(_predicted_accuracies(vehicle, estimate, learned), delay, delay_std, agrees, fit.levels)


def _predicted_accuracies(vehicle: Vehicle, estimate: Estimate, std: dict[str, float]) -> dict[str, PredictedAccuracy]:
    """Return the accuracies of coefficients with these deviations; an added inertia counts with the rigid body's."""
    size = np.array([abs(_total(vehicle, name, estimate[name].value)) for name in std])
    with np.errstate(divide="ignore"):
        percents = excitation(tuple(std), np.diag((np.array(list(std.values())) / size) ** 2))
    texts = dict(zip(percents, excitation_words(percents), strict=True))
    for name, deviation in std.items():
        if percents[name] > _MAY_BE_NOTHING and role(name).kind in ("restoring", "constant") and np.isfinite(deviation):
            texts[name] = f"{phrase(name)} will be known to {deviation:.2g} {unit(name)}"
    return {name: PredictedAccuracy(percents[name], std[name], unit(name), texts[name]) for name in std}


def _total(vehicle: Vehicle, name: str, value: float) -> float:
    kind, i, j = index(name)
    return float(vehicle.rigid_body_matrix[i, j]) - value if kind == "mass" else value


def best_excited(grid: Grid, vehicle: Vehicle, rows: int = _MOST_ROWS) -> tuple[tuple[float, float], ...]:
    """Return the stretches (start, end) [s], of so many rows in all, in which the thrusters do the most on each axis;
    one that spans the grid where it has no more rows than that.
    """
    n = len(grid)
    if n <= rows:
        return ((float(grid.t[0]), float(grid.t[-1])),)
    wrench = grid.wrench
    if uses_commands(vehicle, grid):
        wrench = held_forces(vehicle, grid.commands, None) @ configuration_matrix(vehicle).T
    long = rows // _STRETCHES
    done = np.vstack([np.zeros(6), np.cumsum(np.nan_to_num(wrench) ** 2, axis=0)])
    inside = done[long:] - done[:-long]
    taken: list[int] = []
    for axis in range(6):
        free = np.all([np.abs(np.arange(len(inside)) - first) >= long for first in taken], axis=0)
        score = np.where(free, inside[:, axis], -1.0)[: n - long]
        if score.max() > 0.0:
            taken.append(int(np.argmax(score)))
    return tuple((float(grid.t[first]), float(grid.t[first + long])) for first in sorted(taken or [0]))
