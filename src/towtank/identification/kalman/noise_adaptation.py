"""Levels of noise and disturbance, from what a pass of the joint filter shows: the one tuning that matters.

The noise of each sensor follows from the innovations, E[nu^2] = H P H^T + R, and the disturbance of each axis from
E[d^2] = d_hat^2 + P_dd. The latter alone runs away where coefficients can stand for a disturbance; so it is held by a
usual level, as so many independent looks at it would hold it.

Where the joint estimator starts: coefficients from least squares or the body's size, levels from the data.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.data.noise import NoiseLevels, noise_level, noise_levels
from towtank.identification.data.samples import N_MEASURED, Samples
from towtank.identification.kalman.state import C_DURATION, FilterSettings, JointState
from towtank.identification.model.prior import usual_disturbance
from towtank.recording import Recording
from towtank.recording.standard import EULER, MOTION, QUATERNION
from towtank.vehicle import Vehicle

__all__ = [
    "adapt_noise",
    "astray",
    "at_odds",
    "common_noise_levels",
    "converged",
    "filter_settings",
    "initial_noise_levels",
    "log_prior_of_levels",
    "midpoint",
    "noise_of_rows",
    "rejected_share",
    "variance_inflation",
    "velocity_walk_of_rows",
]

_NOISE_SHOWN = 1.5  # times what the samples show, at most
_NOISE_AT_LEAST = 0.5  # of it, of a speed: one that was smoothed tells of none at all
_LEVELS_SETTLED = 0.05  # of a level
_USUAL_FOR = 2.0  # independent looks at the disturbance that the usual level counts for
_FAR_ABOVE = 7.0  # times the usual level
_REFUSED, _LONG = 0.3, 10.0  # share of a sensor's samples beyond which, after so long [s], it is the model that is off
_ASTRAY = 0.1  # share of a sensor's samples that a pass refuses which has gone astray
_AT_ODDS = 2.0  # mean innovation^2 / S
_SURELY = 4.0  # deviations by which innovations must be too large
_SMOOTHER = 0.9  # times a roughness that was too large: it hid the disturbance, whose level may rise but not fall
_SWING = 5.0  # by which a level may change from one pass to the next
_FLOOR = 0.3  # of that
_LATEST, _FEWEST = 2000, 30  # rows that tell the noise of a stream
_APART = 0.1  # s between two speeds whose difference tells what a vehicle does
_TYPICAL = np.array([2e-3] * 3 + [2e-3] * 3 + [1e-2] * 3 + [3e-3] * 3 + [5e-2] * 3)
_LEAST = np.array([1e-5] * 3 + [1e-5] * 3 + [1e-4] * 3 + [1e-5] * 3 + [1e-3] * 3)


def adapt_noise(
    state: JointState, levels: NoiseLevels, settings: FilterSettings, shown: Array, *, neighbours: bool = False
) -> NoiseLevels:
    """Return the levels that the pass's own innovations and disturbances speak for.

    Args:
        shown: noise (15,) that the samples show by themselves. Innovations beyond it are the model's, not the sensors'.
        neighbours: of speeds, part noise and roughness by neighbouring innovations. That takes several passes to
            settle, more than a stream has time for.
    """
    noise = levels.noise.copy()
    for j in range(N_MEASURED):
        told, total = state.stats[j, 7:9] if neighbours and 6 <= j < 12 else state.stats[j, :2]
        if told > 50.0:
            square = total / told
            noise[j] = np.sqrt(np.clip(square, noise[j] ** 2 / 4.0, noise[j] ** 2 * 4.0))
    rejected = rejected_share(state) * (state.clock[C_DURATION] > _LONG)
    for j in range(N_MEASURED):
        if j < 6 and state.stats[6 + j, 4] > 0.0:  # a pose beside its speed: forces cannot part the two, clocks can
            noise[j] *= _SWING if rejected[j] > _REFUSED else 1.0
        else:
            noise[j] = min(noise[j], _NOISE_SHOWN * shown[j])
            if neighbours and 6 <= j < 12:
                noise[j] = max(noise[j], _NOISE_AT_LEAST * shown[j])
    disturbance, velocity_walk = levels.disturbance.copy(), _rough(state, levels, steady=neighbours)
    outage = neighbours & (np.nan_to_num(velocity_walk) < _SMOOTHER * np.nan_to_num(levels.velocity_walk))
    floors = np.array([settings.floor_force] * 3 + [settings.floor_moment] * 3)
    usual = np.array(settings.usual)
    for i in range(6):
        if rejected[i] > _REFUSED and not state.stats[6 + i, 4] > 0.0:
            disturbance[i] *= _SWING
            continue
        time, square, variance, effective_samples = state.level[i]
        expected = disturbance[i] ** 2 * time - variance  # what d_hat^2 should have added up to
        if time > 0.0 and expected > 1e-3 * disturbance[i] ** 2 * time:
            ratio = float(np.clip(square / expected, 1.0 / _SWING, _SWING))
            disturbance[i] *= min(
                np.sqrt(ratio), ratio
            )  # down at twice the pace: a level too high hides what would lower it
        if usual[i] > 0.0:
            weight = effective_samples / (effective_samples + _USUAL_FOR)
            disturbance[i] = disturbance[i] ** weight * usual[i] ** (1.0 - weight)
        if outage[i]:
            disturbance[i] = max(disturbance[i], levels.disturbance[i])
    return NoiseLevels(noise, np.maximum(disturbance, floors), velocity_walk)


def rejected_share(state: JointState) -> Array:
    """Return the share (15,) of each column's samples that lay beyond the gate."""
    requested = state.stats[:, 3] + state.stats[:, 4]
    return np.asarray(state.stats[:, 3] / np.maximum(requested, 1.0))


def astray(state: JointState) -> bool:
    """Whether the pass has refused much of a sensor."""
    return bool(np.any(rejected_share(state) > _ASTRAY))


def at_odds(state: JointState) -> bool:
    """Whether innovations are far larger than the levels of the pass allow."""
    believed = state.stats[:, 4]
    return bool(np.any(state.stats[:, 2] > _AT_ODDS * np.maximum(believed, 50.0)))


def _rough(state: JointState, levels: NoiseLevels, *, steady: bool) -> Array:
    """Return the random walk (6,) of speeds that are measured themselves, by one step of scoring.

    A walk adds to a sample's variance what it did since the last one; in the steady state, all that is not forgotten.
    """
    velocity_walk = levels.velocity_walk.copy()
    for i in range(6):
        believed = state.stats[6 + i, 4]
        score, information = state.stats[6 + i, 9:11] if steady else state.stats[6 + i, 5:7]
        now = np.nan_to_num(velocity_walk[i])
        if believed > 50.0 and information > 0.0 and (now > 0.0 or score > _SURELY * np.sqrt(2.0 * information)):
            velocity_walk[i] = np.sqrt(max(now**2 + score / information, 0.0))
    return np.asarray(velocity_walk)


def midpoint(one: NoiseLevels, other: NoiseLevels) -> NoiseLevels:
    """Return the geometric mean of two levels."""
    return NoiseLevels(
        np.sqrt(one.noise * other.noise),
        np.sqrt(one.disturbance * other.disturbance),
        np.sqrt(one.velocity_walk * other.velocity_walk),
    )


def converged(new: NoiseLevels, old: NoiseLevels) -> bool:
    """Whether levels have settled."""
    return bool(
        np.all(np.abs(new.disturbance - old.disturbance) <= _LEVELS_SETTLED * old.disturbance)
        and np.all(np.abs(new.noise - old.noise) <= _LEVELS_SETTLED * old.noise)
        and np.all(
            np.abs(np.nan_to_num(new.velocity_walk - old.velocity_walk))
            <= _LEVELS_SETTLED * np.nan_to_num(old.velocity_walk)
        )
    )


def log_prior_of_levels(levels: NoiseLevels, settings: FilterSettings) -> float:
    """Return the logarithm of the prior likelihood of the disturbance's level, which is `usual` give or take."""
    usual = np.array(settings.usual)
    away = np.log(levels.disturbance[usual > 0.0] / usual[usual > 0.0])
    return -_USUAL_FOR * float(np.sum(away**2))


def variance_inflation(effective_samples: Array) -> Array:
    """Return the factor (6,) by which the usual level pulls down one far above it, after so many looks (6,)."""
    return np.asarray(_FAR_ABOVE ** (_USUAL_FOR / (effective_samples + _USUAL_FOR)))


def initial_noise_levels(recording: Recording, vehicle: Vehicle) -> NoiseLevels:
    """Return noise levels from the recording's own samples and a usual level of the disturbance."""
    found = noise_levels(recording)
    if all(name in recording for name in QUATERNION) and not all(name in found for name in EULER):
        found = {**found, **{name: found[q] for name, q in zip(EULER, QUATERNION[1:], strict=True) if q in found}}
    noise = _TYPICAL.copy()
    for j, name in enumerate(MOTION):
        level = found.get(name)
        if level is not None and np.isfinite(level.std) and level.std > 0.0 and not level.dead:
            noise[j] = max(level.of_each(_rate(recording, name)), level.quantum / math.sqrt(12.0), float(_LEAST[j]))
    return NoiseLevels(noise, usual_disturbance(vehicle))


def common_noise_levels(recordings: Sequence[Recording], samples: Sequence[Samples], vehicle: Vehicle) -> NoiseLevels:
    """Return the levels that several recordings start with: their usual noise, the largest roughness."""
    each = [initial_noise_levels(recording, vehicle) for recording in recordings]
    velocity_walk = np.fmax.reduce([velocity_walk_of_rows(one.t, one.values) for one in samples], axis=0)
    return NoiseLevels(np.median([level.noise for level in each], axis=0), each[0].disturbance, velocity_walk)


def noise_of_rows(t: Array, values: Array) -> Array:
    """Return the noise (15,) of rows (n,), (n, 15), from the latest of them."""
    noise = _TYPICAL.copy()
    for j, name in enumerate(MOTION):
        column = values[-_LATEST:, j]
        known = np.isfinite(column)
        if known.sum() < _FEWEST:
            continue
        stamps = t[-_LATEST:][known]
        regular = np.concatenate([[True], np.diff(stamps) > 0.0])
        level = noise_level(stamps[regular], column[known][regular], "angle" if name in ("phi", "psi") else "linear")
        if np.isfinite(level.std) and level.std > 0.0 and not level.dead:
            span = float(stamps[-1] - stamps[0])
            rate = (len(stamps) - 1) / span if span > 0.0 else level.rate
            noise[j] = max(level.of_each(rate), level.quantum / math.sqrt(12.0), float(_LEAST[j]))
    return noise


def velocity_walk_of_rows(t: Array, values: Array) -> Array:
    """Return what the speeds of rows (n,), (n, 15) do in all, as a random walk (6,) [m/s^2 sqrt(s), rad/s^2 sqrt(s)].

    No model leaves more than this unexplained: a filter that starts from here cannot lose the motion. NaN where there
    are too few samples to tell.
    """
    velocity_walk = np.full(6, np.nan)
    for i in range(6):
        known = np.isfinite(values[:, 6 + i])
        if known.sum() < _FEWEST:
            continue
        stamps, speeds = t[known], values[known, 6 + i]
        apart = np.searchsorted(stamps, stamps + _APART)
        from_, to = np.flatnonzero(apart < stamps.size), apart[apart < stamps.size]
        near = stamps[to] - stamps[from_] < 5.0 * _APART
        if near.any():
            steps = (speeds[to] - speeds[from_])[near] ** 2 / (stamps[to] - stamps[from_])[near]
            velocity_walk[i] = math.sqrt(float(np.mean(steps)))
    return velocity_walk


def _rate(recording: Recording, name: str) -> float:
    channel = recording[name] if name in recording else recording[QUATERNION[0]]
    known = channel.measured
    return (len(known) - 1) / max(float(known.t[-1] - known.t[0]), 1e-9) if len(known) > 1 else 1.0


def filter_settings(vehicle: Vehicle) -> FilterSettings:
    """Return the filter's settings for a vehicle: floors of the disturbance in proportion to its inertia."""
    usual = usual_disturbance(vehicle)
    return FilterSettings(
        floor_force=_FLOOR * float(usual[:3].min()),
        floor_moment=_FLOOR * float(usual[3:].min()),
        usual=tuple(float(level) for level in usual),
    )
