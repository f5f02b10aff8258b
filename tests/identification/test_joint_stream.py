"""The joint filter on a stream that its model does not explain, and one that is broken from outside."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.identification import Learner
from towtank.identification.data.samples import N_MEASURED
from towtank.identification.kalman.noise_adaptation import rejected_share
from towtank.identification.online.joint import JointLearner
from towtank.identification.online.stream import RowsInOrder
from towtank.recording import Recording
from towtank.simulation import Ins, simulate
from towtank.vehicle import Coefficient, Vehicle, load_vehicle

TRUTH = load_vehicle("vlbv300").with_coefficients({"inflow_loss": Coefficient(value=0.0, std=1e-3)})
FREE = ("N_rdot", "N_rr")
RATE, DT = 50, 0.02  # Hz, s
INS = Ins(imu_rate=RATE, gyro_bias=0.0)


def _late(lag: float) -> Vehicle:
    slow = tuple(each.model_copy(update={"time_constant": lag}) for each in TRUTH.thrusters)
    return TRUTH.model_copy(update={"thrusters": slow})


def _yaw(lag: float, seconds: float = 30.0) -> Recording:
    """Full yaw to and fro, seen by gyros alone, with thrusters that answer late."""
    signs = np.random.default_rng(1).choice([-1.0, 1.0], int(seconds))
    turn = [np.cross(each.position, each.direction)[2] for each in TRUTH.thrusters]
    turning = np.where(np.abs(turn) > 1e-3, np.sign(turn), 0.0)
    commands = 60.0 * np.repeat(signs, RATE)[:, None] * turning
    run = simulate(_late(lag), commands=commands, dt=DT, sensors=INS, seed=1)
    return run.without("x", "y", "z", "phi", "theta", "psi", "u", "v", "w", "ax", "ay", "az")


def _total(values: dict[str, float]) -> float:
    return float(TRUTH.rigid_body_matrix[5, 5] - values["N_rdot"])


@pytest.mark.parametrize("lag", [0.01, 0.15])
def test_gyros_are_believed_where_the_thrusters_answer_late(lag: float) -> None:
    """A step of thrust that comes late looks like ten deviations of a gyro: the lag is learned, the sensor believed."""
    learner = JointLearner(TRUTH.with_coefficients({"N_rdot": -0.3, "N_rr": -1.0}), free=(*FREE, "lag"), delay=0.0)
    learner.run(_yaw(lag))
    assert learner._stream.running is not None
    assert rejected_share(learner._stream.running.state)[11] < 0.1
    assert learner.lag == pytest.approx(lag, abs=0.01)
    found = {each.name: each.value for each in learner.estimate.coefficients}
    assert found["N_rr"] == pytest.approx(TRUTH.coefficient("N_rr"), rel=0.03)
    assert _total(found) == pytest.approx(float(TRUTH.rigid_body_matrix[5, 5]) - TRUTH.coefficient("N_rdot"), rel=0.06)


def test_a_filter_that_lost_itself_goes_on_from_what_it_knew() -> None:
    run = _yaw(0.0, 20.0)
    learner = JointLearner(TRUTH, free=FREE, delay=0.0)
    learner.run(run.window(0.0, 10.0))
    stream, before = learner._stream, learner.estimate
    assert stream.running is not None
    stream.running.state.P[9, 9] = np.nan
    for k in range(500):  # held commands: the last ones go on
        rates = [run[name].values[500 + k] if k % 2 else np.nan for name in "pqr"]
        learner.update(10.0 + DT * (k + 1), velocity=[np.nan, np.nan, np.nan, *rates])
        if stream.recoveries:
            break
    assert k < 100
    assert stream.recoveries == 1
    after = learner.estimate
    assert after.values == pytest.approx(before.values, rel=1e-3)
    assert (after.std > before.std).all()


def test_axes_that_nothing_measures_stay_at_the_prior() -> None:
    learner = JointLearner(TRUTH)
    learner.run(_yaw(0.0, 10.0))
    estimate = learner.estimate
    assert estimate["N_rdot"].identified
    for name in ("X_uu", "Z_w", "Z_ww"):
        assert not estimate[name].identified
        assert np.isfinite([estimate[name].value, estimate[name].std]).all()
        assert estimate[name].reason


def test_a_coefficient_that_becomes_known_late_calls_for_a_reestimation() -> None:
    """Yaw begins after 20 s: until the one at 32 s its drag was linearised about a guess six times too large."""
    still, moving = np.zeros((20 * RATE, len(TRUTH.thrusters))), _yaw(0.0, 10.0)
    rest = simulate(TRUTH, commands=still, dt=DT, sensors=INS, seed=2)
    moved = np.column_stack([moving[f"cmd_{each.name}"].values for each in TRUTH.thrusters])
    commands = np.vstack([still, moved])[: 30 * RATE]
    rates = np.column_stack([np.concatenate([rest[name].values[: 20 * RATE], moving[name].values]) for name in "pqr"])
    learner = JointLearner(TRUTH.with_coefficients({"N_rr": -2.0}), free=FREE, delay=0.0)
    for k in range(len(commands)):
        learner.update(DT * k, velocity=[np.nan, np.nan, np.nan, *rates[k]], commands=commands[k])
    found = {each.name: each.value for each in learner.estimate.coefficients}
    assert found["N_rr"] == pytest.approx(TRUTH.coefficient("N_rr"), rel=0.05)


def _fed(learner: JointLearner, run: Recording, first: int = 0, last: int | None = None) -> None:
    t, names = run["p"].t, [f"cmd_{each.name}" for each in TRUTH.thrusters]
    for k in range(first, min(len(t), len(run[names[0]].values)) if last is None else last):
        rates = [run[name].values[k] for name in "pqr"]
        commands = [run[name].values[k] for name in names]
        learner.update(float(t[k]), velocity=[np.nan, np.nan, np.nan, *rates], commands=commands)


def test_reestimations_beside_the_stream_end_where_looks_within_it_do() -> None:
    run, start = _yaw(0.0, 12.0), TRUTH.with_coefficients({"N_rr": -1.0, "N_rdot": -0.3})
    within, beside = JointLearner(start, free=FREE), JointLearner(start, free=FREE, background=True)
    _fed(within, run)
    for first in range(0, 12 * RATE, 25):  # a stream is not as fast as a computer
        _fed(beside, run, first, first + 25)
        beside.settle()
    assert beside._stream.rows > 0
    for one, other in zip(within.estimate.coefficients, beside.estimate.coefficients, strict=True):
        assert other.value == pytest.approx(one.value, abs=one.std)


@pytest.mark.parametrize("cut", [3 * RATE, 11 * RATE])
def test_a_checkpoint_goes_on_as_if_nothing_had_happened(cut: int, tmp_path: Path) -> None:
    run = _yaw(0.0, 12.0)
    whole, first = JointLearner(TRUTH, free=FREE), JointLearner(TRUTH, free=FREE)
    _fed(whole, run)
    _fed(first, run, 0, cut)
    first.save(tmp_path / "session.state")
    second = Learner.load(tmp_path / "session.state", TRUTH)
    assert isinstance(second, JointLearner)
    _fed(second, run, cut)
    assert second.estimate.values == pytest.approx(whole.estimate.values, rel=1e-9)
    assert second.estimate.std == pytest.approx(whole.estimate.std, rel=1e-6)
    assert second.delay == pytest.approx(whole.delay, abs=1e-9)


def test_a_checkpoint_of_another_vehicle_or_a_damaged_one_is_refused(tmp_path: Path) -> None:
    learner = JointLearner(TRUTH, free=FREE)
    _fed(learner, _yaw(0.0, 2.0))
    place = tmp_path / "session.state"
    learner.save(place)
    with pytest.raises(InputError, match="other numbers of the vehicle"):
        Learner.load(place, load_vehicle("seamor"))
    with np.load(place) as file:
        arrays = {name: file[name] for name in file.files}
    arrays["about"] = np.frombuffer(json.dumps({"version": 7, "vehicle": TRUTH.name}).encode(), dtype=np.uint8)
    np.savez(tmp_path / "old", **arrays)
    with pytest.raises(InputError, match="found a checkpoint of version 7, expected"):
        Learner.load(tmp_path / "old.npz", TRUTH)
    place.write_bytes(place.read_bytes()[:5000])
    with pytest.raises(InputError, match="not a checkpoint, or a damaged one"):
        Learner.load(place, TRUTH)
    with pytest.raises(InputError, match="no such checkpoint"):
        Learner.load(tmp_path / "other.state", TRUTH)


def test_late_rows_are_put_back_and_the_others_wait() -> None:
    latency = np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])
    order, out = RowsInOrder(latency), []
    for k in range(100):
        z = np.full(N_MEASURED, np.nan)
        z[9] = 0.01 * k
        if k % 10 == 5:
            z[6] = 0.01 * k - 0.12  # what it shows is as old as its latency
        out += order.take(0.01 * k, z)
    times = [t for t, _ in out]
    assert times == sorted(times)
    assert times[-1] == pytest.approx(0.99 - 0.12)
    for t, z in out:
        for column in (6, 9):
            assert np.isnan(z[column]) or z[column] == pytest.approx(t, abs=1e-9)
    assert sum(np.isfinite(z[6]) for _, z in out) == 10


def test_what_goes_from_the_buffer_stays_in_the_prior(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stream that keeps four seconds ends where one does that keeps everything."""
    run, start = _yaw(0.0, 20.0), TRUTH.with_coefficients({"N_rr": -0.5})
    whole, short = JointLearner(start, free=FREE, changes=False), JointLearner(start, free=FREE, changes=False)
    whole.run(run)
    monkeypatch.setattr("towtank.identification.online.reestimation._MOST_ROWS", 8 * RATE)
    short.run(run)
    assert short._stream.kept is not None
    for one, other in zip(whole.estimate.coefficients, short.estimate.coefficients, strict=True):
        assert other.value == pytest.approx(one.value, abs=2.0 * one.std)
        assert 0.5 < other.std / one.std < 2.0
