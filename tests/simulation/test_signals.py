"""Wave forms: bounded, balanced, of the stated periods, and independent between axes."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.simulation import FORMS, stream
from towtank.simulation.signals import Lane, chirp, multisine, prbs, square, stairs, telegraph

T = np.arange(12000, dtype=np.float64) * 0.01


def wave(form: str, lane: Lane = (0, 1), seed: int = 1) -> np.ndarray:
    return FORMS[form].wave(T, FORMS[form].period, stream(seed, form, str(lane[0])), lane)


@pytest.mark.parametrize("form", FORMS)
def test_bounds_balance_and_reproducibility(form: str) -> None:
    values = wave(form)
    assert np.isfinite(values).all()
    assert np.abs(values).max() == pytest.approx(1.0, abs=2e-3)
    assert abs(values.mean()) < 0.15
    np.testing.assert_array_equal(values, wave(form))
    assert wave(form)[:1].shape == FORMS[form].wave(T[:1], 5.0, stream(1, "x"), (0, 1)).shape


@pytest.mark.parametrize("form", FORMS)
def test_six_axes_at_once_are_not_collinear(form: str) -> None:
    lanes = np.array([wave(form, (i, 6)) for i in range(6)])
    assert np.abs(np.corrcoef(lanes) - np.eye(6)).max() < 0.4
    assert np.linalg.cond(lanes @ lanes.T) < 12.0


def test_multisine_has_a_low_crest_and_orthogonal_lanes() -> None:
    values = wave("multisine")
    assert 1.0 / values.std() < 2.0
    lanes = np.array([multisine(T, 10.0, stream(1, str(i)), (i, 6)) for i in range(6)])
    assert np.abs(np.corrcoef(lanes) - np.eye(6)).max() < 1e-10
    spectrum = np.abs(np.fft.rfft(values))
    lines = spectrum > 1e-6 * spectrum.max()
    assert lines.sum() == 57
    assert np.fft.rfftfreq(T.size, 0.01)[lines][[0, -1]] == pytest.approx([4 / 120, 0.5])


def test_shapes() -> None:
    generator = stream(1, "x")
    square_wave = square(T, 5.0, generator)
    np.testing.assert_array_equal(square_wave[[0, 124, 125, 374, 375, 499, 500]], [1, 1, -1, -1, 1, 1, 1])
    steps = stairs(T, 16.0, generator)[[0, 200, 400, 600, 800, 1599]]
    np.testing.assert_array_equal(steps, [0.25, 0.5, 0.75, 1, -0.25, -1])
    crossings = T[1:][np.diff(np.sign(chirp(T, 10.0, generator))) != 0]
    assert crossings[2] - crossings[1] > 4.0 * (crossings[-1] - crossings[-2])
    bits = prbs(T, 6.0, generator)[::60]
    assert set(bits) == {-1.0, 1.0}
    assert (np.diff(bits) != 0).mean() == pytest.approx(0.5, abs=0.08)
    switches = np.diff(T[1:][np.diff(telegraph(T, 8.0, generator)) != 0])
    assert switches.min() > 0.38
    assert switches.mean() == pytest.approx(2.0, abs=0.7)
