"""Where passes begin: from a stiff vehicle, from the disturbance that is usual, from inputs that act sooner; which
pass speaks."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towtank.identification.data.samples import samples_of
from towtank.identification.kalman import passes
from towtank.identification.kalman.problem import JointFit
from towtank.identification.logs import learn_recordings
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.simulation.tank import tank_session

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

import optimum_study as optimum
import undriven_study as undriven
from swing_study import CASES, driven, hull
from undriven_study import told


@pytest.mark.parametrize(
    ("case", "seed"),
    [("bluerov2_heavy, tank-session", 1), ("vlbv300, tank-session", 7), ("bluerov2_heavy, surge-square", 2)],
)
def test_passes_come_to_what_the_truth_comes_to(case: str, seed: int) -> None:
    """With what a model that is off leaves as noise, or a disturbance that stays, they end with a yaw pushed hard; with
    what it leaves as a random walk of speeds, with a speed log that is hardly believed."""
    found = optimum.learned(case, seed)
    assert found.short < optimum.SHORT
    assert found.wider < 1.1
    assert found.pushed < 3.0


def test_gyros_alone_tell_the_stiffness_of_what_nobody_pushes() -> None:
    """Roll swings once a second. From the prior's mean, once in 2 s, passes end at an inertia 8 deviations off."""
    truth = hull(CASES["short"].above)
    found = learn_recordings(told(truth), [driven(CASES["short"], 7)], free_runs=False).estimate
    for name in ("K_pdot", "BG_z"):
        assert found[name].identified
        assert abs(found[name].value - truth.coefficient(name)) < 4.0 * found[name].std
    assert sum(each.identified for each in found.coefficients) > 30


def test_passes_begin_stiff_too_where_nothing_shows_how_the_vehicle_leans_and_nobody_said_how_stiff_it_is() -> None:
    truth, seen = hull(CASES["stiff"].above), driven(CASES["stiff"]._replace(seconds=5.0), 1)

    def stiff(vehicle_is_told: bool, attitude: bool) -> np.ndarray | None:
        vehicle = truth if vehicle_is_told else told(truth)
        samples = samples_of(seen, vehicle)
        if attitude:
            samples.values[::4, 3:6] = 0.0
        return joint_problem(LearningRequest(vehicle, [seen], [samples])).stiff

    begun, problem = stiff(False, False), joint_problem(LearningRequest(told(truth), [seen]))
    assert begun is not None
    moved = (begun - problem.prior.mean) / problem.prior.std
    assert dict(zip(problem.prior.names, moved, strict=True)) == {
        name: 1.0 if name == "BG_z" else 0.0 for name in problem.prior.names
    }
    assert stiff(True, False) is None
    assert stiff(False, True) is None


def test_a_stiff_beginning_is_not_asked_again_in_water_that_differs_by_its_levels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It begins with rough levels, so that the same passes would follow."""
    truth, seen = hull(CASES["stiff"].above), driven(CASES["stiff"]._replace(seconds=5.0), 1)
    problem = joint_problem(LearningRequest(told(truth), [seen], [samples_of(seen, truth)]))
    begun: list[np.ndarray] = []
    run = passes._passes

    def watched(problem: Any, about: np.ndarray, *given: Any, **named: Any) -> Any:
        begun.append(about)
        return run(problem, about, *given, **{**named, "passes": 2})

    asked: list[Any] = []

    def other_surroundings(problem: Any, levels: Any) -> list[list[tuple[Any, Any]]]:
        asked.append(problem)
        return [[(problem, problem.rough)]] if len(asked) == 1 else []

    monkeypatch.setattr(passes, "_passes", watched)
    monkeypatch.setattr(passes, "_other_surroundings", other_surroundings)
    monkeypatch.setattr(passes, "_WATER_GAIN", -np.inf)
    passes.joint_fit(problem)
    assert len(asked) == 2
    assert sum(np.array_equal(about, problem.stiff) for about in begun) == 1


def test_what_only_the_water_drives_is_not_taken_for_a_large_push_on_heavy_damping() -> None:
    """From a disturbance twenty times too large, passes ended at twice the push in surge, and X_uu 8 deviations off."""
    truth, run = undriven.driven("yaw ins", 6)
    found = learn_recordings(told(truth), [run], free_runs=False)
    assert found.levels is not None
    assert np.max(np.abs(list(undriven.errors(truth, found).values()))) < 4.0
    assert found.levels.disturbance == pytest.approx(undriven.PUSH, rel=0.6)


def test_a_vehicle_of_much_drag_and_little_inertia_is_not_taken_for_thrusters_that_lag() -> None:
    """Yaw stops within 0.11 s, thrusters lag by 0.05 s. From the lag that is supposed, 0.1 s, passes found it the other
    way round, and were stopped by the rigid body's own inertia: N_rdot 25 deviations off."""
    truth, run = undriven.driven("drag ins", 1)
    found = learn_recordings(told(truth), [run], free_runs=False)
    assert abs(undriven.errors(truth, found)["N_rdot"]) < 4.0
    assert found.lag == pytest.approx(truth.thrusters[0].time_constant, abs=0.01)


@pytest.mark.parametrize(
    ("likelihoods", "speaks"),
    [
        ([0.0, 100.0, 97.0, 98.0, 96.0, 99.0, 50.0], 6),  # as likely but for chance: the last of them
        ([0.0, 100.0, 90.0, 91.0, 92.0, 93.0, 200.0], 2),  # less likely by more
        ([0.0, 50.0, 100.0, 101.0, 60.0, 60.0, 60.0, 60.0], 4),
    ],
)
def test_of_passes_that_are_as_likely_the_last_speaks(
    likelihoods: list[float], speaks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One on the way may be likelier by chance, at levels that have not settled, and far from where passes end."""
    session = tank_session(3.0)
    problem = joint_problem(LearningRequest(session.known, [session.recording]))
    fit_of, moving = passes._fit_of, problem.prior.std

    def told(*of: Any) -> JointFit:
        k = of[4]
        return replace(fit_of(*of), likelihood=likelihoods[k - 1], theta=problem.prior.mean + 0.1 * (-1) ** k * moving)

    monkeypatch.setattr(passes, "_fit_of", told)
    assert passes._passes(problem, problem.prior.mean, problem.usual)[0].passes == speaks
