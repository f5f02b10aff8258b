"""Noise levels of the joint filter: where it starts, and what a pass shows of them; the one tuning that matters.

The noise of each sensor follows from the innovations, E[nu^2] = H P H^T + R, and the disturbance of each axis from
E[d^2] = d_hat^2 + P_dd. The latter alone runs away where coefficients can stand for a disturbance; so it is held by a
usual level, as so many independent samples of it would hold it, and by the accelerations that motion and inputs show.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.core.layout import I_MASS, I_MASS_INVERSE
from towtank.identification.data.samples import N_MEASURED, NoiseLevels, Samples
from towtank.identification.kalman.state import FilterSettings, JointState
from towtank.identification.model.terms import DISTURBANCE
from towtank.recording.frames.rotations import conjugate, multiply, rotate

__all__ = [
    "accelerations_of",
    "adapt_noise",
    "converged",
    "diverged",
    "filter_settings",
    "follows",
    "most_disturbed",
]

_NOISE_AT_MOST = 1.5  # times what the samples show by themselves
_NOISE_AT_LEAST = 0.5  # of it: a sensor that was smoothed leaves no innovations
_CONVERGED = 0.05  # of a level
_USUAL_FOR = 2.0  # effective samples of the disturbance that the usual level counts for
_MODEL_OFF = 0.3  # share of a sensor's samples beyond the gate, from which the model is off
_FOLLOWS = 0.07  # that share, up to which motion follows
_FORESEEN = 0.8  # times the square that is expected of innovations, below which levels are too high
_COUNTED = 50.0  # samples from which innovations say something of a level
_WALK_SURE = 4.0  # deviations by which innovations must be too large for a velocity walk
_SMOOTHER = 0.9  # times a velocity walk that was too large: it hid the disturbance, whose level may rise but not fall
_SWING = 5.0  # factor by which a level may change from one pass to the next
_FLOOR_SHARE = 0.3  # of the usual disturbance: its least level
_LEAST_WAVE = 2e-3  # m/s
_FEWEST_ROWS = 30  # of a column, from which it shows an acceleration
_PUSHED_FOR = 0.3  # s between two poses or speeds whose difference shows an acceleration


def adapt_noise(state: JointState, levels: NoiseLevels, settings: FilterSettings, own_noise: Array) -> NoiseLevels:
    """Return the levels that the pass's own innovations and disturbances speak for.

    Where a column is foreseen better than its levels allow for, its noise does not rise; of a speed, the disturbance
    along its axis falls, whatever it was taken for: what an unknown of that axis is off by has passed for one. Of a
    pose, where the disturbance falls, its noise falls no farther than by its share: each would take all for its own.

    Args:
        own_noise: (18,) that samples show by themselves. Innovations beyond it are the model's, not the sensors'.
    """
    noise = levels.noise.copy()
    measured = state.statistics["accepted"] > 0.0
    nis = state.statistics["nis_sum"] / np.maximum(state.statistics["accepted"], 1.0)
    foreseen = measured & (nis < _FORESEEN)
    for j, own in enumerate(state.statistics):
        speed = 6 <= j < 12  # whose noise and velocity walk are parted by neighbouring innovations
        count, total = (own.neighbours, own.neighbour_sum) if speed else (own.noise_samples, own.noise_sum)
        if count > _COUNTED:
            square = total / count
            noise[j] *= np.sqrt(np.clip(square / noise[j] ** 2, 0.25, 1.0 if foreseen[j] else 4.0))
    for j in range(N_MEASURED):
        if not (j < 6 and measured[6 + j]):
            noise[j] = min(noise[j], _NOISE_AT_MOST * own_noise[j])
        noise[j] = max(noise[j], _NOISE_AT_LEAST * own_noise[j])
    disturbance, velocity_walk = levels.disturbance.copy(), _velocity_walk(state, levels)
    smoother = np.nan_to_num(velocity_walk) < _SMOOTHER * np.nan_to_num(levels.velocity_walk)
    floors = np.array([settings.floor_force] * 3 + [settings.floor_moment] * 3)
    usual = np.array(settings.usual)
    for i, shown in enumerate(state.disturbance_statistics):
        expected = disturbance[i] ** 2 * shown.time - shown.variance  # what d_hat^2 should have added up to
        if shown.time > 0.0 and expected > 1e-3 * disturbance[i] ** 2 * shown.time:
            ratio = float(np.clip(shown.square / expected, 1.0 / _SWING, _SWING))
            if foreseen[6 + i] and noise[6 + i] > _NOISE_AT_LEAST * own_noise[6 + i]:  # else the noise is too large
                ratio = min(ratio, max(nis[6 + i], 1.0 / _SWING))
            disturbance[i] *= min(np.sqrt(ratio), ratio)  # down at twice the pace: a high level hides what lowers it
        if usual[i] > 0.0:
            weight = shown.effective_samples / (shown.effective_samples + _USUAL_FOR)
            disturbance[i] = disturbance[i] ** weight * usual[i] ** (1.0 - weight)
        if smoother[i]:
            disturbance[i] = max(disturbance[i], levels.disturbance[i])
    disturbance = np.maximum(disturbance, floors)
    falls = disturbance < (1.0 - _CONVERGED) * levels.disturbance
    noise[:6] = np.maximum(noise[:6], np.where(falls, levels.noise[:6] * np.sqrt(np.minimum(nis[:6], 1.0)), 0.0))
    waves = _wave_level(state, levels)
    return replace(levels, noise=noise, disturbance=disturbance, velocity_walk=velocity_walk, waves=waves)


def _wave_level(state: JointState, levels: NoiseLevels) -> Array:
    """Return the deviations (3,) of the water's velocity in waves, as the pass shows them; 0 where it has none."""
    waves = levels.waves.copy()
    for i, shown in enumerate(state.wave_statistics):
        expected = waves[i] ** 2 * shown.time - shown.variance
        if expected > 1e-3 * waves[i] ** 2 * shown.time > 0.0:
            waves[i] *= np.sqrt(np.clip(shown.square / expected, 1.0 / _SWING, _SWING))
    return np.where(waves > 0.0, np.maximum(waves, _LEAST_WAVE), 0.0)


def rejected_share(state: JointState) -> Array:
    """Return the share (18,) of each column's samples that lay beyond the gate."""
    rejected, accepted = state.statistics["rejected"], state.statistics["accepted"]
    return np.asarray(rejected / np.maximum(rejected + accepted, 1.0))


def diverged(state: JointState) -> bool:
    """Return whether the pass has rejected much of a sensor."""
    return bool((rejected_share(state) > _MODEL_OFF).any())


def follows(state: JointState) -> bool:
    """Return whether the pass came to numbers, and has rejected little of every sensor."""
    return bool(np.isfinite(state.theta).all() and rejected_share(state).max() < _FOLLOWS)


def _velocity_walk(state: JointState, levels: NoiseLevels) -> Array:
    """Return the random walk (6,) of speeds that are measured themselves, by one step of scoring.

    In the steady state a walk adds to a sample's variance all that it did and is not forgotten.
    """
    velocity_walk = levels.velocity_walk.copy()
    for i, own in enumerate(state.statistics[6:12]):
        score, information = own.steady_score, own.steady_information
        now = np.nan_to_num(velocity_walk[i])
        sure = now > 0.0 or score > _WALK_SURE * np.sqrt(2.0 * information)
        if own.accepted > _COUNTED and information > 0.0 and sure:
            velocity_walk[i] = np.sqrt(max(now**2 + score / information, 0.0))
    return np.asarray(velocity_walk)


def converged(new: NoiseLevels, old: NoiseLevels, before: NoiseLevels) -> bool:
    """Return whether levels have converged, or only go to and fro between these, the `old` ones and those `before`."""

    def settled(now: Array, then: Array, first: Array) -> bool:
        change = np.nan_to_num(now - then)
        return bool(np.all((np.abs(change) <= _CONVERGED * np.nan_to_num(then)) | (change * (then - first) < 0.0)))

    return all(map(settled, new.random, old.random, before.random))


def most_disturbed(samples: Sequence[Samples], p: Array) -> Array:
    """Return the largest level (6,) that a disturbance may have [m/s^2, rad/s^2], infinite where that is unknown.

    What pushes an axis shows in its motion, or inputs stand against it: so it is not larger than the accelerations of
    both, and the usual one. Without that, a large push on heavy damping looks like a small one on light damping, and
    passes go on from one to the other.

    Args:
        p: kernel parameters (170,): the inertia that inputs move.
    """
    inertia = p[I_MASS:I_MASS_INVERSE].reshape(6, 6).diagonal()
    most = np.zeros(6)
    for each in samples:
        pushed = each.input_force @ each.B.T / inertia
        own = np.sqrt(np.mean(pushed**2, axis=0)) if len(pushed) else 0.0
        most = np.maximum(most, accelerations_of(each) + own)
    return np.asarray(most + np.array(DISTURBANCE), dtype=np.float64)


def accelerations_of(samples: Samples) -> Array:
    """Return the accelerations (6,) [m/s^2, rad/s^2] of the body that nine in ten samples stay below.

    Of speeds that are measured, else of the pose; infinite where an accelerometer alone feels them beside gravity, and
    0 where nothing does.
    """
    feels = np.isfinite(samples.values[:, 12:15]).any(axis=0)
    out = np.where(np.append(feels, [False] * 3), np.inf, 0.0)
    posed = np.asarray(np.isfinite(samples.values[:, :6]).all(axis=1))
    for i in range(6):
        known = np.asarray(np.isfinite(samples.values[:, 6 + i]))
        if known.sum() < _FEWEST_ROWS and posed.sum() >= _FEWEST_ROWS:
            rows = _spaced(samples.t, posed)
            q = quaternions_from_eulers(samples.values[rows, 3:6])
            between, back = np.diff(samples.t[rows]), conjugate(q[:-1])
            if i < 3:
                moved = rotate(back, np.diff(samples.values[rows, :3], axis=0))[:, i]
            else:
                turn = multiply(back, q[1:])
                moved = 2.0 * np.sign(turn[:, 0]) * turn[:, i - 2]
            speeds, t = moved / between, samples.t[rows[:-1]] + 0.5 * between
        elif known.sum() >= _FEWEST_ROWS:
            rows = _spaced(samples.t, known)
            speeds, t = samples.values[rows, 6 + i], samples.t[rows]
        else:
            continue
        if len(speeds) > 1:
            out[i] = float(np.quantile(np.abs(np.diff(speeds) / np.diff(t)), 0.9))
    return out


def _spaced(t: Array, known: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return rows that are known, each `_PUSHED_FOR` after the one before at least."""
    there = np.flatnonzero(known)
    at = np.searchsorted(t[there], np.arange(t[there[0]], t[there[-1]], _PUSHED_FOR))
    return np.asarray(there[np.unique(at[at < there.size])])


def filter_settings() -> FilterSettings:
    """Return the filter's settings: usual levels of the disturbance, and floors."""
    return FilterSettings(
        floor_force=_FLOOR_SHARE * DISTURBANCE[0], floor_moment=_FLOOR_SHARE * DISTURBANCE[3], usual=DISTURBANCE
    )
