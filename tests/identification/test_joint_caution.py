"""The level that deviations are stated at: the estimate without the pull of the usual one."""

from __future__ import annotations

import numpy as np

from towtank.identification.kalman.noise_adaptation import variance_inflation

FAR = 7.0  # times the usual level
COUNTS_FOR = 2.0  # looks that the usual level counts for


def test_caution_undoes_what_the_usual_level_takes_from_one_far_above_it() -> None:
    effective_samples, usual = np.array([0.0, 1.0, 3.0, 12.0, 40.0, 1e6]), 0.2
    weight = effective_samples / (effective_samples + COUNTS_FOR)
    blended = (FAR * usual) ** weight * usual ** (1.0 - weight)
    np.testing.assert_allclose(variance_inflation(effective_samples) * blended, FAR * usual, rtol=1e-12)
    assert np.all(np.diff(variance_inflation(effective_samples)) < 0.0)
