"""What a learning will know, told before it is done."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from towtank.identification import LogLearning, learn_paper, learn_recordings
from towtank.identification.offline.forecast import Forecast, best_excited, forecast
from towtank.recording import Recording, align
from towtank.simulation import OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import load_vehicle

VEHICLE = load_vehicle("vlbv300")


def drive(name: str, seconds: float, **more: object) -> Recording:
    commands = manoeuvre(name, VEHICLE, duration=seconds, dt=0.02).commands
    return simulate(VEHICLE, commands=commands, dt=0.02, sensors="ins", seed=3, **more)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def run() -> Recording:
    return drive("yaw-square", 20.0, disturbance=OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.03, 0.03, 0.03)))


@pytest.fixture(scope="module")
def first(run: Recording) -> LogLearning:
    return learn_paper(VEHICLE, [run])


@pytest.fixture(scope="module")
def ahead(run: Recording, first: LogLearning) -> Forecast:
    found = forecast(VEHICLE, [run], first)
    assert found is not None
    return found


def test_it_promises_what_learning_then_finds(run: Recording, ahead: Forecast) -> None:
    learned = learn_recordings(VEHICLE, [run], free=("N_rdot", "N_rr")).estimate
    for name in ("N_rdot", "N_rr"):
        assert 0.5 < ahead.known[name].std / learned[name].std < 2.0
    total = VEHICLE.rigid_body_matrix[5, 5] - VEHICLE.coefficient("N_rdot")
    predicted_accuracy = ahead.known["N_rdot"]
    assert predicted_accuracy.percent == pytest.approx(100.0 * predicted_accuracy.std / total, rel=0.05)
    assert predicted_accuracy.text.startswith("yaw inertia will be known to ")
    assert ahead.known["N_rr"].text.startswith("yaw drag will be known to ")


def test_the_filter_is_believed_where_its_picture_is_right(ahead: Forecast) -> None:
    assert ahead.agrees
    assert abs(ahead.delay) < 0.005
    assert 0.0 < ahead.delay_std < 0.01
    assert set(ahead.known) <= {"N_rdot", "N_rr", "N_0"}


def test_least_squares_speaks_where_the_two_differ(run: Recording, first: LogLearning) -> None:
    wrong = first.estimate.values.copy()
    wrong[first.estimate.names.index("N_rdot")] -= 1.0
    off = replace(first, estimate=replace(first.estimate, values=wrong))
    found = forecast(VEHICLE, [run], off)
    assert found is not None
    assert not found.agrees
    assert found.known["N_rr"].std == off.estimate["N_rr"].std


def test_liveliest_finds_what_drives_each_axis() -> None:
    wrench = np.zeros((3000, 6))
    wrench[500:700, 0] = 5.0
    wrench[2000:2200, 5] = 1.0
    log = simulate(VEHICLE, wrench=wrench, dt=0.02, sensors="perfect")
    windows = best_excited(align(log), VEHICLE, 1800)
    assert len(windows) == 2
    (surge, yaw), seconds = windows, 300 * 0.02
    assert surge[0] <= 10.0
    assert surge[1] >= 14.0
    assert yaw[0] <= 40.0
    assert yaw[1] >= 44.0
    assert all(end - start == pytest.approx(seconds, abs=0.03) for start, end in windows)
    [whole] = best_excited(align(log), VEHICLE, 5000)
    assert whole == pytest.approx((0.0, 60.0))


def test_several_stretches_are_one_recording(run: Recording, first: LogLearning, ahead: Forecast) -> None:
    parts = [run.window(0.0, 10.0), run.window(10.0, 20.0)]
    found = forecast(VEHICLE, parts, first)
    assert found is not None
    assert found.known["N_rr"].std == pytest.approx(ahead.known["N_rr"].std, rel=0.5)


def test_nothing_to_know_is_none() -> None:
    still = drive("yaw-square", 5.0)
    quiet = simulate(VEHICLE, commands=np.zeros((250, 6)), dt=0.02, sensors="ins", seed=1)
    assert still.duration == pytest.approx(quiet.duration)
    assert forecast(VEHICLE, [quiet], learn_paper(VEHICLE, [quiet], delay=0.0)) is None
