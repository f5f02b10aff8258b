"""Where passes begin: from a stiff vehicle, from the disturbance that is usual, from inputs that act sooner; with fewer
rows than steps."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from towtank.identification.data.samples import samples_of
from towtank.identification.kalman import passes
from towtank.identification.kalman.problem import JointProblem
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


def test_passes_begin_with_a_row_a_step_and_end_with_all_where_a_sensor_sees_the_ground(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    session = tank_session(20.0)
    problem = joint_problem(LearningRequest(session.known, [session.recording]))
    taken, one_pass = list[int](), passes.one_pass

    def counting(asked: JointProblem, *words: object, **options: object) -> object:
        taken.append(sum(map(len, asked.samples)))
        return one_pass(asked, *words, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(passes, "one_pass", counting)
    rows = len(problem.samples[0])
    found = passes.joint_fit(problem)
    assert taken[0] == pytest.approx(rows / 2, abs=2)
    assert sorted(taken) == taken
    assert taken[-1] == rows
    monkeypatch.setattr(passes, "_coarse", lambda whole: whole)
    assert np.all(np.abs(found.theta - passes.joint_fit(problem).theta) < 0.2 * found.std)


def test_gyros_alone_are_taken_row_by_row_from_the_first_pass_on() -> None:
    session = tank_session(3.0)
    samples = samples_of(session.recording, session.known)
    samples.values[:, :9] = np.nan
    problem = joint_problem(LearningRequest(session.known, [session.recording], [samples]))
    assert passes._coarse(problem) is problem
