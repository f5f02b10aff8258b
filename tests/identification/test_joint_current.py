"""Water that flows: it is noticed, and learned along it costs nothing."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest
from scipy.stats import gmean

from towtank.identification import Estimate, LogLearning, learn_recordings
from towtank.identification.kalman import passes
from towtank.identification.online.joint import JointLearner
from towtank.live.pipeline.instants import Instants, rows_of
from towtank.recording import Recording
from towtank.simulation import Ins, OrnsteinUhlenbeck, RisingCurrent, manoeuvre, simulate
from towtank.vehicle import load_vehicle

_QUICK = load_vehicle("vlbv300")
TRUTH = _QUICK.model_copy(  # what an accelerometer shows at the instant of a command is not of one force without a lag
    update={"thrusters": tuple(each.model_copy(update={"time_constant": 0.1}) for each in _QUICK.thrusters)}
)
FREE = ("X_udot", "Y_vdot", "N_rdot", "X_uu", "Y_vv", "N_rr")
WATER = (0.15, -0.1, 0.0)


def _dive(current: tuple[float, float, float], seed: int = 1, rate: float = 50.0) -> Recording:
    dt, sensors = 1.0 / rate, Ins(imu_rate=rate)
    commands = manoeuvre("all-multisine", TRUTH, duration=30.0, dt=dt).commands
    push = OrnsteinUhlenbeck(std=(0.25, 0.25, 0.25, 0.02, 0.02, 0.02), time_constant=2.0)
    return simulate(TRUTH, commands=commands, dt=dt, sensors=sensors, seed=seed, current=current, disturbance=push)


@pytest.fixture(scope="module")
def flowing() -> Recording:
    return _dive(WATER)


@pytest.fixture(scope="module")
def along(flowing: Recording) -> LogLearning:
    return learn_recordings(TRUTH, [flowing], free=FREE, delay=0.0)


@pytest.fixture(scope="module")
def streamed(flowing: Recording) -> JointLearner:
    learner = JointLearner(TRUTH, free=FREE, delay=0.0)
    learner.run(flowing)
    return learner


def test_a_current_that_changes_along_the_way_is_no_drag() -> None:
    """Linearised about one current for the whole log, what the other does looked like drag, at 4 to 7 deviations."""
    commands = manoeuvre("all-multisine", TRUTH, duration=60.0, dt=0.02).commands
    push = OrnsteinUhlenbeck(std=(0.25, 0.25, 0.25, 0.02, 0.02, 0.02), time_constant=2.0)
    turn = RisingCurrent((0.25, -0.1, 0.0), begin=25.0, seconds=15.0)
    run = simulate(TRUTH, commands=commands, dt=0.02, sensors=Ins(imu_rate=50.0), seed=1, waves=turn, disturbance=push)
    found = learn_recordings(TRUTH, [run], free=(*FREE, "X_u", "Y_v"), delay=0.0)
    for each in found.estimate.coefficients:
        if each.identified:
            assert abs(each.value - TRUTH.coefficient(each.name)) < 3.0 * each.std, each.name
    assert found.levels is not None
    assert found.levels.current_walk >= 3e-3
    assert any("the current changes along the way" in each for each in found.remarks)
    assert found.current is not None
    assert (np.abs(found.current.velocity - (0.25, -0.1, 0.0)) < 4.0 * found.current.std).all()


def test_the_current_is_found_and_the_drag_is_right(along: LogLearning) -> None:
    assert along.current is not None
    assert along.current.velocity == pytest.approx(WATER, abs=0.006)
    assert (np.abs(along.current.velocity - WATER) < 4.0 * along.current.std).all()
    for name in ("X_uu", "Y_vv"):
        found = along.estimate[name]
        assert found.value == pytest.approx(TRUTH.coefficient(name), rel=0.08)
        assert abs(found.value - TRUTH.coefficient(name)) < 3.5 * found.std
    assert along.method == "joint"


def test_a_current_is_said(along: LogLearning) -> None:
    [told] = [line for line in along.remarks if line.startswith("the water flows")]
    assert "towards 32" in told or "towards 33" in told


def test_still_water_is_left_in_peace() -> None:
    learning = learn_recordings(TRUTH, [_dive((0.0, 0.0, 0.0), seed=2)], free=FREE, delay=0.0)
    assert learning.current is not None
    assert (np.abs(learning.current.velocity) < 4.0 * learning.current.std).all()
    assert learning.current.std.max() < 0.01
    assert not any("flows" in line for line in (*learning.remarks, *learning.warnings))


def test_two_recordings_have_water_of_their_own(flowing: Recording) -> None:
    """One in a current, one in still water: both together say what they say of the drag, and it is right."""
    learning = learn_recordings(TRUTH, [flowing, _dive((0.0, 0.0, 0.0), seed=2)], free=FREE, delay=0.0)
    assert learning.current is not None
    assert (np.abs(learning.current.velocity) < 4.0 * learning.current.std).all()  # that of the last one
    for name in ("X_uu", "Y_vv"):
        found = learning.estimate[name]
        assert abs(found.value - TRUTH.coefficient(name)) < 3.5 * found.std
        assert found.value == pytest.approx(TRUTH.coefficient(name), rel=0.08)


def test_a_stream_learns_it_along(streamed: JointLearner) -> None:
    assert streamed.current is not None
    assert streamed.current.velocity == pytest.approx(WATER, abs=0.01)
    assert streamed.estimate["X_uu"].value == pytest.approx(TRUTH.coefficient("X_uu"), rel=0.08)


def test_a_stretch_of_the_same_session_is_in_the_same_water_and_another_dive_is_not(
    flowing: Recording, streamed: JointLearner
) -> None:
    learner = deepcopy(streamed)
    known = learner.current
    assert known is not None
    rows = [(t, names, values) for t, names, values in rows_of(flowing)][:20]
    deviation = {}
    for later in (1.0, 3600.0):
        learner.restart()
        instants = Instants(TRUTH)
        last = learner._stream.running.state.clock[0].time  # type: ignore[union-attr]
        for t, names, values in rows:
            learner.update(last + later + t, **instants.arguments(dict(zip(names, values, strict=True))))
        assert learner.current is not None
        deviation[later] = learner.current.std
    assert (deviation[1.0][:2] < 1.2 * known.std[:2]).all()
    assert (deviation[3600.0][:2] > 5.0 * known.std[:2]).all()


def _learned(flowing: Recording, broken: int) -> Estimate:
    learner = JointLearner(TRUTH, free=FREE, delay=0.0)
    instants = Instants(TRUTH)
    for k, (t, names, values) in enumerate(rows_of(flowing)):
        if k == broken:
            learner.restart()
            instants.forget()
        learner.update(t, **instants.arguments(dict(zip(names, values, strict=True))))
    return learner.estimate


def test_a_break_in_a_session_costs_less_than_another_dive_would(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    flowing = _dive(WATER, rate=100.0)
    learner = JointLearner(TRUTH, free=FREE, delay=0.0)
    learner.run(flowing)
    unbroken = learner.estimate
    session = _learned(flowing, 2200)
    monkeypatch.setattr(passes, "_SAME_WATER", -1.0)
    dives = _learned(flowing, 2200)
    assert (np.abs(session.values - unbroken.values) < 2.0 * unbroken.std).all()
    assert gmean(session.std / unbroken.std) < 1.2
    assert gmean(dives.std / session.std) > 1.2
