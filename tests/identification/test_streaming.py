"""One sample at a time, or a whole recording: the same numbers; and memory that stays what it is."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.identification import PaperLearner
from towtank.recording import Recording
from towtank.simulation import Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import Vehicle, load_vehicle

from .runs import POSE, TRUTH, VELOCITY, box, fly, follow, table, waves

SENSORS = {"perfect": "perfect", "mocap": Mocap()}


def rows_of(log: Recording, vehicle: Vehicle, learner: PaperLearner) -> PaperLearner:
    """Every row of a recording on one clock, one after the other."""
    pose, velocity = (table(log, names) if names[0] in log else None for names in (POSE, VELOCITY))
    commands = np.column_stack([log[f"cmd_{thruster.name}"].values for thruster in vehicle.thrusters])
    for k, t in enumerate(log["x"].t):
        learner.update(
            t,
            pose=None if pose is None else pose[k],
            velocity=None if velocity is None else velocity[k],
            commands=commands[k] if k < len(commands) else None,
        )
    return learner


def assert_same(a: PaperLearner, b: PaperLearner, tolerance: float) -> None:
    one, two = a.estimate, b.estimate
    assert one.samples == two.samples
    assert one.identified == two.identified
    assert any(one.identified)
    assert np.allclose(one.values, two.values, rtol=tolerance, atol=1e-12)
    assert np.allclose(one.std, two.std, rtol=1e3 * tolerance, atol=1e-9, equal_nan=True)


@pytest.mark.parametrize("sensors", SENSORS.values(), ids=SENSORS.keys())
def test_row_by_row_equals_run(sensors: str | Mocap) -> None:
    vehicle = load_vehicle("vlbv300")
    commands = manoeuvre("all-telegraph", vehicle, duration=25.0).commands
    log = simulate(vehicle, commands=commands, sensors=sensors, disturbance=OrnsteinUhlenbeck(), seed=4)
    whole = PaperLearner(vehicle)
    whole.run(log)
    assert_same(whole, rows_of(log, vehicle, PaperLearner(vehicle)), 1e-9)


def test_the_order_of_restarts_and_runs_does_not_matter() -> None:
    vehicle = load_vehicle("vlbv300")
    logs = [
        simulate(vehicle, commands=manoeuvre(name, vehicle, duration=20.0).commands, sensors=Mocap(), seed=k)
        for k, name in enumerate(("surge-square", "yaw-square"))
    ]
    a, b = PaperLearner(vehicle), PaperLearner(vehicle)
    for log in logs:
        a.run(log)
        b.restart()
        rows_of(log, vehicle, b)
    assert_same(a, b, 1e-9)
    c = PaperLearner(vehicle)
    for log in reversed(logs):
        c.run(log)
    assert np.allclose(a.estimate["N_rr"].value, c.estimate["N_rr"].value, rtol=0.02)


def test_the_estimate_can_be_read_at_any_time_and_reading_changes_nothing() -> None:
    run = fly(box(), waves(1500, 0.01, (0, 30.0, 0.8), square=True))
    read, unread = PaperLearner(box()), PaperLearner(box())
    for k in range(run.t.size):
        read.update(run.t[k], velocity=run.velocity[k], pose=run.pose[k], wrench=run.wrench[k])
        if k % 25 == 0:
            assert set(read.estimate.names) == set(unread.estimate.names)
            read.model()
    follow(unread, run)
    assert np.array_equal(read.estimate.values, unread.estimate.values)


def test_the_callers_arrays_stay_the_callers() -> None:
    run = fly(box(), waves(800, 0.01, (0, 30.0, 0.8)))
    a, b = follow(PaperLearner(box()), run), PaperLearner(box())
    pose, velocity, wrench = np.empty(6), np.empty(6), np.empty(6)
    for k in range(run.t.size):
        pose[:], velocity[:], wrench[:] = run.pose[k], run.velocity[k], run.wrench[k]
        kept = velocity.copy()
        b.update(run.t[k], pose=pose, velocity=velocity, wrench=wrench)
        assert np.array_equal(velocity, kept)
        pose[:], velocity[:], wrench[:] = 1e9, 1e9, 1e9
    assert np.array_equal(a.estimate.values, b.estimate.values)
    found = b.estimate
    found.values[:] = 7.0
    assert np.array_equal(a.estimate.values, b.estimate.values)


def test_a_pickled_learner_goes_on() -> None:
    run = fly(box(), waves(1000, 0.01, (0, 30.0, 0.8)))
    a = PaperLearner(box())
    for k in range(1001):
        if k == 500:
            b = pickle.loads(pickle.dumps(a))
        for learner in (a, b) if k >= 500 else (a,):
            learner.update(run.t[k], pose=run.pose[k], velocity=run.velocity[k], wrench=run.wrench[k])
    assert np.array_equal(a.estimate.values, b.estimate.values)


def test_memory_is_bounded_and_blocks_keep_every_row() -> None:
    dt, n = 0.05, 100_000
    push = waves(n, dt, (0, 30.0, 0.8), square=True)
    log = simulate(box(), wrench=push, dt=dt, disturbance=OrnsteinUhlenbeck(std=(0.5, 0, 0, 0, 0, 0)), seed=1)
    learner = PaperLearner(box(), free=("X_udot", "X_uu"))
    small = PaperLearner(box(), free=("X_udot", "X_uu"))
    small.run(log.window(0.0, 10.0))
    learner.run(log)

    def nbytes(part: object) -> int:
        return sum(map(nbytes, part)) if isinstance(part, tuple) else np.asarray(part).nbytes

    def size(one: PaperLearner) -> int:
        chain = one._chain
        assert chain is not None
        return sum(nbytes(part) for part in (chain.state, chain.motion, chain.held))

    assert size(learner) == size(small)
    chain = learner._chain
    assert chain is not None
    information = chain.information(0)
    assert len(information.blocks) <= 256
    assert information.rows == n
    R = information.triangle
    assert np.allclose(information.blocks.sum(axis=0), R.T @ R, rtol=1e-9, atol=1e-9 * np.abs(R).max() ** 2)
    found = learner.estimate["X_udot"]
    assert abs(found.value - TRUTH["X_udot"]) < 4.0 * found.std
    assert found.std < 0.02 * 30.0


def test_recordings_of_one_kind_at_a_time() -> None:
    vehicle = box()
    push = waves(500, 0.01, (0, 30.0, 0.8))
    learner = PaperLearner(vehicle)
    learner.run(simulate(vehicle, wrench=push))
    with pytest.raises(InputError, match="one kind at a time"):
        learner.run(simulate(vehicle, wrench=push, sensors=Mocap()))


@pytest.mark.parametrize("scheme", ["directional", "exponential"])
def test_forgetting_streams_as_it_runs(scheme: str) -> None:
    vehicle = load_vehicle("vlbv300")
    commands = manoeuvre("all-telegraph", vehicle, duration=15.0).commands
    log = simulate(vehicle, commands=commands, sensors=Mocap(), seed=4)
    whole = PaperLearner(vehicle, forgetting=0.995, scheme=scheme)  # type: ignore[arg-type]
    whole.run(log)
    rows = rows_of(log, vehicle, PaperLearner(vehicle, forgetting=0.995, scheme=scheme))  # type: ignore[arg-type]
    assert_same(whole, rows, 1e-7)
    copy = pickle.loads(pickle.dumps(whole))
    assert_same(whole, copy, 1e-12)


def test_scheme_has_to_be_known() -> None:
    with pytest.raises(InputError, match='scheme: found "forgetful", expected one of'):
        PaperLearner(box(), scheme="forgetful")  # type: ignore[arg-type]


def test_rest_changes_nothing_that_was_learned() -> None:
    """100 s of noise after 40 s of motion, with forgetting; then the change is seen."""
    push = waves(4000, 0.01, (0, 30.0, 0.8), square=True)
    sensors = Mocap(jump_fraction=0.0)
    learner, heavy = PaperLearner(box(), forgetting=0.995), box(hydrodynamics={**TRUTH, "X_uu": -40.0})
    learner.run(simulate(box(), wrench=push, sensors=sensors, seed=1))
    before = learner.estimate["X_uu"]
    learner.run(simulate(box(), wrench=np.zeros((10_000, 6)), sensors=sensors, seed=2))
    after = learner.estimate["X_uu"]
    assert after.value == pytest.approx(before.value, rel=0.01)
    learner.run(simulate(heavy, wrench=push, sensors=sensors, seed=3))
    assert learner.estimate["X_uu"].value == pytest.approx(-40.0, rel=0.05)


def test_forgetting_follows_a_change() -> None:
    light, heavy = box(), box(hydrodynamics={**TRUTH, "X_udot": -25.0, "X_uu": -60.0})
    push = waves(6000, 0.01, (0, 30.0, 0.8), square=True)
    learner = PaperLearner(box(), free=("X_udot", "X_uu"), forgetting=0.998)
    follow(learner, fly(light, push))
    assert learner.estimate["X_uu"].value == pytest.approx(-30.0, rel=1e-3)
    learner.restart()
    follow(learner, fly(heavy, push))
    assert learner.estimate["X_uu"].value == pytest.approx(-60.0, rel=1e-3)
    assert learner.estimate["X_udot"].value == pytest.approx(-25.0, rel=1e-3)
