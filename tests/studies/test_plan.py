"""The study of plans: from when on a stream is right."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from plan_study import for_good


def test_near_for_good_is_from_the_last_time_that_it_was_not() -> None:
    near = np.array([[1, 0, 0, 1], [1, 1, 0, 1], [1, 0, 1, 1], [1, 1, 1, 0]], dtype=np.bool_)
    np.testing.assert_array_equal(for_good(np.array([0.5, 1.0, 1.5, 2.0]), near), [0.5, 2.0, 1.5, np.inf])
