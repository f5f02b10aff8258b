"""Other pictures of the same data: when they are asked, and what they say of the posterior that speaks."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.identification import learn_recordings
from towtank.identification.data.samples import prepared, samples_of
from towtank.identification.kalman import rivals
from towtank.identification.kalman.passes import joint_fit
from towtank.identification.kalman.problem import JointFit, JointProblem
from towtank.identification.kalman.rivals import (
    Rival,
    apart_from,
    forbidden_rival,
    late_rival,
    likeliest_rival,
    quick_rival,
)
from towtank.identification.kalman.state import coefficient_block
from towtank.identification.offline import joint
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.recording.grids.grid import held_at

from .runs import unknown

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from pushed_box import flight, true_box

LACKS = "the model lacks something"
SECONDS = 40.0


def asked(case: str, seed: int = 1) -> tuple[JointProblem, JointFit]:
    """The question of a run, and the filter's answer with a slow disturbance."""
    vehicle = unknown(true_box())
    recording = prepared(flight(case, seed).window(0.0, SECONDS), vehicle)
    problem = joint_problem(LearningRequest(vehicle, [recording], [samples_of(recording, vehicle)]))
    return problem, joint_fit(problem)


@pytest.fixture(scope="module")
def slow() -> tuple[JointProblem, JointFit]:
    return asked("as recorded")


@pytest.fixture(scope="module")
def stirred() -> tuple[JointProblem, JointFit]:
    return asked("quick water")


def test_where_windows_agree_and_one_pass_speaks_against_it_nobody_asks(
    slow: tuple[JointProblem, JointFit], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, fit = slow
    assert fit.disagreement < rivals.CONTRADICTED
    monkeypatch.setattr(rivals, "joint_fit", None)  # asked, it would fail
    assert quick_rival(problem, fit, fit.likelihood) is None


def test_slow_water_is_likelier_with_a_slow_disturbance(slow: tuple[JointProblem, JointFit]) -> None:
    problem, fit = slow
    assert quick_rival(problem, replace(fit, disagreement=2.0), fit.likelihood) is None


@pytest.mark.parametrize("disagreement", [1.0, 2.0])
def test_quick_water_is_likelier_with_a_quick_disturbance(
    stirred: tuple[JointProblem, JointFit], disagreement: float
) -> None:
    """Whether windows contradict each other or not, and though a current that walks has stood for what is quick."""
    problem, fit = stirred
    levels = replace(fit.levels, current_walk=0.03)
    rival = quick_rival(problem, replace(fit, disagreement=disagreement, levels=levels), fit.likelihood)
    assert rival is not None
    assert rival.fit.levels.current_walk < 0.01
    assert rival.fit.likelihood > fit.likelihood + 100.0
    assert rival.fit.free.names == fit.free.names
    assert rival.fit.disagreement < 1.2  # its picture of what is random is right: windows agree


def test_nothing_is_late_where_forces_act_as_recorded(slow: tuple[JointProblem, JointFit]) -> None:
    problem, fit = slow
    assert late_rival(problem, fit, fit.likelihood) is None


def test_the_likeliest_of_several_pictures_counts(
    slow: tuple[JointProblem, JointFit], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, fit = slow
    one = Rival(replace(fit, likelihood=fit.likelihood + 30.0), fit.theta, fit.std, "one")
    other = Rival(replace(fit, likelihood=fit.likelihood + 40.0), fit.theta, fit.std, "other")
    cases = ((one, other, None, other), (other, one, None, other), (None, one, other, other), (None, None, None, None))
    for *each, chosen in cases:
        for kind, it in zip(("quick", "late", "forbidden"), each, strict=True):
            monkeypatch.setattr(rivals, f"{kind}_rival", lambda *asked, it=it: it)
        assert likeliest_rival(problem, fit) is chosen


def test_an_answer_is_as_likely_as_a_pass_about_it(
    slow: tuple[JointProblem, JointFit], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Passes that did not settle may have been far likelier on the way: nothing was said against what they came to."""
    problem, fit = slow
    knew: list[float] = []
    for kind in ("quick", "late", "forbidden"):
        monkeypatch.setattr(rivals, f"{kind}_rival", lambda *asked: knew.append(asked[-1]))
    on_the_way = replace(fit, likelihood=fit.likelihood + 1000.0, still=False)
    assert likeliest_rival(problem, on_the_way) is None
    assert knew == pytest.approx([fit.likelihood] * 3, abs=1.0)
    monkeypatch.setattr(rivals, "one_pass", None)
    assert fit.still
    assert likeliest_rival(problem, fit) is None  # the last pass was one about it
    assert knew[3:] == [fit.likelihood] * 3


@pytest.mark.parametrize(("deviations", "asked_for"), [(0.0, False), (5.0, False), (8.0, True)])
def test_data_that_ask_for_what_physics_forbids_are_another_picture(
    slow: tuple[JointProblem, JointFit], deviations: float, asked_for: bool
) -> None:
    """At a bound the likelihood is lower by half the square of how many deviations the data lie beyond it."""
    problem, fit = slow
    k = fit.free.names.index("X_uu")
    known = coefficient_block(fit.state)
    beyond = fit.theta + deviations * known[:, k] / np.sqrt(known[k, k])
    rival = forbidden_rival(replace(fit, mean=beyond, forbidden=0.5 * deviations**2), fit.likelihood)
    assert (rival is not None) == asked_for
    if rival is not None:
        np.testing.assert_array_equal(rival.theta, beyond)
        assert rival.fit.likelihood == pytest.approx(fit.likelihood + 0.5 * deviations**2)
        apart, [text] = apart_from(problem, fit, rival)
        assert "physics forbids" in text
        assert np.hypot(fit.std, apart)[k] > 3.0 * np.sqrt(known[k, k])


def test_a_model_that_is_right_asks_for_nothing_that_physics_forbids(slow: tuple[JointProblem, JointFit]) -> None:
    _, fit = slow
    assert forbidden_rival(fit, fit.likelihood) is None


def off(problem: JointProblem, fit: JointFit, theta: Array) -> float:
    """The error of the total yaw inertia."""
    truth = true_box()
    total = truth.rigid_body.inertia[2] - truth.coefficient("N_rdot")
    return float(np.exp(theta[fit.free.names.index("N_rdot")])) / total - 1.0


@pytest.mark.parametrize(
    ("case", "said"), [("a third late", "of it 0.25 s late"), ("overshoots", "more for the first")]
)
def test_forces_that_act_otherwise_are_found_and_make_it_less_sure(case: str, said: str) -> None:
    problem, fit = asked(case, 2)
    k = fit.free.names.index("N_rdot")
    assert abs(off(problem, fit, fit.theta)) > 10.0 * fit.std[k]  # confidently wrong
    rival = late_rival(problem, fit, fit.likelihood)
    assert rival is not None
    assert said in rival.picture
    assert abs(off(problem, fit, rival.theta)) < 0.5 * abs(off(problem, fit, fit.theta))
    apart, _ = apart_from(problem, fit, rival)
    assert abs(off(problem, fit, fit.theta)) < 2.0 * np.hypot(fit.std, apart)[k]


def test_a_late_force_of_no_share_is_none(slow: tuple[JointProblem, JointFit]) -> None:
    problem, _ = slow
    samples = problem.samples[0]
    late = rivals._with_late_forces(samples, [0, 5])
    assert set(samples.input_t) <= set(late.input_t)
    acts = late.input_force @ late.B.T
    np.testing.assert_allclose(
        acts, held_at(samples.input_t, samples.input_force, late.input_t) @ samples.B.T, atol=1e-9
    )
    gains = np.ones(late.B.shape[1])
    m, share = samples.B.shape[1], 0.4
    gains[m + 4 : m + 6] = 1.0 + share  # the second lateness: 0.25 s
    acts = (late.input_force * gains) @ late.B.T
    t = late.input_t[late.input_t >= samples.input_t[0] + 0.25]
    now, before = (held_at(samples.input_t, samples.input_force, t - d) @ samples.B.T for d in (0.0, 0.25))
    expected = now.copy()
    expected[:, [0, 5]] = ((1.0 - share) * now + share * before)[:, [0, 5]]
    np.testing.assert_allclose(acts[-len(t) :], expected, atol=1e-9)


def test_late_shares_say_nothing_of_the_scale_of_force(slow: tuple[JointProblem, JointFit]) -> None:
    problem, fit = slow
    own, n = problem.prior, len(problem.prior.mean)
    late = rivals._LatePrior.of(own, problem.samples[0].B.shape[1], [0, 5])
    away = np.concatenate([fit.theta, [0.3, -0.2, 0.1, 0.4]])
    mean, covariance = late.seen_from(away)
    own_mean, own_covariance = own.seen_from(fit.theta)
    np.testing.assert_array_equal(mean, [*own_mean, 0.0, 0.0, 0.0, 0.0])
    np.testing.assert_array_equal(covariance[:n, :n], own_covariance)
    np.testing.assert_array_equal(covariance[n:, n:], 0.3**2 * np.eye(4))
    assert not covariance[:n, n:].any()


def test_a_rival_widens_by_how_far_it_lies_off_and_nothing_else(slow: tuple[JointProblem, JointFit]) -> None:
    problem, fit = slow
    d = np.zeros(len(fit.free))
    one, two = fit.free.names.index("N_rdot"), fit.free.names.index("X_uu")
    d[one], d[two] = 0.4 * fit.prior.std[one], -0.2 * fit.prior.std[two]
    apart, [text] = apart_from(problem, fit, Rival(fit, fit.theta - d, fit.std, ""))
    np.testing.assert_allclose(np.outer(apart, apart), 0.5 * np.outer(d, d), atol=1e-12)
    assert "N_rdot would come out" in text
    agreeing, _ = apart_from(problem, fit, Rival(fit, fit.theta, fit.std, ""))
    assert not agreeing.any()


@pytest.mark.parametrize(("deviations", "said"), [(0.3, 0), (3.0, 1)])
def test_a_picture_that_says_nearly_the_same_is_not_worth_a_word(
    slow: tuple[JointProblem, JointFit], deviations: float, said: int
) -> None:
    problem, fit = slow
    apart, texts = apart_from(problem, fit, Rival(fit, fit.theta + deviations * fit.std, fit.std, "another picture"))
    assert apart.any()
    assert len(texts) == said


def test_no_rival_lies_further_off_than_the_deviation_of_the_prior(
    slow: tuple[JointProblem, JointFit],
) -> None:
    problem, fit = slow
    apart, _ = apart_from(problem, fit, Rival(fit, fit.theta + 50.0 * fit.prior.std, fit.std, ""))
    learned, grown = problem.learned, apart**2
    np.testing.assert_allclose(grown[learned], 0.5 * fit.prior.std[learned] ** 2)
    assert (grown[~learned] == 0.0).all()


def test_learning_says_so_and_is_less_sure(monkeypatch: pytest.MonkeyPatch) -> None:
    recording, vehicle = flight("quick water", 1).window(0.0, SECONDS), unknown(true_box())
    monkeypatch.setattr(rivals, "CONTRADICTED", 1.0)
    with_it = learn_recordings(vehicle, [recording], free_runs=False)
    assert any(LACKS in remark for remark in with_it.remarks)
    monkeypatch.setattr(joint, "likeliest_rival", lambda problem, fit: None)
    without = learn_recordings(vehicle, [recording], free_runs=False)
    assert not any(LACKS in remark for remark in without.remarks)
    lost = [name for name in without.estimate.names if without.estimate[name].identified]
    lost = [name for name in lost if not with_it.estimate[name].identified]
    reasons = {name for name, reason in zip(with_it.estimate.names, with_it.estimate.reasons, strict=True) if reason}
    told = {name for name in reasons if "read in another way" in str(with_it.estimate[name].reason)}
    assert told == set(lost)
    stds = np.array([[each.estimate[name].std for name in without.estimate.names] for each in (with_it, without)])
    assert (stds[0] >= stds[1] * (1.0 - 1e-9)).all()
    assert (stds[0] > 1.05 * stds[1]).sum() > 5
