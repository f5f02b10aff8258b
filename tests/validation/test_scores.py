"""The fit in percent, by hand; and that it orders models."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from towtank.simulation import Mocap, simulate
from towtank.validation import fit_percent, validate

from .test_prediction import box, pushes, run


def test_the_formula_by_hand() -> None:
    y, yhat = np.array([1.0, 2.0, 3.0, 6.0]), np.array([1.0, 3.0, 3.0, 4.0])
    # mean 3, |y - mean|^2 = 4 + 1 + 0 + 9 = 14, |y - yhat|^2 = 0 + 1 + 0 + 4 = 5
    assert fit_percent(y, yhat) == pytest.approx(100.0 * (1.0 - np.sqrt(5.0 / 14.0)))
    assert fit_percent(y, y) == 100.0
    assert fit_percent(y, np.full(4, 3.0)) == pytest.approx(0.0)
    assert fit_percent(y, 2 * 3.0 - y) == pytest.approx(-100.0)


def test_samples_that_were_not_measured_do_not_count() -> None:
    y = np.array([1.0, np.nan, 2.0, 3.0, np.nan, 6.0])
    yhat = np.array([1.0, 77.0, 3.0, 3.0, np.nan, 4.0])
    assert fit_percent(y, yhat) == pytest.approx(100.0 * (1.0 - np.sqrt(5.0 / 14.0)))


def test_divergence_is_the_worst_fit() -> None:
    y = np.array([1.0, 2.0, 3.0])
    assert fit_percent(y, np.array([1.0, np.nan, 3.0])) == -999.0
    assert fit_percent(y, np.array([1.0, np.inf, 3.0])) == -999.0
    assert fit_percent(y, np.array([1.0, 1e9, 3.0])) == -999.0


def test_no_sample_is_no_fit() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert fit_percent(np.full(3, np.nan), np.zeros(3)) != 100.0


def test_fit_and_rmse_are_those_of_the_channels() -> None:
    judged = validate(box(X_uu=-40.0), [run()])
    y, yhat = judged.predictions[0].channels["u"]
    assert judged.fit["u"] == pytest.approx(100 * (1 - np.linalg.norm(y - yhat) / np.linalg.norm(y - y.mean())))
    assert judged.rmse["u"] == pytest.approx(np.sqrt(np.mean((y - yhat) ** 2)))


def test_several_recordings_are_judged_as_one() -> None:
    logs = [run(), simulate(box(), wrench=0.5 * pushes(700))]
    judged = validate(box(X_uu=-40.0), logs)
    y, yhat = (np.concatenate([p.channels["u"][k] for p in judged.predictions]) for k in (0, 1))
    assert judged.fit["u"] == pytest.approx(fit_percent(y, yhat))


@pytest.mark.parametrize("sensors", ["perfect", Mocap()], ids=["perfect", "mocap"])
def test_the_right_model_is_better_than_wrong_ones(sensors: str | Mocap) -> None:
    log = run(sensors=sensors)
    channel = "u" if sensors == "perfect" else "x"
    right = validate(box(), [log]).fit[channel]
    assert right is not None
    for wrong in ({"X_uu": -15.0}, {"X_uu": -60.0}, {"X_udot": -40.0}, {"X_udot": 0.0}):
        fit = validate(box(**wrong), [log]).fit[channel]
        assert fit is not None
        assert fit < right - 3.0


def test_an_axis_that_rests_is_not_called_wrong() -> None:
    """Exactly still, and predicted still but for rounding: no spread to divide by, nothing wrong with the model."""
    wrench = np.zeros((1000, 6))
    wrench[:, 0] = 20 * np.sin(0.01 * np.arange(1000))
    log = simulate(box(), wrench=wrench, eta0=(0, 0, 5.0, 0, 0, 0.7))
    for name, fit in validate(box(), [log]).fit.items():
        assert fit is None or fit > 99.0, name
