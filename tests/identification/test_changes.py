"""A vehicle that changes while it is learned: noticed, named, followed; and quiet where nothing changes."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import towtank as tt
from towtank.core.arrays import Array
from towtank.identification.changes import detector
from towtank.identification.changes.branch import Kept, Running, with_coordinates
from towtank.identification.changes.detector import ChangeDetector
from towtank.identification.changes.events import Change, ChangeLog, change_words
from towtank.identification.changes.evidence import Overdispersion
from towtank.identification.changes.hypotheses import Verdict
from towtank.identification.data.samples import Buffer, samples_of
from towtank.identification.kalman.state import coefficient_std
from towtank.identification.model.parameters import free_parameters
from towtank.identification.model.prior import prior_of
from towtank.identification.model.terms import N_FIXED
from towtank.identification.online.joint import JointLearner
from towtank.identification.online.reestimation import Reestimation
from towtank.recording import Recording
from towtank.simulation import Mocap, OrnsteinUhlenbeck, Waves, manoeuvre
from towtank.vehicle import Coefficient, Vehicle

FREE = ("X_udot", "X_uu", "Y_vdot", "Y_vv", "N_rdot", "N_rr")
LEARNED, CALM, AFTER, DT = 28.0, 6.0, 8.0, 0.04
COMMANDED = 79.0  # s
FORCE = OrnsteinUhlenbeck(std=(0.25, 0.25, 0.25, 0.025, 0.025, 0.025), time_constant=2.0)


@cache
def truth() -> Vehicle:
    """The vLBV300 with its horizontal thrusters at the height of the origin: it moves in the plane alone."""
    vehicle = tt.load_vehicle("vlbv300").with_coefficients({"inflow_loss": Coefficient(value=0.0, std=1e-3)})
    flat = [
        each.model_copy(
            update={"position": (*each.position[:2], 0.0 if each.direction[2] == 0.0 else each.position[2])}
        )
        for each in vehicle.thrusters
    ]
    return vehicle.model_copy(update={"thrusters": tuple(flat)})


@cache
def commands() -> Array:
    """Thruster commands (n, m) on surge, sway and yaw together."""
    random = np.random.default_rng(4)
    steps = round(COMMANDED / 0.8)
    held = np.repeat(random.choice([-25.0, 25.0], (steps, 3)), round(0.8 / DT), axis=0)
    vehicle = truth()
    wrench = np.zeros((len(held), 6))
    wrench[:, [0, 1, 5]] = held * np.array([1.0, 1.0, 0.25]) * 0.6
    plan = manoeuvre("surge-square", vehicle, duration=1.0, dt=DT).commands
    assert plan is not None
    matrix = np.array([np.asarray(tt.thruster_wrench(vehicle, 20.0 * row)) for row in np.eye(plan.shape[1])]).T
    share = np.linalg.pinv(matrix[[0, 1, 5]]) @ wrench[:, [0, 1, 5]].T
    return np.asarray(np.clip(20.0 * share.T, -60.0, 60.0))


def run_of(changes: list[tuple[float, Vehicle]], seed: int, duration: float = LEARNED + CALM + AFTER) -> Recording:
    """Return a run as motion capture sees it."""
    return tt.simulate(
        truth(), commands=commands(), dt=DT, duration=duration, sensors=Mocap(rate=1.0 / DT), disturbance=FORCE,
        seed=seed, changes=changes,
    )  # fmt: skip


def learned(run: Recording, **settings: object) -> tt.Learner:
    """Return a learner that has taken the run."""
    learner = tt.Learner(truth(), free=FREE, delay=0.0, **settings)
    learner.run(run)
    return learner


def payload() -> Vehicle:
    """Return the vehicle with +2 kg in surge and sway, +30 % of their drags."""
    vehicle = truth()
    names = {"X_udot": 2.0, "Y_vdot": 2.0}
    return vehicle.with_coefficients(
        {name: vehicle.coefficient(name) - kg for name, kg in names.items()}
        | {name: 1.3 * vehicle.coefficient(name) for name in ("X_uu", "Y_vv")}
    )


def weak(k: int) -> Vehicle:
    """Return the vehicle with a thruster at 60 %."""
    thrusters = list(truth().thrusters)
    thrusters[k] = thrusters[k].model_copy(update={"gain": 0.6})
    return truth().model_copy(update={"thrusters": tuple(thrusters)})


WHEN = LEARNED + CALM


@cache
def loaded_run() -> Recording:
    """Return the run in which a payload is taken up."""
    return run_of([(WHEN, payload())], 3)


@cache
def _learned_of_load() -> tt.Learner:
    return learned(loaded_run())


@pytest.fixture
def loaded() -> tuple[tt.Learner, Recording]:
    """A learner that has seen a payload taken up, and the run; each test has a copy of its own."""
    return deepcopy(_learned_of_load()), loaded_run()


def test_a_payload_is_noticed_named_and_followed(loaded: tuple[tt.Learner, Recording]) -> None:
    learner, _ = loaded
    assert [event.kind for event in learner.events] == ["change"]
    event = learner.events[0]
    assert event.details["settled"] == 1.0
    assert 0.0 < float(event.details["noticed"]) - WHEN < 3.0
    assert abs(event.t - WHEN) < 1.0
    assert "drag +" in event.text
    assert "inertia +" in event.text
    for name in ("X_udot", "Y_vdot", "X_uu", "Y_vv"):
        step = payload().coefficient(name) - truth().coefficient(name)
        told, std = float(event.details[name]), float(event.details[f"{name}_std"])
        assert abs(told - step) < 4.0 * std
        assert std < 0.5 * abs(step)
    for name, limit in (("X_uu", 0.06), ("Y_vv", 0.06), ("N_rr", 0.2)):
        found = next(c for c in learner.estimate.coefficients if c.name == name)
        assert found.value == pytest.approx(payload().coefficient(name), rel=limit)


def test_nothing_is_gone_over_while_a_change_is_suspected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Vehicles of before and after would be made one, and the change would never be told."""
    taken, suspected = list[bool](), [False]
    step, run = ChangeDetector.step, Reestimation.run

    def stepped(watching: ChangeDetector, *row: Any) -> Any:
        found = step(watching, *row)
        suspected.append(watching.suspect is not None)
        return found

    def gone_over(job: Reestimation) -> Any:
        taken.append(suspected[-1])
        return run(job)

    monkeypatch.setattr(ChangeDetector, "step", stepped)
    monkeypatch.setattr(Reestimation, "run", gone_over)
    called_for = property(lambda running: np.full(len(running.free), suspected[-1]))
    monkeypatch.setattr(Running, "moved", called_for)  # and so a re-estimation, as soon as a change is suspected
    monkeypatch.setattr(ChangeDetector, "_just_known", lambda *about: False)
    steps_of = detector.steps_of

    def known_otherwise(*about: Any) -> Array:
        steps = steps_of(*about)  # and what it makes known may change from then on, too
        steps[np.flatnonzero(steps)[: int(suspected[-1])]] = 0.0
        return steps

    monkeypatch.setattr(detector, "steps_of", known_otherwise)
    learner = learned(loaded_run())
    assert any(suspected)
    assert taken
    assert not any(taken)
    assert [event.kind for event in learner.events] == ["change"]


@pytest.mark.parametrize(("known", "expected"), [(0.3, True), (0.9, False)])
def test_what_moves_and_is_known_no_better_has_not_just_become_known(known: float, expected: bool) -> None:
    """An axis that begins to move surprises as a change does; it becomes known by that."""
    prior = prior_of(truth(), commands=True).only(FREE)
    state = SimpleNamespace(theta=prior.mean + 5.0 * prior.std, P=np.zeros((99, 99)))
    state.P[range(N_FIXED, N_FIXED + 6), range(N_FIXED, N_FIXED + 6)] = (known * prior.std) ** 2
    moved = np.arange(len(FREE)) == 1
    running: Any = SimpleNamespace(free=prior.free, state=state, moved=moved)
    branch: Any = SimpleNamespace(free=prior.free, P0=np.diag(prior.std**2))
    watching = ChangeDetector(truth(), Buffer(np.eye(6), np.zeros(6), commands=False), {}, Overdispersion())
    assert watching._just_known(branch, running) is expected
    running.moved = np.zeros(len(FREE), dtype=bool)
    assert not watching._just_known(branch, running)


def test_streaming_and_logs_notice_the_same(loaded: tuple[tt.Learner, Recording]) -> None:
    learner, run = loaded
    other = tt.Learner(truth(), free=FREE, delay=0.0)
    poses = np.column_stack([run[name].values for name in ("x", "y", "z", "phi", "theta", "psi")])
    held = np.column_stack([run[f"cmd_{thruster.name}"].values for thruster in truth().thrusters])
    for k, t in enumerate(run["x"].t):
        other.update(float(t), pose=poses[k], commands=held[k] if k < len(held) else None)
    assert [event.text for event in other.events] == [event.text for event in learner.events]
    np.testing.assert_array_equal(other.estimate.values, learner.estimate.values)


def test_the_water_stays_known_where_the_vehicle_changes() -> None:
    """What follows a change is short at first: of its few samples neither waves nor levels could be told anew."""
    run = tt.simulate(
        truth(), commands=commands(), dt=DT, duration=WHEN + 7.0, sensors=Mocap(rate=1.0 / DT), disturbance=FORCE,
        waves=Waves(0.06, 5.0), seed=3, changes=[(WHEN, payload())],
    )  # fmt: skip
    learner = learned(run)
    assert isinstance(learner, JointLearner)
    assert [each.kind for each in learner.events] == ["change"]
    details = learner.events[0].details
    for name in ("X_udot", "Y_vdot"):  # taken anew, the levels made 3.8 +- 0.2 kg of the 2 kg
        assert abs(float(details[name]) + 2.0) < 4.0 * float(details[f"{name}_std"])
    stream = learner._stream
    assert stream.running is not None
    assert stream.schedule.last - stream.schedule.began < 6.0
    assert stream.running.levels.waves[:2].max() > 0.03
    assert stream.running.levels.disturbance[0] < 0.02  # m/s^2; the usual one, taken anew, is six times as large


def test_waves_are_asked_for_after_an_early_change_too() -> None:
    """A change that is noticed before the water was asked about: the first passes know of no waves to begin with."""
    run = tt.simulate(
        truth(), commands=commands(), dt=DT, duration=50.0, sensors=Mocap(rate=1.0 / DT), disturbance=FORCE,
        waves=Waves(0.06, 5.0), seed=3, changes=[(20.0, weak(1))],
    )  # fmt: skip
    learner = learned(run)
    assert isinstance(learner, JointLearner)
    assert [round(float(each.details["noticed"]), -1) for each in learner.events] == [20.0]
    running = learner._stream.running
    assert running is not None
    assert running.levels.waves[:2].max() > 0.03


def test_a_re_estimation_begins_where_the_last_filter_is_by_name(loaded: tuple[tt.Learner, Recording]) -> None:
    learner, run = loaded
    assert isinstance(learner, JointLearner)
    stream = learner._stream
    assert stream.running is not None
    assert stream._buffer is not None
    job = Reestimation.of(stream.question, stream._buffer, stream.kept, stream.running)
    _, problem = job._problem([samples_of(run, truth())])
    prior = stream.running.prior.only(problem.prior.names[1:])
    cut = stream.running._replace(
        prior=prior,
        state=with_coordinates(stream.running.state, prior.free, range(1, len(prior.names) + 1)),
        disagreement=stream.running.disagreement[1:],
        apart=stream.running.apart[1:],
    )
    about = replace(job, last=cut)._about(problem)
    assert about is not None
    assert about[0] == problem.prior.mean[0]
    np.testing.assert_allclose(about[1:], stream.running.told[0][1:], rtol=1e-12)
    more = replace(problem, prior=prior_of(truth(), more=("latency_velocity",)))
    assert job._about(more) is None  # a DVL that is heard for the first time may show waves
    other = replace(problem, settings=replace(problem.settings, step=2.0 * problem.settings.step))
    assert job._about(other) is None


def test_a_fouled_thruster_is_told_apart_from_a_payload() -> None:
    learner = learned(run_of([(WHEN, weak(1))], 5))
    assert [event.kind for event in learner.events] == ["thruster"]
    event = learner.events[0]
    assert event.details["thruster"] == truth().thrusters[1].name
    assert "60" in event.text or "59" in event.text or "61" in event.text
    gains = {each.name: each.gain for each in learner.model().thrusters}
    assert gains.pop(truth().thrusters[1].name) == pytest.approx(0.6, abs=0.03)
    assert set(gains.values()) == {1.0}
    surge = next(c for c in learner.estimate.coefficients if c.name == "X_uu")
    assert surge.value == pytest.approx(truth().coefficient("X_uu"), rel=0.05)


def test_nothing_is_noticed_where_nothing_changes_or_nobody_watches() -> None:
    run = run_of([], 6)
    assert learned(run).events == ()
    short = loaded_run().window(WHEN - 25.0, WHEN + 4.0)
    assert [event.kind for event in learned(short).events] == ["change"]  # long enough for whoever watches
    assert learned(short, changes=False).events == ()


def test_a_configuration_met_before_is_recognised_and_another_is_not() -> None:
    def stored(vehicle: Vehicle) -> Vehicle:
        return vehicle.with_coefficients(
            {name: {"value": vehicle.coefficient(name), "std": 0.01 * abs(vehicle.coefficient(name))} for name in FREE}
        )

    light = truth().with_coefficients(
        {"X_uu": 0.8 * truth().coefficient("X_uu"), "N_rr": 1.5 * truth().coefficient("N_rr")}
    )
    run = loaded_run()
    learner = learned(run, known={"with gripper": stored(payload()), "light": stored(light)})
    assert [event.kind for event in learner.events] == ["change", "configuration"]
    assert learner.events[1].details["configuration"] == "with gripper"
    assert learner.events[1].t < WHEN + 5.0
    assert learner.likely["with gripper"] > 0.98
    drag = next(c for c in learner.estimate.coefficients if c.name == "X_uu")
    assert drag.value == pytest.approx(payload().coefficient("X_uu"), rel=0.02)
    stranger = learned(run.window(WHEN - 25.0, WHEN + 5.0), known={"light": stored(light)})
    assert [event.kind for event in stranger.events] == ["change"]
    assert stranger.likely["light"] < 0.02


def test_checkpoints_keep_what_happened(loaded: tuple[tt.Learner, Recording], tmp_path: Path) -> None:
    learner, _ = loaded
    learner.save(tmp_path / "state.npz")
    again = tt.Learner.load(tmp_path / "state.npz", truth())
    assert [(each.t, each.kind, each.text) for each in again.events] == [
        (each.t, each.kind, each.text) for each in learner.events
    ]
    np.testing.assert_array_equal(again.estimate.values, learner.estimate.values)
    for one in (again, learner):
        one.run(run_of([], 9, duration=8.0))  # put down again
    np.testing.assert_array_equal(again.estimate.values, learner.estimate.values)
    for name in ("X_udot", "Y_vdot"):
        found = again.estimate[name]
        assert abs(found.value - truth().coefficient(name)) < 4.0 * found.std


def test_numbers_of_a_change_are_those_of_passes_that_follow_with_other_unknowns(
    loaded: tuple[tt.Learner, Recording],
) -> None:
    """What a filter says in the first second is linearised about the vehicle of before, and may be far off."""
    learner, _ = loaded
    assert isinstance(learner, JointLearner)
    running = learner._stream.running
    assert running is not None
    names = [name for name in running.free.names if name != "Y_vdot"]
    rows = [running.free.names.index(name) for name in names]
    step = np.where(np.isin(names, ("X_uu",)), -5.0, 0.0)
    before = running.state.theta[rows] - step, 0.01 * coefficient_std(running.state)[rows]
    fewer = running._replace(
        prior=running.prior.only(names),
        state=running.state._replace(theta=before[0]),
        disagreement=running.disagreement[rows],
        apart=running.apart[rows],
    )
    verdict = Verdict(50.0, 0, {}, None, 9.0, np.ones(len(names)), 50.0)
    log = ChangeLog()
    kept = Kept(tuple(names), before[0], np.eye(len(names)), before[0], step, step)
    log.add(Change(1.0, 2.0, verdict, fewer, kept, before))
    assert float(log.events[0].details["X_uu"]) == 0.0
    assert log.events[0].text.endswith("(settling)")
    log.revise(2.5, running)
    assert float(log.events[0].details["X_uu"]) == 0.0  # too soon
    log.gone_over = True
    log.revise(3.5, running)
    [event] = log.events
    assert event.details["settled"] == 1.0
    assert "settling" not in event.text
    assert float(event.details["X_uu"]) == pytest.approx(-5.0)
    assert "surge drag +" in event.text
    assert "Y_vdot" not in event.details


def test_words_name_what_is_sure_and_by_how_much() -> None:
    vehicle = tt.load_vehicle("vlbv300")
    free = free_parameters(vehicle, ("Z_wdot", "Z_ww", "BG_z", "W_minus_B", "gain_" + vehicle.thrusters[0].name))
    theta = free.theta(vehicle, delay=0.0, lag=0.1)
    small = np.full(len(free), 1e-9)
    now = theta + np.array([0.0, 0.3 * theta[1], -0.22 * theta[2], 4.1, 0.0])
    now[0] = np.log(np.exp(theta[0]) + 1.9)
    std = np.array([0.4 / np.exp(now[0]), 0.04 * abs(theta[1]), 0.05 * abs(theta[2]), 0.3, 1e-9])
    text = change_words(free, (theta, small), (now, std), thruster=None)
    assert "net weight +4.10 ± 0.30 N" in text or "net weight +4.1 ± 0.3 N" in text
    assert "heave inertia +1.9 ± 0.4 kg" in text
    assert "heave drag +30 ± 4 %" in text
    assert "roll and pitch stiffness −22 ± 5 %" in text
    now[4], std[4] = np.log(0.6), 0.02
    text = change_words(free, (theta, small), (now, std), thruster=vehicle.thrusters[0].name)
    assert text == f"thruster {vehicle.thrusters[0].name}: 60 ± 1 % of its thrust"


def test_a_coupling_is_told_with_the_sign_of_the_coefficient() -> None:
    """Its coordinate is that of the mass matrix: the rigid body's element less the coefficient."""
    free = free_parameters(tt.load_vehicle("vlbv300"), ("Y_rdot", "Y_uv"))
    theta = free.theta(tt.load_vehicle("vlbv300"), delay=0.0, lag=0.1)
    small = np.full(len(free), 1e-3)
    now = free.thetas(free.values(theta) + np.array([-0.16, 2.0]))
    text = change_words(free, (theta, small), (now, small), thruster=None)
    assert "Y_rdot −0.16" in text
    assert "Y_uv +2.000" in text
