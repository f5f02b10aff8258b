"""The posterior as a whole: the truth lies where mean and covariance in the vehicle's file say, in all directions."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from together_study import distance, learned


def test_a_truth_drawn_from_the_prior_is_as_far_as_chi_square_says() -> None:
    """That 40 of them are is printed by `benchmarks/studies/together_study.py`."""
    found = learned("supposed camera", 4)
    assert found.unknowns > 50
    assert 0.001 < found.share < 0.999


def test_a_combination_that_is_claimed_too_narrowly_shows_though_no_unknown_alone_does() -> None:
    covariance = np.array([[1.0, 0.999], [0.999, 1.0]])
    along, across = np.array([0.9, 0.9]), np.array([0.9, -0.9])
    factor = np.linalg.cholesky(covariance)
    assert distance(along, factor) == pytest.approx(2.0 * 0.81 / 1.999)
    assert distance(across, factor) == pytest.approx(2.0 * 0.81 / 0.001)
