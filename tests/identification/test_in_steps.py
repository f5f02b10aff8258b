"""Passes take what a sensor shows within a step of integration as its mean: the same answer from fewer rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.identification.data.samples import N_MEASURED, Samples, samples_of
from towtank.identification.kalman import passes
from towtank.identification.kalman.passes import joint_fit
from towtank.identification.kalman.problem import JointProblem
from towtank.identification.model.measurements import ATTITUDE, POSITION, RATES, VELOCITY
from towtank.identification.offline.joint import LearningRequest, joint_problem, learn_joint
from towtank.simulation.tank import tank_session

STEP = 0.02  # s
T = 0.01 * np.arange(400)


def rows(t: Array = T, **shown: tuple[int, Array]) -> Samples:
    """Rows with what sensors show (n, 3), NaN where they are silent."""
    values = np.full((t.size, N_MEASURED), np.nan)
    for sensor, numbers in shown.values():
        values[:, 3 * sensor : 3 * sensor + 3] = numbers
    return Samples(t, values, np.zeros(1), np.zeros((1, 1)), np.zeros((6, 1)), np.zeros(1), True)


def of(samples: Samples, sensor: int) -> tuple[Array, Array]:
    """Return times and numbers of a sensor where it speaks."""
    numbers = samples.values[:, 3 * sensor : 3 * sensor + 3]
    known = np.isfinite(numbers).any(axis=1)
    return samples.t[known], numbers[known]


def straight(t: Array) -> Array:
    return np.column_stack([1.0 + 0.7 * t, -0.2 * t, np.full(t.size, 4.0)])


def test_what_goes_on_evenly_is_where_it_was_at_the_mean_of_the_times() -> None:
    jittered = T + np.random.default_rng(1).uniform(0.0, 0.004, T.size)
    for t in (T, jittered, np.delete(T, np.arange(20, 200, 7))):
        found, numbers = of(rows(t, position=(POSITION, straight(t))).averaged(STEP), POSITION)
        np.testing.assert_allclose(numbers, straight(found), atol=1e-12)
        assert np.all(np.diff(found) > 0.0)
        assert t.size / 2 <= found.size <= 0.6 * t.size
    assert found.size < t.size


@pytest.mark.parametrize("per_step", [2, 4, 20])
def test_what_accelerates_is_off_by_half_of_that_times_the_variance_of_the_times(per_step: int) -> None:
    """The mean of a t^2 / 2 is a / 2 (mean^2 + variance of t), and times within a step h vary by h^2 / 4 at most."""
    rate, acceleration = per_step / STEP, np.array([1.0, -3.0, 0.2])
    t = np.arange(per_step * 50) / rate
    found, numbers = of(rows(t, position=(POSITION, 0.5 * t[:, None] ** 2 * acceleration)).averaged(STEP), POSITION)
    assert found.size == 50
    off = numbers - 0.5 * found[:, None] ** 2 * acceleration
    np.testing.assert_allclose(off, np.tile(0.5 * acceleration * np.var(t[:per_step]), (50, 1)), atol=1e-12)
    assert np.all(np.abs(off) <= np.abs(acceleration) * STEP**2 / 8.0)


def test_errors_of_samples_fall_as_the_root_of_how_many_are_one() -> None:
    noise = np.random.default_rng(2).normal(0.0, 0.01, (T.size, 3))
    _, numbers = of(rows(position=(POSITION, noise)).averaged(4 * STEP), POSITION)
    assert np.std(numbers) == pytest.approx(0.01 / np.sqrt(8.0), rel=0.15)


def test_a_heading_that_wraps_is_not_drawn_through_zero() -> None:
    heading = 3.0 + 0.4 * T
    wrapped = np.column_stack([0.1 * np.ones(T.size), -0.1 * np.ones(T.size), (heading + np.pi) % (2 * np.pi) - np.pi])
    t, numbers = of(rows(attitude=(ATTITUDE, wrapped)).averaged(STEP), ATTITUDE)
    assert t.size == T.size // 2
    off = numbers - np.column_stack([0.1 + 0.0 * t, -0.1 + 0.0 * t, 3.0 + 0.4 * t])
    np.testing.assert_allclose((off + np.pi) % (2 * np.pi) - np.pi, 0.0, atol=1e-12)


def test_a_jump_stays_as_it_is_for_the_filter_to_judge() -> None:
    noisy = straight(T) + np.random.default_rng(3).normal(0.0, 1e-3, (T.size, 3))
    noisy[101] += [0.5, 0.0, 0.0]  # the second of its step
    t, numbers = of(rows(position=(POSITION, noisy)).averaged(STEP), POSITION)
    single = np.flatnonzero(np.isin(t, T))
    np.testing.assert_array_equal(t[single], T[[100, 101]])
    np.testing.assert_array_equal(numbers[single], noisy[[100, 101]])


def test_sensors_of_other_rates_and_numbers_that_are_missing_stand_by_themselves() -> None:
    speeds, rates = straight(T), np.full((T.size, 3), 0.2)
    speeds[np.arange(T.size) % 10 != 3] = np.nan  # 10 Hz
    rates[::2, 2] = np.nan  # one number of every other sample
    means = rows(speeds=(VELOCITY, speeds), rates=(RATES, rates)).averaged(STEP)
    t, numbers = of(means, VELOCITY)
    np.testing.assert_allclose(t, T[3::10])
    np.testing.assert_array_equal(numbers, speeds[3::10])
    t, numbers = of(means, RATES)
    np.testing.assert_allclose(t, T)
    np.testing.assert_array_equal(numbers, rates)
    assert len(rows().averaged(STEP)) == T.size  # nothing shows anything


def test_inputs_stay_and_a_slow_log_stays_as_it_is() -> None:
    slow = rows(5.0 * T, position=(POSITION, straight(5.0 * T)))
    means = slow.averaged(STEP)
    np.testing.assert_array_equal(means.t, slow.t)
    np.testing.assert_array_equal(means.values, slow.values)
    assert means.input_t is slow.input_t


def test_means_come_to_what_single_samples_come_to_and_levels_are_of_single_ones() -> None:
    session = tank_session(20.0)
    problem = joint_problem(LearningRequest(session.known, [session.recording]))
    assert len(problem.samples[0]) == pytest.approx(len(problem.of_each.samples[0]) / 2, rel=0.01)
    pose = slice(0, 6)
    np.testing.assert_allclose(problem.own_noise[pose], problem.of_each.own_noise[pose] / np.sqrt(2.0), rtol=5e-3)
    one, other = joint_fit(problem), joint_fit(problem.of_each)
    assert np.all(np.abs(one.theta - other.theta) < 0.3 * other.std)
    told = [
        k for k, name in enumerate(one.prior.names) if name not in ("delay", "lag")
    ]  # thrusters have no lag to tell
    np.testing.assert_allclose(one.std[told], other.std[told], rtol=0.1)
    single = one.levels.noise / problem.quieter
    np.testing.assert_allclose(single[pose], other.levels.noise[pose], rtol=0.1)
    learned = learn_joint(LearningRequest(session.known, [session.recording], free_runs=False))
    assert learned.levels is not None
    np.testing.assert_allclose(learned.levels.noise[pose], single[pose], rtol=1e-6)
    assert learned.estimate.samples == len(problem.of_each.samples[0])


def test_what_stands_for_a_long_log_is_gone_over_first_and_all_of_it_last(monkeypatch: pytest.MonkeyPatch) -> None:
    session = tank_session(20.0)
    problem = joint_problem(LearningRequest(session.known, [session.recording]))
    taken, one_pass = list[int](), passes.one_pass

    def counting(asked: JointProblem, *words: Any, **options: Any) -> Any:
        taken.append(sum(map(len, asked.samples)))
        return one_pass(asked, *words, **options)

    monkeypatch.setattr(passes, "one_pass", counting)
    monkeypatch.setattr(passes, "spread", lambda samples: [samples[0].stretch(0, 600)])
    passes.joint_fit(problem)
    assert taken[0] == 600
    assert sorted(taken) == taken
    assert taken[-1] == len(problem.samples[0])


def test_gyros_alone_are_taken_sample_by_sample() -> None:
    session = tank_session(3.0)
    samples = samples_of(session.recording, session.known)
    samples.values[:, :9] = np.nan
    problem = joint_problem(LearningRequest(session.known, [session.recording], [samples]))
    assert problem.of_each is problem
    assert problem.samples[0] is samples
