"""Velocity through the water: with it a current is found, and without any other speed the drag is."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.identification import Learner, LogLearning, learn_recordings
from towtank.live.pipeline.instants import Instants, rows_of
from towtank.recording import Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, Together, WaterTrack, manoeuvre, simulate
from towtank.vehicle import load_vehicle

TRUTH = load_vehicle("vlbv300")
FREE = ("X_udot", "Y_vdot", "N_rdot", "X_uu", "Y_vv", "N_rr")
WATER = (0.16, -0.12, 0.0)  # 0.2 m/s


def dive(sensors: object, current: tuple[float, float, float], seconds: float = 30.0) -> Recording:
    commands = manoeuvre("all-multisine", TRUTH, duration=seconds, dt=0.01).commands
    push = OrnsteinUhlenbeck(std=(0.25, 0.25, 0.25, 0.02, 0.02, 0.02), time_constant=2.0)
    return simulate(TRUTH, commands=commands, dt=0.01, sensors=sensors, seed=4, current=current, disturbance=push)


@pytest.fixture(scope="module")
def flowing() -> Recording:
    return dive(Together((Mocap(noise_mm=2.0), WaterTrack(rate=5.0, noise=0.02))), WATER)


@pytest.fixture(scope="module")
def learned(flowing: Recording) -> LogLearning:
    return learn_recordings(TRUTH, [flowing], free=FREE, delay=0.0)


def test_with_position_a_current_is_found_within_a_centimetre_a_second(learned: LogLearning) -> None:
    assert learned.current is not None
    assert learned.current.velocity == pytest.approx(WATER, abs=0.01)
    assert (np.abs(learned.current.velocity - WATER) < 4.0 * learned.current.std).all()
    for name in ("X_uu", "Y_vv"):
        assert learned.estimate[name].value == pytest.approx(TRUTH.coefficient(name), rel=0.06)


def test_its_noise_is_found_as_that_of_any_sensor(learned: LogLearning) -> None:
    assert learned.levels is not None
    assert learned.levels.noise[15:] == pytest.approx(0.02, rel=0.3)


def test_a_stream_takes_it_and_learns_the_same_at_once_or_row_by_row(flowing: Recording) -> None:
    short = flowing.window(0.0, 6.0)
    whole, single = (Learner(TRUTH, free=FREE, delay=0.0) for _ in range(2))
    whole.run(short)
    instants = Instants(TRUTH)
    for t, names, values in rows_of(short):
        single.update(t, **instants.arguments(dict(zip(names, values, strict=True))))
    for learner in (whole, single):
        learner.settle()
        assert learner.current is not None
    assert single.current is not None
    assert whole.current is not None
    np.testing.assert_allclose(single.current.velocity, whole.current.velocity, rtol=1e-9)
    np.testing.assert_allclose(single.estimate.values, whole.estimate.values, rtol=1e-9)


def test_free_runs_take_it_for_the_speed_where_no_other_is_measured() -> None:
    run = dive(Together((Ins(), WaterTrack(rate=10.0, noise=0.01))), (0.0, 0.0, 0.0)).without("u", "v", "w")
    learning = learn_recordings(TRUTH, [run], free=("X_udot", "X_uu"), delay=0.0, method="output-error")
    assert learning.method == "output-error"
    drag = learning.estimate["X_uu"]
    off = abs(drag.value - TRUTH.coefficient("X_uu"))
    assert off < min(3.0 * drag.std, 0.1 * abs(drag.value))
    assert drag.identified
