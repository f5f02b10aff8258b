"""Which model is better, and whether it really is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.simulation import OrnsteinUhlenbeck
from towtank.validation import compare, validate
from towtank.validation.comparison import difference

from .errors import INDEPENDENT, as_series, boat, noisy_run, remembering

WAVES = OrnsteinUhlenbeck(std=INDEPENDENT, time_constant=1.0)


@pytest.mark.parametrize("time", [0.05, 0.5, 2.0])
@pytest.mark.parametrize("shared", [0.0, 1.0])
def test_two_equal_models_are_told_apart_as_rarely_as_they_should_be(time: float, shared: float) -> None:
    alarms = judged = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        common = shared * remembering(rng, 1200, time)
        first, second = (as_series(common + remembering(rng, 1200, time, std=0.5)) for _ in range(2))
        p = difference(first, second)
        if p is not None:
            judged += 1
            alarms += p < 0.05
    assert judged >= 95
    assert alarms <= 0.05 * judged + 2.8 * np.sqrt(0.05 * judged)


def test_a_larger_error_is_found() -> None:
    found = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        found.append(
            difference(as_series(remembering(rng, 2400, 0.5)), as_series(remembering(rng, 2400, 0.5, std=1.5)))
        )
    assert sum(p is not None and p < 0.05 for p in found) >= 27


def test_the_extremes() -> None:
    rng = np.random.default_rng(1)
    error = remembering(rng, 400, 0.2)
    broken = np.where(np.arange(400) > 300, np.inf, error)
    assert difference(as_series(error), as_series(error)) == 1.0
    assert difference(as_series(error), as_series(broken)) == 0.0
    assert difference(as_series(broken), as_series(broken)) == 1.0
    assert difference(as_series(error[:40]), as_series(2.0 * remembering(rng, 40, 2.0))) is None


def test_the_better_model_is_picked() -> None:
    models = {"right": boat(), "wrong": boat(X_uu=-60.0), "worse": boat(X_uu=-150.0)}
    found = compare(models, [noisy_run(1, disturbance=WAVES)])
    assert list(found.channels) == ["u", "r"]
    surge, yaw = found.channels["u"], found.channels["r"]
    assert surge.best == "right"
    assert surge.decided
    assert surge.against["worse"].behind > surge.against["wrong"].behind > 0.0
    assert yaw.against["worse"].behind < 0.5 * surge.against["worse"].behind
    assert found.validations["wrong"].fit == validate(models["wrong"], [noisy_run(1, disturbance=WAVES)]).fit


def test_models_that_err_alike_are_no_different() -> None:
    decided = 0
    for seed in range(15):
        found = compare({"a": boat(X_uu=-30.3), "b": boat(X_uu=-29.7)}, [noisy_run(seed, disturbance=WAVES)])
        decided += found.channels["u"].decided
    assert decided <= 4
    same = compare({"a": boat(), "b": boat()}, [noisy_run(1)])
    assert same.channels["u"].best == "a"
    assert same.channels["u"].against["b"].p == 1.0
    assert same.channels["u"].against["b"].behind == 0.0


def test_models_of_other_delays_are_compared_where_both_predict() -> None:
    first = as_series(remembering(np.random.default_rng(1), 2000, 0.3))
    (stretch,) = first.stretches
    late = replace(stretch, t=stretch.t[7:], error=2.0 * stretch.error[7:])
    p = difference(first, replace(first, stretches=(late,), samples=1993))
    assert p is not None
    assert p < 1e-6
    same = replace(stretch, t=stretch.t[7:], error=stretch.error[7:])
    assert difference(first, replace(first, stretches=(same,), samples=1993)) == 1.0


def test_one_model_is_no_comparison() -> None:
    with pytest.raises(InputError, match="at least two"):
        compare({"a": boat()}, [noisy_run(1)])


def test_a_model_that_does_not_fit_the_log_is_named() -> None:
    with pytest.raises(InputError, match=r"^first: "):
        compare({"first": boat(), "second": boat()}, [noisy_run(1).without("u", "r")])
