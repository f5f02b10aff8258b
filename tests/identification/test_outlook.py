"""What a learning will know, told before it is done."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.identification import LogLearning, learn_recordings
from towtank.identification.offline.first_look import best_excited, predicted_accuracies
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
    return learn_recordings(VEHICLE, [run], free_runs=False)


def test_it_says_what_was_narrowed(first: LogLearning) -> None:
    known = predicted_accuracies(first)
    assert set(known) == {each.name for each in first.estimate.coefficients if each.identified}
    assert {"N_rdot", "N_rr"} <= set(known)
    inertia, drag = known["N_rdot"], known["N_rr"]
    total = VEHICLE.rigid_body_matrix[5, 5] - first.estimate["N_rdot"].value
    assert inertia.percent == pytest.approx(100.0 * first.estimate["N_rdot"].std / total)
    assert inertia.text.startswith("yaw inertia will be known to ")
    assert inertia.text.endswith(" %")
    assert drag.percent == pytest.approx(100.0 * drag.std / abs(first.estimate["N_rr"].value))
    assert "yaw drag will be known to " in drag.text


def test_it_promises_no_more_than_the_whole_recording_gives(run: Recording, first: LogLearning) -> None:
    whole = predicted_accuracies(first)
    half = predicted_accuracies(learn_recordings(VEHICLE, [run.window(0.0, 10.0)], free_runs=False))
    common = sorted(set(whole) & set(half))
    assert "N_rdot" in common
    assert np.median([whole[name].std / half[name].std for name in common]) < 1.0


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
