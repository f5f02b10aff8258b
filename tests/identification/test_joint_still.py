"""Still water is found where nothing disturbs the vehicle, markers that jump or not, and not where something does."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.identification import Learner
from towtank.simulation import Mocap, OrnsteinUhlenbeck, simulate

from .runs import TRUTH, box, unknown, waves

NAMES = ("X_udot", "X_uu")
DT, SECONDS, EARLY, LATE = 0.02, 14.0, 5.0, 12.0  # s
USUAL = 20.0 * 1.6 * 0.006  # N, what the learner expects of this vehicle


def levels(force: float, noise_mm: float, seed: int, seconds: float) -> tuple[float, float]:
    """Return the level of the disturbance that a stream takes there to be, and its error of the mass [share]."""
    vehicle = box()
    wrench = waves(round(SECONDS / DT), DT, (0, 12.0, 1.5), square=True)
    wrench[: round(0.5 / DT)] = 0.0
    run = simulate(
        vehicle, wrench=wrench, dt=DT, sensors=Mocap(noise_mm=noise_mm, jump_fraction=0.03),
        disturbance=OrnsteinUhlenbeck(std=force, time_constant=2.0, axes=("X",)) if force else None, seed=seed,
    )  # fmt: skip
    others = {name: value for name, value in TRUTH.items() if name not in NAMES}
    learner = Learner(unknown(vehicle, **others), free=NAMES, changes=False)
    learner.run(run.window(0.0, seconds))
    mass = 20.0 - learner.estimate["X_udot"].value
    return float(learner.disturbance[0]), mass / (20.0 - TRUTH["X_udot"]) - 1.0


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
@pytest.mark.parametrize("noise_mm", [1.0, 5.0])
def test_water_that_is_still_is_taken_as_still(noise_mm: float, seed: int) -> None:
    level, error = levels(0.0, noise_mm, seed, EARLY)
    assert level < 0.35 * USUAL  # as low as levels go
    assert abs(error) < 1e-3 * noise_mm


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_force_is_not_taken_for_still_water(seed: int) -> None:
    level, error = levels(0.6, 1.0, seed, LATE)
    assert 0.5 * 0.6 < level < 2.0 * 0.6
    assert abs(error) < 0.05


def test_nothing_is_supposed_before_a_force_could_have_shown() -> None:
    level, _ = levels(0.0, 1.0, 1, 2.5)
    assert np.isclose(level, USUAL, rtol=0.6)
    assert level > 0.15 * USUAL
