"""Water that begins to move otherwise while a vehicle is learned: told, and no change of the vehicle."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.identification.test_changes import DT, FORCE, FREE, commands, learned, truth

import towtank as tt
from towtank.core.arrays import Array
from towtank.identification.changes.water import Waters
from towtank.identification.data.samples import NoiseLevels, prepared
from towtank.identification.kalman import passes
from towtank.identification.kalman.passes import joint_fit
from towtank.identification.kalman.problem import ROUGH, JointFit, JointProblem
from towtank.identification.model.prior import prior_of
from towtank.identification.model.terms import DISTURBANCE
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.identification.online.joint import JointLearner
from towtank.identification.online.reestimation import Schedule
from towtank.recording import Recording
from towtank.simulation import Mocap, RisingCurrent, Waves


def run_in(water: Waves | RisingCurrent, duration: float) -> Recording:
    twice = np.tile(commands(), (2, 1))
    return tt.simulate(
        truth(), commands=twice, dt=DT, duration=duration, sensors=Mocap(rate=1.0 / DT), disturbance=FORCE,
        waves=water, seed=3,
    )  # fmt: skip


@cache
def run_in_waves() -> Recording:
    """Return a run in which waves come up after the time in which a stream asks for them."""
    return run_in(Waves(0.08, 4.0, begin=62.0), 78.0)


def holds(learner: tt.Learner) -> None:
    """Coefficients that are called identified are what they are."""
    for each in learner.estimate.coefficients:
        if each.identified:
            assert abs(each.value - truth().coefficient(each.name)) < 3.0 * each.std, each.name


def test_waves_that_begin_are_no_change_of_the_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    """They explain what they do better than a payload; what a look leaves out is not missed at the next."""
    weighed, looks = Waters.weighed, list[tuple[int, int, float]]()

    def twice(waters: Waters, *arguments: Any) -> Any:
        whole = len(waters._left)
        lead, _ = weighed(waters, *arguments)
        left = len(waters._left)
        again, begun = weighed(waters, *arguments)
        looks.append((whole, left, abs(again - lead)))
        return again, begun

    monkeypatch.setattr(Waters, "weighed", twice)
    learner = learned(run_in_waves())
    assert looks
    assert any(left < whole for whole, left, _ in looks)
    assert max(moved for *_, moved in looks) < 1e-3
    assert isinstance(learner, JointLearner)
    [event] = learner.events
    assert event.kind == "water"
    assert 62.0 < float(event.details["noticed"]) < 72.0
    stream = learner._stream
    assert stream.running is not None
    assert stream.running.levels.waves.any()
    assert stream.schedule.next - stream.schedule.began >= 20.0  # of less, a wave is no more than a slow force
    holds(learner)


@pytest.mark.parametrize(
    ("flow", "seconds"),
    [
        ((0.4, -0.2, 0.0), 6.0),
        ((0.3, 0.3, 0.0), 15.0),  # rises on, while it is taken for a wave of 8 s: a change was cried after 14 s
    ],
)
def test_a_current_that_begins_to_flow_is_no_change_of_the_vehicle(
    flow: tuple[float, float, float], seconds: float
) -> None:
    """It looks like a long wave at first; the passes of twenty seconds later know better."""
    learner = learned(run_in(RisingCurrent(flow, begin=62.0, seconds=seconds), 88.0))
    assert isinstance(learner, JointLearner)
    [event] = learner.events
    assert event.kind == "water"
    running = learner._stream.running
    assert running is not None
    assert np.abs(running.state.current[:2] - flow[:2]).max() < 0.06
    holds(learner)


def test_what_was_learned_before_other_water_is_kept() -> None:
    """In the first minute, too, where passes begin at the prior: what calm water has told is that prior then."""
    learner = learned(run_in(Waves(0.08, 4.0, begin=30.0), 58.0))
    assert isinstance(learner, JointLearner)
    assert [each.kind for each in learner.events] == ["water"]
    stream = learner._stream
    assert stream.running is not None
    assert stream.running.levels.waves.any()
    assert stream.kept is not None
    told = dict(zip(stream.kept.names, np.sqrt(np.diag(stream.kept.covariance)), strict=True))
    supposed = prior_of(truth(), commands=True)
    assert told["X_uu"] < 0.2 * supposed.std[supposed.names.index("X_uu")]
    holds(learner)


@cache
def calm_problem() -> JointProblem:
    run = tt.simulate(
        truth(), commands=commands(), dt=DT, duration=40.0, sensors=Mocap(rate=1.0 / DT), disturbance=FORCE, seed=3
    )
    return joint_problem(LearningRequest(truth(), [prepared(run, truth())], free=FREE, delay=0.0))


def test_waves_that_were_supposed_in_calm_water_go_again() -> None:
    """As where a few seconds of a current that began to flow looked like waves: passes over more of it know better."""
    problem = calm_problem()
    calm = joint_fit(problem)
    again = joint_fit(problem, since=(calm.theta, replace(calm.levels, waves=np.full(3, 0.1))))
    assert not calm.levels.waves.any()
    assert not again.levels.waves.any()
    assert (np.abs(again.theta - calm.theta) < 0.1 * calm.std).all()
    assert again.std == pytest.approx(calm.std, rel=0.05)


def test_two_passes_from_what_was_found_tell_that_there_are_no_waves(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = calm_problem()
    in_waves, run = list[bool](), passes.one_pass

    def counted(problem: JointProblem, about: Array, levels: NoiseLevels, *more: Any, **options: Any) -> Any:
        in_waves.append(bool(levels.waves.any()))
        return run(problem, about, levels, *more, **options)

    monkeypatch.setattr(passes, "one_pass", counted)
    fit = joint_fit(problem)
    assert not fit.levels.waves.any()
    assert sum(in_waves) == 2
    assert fit.still


@pytest.mark.parametrize(("from_mean", "speaks"), [(50.0, "from the mean"), (30.0, "from what was found")])
def test_where_there_are_waves_passes_with_them_begin_at_the_prior_s_mean_too(
    from_mean: float, speaks: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From what was found without them half of a boat's logs came to an answer that is far less likely."""
    problem = calm_problem()
    calm = joint_fit(problem)
    wavy = replace(calm.levels, waves=np.full(3, 0.1))
    answers = {
        "from what was found": replace(calm, levels=wavy, likelihood=calm.likelihood + 40.0),
        "from the mean": replace(calm, levels=wavy, likelihood=calm.likelihood + from_mean),
    }

    def stub(problem: JointProblem, about: Array, levels: NoiseLevels, *more: Any, **options: Any) -> JointFit:
        if not levels.waves.any():
            return calm
        return answers["from the mean" if np.array_equal(about, problem.prior.mean) else "from what was found"]

    monkeypatch.setattr(passes, "settled", stub)
    monkeypatch.setattr(passes, "_likeliest_surroundings", lambda problem, fit, progress: fit)
    assert passes._with_waves(problem, lambda share: None) is answers[speaks]


def test_surroundings_that_only_seem_likelier_are_asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """One pass in them may be likelier by much, and passes from there come back to hardly more than was."""
    problem = calm_problem()
    fit = joint_fit(problem)
    asked = list[str]()
    far = {"asked": fit.likelihood + 100.0, "settled": fit.likelihood + 1.0}

    def one(*arguments: Any) -> Any:
        asked.append("asked")
        return (SimpleNamespace(clock=[SimpleNamespace(log_likelihood=far["asked"])]),)

    def all_of_them(*arguments: Any, **named: Any) -> JointFit:
        asked.append("settled")
        return replace(fit, likelihood=far["settled"])

    monkeypatch.setattr(passes, "one_pass", one)
    monkeypatch.setattr(passes, "settled", all_of_them)
    found = passes._likeliest_surroundings(problem, fit, lambda share: None)
    assert found is fit
    assert asked.count("settled") == 1
    far["settled"] += 50.0  # more than chance: and asked again from there
    assert passes._likeliest_surroundings(problem, fit, lambda share: None).likelihood == far["settled"]


@pytest.mark.parametrize(("off", "first"), [(0.0, 1.0), (3.0, ROUGH)])
def test_disturbances_begin_as_usual_where_motion_follows_so_and_else_rough(
    off: float, first: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    problem = calm_problem()
    fit = joint_fit(problem)
    began, adapt = list[Array](), passes.adapt_noise

    def watched(state: Any, levels: NoiseLevels, *more: Any, **options: Any) -> NoiseLevels:
        began.append(levels.disturbance)
        return adapt(state, levels, *more, **options)

    monkeypatch.setattr(passes, "adapt_noise", watched)
    passes.settled(problem, fit.theta + off * problem.prior.std, problem.usual, tentative=True)
    most = passes.most_disturbed(problem.samples, np.array(problem.vehicle.parameters))
    assert began[0] == pytest.approx(np.minimum(first * np.array(DISTURBANCE), most))


@pytest.mark.parametrize(
    ("water", "period"),
    [(Waves(0.08, 4.0), 4.2), (RisingCurrent((0.3, 0.3, 0.0), begin=5.0, seconds=15.0), None)],
)
def test_passes_that_suppose_long_waves_find_which_water_it_is(
    water: Waves | RisingCurrent, period: float | None
) -> None:
    """Waves of half their period, or none but a current."""
    run = tt.simulate(
        truth(), commands=commands(), dt=DT, duration=40.0, sensors=Mocap(rate=1.0 / DT), disturbance=FORCE,
        waves=water, seed=3,
    )  # fmt: skip
    problem = joint_problem(LearningRequest(truth(), [prepared(run, truth())], free=FREE, delay=0.0))
    problem = replace(problem, settings=replace(problem.settings, wave_period=8.0))
    fit = joint_fit(problem, since=(problem.prior.mean, replace(problem.rough, waves=np.full(3, 0.1))))
    assert fit.levels.waves.any() == (period is not None)
    if period is not None:
        assert fit.wave_period == period
    else:
        assert fit.levels.current_walk > problem.rough.current_walk
        assert np.abs(fit.state.current[:2] - 0.3).max() < 0.05
    assert (np.abs(fit.theta - problem.free.theta(truth(), delay=0.0, lag=0.1)) < 4.0 * fit.std)[: len(FREE)].all()


def test_waves_are_not_looked_for_where_nothing_would_show_them() -> None:
    """Of a craft on the surface nobody measures heave, and nothing drives it: what is supposed there is no evidence."""
    seen = run_in(Waves(0.08, 4.0), 40.0).without("z", "phi", "theta")
    problem = joint_problem(LearningRequest(truth(), [prepared(seen, truth())], free=FREE, delay=0.0))
    assert problem.waving.tolist() == [True, True, False]
    whole = joint_problem(LearningRequest(truth(), [prepared(run_in_waves(), truth())], free=FREE, delay=0.0))
    assert whole.waving.all()
    fit = joint_fit(problem, since=(problem.prior.mean, replace(problem.rough, waves=np.full(3, 0.1))))
    assert fit.levels.waves[0] > 0.02
    assert fit.levels.waves[2] == 0.0


def test_a_checkpoint_after_other_water_goes_on_in_it(tmp_path: Path) -> None:
    run = run_in_waves()
    first = tt.Learner(truth(), free=FREE, delay=0.0)
    cut = round(76.0 / DT)
    poses = np.column_stack([run[name].values for name in ("x", "y", "z", "phi", "theta", "psi")])
    held = np.column_stack([run[f"cmd_{thruster.name}"].values for thruster in truth().thrusters])

    def give(learner: tt.Learner, begin: int, end: int) -> None:
        for k in range(begin, end):
            learner.update(float(run["x"].t[k]), pose=poses[k], commands=held[k] if k < len(held) else None)

    give(first, 0, cut)
    assert [each.kind for each in first.events] == ["water"]
    whole = deepcopy(first)
    first.save(tmp_path / "kept.npz")
    second = tt.Learner.load(tmp_path / "kept.npz", truth())
    give(second, cut, len(poses))
    give(whole, cut, len(poses))
    assert second.events == whole.events
    for one, other in zip(second.estimate.coefficients, whole.estimate.coefficients, strict=True):
        assert one.value == pytest.approx(other.value, abs=1e-3 * other.std)


def test_a_stream_is_gone_over_at_times_that_grow() -> None:
    schedule = Schedule()
    for seen, after in ((0.5, 1.0), (1.0, 2.0), (2.0, 3.0), (40.0, 60.0), (60.0, 120.0), (600.0, 1200.0)):
        schedule.done(seen)
        assert schedule.next == after


def test_after_other_water_no_re_estimation_comes_before_waves_can_show() -> None:
    schedule = Schedule()
    assert schedule.settled
    schedule.anew(100.0, 20.0)
    assert not schedule.settled
    schedule.call(105.0)
    assert schedule.next == 120.0
    assert not schedule.behind(119.9)
    assert schedule.behind(120.0)
    schedule.settle()
    assert schedule.settled
    schedule.anew(200.0, 2.0)  # a changed vehicle shows itself sooner
    schedule.call(201.5)
    assert schedule.next == 201.5
    assert schedule.settled
