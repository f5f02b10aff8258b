"""What cannot be fitted is said: in one line where the question makes no sense, else in the fit; never NaN unseen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.identification.runs import box
from tests.identification.test_output_error import DT, NOISE, POSE, SURGE, only, push, recorded

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification.data.samples import N_MEASURED, Samples
from towtank.identification.model.parameters import free_parameters
from towtank.identification.simulation_error.fit import OutputErrorFit, fit_output_error
from towtank.identification.simulation_error.residuals import autocorrelation_of, jumps
from towtank.identification.simulation_error.segments import CandidateModel

SAMPLES = only(recorded(box(), push(600, 0)), POSE)


def fit(samples: Samples, names: tuple[str, ...] = SURGE, off: float = 0.2, **more: object) -> OutputErrorFit:
    free = free_parameters(box(), names)
    theta = free.theta(box(), delay=0.0, lag=0.05) + off
    return fit_output_error([samples], CandidateModel(box(), free, theta), NOISE, **more)  # type: ignore[arg-type]


def cut(rows: int, samples: Samples = SAMPLES) -> Samples:
    return replace(samples, t=samples.t[:rows], values=samples.values[:rows])


def assert_sound(found: OutputErrorFit) -> None:
    """Finite where it converged; else it says so, and no number is NaN."""
    assert np.isfinite(found.theta).all()
    assert not np.isnan(found.covariance).any()
    assert (np.diag(found.covariance) > 0.0).all()
    assert np.isfinite(found.information).all()
    assert np.isfinite(found.states).all()
    assert not np.isnan(found.cost)
    assert 0.0 <= found.rejected <= 1.0


@pytest.mark.parametrize("more, words", [
    ({"prior": (np.zeros(2), np.eye(3))}, "2 x 2"), ({"prior": (np.full(2, np.nan), np.eye(2))}, "finite"),
])  # fmt: skip
def test_a_prior_that_does_not_fit(more: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        fit(SAMPLES, **more)


def test_questions_without_sense() -> None:
    free = free_parameters(box(), SURGE)
    none = CandidateModel(box(), free_parameters(box(), ()), np.zeros(0))
    model = CandidateModel(box(), free, np.array([3.0, 3.0]))
    with pytest.raises(InputError, match="nothing to fit"):
        fit_output_error([SAMPLES], none, NOISE)
    with pytest.raises(InputError, match="2 finite"):
        fit_output_error([SAMPLES], replace(model, theta=np.array([1.0, np.nan])), NOISE)
    with pytest.raises(InputError, match="18 deviations"):
        fit_output_error([SAMPLES], model, NOISE[:6])
    with pytest.raises(InputError, match="positive noise"):
        fit_output_error([SAMPLES], model, 0.0 * NOISE)
    with pytest.raises(InputError, match="no recording"):
        fit_output_error([], model, NOISE)
    with pytest.raises(InputError, match="nothing is measured"):
        fit(replace(SAMPLES, values=np.full_like(SAMPLES.values, np.nan)))
    with pytest.raises(InputError, match="three measured rows"):
        fit(cut(2))


@pytest.mark.parametrize("rows", [3, 4, 7, 12, 30, 60, 120])
def test_short_recordings(rows: int) -> None:
    assert_sound(fit(cut(rows)))
    assert_sound(fit(cut(rows), ("X_udot", "X_uu", "N_rr", "Y_rdot", "delay", "lag")))


def test_a_vehicle_at_rest_says_nothing() -> None:
    still = only(recorded(box(), np.zeros((600, 6))), POSE)
    found = fit(still, off=0.0)
    assert_sound(found)
    assert (np.sqrt(np.diag(found.covariance)) > 1.0).all()


def test_what_the_run_does_not_tell_has_a_deviation_that_says_so() -> None:
    found = fit(SAMPLES, ("X_udot", "X_uu", "N_rr"))
    std = np.sqrt(np.diag(found.covariance))
    assert found.converged
    assert std[2] > 100.0 * std[1]
    assert abs(found.theta[2] - box().coefficient("N_rr")) < std[2]


def test_a_start_whose_run_is_impossible() -> None:
    free = free_parameters(box(), ("X_udot", "Y_rdot"))
    found = fit_output_error([SAMPLES], CandidateModel(box(), free, np.array([3.0, 1e4])), NOISE)
    assert not found.converged
    assert found.cost == np.inf
    assert np.isinf(np.diag(found.covariance)).all()
    np.testing.assert_array_equal(found.theta, [3.0, 1e4])


def test_far_starts_end() -> None:
    for off in (-3.0, 3.0, 8.0):
        assert_sound(fit(SAMPLES, off=off))
    assert_sound(fit(SAMPLES, iterations=1))


def test_a_wrong_model_shows_in_the_autocorrelation_of_its_residuals() -> None:
    free = free_parameters(box(), ("X_uu",))
    wrong = box(rigid_body={"mass": 35.0, "inertia": (1.0, 1.2, 1.5)})
    found = fit_output_error([SAMPLES], CandidateModel(wrong, free, np.array([3.4])), NOISE)
    assert_sound(found)
    assert found.autocorrelation.time[0] > 5.0 * found.autocorrelation.step[0]
    assert found.residual_std[0] > 2.0 * NOISE[0]


def test_nothing_given_is_changed() -> None:
    free, theta, noise = free_parameters(box(), SURGE), np.array([3.0, 3.0]), NOISE.copy()
    values = SAMPLES.values.copy()
    fit_output_error([SAMPLES], CandidateModel(box(), free, theta), noise)
    np.testing.assert_array_equal(theta, [3.0, 3.0])
    np.testing.assert_array_equal(noise, NOISE)
    np.testing.assert_array_equal(SAMPLES.values, values)


def _coloured(n: int, rho: float) -> Array:
    x = np.random.default_rng(0).standard_normal(n)
    for i in range(1, n):
        x[i] = rho * x[i - 1] + np.sqrt(1.0 - rho**2) * x[i]
    return x


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_autocorrelation_is_that_of_a_first_order_series(rho: float) -> None:
    residuals = np.full((20000, N_MEASURED), np.nan)
    residuals[:, 4] = 2.0 * _coloured(20000, rho)
    correlation = autocorrelation_of([(DT * np.arange(20000.0), residuals)], np.full(N_MEASURED, 100.0))
    assert correlation.std[4] == pytest.approx(2.0, rel=0.05)
    assert correlation.time[4] == pytest.approx(DT * (1.0 + rho) / (1.0 - rho), rel=0.2)
    assert np.isnan(correlation.time[:4]).all()


def test_jumps_are_seen_in_white_residuals_only() -> None:
    residuals = np.full((2000, N_MEASURED), np.nan)
    residuals[:, :4] = np.random.default_rng(0).standard_normal((2000, 4))
    residuals[700:730, 1] += 3.0
    found = jumps(residuals, np.ones(N_MEASURED))
    assert found[700:730, :3].all(), "one component wrong: none of its instrument is trusted"
    assert found.sum() < 3 * 50
    assert not found[:, 3:].any()
    residuals[:, 1] = 3.0 * _coloured(2000, 0.95)
    assert not jumps(residuals, 3.0 * np.ones(N_MEASURED)).any()
