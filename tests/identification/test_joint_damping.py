"""Linear damping, quadratic or both: what the joint filter makes of the choice of least squares."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.identification import Learner, learn_recordings
from towtank.identification.data.samples import N_MEASURED, Samples, samples_of, spread_over
from towtank.identification.kalman.alternatives import Choice, choose_damping, damping_in_question
from towtank.identification.kalman.iterated import FilterProblem, JointFit, joint_passes, prior_deviation
from towtank.identification.kalman.noise_adaptation import common_noise_levels, filter_settings
from towtank.identification.model.parameters import free_parameters
from towtank.identification.model.prior import size_of, start_theta
from towtank.identification.model.terms import AXES
from towtank.identification.offline.rounds import FilterTask, Start, doubted_inertias, run_rounds
from towtank.identification.posterior.statistics import information_of_data
from towtank.recording import Recording
from towtank.simulation import Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.simulation.tank import tank_session
from towtank.vehicle import Vehicle

from .runs import TRUTH, box, unknown, waves

TANK = OrnsteinUhlenbeck(std=(0.25,) * 3 + (0.02,) * 3)
SURGE = ("X_u", "X_uu")


@cache
def surge(linear: float, quadratic: float, amplitude: float = 30.0) -> Recording:
    truth = box(hydrodynamics={**TRUTH, "X_u": linear, "X_uu": quadratic})
    push = waves(4000, 0.01, (0, amplitude, 0.5), (0, 0.6 * amplitude, 1.7), square=True)
    return simulate(truth, wrench=push, sensors=Mocap(), disturbance=TANK, seed=1)


def chosen(log: Recording, *damping: str, requested: bool = False) -> tuple[JointFit, Choice | None]:
    """The choice that follows a fit with these damping terms of surge free, all else known."""
    vehicle = unknown(box(), **{name: value for name, value in TRUTH.items() if name[0] != "X"})
    samples, settings = [samples_of(log, vehicle)], filter_settings(vehicle)
    free = free_parameters(vehicle, ("X_udot", *damping))
    levels = common_noise_levels([log], samples, vehicle)
    p = np.array(vehicle.parameters)
    theta = start_theta(vehicle, vehicle, free, delay=0.0, lag=0.05)
    problem = FilterProblem(samples, p, free, prior_deviation(free, size_of(vehicle, free)), own_noise=levels.noise)
    fit = joint_passes(problem, theta, levels, settings, inflate=False)
    return fit, choose_damping(
        problem, vehicle, fit, [SURGE], settings=settings, prior=lambda free: None, requested=requested
    )


@pytest.mark.parametrize("free", SURGE)
@pytest.mark.parametrize(("linear", "quadratic"), [(0.0, -30.0), (-12.0, 0.0)])
def test_the_term_that_is_there_takes_the_place_of_the_one_that_is_not(
    free: str, linear: float, quadratic: float
) -> None:
    true = "X_uu" if quadratic else "X_u"
    fit, choice = chosen(surge(linear, quadratic), free)
    assert choice is not None
    found = dict(zip(choice.fit.free.names, choice.fit.free.values(choice.fit.theta), strict=True))
    assert found[true] == pytest.approx(linear + quadratic, rel=0.03)
    assert set(found) == {"X_udot", true}
    assert set(choice.left_out) == set(SURGE) - {true}
    assert f"{true} stands for both" in next(iter(choice.left_out.values()))
    assert (choice.fit is fit) == (free == true)


@pytest.mark.parametrize("free", SURGE)
def test_both_are_free_where_both_are_there(free: str) -> None:
    _, choice = chosen(surge(-6.0, -20.0), free)
    assert choice is not None
    assert not choice.left_out
    found = dict(zip(choice.fit.free.names, choice.fit.free.values(choice.fit.theta), strict=True))
    std = dict(
        zip(choice.fit.free.names, choice.fit.std * np.abs(choice.fit.free.slopes(choice.fit.theta)), strict=True)
    )
    for name, true in zip(SURGE, (-6.0, -20.0), strict=True):
        assert abs(found[name] - true) < 3.0 * std[name]


@pytest.mark.parametrize("free", SURGE)
def test_a_run_that_cannot_tell_them_apart_leaves_the_choice_as_it_is(free: str) -> None:
    fit, choice = chosen(surge(-6.0, -20.0, 0.8), free)
    assert choice is None or set(choice.fit.free.names) == set(fit.free.names)


def test_of_two_that_somebody_asked_for_the_one_that_is_nothing_is_left_out_with_its_figure() -> None:
    _, choice = chosen(surge(0.0, -30.0), *SURGE, requested=True)
    assert choice is not None
    assert set(choice.left_out) == {"X_u"}
    assert "not different from 0" in choice.left_out["X_u"]
    _, choice = chosen(surge(-6.0, -20.0), *SURGE, requested=True)
    assert choice is None or not choice.left_out


def test_only_terms_that_may_be_free_are_in_question() -> None:
    bare = unknown(box())
    assert damping_in_question(bare, ("X_u", "N_rr"), requested=False) == [SURGE, ("N_r", "N_rr")]
    assert damping_in_question(unknown(box(), X_uu=-30.0), ("X_uu",), requested=False) == []
    assert damping_in_question(bare, ("X_uu",), requested=True) == []
    assert damping_in_question(bare, SURGE, requested=True) == [SURGE]


def test_a_log_on_which_both_are_asked_for_and_one_is_there() -> None:
    vehicle: Vehicle = unknown(box(), **{name: value for name, value in TRUTH.items() if name[0] != "X"})
    found = learn_recordings(vehicle, [surge(0.0, -30.0)], free=("X_udot", *SURGE), delay=0.0).estimate
    assert found["X_uu"].identified
    assert found["X_uu"].value == pytest.approx(-30.0, rel=0.03)
    assert not found["X_u"].identified
    assert found["X_u"].value == 0.0
    assert "not different from 0" in str(found["X_u"].reason)


@pytest.mark.parametrize("amplitude", [30.0, 0.05])
def test_an_inertia_that_least_squares_doubts_is_learned_where_the_filter_is_sure_of_it(amplitude: float) -> None:
    log = surge(0.0, -30.0, amplitude)
    vehicle = unknown(box(), **{name: value for name, value in TRUTH.items() if name[0] != "X"})
    samples, free = [samples_of(log, vehicle)], free_parameters(vehicle, ("X_uu",))
    theta = start_theta(vehicle, vehicle, free, delay=0.0, lag=0.05)
    task = FilterTask(
        vehicle,
        samples,
        Start(free, theta, common_noise_levels([log], samples, vehicle)),
        filter_settings(vehicle),
        held={"X_udot": "too little acceleration"},
        doubted=doubted_inertias(("X_uu",), ("X_udot", "N_rdot")),
        set_to_zero=["X_udot"],
        speeds=np.full((6, 2), 0.5),
    )
    found = run_rounds(task, lambda share: None)
    values = dict(zip(found.fit.free.names, found.fit.free.values(found.fit.theta), strict=True))
    if amplitude > 1.0:
        assert found.sure == ("X_udot",)
        assert values["X_udot"] == pytest.approx(-10.0, abs=0.6)
        assert "X_udot" not in found.unidentified
    else:
        assert found.sure == ()
        assert found.unidentified["X_udot"] == "too little acceleration"


def test_a_stream_finds_linear_drag_axis_by_axis_and_takes_no_first_motion_for_a_change(
    tmp_path: Path,
) -> None:
    tank = tank_session(2.0)
    linear = {axis.linear: tank.truth.coefficient(axis.quadratic) * (0.5 if axis.index < 3 else 0.7) for axis in AXES}
    truth = tank.truth.with_coefficients({**dict.fromkeys((axis.quadratic for axis in AXES), 0.0), **linear})
    commands = manoeuvre("tank-session", truth, duration=60.0, dt=0.01, seed=1).commands
    start = (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)
    run = simulate(truth, commands=commands, dt=0.01, eta0=start, sensors=Mocap(), disturbance=TANK, seed=1)
    learner = Learner(tank.known)
    learner.run(run)
    assert learner.events == ()
    model = learner.model()
    for axis in AXES:
        assert model.coefficient(axis.linear) == pytest.approx(linear[axis.linear], rel=0.15)
        assert model.coefficient(axis.quadratic) == 0.0
        assert "stands for both" in str(learner.estimate[axis.quadratic].reason)
    learner.save(tmp_path / "learner")
    again = Learner.load(tmp_path / "learner", tank.known)
    assert [each.reason for each in again.estimate.coefficients] == [
        each.reason for each in learner.estimate.coefficients
    ]


def test_what_nothing_is_known_of_does_not_drown_the_rest() -> None:
    covariance = np.diag([1e-4, 4e-4, 1e30])
    covariance[0, 1] = covariance[1, 0] = 1e-4
    information = information_of_data(covariance, np.diag([1.0, 1.0, 0.0]))
    expected = np.linalg.inv(covariance[:2, :2]) - np.eye(2)
    np.testing.assert_allclose(information[:2, :2], expected, rtol=1e-9)
    assert abs(information[2, 2]) < 1e-6


def test_stretches_stand_for_long_recordings_and_nothing_for_short_ones() -> None:
    def rows(n: int) -> Samples:
        t, none = np.arange(n) / 10.0, np.empty((0, 6))
        values: Array = np.full((n, N_MEASURED), np.nan)
        return Samples(t, values, np.arange(0.0, t[-1], 1.0), np.zeros((int(np.ceil(t[-1])), 6)), none, none, False)

    short = [rows(80_000)]
    assert spread_over(short) is short
    few = spread_over([rows(200_000), rows(200_000)])
    assert 55_000 <= sum(len(each) for each in few) <= 65_000
    assert all(55.0 <= each.duration <= 65.0 for each in few)
    assert few[0].t[0] == 0.0
    assert few[-1].t[-1] == pytest.approx(19999.9)
    for each in few:
        assert each.input_t[0] <= max(each.t[0] - 4.0, 0.0)
        assert each.input_t[-1] <= each.t[-1]
