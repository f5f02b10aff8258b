"""Inputs that were given and held, and inputs that were looked at now and then while they went on."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.identification import LogLearning, learn_recordings
from towtank.identification.data.samples import Samples
from towtank.identification.kalman.passes import joint_fit
from towtank.identification.kalman.rivals import as_looked_at
from towtank.identification.offline.convergence import convergence
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.recording import held_mean

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from looked_study import DELAY, INERTIAS, LAG, driven
from undriven_study import told

WENT_ON = "looked at now and then"


def given(t: Array, force: Array) -> Samples:
    """Inputs of one force, (k,) at stamps (k,), and nothing measured."""
    return Samples(
        t=np.zeros(1),
        values=np.full((1, 18), np.nan),
        input_t=t,
        input_force=force[:, None],
        B=np.eye(6)[:, :1],
        lag=np.zeros(1),
        commands=True,
    )


def a_hand(period: float, seconds: float = 10.0) -> tuple[Array, Array]:
    t = period * np.arange(round(seconds / period))
    return t, np.sin(1.3 * t) + 0.4 * np.sin(3.1 * t + 1.0)


def means(samples: Samples, edges: Array) -> Array:
    """Mean of the input between edges (n,), held from each stamp to the next: (n - 1,)."""
    return np.asarray(held_mean(samples.input_t, samples.input_force, edges, 0.0))[:, 0]


@pytest.mark.parametrize("period", [0.05, 0.1, 0.2, 0.5])
def test_between_two_looks_an_input_goes_on(period: float) -> None:
    t, force = a_hand(period)
    looked = given(t, force).between_looks()
    assert np.max(np.diff(looked.input_t)) < 0.03
    assert looked.input_force[-1, 0] == force[-1]
    often = np.linspace(0.0, t[-1], 4000)
    hand = np.sin(1.3 * often) + 0.4 * np.sin(3.1 * often + 1.0)
    held, gone_on = (
        np.sqrt(np.mean((each - hand) ** 2))
        for each in (
            force[np.searchsorted(t, often, "right") - 1],
            looked.input_force[np.searchsorted(looked.input_t, often, "right") - 1, 0],
        )
    )
    assert gone_on < 0.5 * held


@pytest.mark.parametrize("period", [0.05, 0.1, 0.5])
def test_a_hand_that_moves_evenly_is_told_exactly(period: float) -> None:
    t = period * np.arange(60)
    looked = given(t, 3.0 - 0.7 * t).between_looks()
    middle = 0.5 * (looked.input_t[1:] + looked.input_t[:-1])
    assert looked.input_force[:-1, 0] == pytest.approx(3.0 - 0.7 * middle, abs=1e-10)


def test_between_two_looks_it_is_hermites_cubic_with_the_harmonic_mean_of_slopes() -> None:
    """Fritsch and Butland's slopes for the cubic of Fritsch and Carlson (SIAM J. Numer. Anal. 17, 1980)."""
    t, force = 0.2 * np.arange(4), np.array([0.0, 1.0, 4.0, 5.0])
    rise = np.diff(force) / 0.2
    left, right = (2.0 / (1.0 / rise[k] + 1.0 / rise[k + 1]) for k in (0, 1))
    over = 0.2 * (0.5 * (force[1] + force[2]) + 0.2 * (left - right) / 12.0)  # Hermite's cubic, integrated
    looked = given(t, force).between_looks()
    assert 0.2 * means(looked, t[1:3])[0] == pytest.approx(over, rel=1e-12)


@pytest.mark.parametrize("period", [0.1, 0.2])
def test_no_force_goes_beyond_what_was_seen_on_either_side(period: float) -> None:
    t, _ = a_hand(period)
    force = np.random.default_rng(3).choice([-1.0, 0.0, 1.0, 1.5], size=t.size)
    force[1:][np.diff(force) == 0.0] += 0.1
    looked = given(t, force).between_looks()
    before = np.searchsorted(t, looked.input_t[:-1] + 1e-6, "right") - 1
    low, high = np.minimum(force[before], force[before + 1]), np.maximum(force[before], force[before + 1])
    assert np.all(looked.input_force[:-1, 0] >= low - 1e-9)
    assert np.all(looked.input_force[:-1, 0] <= high + 1e-9)


@pytest.mark.parametrize("repeats", [2, 3])
def test_a_table_that_repeats_what_was_seen_is_looked_at_no_oftener(repeats: int) -> None:
    t, force = a_hand(0.12)
    often = given(0.12 / repeats * np.arange(repeats * t.size), np.repeat(force, repeats))
    seldom = given(t, force)
    assert often.input_period == pytest.approx(0.12)
    edges = np.linspace(0.0, t[-1], 700)
    assert means(often.between_looks(), edges) == pytest.approx(means(seldom.between_looks(), edges), abs=1e-9)


def test_what_rests_between_looks_is_held_until_the_last_of_them() -> None:
    t, force = a_hand(0.1)
    force[40:60] = force[40]  # the hand rests for two seconds
    looked = given(t, force).between_looks()
    edges = np.linspace(t[40], t[59], 40)
    assert means(looked, edges) == pytest.approx(np.full(39, force[40]), abs=1e-12)
    assert abs(means(looked, t[59:61])[0] - force[59]) > 0.2 * abs(force[60] - force[59])


def test_where_nothing_was_recorded_for_long_the_last_is_held() -> None:
    t, force = a_hand(0.1)
    kept = np.delete(np.arange(t.size), np.arange(41, 60))
    looked = given(t[kept], force[kept]).between_looks()
    assert means(looked, np.array([t[40], t[59]]))[0] == pytest.approx(force[40])
    assert abs(means(looked, t[59:61])[0] - force[40]) > 0.2 * abs(force[60] - force[40])


@pytest.mark.parametrize("period", [0.01, 0.02, 0.7])
def test_quick_inputs_and_steps_stay_as_they_are(period: float) -> None:
    samples = given(*a_hand(period))
    assert samples.between_looks() is samples


def test_without_inputs_or_with_one_nothing_happens() -> None:
    for n in (0, 1, 2):
        samples = given(np.arange(n) * 0.1, np.ones(n))
        assert samples.between_looks() is samples


@pytest.fixture(scope="module")
def looked_at() -> LogLearning:
    truth, run = driven("10 Hz", 1)
    return learn_recordings(told(truth), [run.window(0.0, 20.0)])


def test_of_outputs_that_are_looked_at_delay_and_inertias_are_right(looked_at: LogLearning) -> None:
    truth, _ = driven("10 Hz", 1)
    assert looked_at.mode is not None
    assert looked_at.mode.looked_at
    assert any(WENT_ON in each for each in looked_at.remarks)
    assert looked_at.delay + looked_at.lag == pytest.approx(DELAY + LAG, abs=0.01)
    for name, rigid, total in zip(INERTIAS, np.diag(truth.rigid_body_matrix), np.diag(truth.mass_matrix), strict=True):
        assert rigid - looked_at.estimate[name].value == pytest.approx(total, rel=0.02)


def test_how_they_settled_ends_where_they_came_to(looked_at: LogLearning) -> None:
    _, run = driven("10 Hz", 1)
    settled = convergence(looked_at, [run.window(0.0, 20.0)])
    k = settled.names.index("X_udot")
    assert settled.values[-1, k] == pytest.approx(looked_at.estimate["X_udot"].value, rel=0.02)


@pytest.mark.parametrize("case", ["held", "10 Hz"])
def test_held_inputs_and_a_delay_that_is_given_count_from_their_stamps(case: str) -> None:
    truth, run = driven(case, 1)
    delay = None if case == "held" else 0.0
    learning = learn_recordings(told(truth), [run.window(0.0, 20.0)], delay=delay)
    assert learning.mode is not None
    assert not learning.mode.looked_at
    assert not any(WENT_ON in each for each in learning.remarks)
    if case == "held":
        assert learning.delay + learning.lag == pytest.approx(DELAY + LAG, abs=0.003)


def test_single_samples_are_asked_of_the_same_inputs() -> None:
    truth, run = driven("10 Hz", 1)
    problem = joint_problem(LearningRequest(told(truth), [run.window(0.0, 5.0)]))
    looked = problem.between_looks()
    for means_of, single in zip(looked.samples, looked.of_each.samples, strict=True):
        assert np.array_equal(means_of.input_t, single.input_t)
    assert looked.between_looks() is looked
    given_delay = replace(problem, prior=problem.prior.only([n for n in problem.prior.names if n != "delay"]))
    assert as_looked_at(given_delay, None) is None  # type: ignore[arg-type]


def test_what_passes_come_to_decides_and_not_the_first_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where passes have not settled, one about another picture may be likelier by chance than one about the answer."""
    truth, run = driven("10 Hz", 1)
    problem = joint_problem(LearningRequest(told(truth), [run.window(0.0, 10.0)]))
    held = joint_fit(problem)
    found = as_looked_at(problem, held)
    assert found is not None
    assert found[1].likelihood > held.likelihood + 20.0
    as_likely = replace(found[1], likelihood=held.likelihood + 19.0)
    monkeypatch.setattr("towtank.identification.kalman.rivals.joint_fit", lambda *given, **named: as_likely)
    assert as_looked_at(problem, held) is None
