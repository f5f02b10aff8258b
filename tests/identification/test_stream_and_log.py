"""A stream ends where a log does: every plausible coefficient of a thruster-driven vehicle, from the same samples.

And as honest as a log where the model lacks something, or a sensor pretends.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from towtank.identification import Learner, learn_recordings
from towtank.identification.changes.branch import Kept
from towtank.identification.kalman.state import coefficient_block
from towtank.identification.online.reestimation import Reestimation
from towtank.recording import Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import load_vehicle

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from pushed_box import flight, true_box

TRUTH = load_vehicle("vlbv300").model_copy(update={"command_delay": 0.1})
FORCE = OrnsteinUhlenbeck(std=(0.3, 0.3, 0.3, 0.02, 0.02, 0.02), time_constant=2.0)
SECONDS = 30.0


def camera() -> Recording:
    return dive(Mocap(rate=25.0), dt=0.04)


def station() -> Recording:
    """A Doppler log at 8 Hz, a gyro at 50 Hz and a depth gauge."""
    return dive(Ins(gyro_bias=0.0, imu_rate=50.0), dt=0.02).without("x", "y", "phi", "theta", "psi", "ax", "ay", "az")


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
    assert np.mean(apart < 0.5) > 0.95  # the last seconds are linear about what was known before them
    assert apart.max() < 1.0
    assert abs(learner.delay - log.delay) < max(0.5 * log.delay_std, 1e-3)
    assert set(learner.latency) == set(log.latency)
    assert sum(each.identified for each in other.coefficients) > 20


BOX = true_box().model_copy(update={"hydrodynamics": {}})
PUSHED = ("X_udot", "X_u", "X_uu", "Y_vdot", "N_rdot", "N_r", "N_rr")  # what pushes ahead and turning in yaw show


def off(learner: Learner) -> list[float]:
    """Errors of what is identified, in deviations."""
    found = [each for each in learner.estimate.coefficients if each.identified and each.std]
    return [abs(each.value - true_box().coefficient(each.name)) / float(each.std or 1.0) for each in found]


def test_a_stream_doubts_speeds_that_show_no_noise() -> None:
    """Means over a second about each sample: believed, they make of 2.3 kg m^2 in yaw a dozen."""
    learner = Learner(BOX, free=PUSHED, changes=False)
    learner.run(flight("smooth 1.2", 1).window(0.0, 30.0))
    assert any(each.startswith("samples of p q r show no noise of their own") for each in learner.remarks)
    assert max(off(learner)) < 4.0
    own, truth = true_box().rigid_body.inertia[2], true_box().coefficient("N_rdot")
    assert own - learner.estimate["N_rdot"].value == pytest.approx(own - truth, rel=0.02)


@pytest.fixture(scope="module")
def late() -> Learner:
    """Learned from 30 s of forces of which a third acts 0.2 s late."""
    learner = Learner(BOX, free=PUSHED, changes=False)
    learner.run(flight("a third late", 1).window(0.0, 30.0))
    return learner


def test_a_stream_is_less_sure_where_another_picture_of_the_data_is_likelier(late: Learner) -> None:
    assert any("0.25 s late" in each for each in late.remarks)
    assert max(off(late)) < 4.0
    running = late._stream.running  # type: ignore[attr-defined]
    k = running.free.names.index("N_rdot")
    alone = np.sqrt(np.diag(running.undoubted))
    np.testing.assert_allclose(running.std, np.hypot(alone, running.apart))
    np.testing.assert_allclose(np.diag(running.told[1]), running.std**2)
    assert running.apart[k] > 4.0 * alone[k]  # nearly all of the doubt is about which picture is right


def test_what_is_lost_to_another_picture_says_so(late: Learner, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = late._stream  # type: ignore[attr-defined]
    assert late.estimate["N_rdot"].identified
    prior = stream.running.prior
    further = np.where(np.array(prior.names) == "N_rdot", prior.std, 0.0)
    monkeypatch.setattr(stream, "running", stream.running._replace(apart=further))
    monkeypatch.setattr(late, "_estimate", None)
    assert "read in another way" in str(late.estimate["N_rdot"].reason)
    monkeypatch.setattr(late, "_estimate", None)


def test_a_checkpoint_keeps_what_contradicts_it(late: Learner, tmp_path: Path) -> None:
    late.save(tmp_path / "state.npz")
    again = Learner.load(tmp_path / "state.npz", BOX)
    assert again.remarks == late.remarks
    np.testing.assert_array_equal(again.estimate.std, late.estimate.std)


def test_what_has_gone_stays_as_doubtful_as_it_was(late: Learner) -> None:
    """The rest of a stream may agree with what is kept of rows that are gone, wrong as that is."""
    stream = late._stream  # type: ignore[attr-defined]
    running = stream.running
    known = running.state.theta.copy(), coefficient_block(running.state).copy()
    kept = Kept(running.free.names, *known, running.state.linearised_at, running.disagreement, running.apart)
    buffer = stream._buffer.without(stream._buffer.rows - 60)
    found = Reestimation.of(stream.question, buffer, kept, None).run()
    assert found is not None
    assert set(kept.names) == set(found.running.free.names)
    assert (np.abs(found.running.apart) >= np.abs(running.apart) - 1e-12).all()
