"""The joint estimator on a stream: what it takes, that a log teaches it the same, and what it finds."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import towtank as tt
from towtank.errors import InputError
from towtank.identification import Learner, learn_recordings
from towtank.recording import Recording
from towtank.simulation import Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import Coefficient, Vehicle, load_vehicle

FREE = ("X_udot", "X_uu")
_POSE = ("x", "y", "z", "phi", "theta", "psi")


def _truth() -> Vehicle:
    vehicle = load_vehicle("vlbv300")
    level = tuple(
        each.model_copy(update={"position": (*each.position[:2], 0.0)}) if each.direction[2] == 0.0 else each
        for each in vehicle.thrusters
    )
    return vehicle.model_copy(update={"thrusters": level})


TRUTH = _truth()


def _run(seconds: float = 8.0, *, delay: float = 0.0, seed: int = 1, rate: float = 100.0) -> Recording:
    commands = manoeuvre("surge-square", TRUTH, duration=seconds, dt=0.01).commands
    return simulate(
        TRUTH.model_copy(update={"command_delay": delay}),
        commands=commands,
        dt=0.01,
        sensors=Mocap(rate=rate),
        disturbance=OrnsteinUhlenbeck(std=(0.3, 0.3, 0.3, 0.02, 0.02, 0.02), time_constant=2.0),
        seed=seed,
    )


def _blank(**changes: float) -> Vehicle:
    """The vehicle without its surge coefficients, or with others."""
    wrong = {"X_udot": -6.0, "X_uu": -30.0, **changes}
    return TRUTH.with_coefficients(wrong)


def _feed(learner: Learner, run: Recording) -> None:
    commands = np.column_stack([run[f"cmd_{thruster.name}"].values for thruster in TRUTH.thrusters])
    poses = np.column_stack([run[name].values for name in _POSE])
    t = run["x"].t
    for k in range(len(t)):
        given = commands[k] if k < len(commands) else None
        learner.update(float(t[k]), pose=poses[k], commands=given)


@pytest.fixture(scope="module")
def run() -> Recording:
    return _run()


def test_the_default_method_is_joint() -> None:
    assert tt.Learner(TRUTH).method == "joint"


def test_a_log_teaches_the_same_as_its_samples(run: Recording) -> None:
    a, b = Learner(_blank(), free=FREE), Learner(_blank(), free=FREE)
    _feed(a, run)
    b.run(run)
    np.testing.assert_array_equal(a.estimate.values, b.estimate.values)
    np.testing.assert_array_equal(a.estimate.covariance, b.estimate.covariance)
    assert a.model().command_delay == b.model().command_delay


def test_it_finds_inertia_drag_and_delay_together() -> None:
    learner = Learner(_blank(), free=FREE)
    learner.run(_run(12.0, delay=0.12))
    found = learner.estimate
    total = TRUTH.rigid_body_matrix[0, 0]
    for name, offset, limit in (("X_udot", total, 0.02), ("X_uu", 0.0, 0.06)):
        truth = TRUTH.coefficient(name)
        assert abs(found[name].value - truth) <= 4.0 * found[name].std
        assert abs(found[name].value - truth) <= limit * (offset - truth)
    assert learner.delay + learner.lag == pytest.approx(0.12, abs=0.01)  # told apart within a few ms


def test_a_prior_counts_as_information(run: Recording) -> None:
    known = _blank(X_uu=-60.0).with_coefficients({"X_uu": Coefficient(value=-60.0, std=0.05)})
    learner = Learner(_blank(), free=FREE, delay=0.0, prior=known)
    learner.run(run)
    assert learner.estimate["X_uu"].value == pytest.approx(-60.0, abs=0.5)
    assert learner.estimate["X_uu"].std < 0.06


def test_what_is_not_in_order_or_not_a_number_is_passed_over(run: Recording) -> None:
    a, b = Learner(_blank(), free=FREE, delay=0.0), Learner(_blank(), free=FREE, delay=0.0)
    _feed(a, run)
    commands = np.column_stack([run[f"cmd_{thruster.name}"].values for thruster in TRUTH.thrusters])
    poses = np.column_stack([run[name].values for name in _POSE])
    t = run["x"].t
    for k in range(len(t)):
        b.update(float(t[k]), pose=poses[k], commands=commands[k] if k < len(commands) else None)
        assert not b.update(float(t[k]), pose=poses[k] + 1.0)
        assert not b.update(float(t[max(0, k - 3)]), pose=poses[k] - 1.0)
        assert not b.update(float("nan"), pose=poses[k])
        assert not b.update(float(t[k]) + 1e-3, pose=np.full(6, np.nan))
    np.testing.assert_allclose(a.estimate.values, b.estimate.values, rtol=1e-6)


def test_pose_and_rates_may_come_at_times_of_their_own() -> None:
    run = _run(10.0)
    learner = Learner(_blank(), free=FREE, delay=0.0)
    commands = np.column_stack([run[f"cmd_{thruster.name}"].values for thruster in TRUTH.thrusters])
    poses = np.column_stack([run[name].values for name in _POSE])
    depths = poses[:, 2]
    rng = np.random.default_rng(1)
    t = run["x"].t
    for k in range(len(commands)):
        learner.update(float(t[k]), commands=commands[k])
        if k % 4 == 0:
            learner.update(float(t[k]) + 0.002 + 0.002 * rng.random(), pose=poses[k])
        elif rng.random() < 0.7:
            depth = np.array([np.nan, np.nan, depths[k], np.nan, np.nan, np.nan])
            learner.update(float(t[k]) + 0.003, pose=depth)
    found = learner.estimate["X_udot"]
    assert found.identified
    assert abs(found.value - TRUTH.coefficient("X_udot")) <= max(4.0 * found.std, 0.8)


def test_a_pause_begins_a_new_stretch_and_keeps_what_was_learned(run: Recording) -> None:
    learner = Learner(_blank(), free=FREE, delay=0.0)
    learner.run(run)
    before = learner.estimate
    learner.run(_run(20.0, seed=2))
    after = learner.estimate
    assert after.duration > before.duration
    for name in FREE:
        assert abs(after[name].value - TRUTH.coefficient(name)) < 4.0 * after[name].std


def test_a_weak_thruster_is_found_and_put_into_the_model() -> None:
    first, *others = TRUTH.thrusters
    weak = TRUTH.model_copy(update={"thrusters": (first.model_copy(update={"gain": 0.7}), *others)})
    commands = manoeuvre("surge-square", TRUTH, duration=8.0, dt=0.01).commands
    run = simulate(weak, commands=commands, dt=0.01, sensors=Mocap(), seed=3)
    name = f"gain_{first.name}"
    learner = Learner(TRUTH, free=("X_udot", "X_uu", name), delay=0.0)
    learner.run(run)
    model = learner.model()
    assert model.thrusters[0].gain == pytest.approx(0.7, abs=0.01)
    assert all(each.gain == 1.0 for each in model.thrusters[1:])
    batch = learn_recordings(TRUTH, [run], free=("X_udot", "X_uu", name), delay=0.0)
    gain, std = batch.gains[first.name]
    assert gain == pytest.approx(0.7, abs=max(3.0 * std, 0.005))
    assert batch.model.thrusters[0].gain == gain


def test_a_pickled_learner_goes_on(run: Recording) -> None:
    a = Learner(_blank(), free=FREE, delay=0.0)
    a.run(run)
    b = pickle.loads(pickle.dumps(a))
    np.testing.assert_array_equal(a.estimate.values, b.estimate.values)


def test_wrong_settings_are_told() -> None:
    with pytest.raises(InputError, match="X_vdott"):
        Learner(TRUTH, free=("X_vdott",))
    with pytest.raises(InputError, match="delay"):
        Learner(TRUTH, delay=-1.0)
    with pytest.raises(InputError, match="method"):
        Learner(TRUTH, method="jiont")
    with pytest.raises(InputError, match="pose"):
        Learner(TRUTH).update(0.0, pose=[1.0, 2.0])


def test_nothing_seen_is_the_prior() -> None:
    learner = Learner(TRUTH, free=FREE)
    found = learner.estimate
    assert found.names == FREE
    assert not any(found.identified)
    assert found.values == pytest.approx([TRUTH.coefficient(name) for name in FREE])
    assert found["X_uu"].std == pytest.approx(0.5 * abs(TRUTH.coefficient("X_uu")))
    assert found.samples == 0
    assert learner.model().coefficient("X_uu") == pytest.approx(TRUTH.coefficient("X_uu"))
