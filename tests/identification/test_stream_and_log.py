"""A stream ends where a log does: every plausible coefficient of a thruster-driven vehicle, from the same samples."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.identification import Learner, learn_recordings
from towtank.recording import Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import load_vehicle

TRUTH = load_vehicle("vlbv300").model_copy(update={"command_delay": 0.1})
FORCE = OrnsteinUhlenbeck(std=(0.3, 0.3, 0.3, 0.02, 0.02, 0.02), time_constant=2.0)
SECONDS = 45.0


def camera() -> Recording:
    return dive(Mocap(rate=50.0), dt=0.02)


def station() -> Recording:
    """A Doppler log at 8 Hz, a gyro at 100 Hz and a depth gauge."""
    return dive(Ins(gyro_bias=0.0), dt=0.01).without("x", "y", "phi", "theta", "psi", "ax", "ay", "az")


def dive(sensors: Mocap | Ins, dt: float) -> Recording:
    commands = manoeuvre("all-multisine", TRUTH, duration=SECONDS, dt=dt).commands
    return simulate(TRUTH, commands=0.6 * np.asarray(commands), dt=dt, sensors=sensors, disturbance=FORCE, seed=4)


@pytest.mark.parametrize("run", [camera, station])
def test_a_stream_and_a_log_say_the_same(run) -> None:  # type: ignore[no-untyped-def]
    recording = run()
    log = learn_recordings(TRUTH, [recording])
    learner = Learner(TRUTH, changes=False)
    learner.run(recording)
    one, other = log.estimate, learner.estimate
    assert set(other.names) == set(one.names)
    apart = np.array([abs(other[name].value - one[name].value) / one[name].std for name in one.names])
    assert np.mean(apart < 0.5) > 0.95  # the last nine seconds are linear about what was known before them
    assert apart.max() < 1.0
    assert abs(learner.delay - log.delay) < max(0.5 * log.delay_std, 1e-3)
    assert set(learner.latency) == set(log.latency)
    assert sum(each.identified for each in other.coefficients) > 20
