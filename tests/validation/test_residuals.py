"""What errors are: cases whose answer is known."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from towtank.simulation import OrnsteinUhlenbeck
from towtank.validation import residuals, validate
from towtank.validation.error_memory import Memory, Samples, memory_of, whiten
from towtank.validation.error_series import error_series
from towtank.validation.residuals import Residual

from .errors import DT, INDEPENDENT, as_prediction, as_series, boat, noisy_run, remembering
from .test_prediction import box, run


def of_u(error: np.ndarray, dt: float = DT, force: np.ndarray | None = None) -> Residual:
    return residuals([as_prediction(error, dt, force)])["u"]


@pytest.mark.parametrize("time", [0.5, 2.0])
@pytest.mark.parametrize("noise", [0.0, 0.3, 2.0])
def test_the_correlation_time_is_found_under_noise(time: float, noise: float) -> None:
    found = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        one = of_u(remembering(rng, 6000, time) + noise * rng.standard_normal(6000))
        assert one.verdict.kind in ("disturbed", "nearly white")
        assert one.time is not None
        found.append(one.time)
        assert one.memory is not None
        assert one.memory.slow == pytest.approx(1.0, rel=0.5)
    assert np.median(found) == pytest.approx(time, rel=0.25)


def test_its_deviation_is_about_right() -> None:
    found = [of_u(remembering(np.random.default_rng(seed), 6000, 2.0)) for seed in range(40)]
    spread = np.std([one.time for one in found])
    assert np.median([one.time_std for one in found]) == pytest.approx(spread, rel=0.6)


@pytest.mark.parametrize("missing", [0.3, 0.8])
def test_missing_samples_change_little(missing: float) -> None:
    rng = np.random.default_rng(5)
    whole = remembering(rng, 8000, 2.0) + 0.1 * rng.standard_normal(8000)
    holed = np.where(rng.random(8000) < missing, np.nan, whole)
    time = of_u(whole).time
    assert time is not None
    assert of_u(holed).time == pytest.approx(time, rel=0.25)
    test = of_u(holed).one_step_test
    assert test is not None
    assert test.p > 1e-3


def test_one_step_errors_of_a_memory_are_white() -> None:
    alarms = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        one = of_u(remembering(rng, 2000, 1.0) + 0.3 * rng.standard_normal(2000))
        assert one.free_test is not None
        assert one.one_step_test is not None
        assert one.free_test.p < 1e-6
        alarms += one.one_step_test.p < 0.05
    assert alarms <= 9  # 3 expected


def test_whitening_is_a_gaussian_likelihood() -> None:
    """Innovations against the Cholesky factor of the covariance that the memory states, at irregular times."""
    rng = np.random.default_rng(7)
    t = np.cumsum(rng.uniform(0.02, 0.4, 60))
    begins = np.zeros(60, dtype=np.int64)
    begins[0] = 2
    memory = Memory(1.3, 0.4, 2.0, 0.5, 0.0, True)
    rows = np.arange(60)
    samples = Samples(t, rng.standard_normal(60), begins, 0 * rows, rows, 0.1)
    columns = rng.standard_normal((60, 3))
    found, deviation = whiten(samples, columns, memory)
    covariance = memory.covariance(np.abs(t[:, None] - t)) + 0.25 * np.eye(60)
    L = np.linalg.cholesky(covariance)
    assert np.allclose(found, np.linalg.solve(L, columns), atol=1e-8)
    assert np.allclose(deviation, np.diag(L), atol=1e-8)


def test_a_right_model_leaves_white_errors() -> None:
    kinds: Counter[str] = Counter()
    alarms = 0
    for seed in range(40):
        log = noisy_run(seed, missing=0.3 * (seed % 2))
        for one in residuals(validate(boat(), [log]).predictions).values():
            kinds[one.verdict.kind] += 1
            assert one.free_test is not None
            alarms += one.free_test.p < 0.05
            if one.verdict.kind == "white":
                assert "as white as the sensor's noise" in one.verdict.text
                assert one.time is None
    assert kinds["white"] >= 76
    assert kinds["follows the command"] <= 3
    assert alarms <= 12  # 4 expected; a prediction starts from a noisy sample


@pytest.mark.parametrize("time", [0.3, 2.0])
def test_a_disturbance_is_one(time: float) -> None:
    """It shows as an error with a memory a little longer than its own, by the lag of the vehicle."""
    disturbance = OrnsteinUhlenbeck(std=INDEPENDENT, time_constant=time)
    kinds: Counter[str] = Counter()
    times, traces = [], 0
    for seed in range(30):
        log = noisy_run(seed, noise=0.01, disturbance=disturbance)
        for one in residuals(validate(boat(), [log]).predictions).values():
            kinds[one.verdict.kind] += 1
            times.append(one.time or 0.0)
            assert one.command is not None
            traces += one.command.p < 0.05
    assert kinds["disturbed"] >= 56
    assert traces <= 9  # 3 expected
    assert 0.7 * time < np.median(times) < 1.3 * (time + 0.8)


@pytest.mark.parametrize("disturbed", [False, True])
def test_a_wrong_drag_follows_the_command(disturbed: bool) -> None:
    disturbance = OrnsteinUhlenbeck(std=INDEPENDENT, time_constant=2.0) if disturbed else None
    wrong = boat(X_uu=-45.0, N_rr=-3.0)
    kinds: Counter[str] = Counter()
    for seed in range(10):
        log = noisy_run(seed, disturbance=disturbance)
        for one in residuals(validate(wrong, [log]).predictions).values():
            kinds[one.verdict.kind] += 1
            if one.verdict.kind == "follows the command":
                assert "the model lacks something" in one.verdict.text
                assert one.command is not None
                assert one.command.share > 0.1
    assert kinds["follows the command"] >= 15


def test_cross_correlation_stands_out_where_it_should() -> None:
    rng = np.random.default_rng(1)
    force = np.repeat(rng.choice([-1.0, 1.0], 60), 50)
    echo = np.roll(force, 20)
    echo[:20] = 0.0
    one = of_u(0.5 * echo + remembering(rng, 3000, 0.5), force=force)
    assert one.command is not None
    lag, correlation = one.command.strongest
    assert lag == pytest.approx(1.0, abs=0.3)
    assert correlation > one.command.band[0]
    assert one.command.p < 1e-3
    alone = of_u(remembering(rng, 3000, 0.5), force=force)
    assert alone.command is not None
    assert np.mean(np.abs(alone.command.correlation) > alone.command.band) < 0.3


def test_restarts_do_not_mix_with_the_memory() -> None:
    log = noisy_run(3, noise=0.005, disturbance=OrnsteinUhlenbeck(std=INDEPENDENT, time_constant=2.0))
    free = residuals(validate(boat(), [log]).predictions)["u"]
    short = residuals(validate(boat(), [log], horizon=4.0).predictions)["u"]
    assert short.verdict.kind == "disturbed"
    assert short.time == pytest.approx(free.time, rel=0.6)
    series = error_series(validate(boat(), [log], horizon=4.0).predictions, "u")
    assert series is not None
    assert len(series.stretches) == 15
    assert sum(stretch.t.size for stretch in series.stretches) == len(log["u"])


def test_several_recordings_are_judged_together() -> None:
    predictions = validate(boat(), [noisy_run(1), noisy_run(2, seconds=30.0)]).predictions
    one = residuals(predictions)["r"]
    assert one.samples == 1201 + 601
    assert one.verdict.kind == "white"


def test_a_drift_is_said_to_be_one() -> None:
    found = [of_u(np.cumsum(np.random.default_rng(seed).standard_normal(2000))).verdict.kind for seed in range(10)]
    assert found.count("drifting") >= 7


def test_a_constant_error_is_said() -> None:
    text = of_u(0.4 + 0.01 * np.random.default_rng(1).standard_normal(500)).verdict.text
    assert "about a constant +0.4 m/s" in text


def test_what_cannot_be_judged() -> None:
    assert of_u(0.1 * np.random.default_rng(1).standard_normal(25)).verdict.kind == "unknown"
    broken = np.zeros(200)
    broken[100:] = np.inf
    assert of_u(broken).verdict.kind == "diverged"
    exact = residuals(validate(box(), [run(500)]).predictions)
    assert {one.verdict.kind for one in exact.values()} == {"none"}
    assert set(exact) == {"u", "v", "w", "p", "q", "r", "x", "y", "z", "phi", "theta", "psi"}


def test_positions_are_held_against_the_force_along_them() -> None:
    """A vehicle that heads east: a fault in surge shows in y, and so does the surge command."""
    wrench = np.zeros((2000, 6))
    wrench[:, 0] = 20.0 * np.sign(np.sin(0.9 * 0.01 * np.arange(2000)))
    from towtank.simulation import simulate

    log = simulate(boat(), wrench=wrench, dt=0.01, eta0=(0, 0, 0, 0, 0, np.pi / 2))
    series = error_series(validate(boat(), [log]).predictions, "y")
    assert series is not None
    assert np.abs(series.stretches[0].wrench).max() == pytest.approx(20.0, abs=1e-6)
    north = error_series(validate(boat(), [log]).predictions, "x")
    assert north is not None
    assert np.abs(north.stretches[0].wrench).max() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("horizon", [DT, 0.2])
def test_horizons_of_a_few_samples(horizon: float) -> None:
    found = residuals(validate(boat(), [noisy_run(1, seconds=20.0)], horizon=horizon).predictions)
    assert all(one.verdict.kind != "diverged" for one in found.values())


def test_the_memory_of_pure_noise_is_not_believed() -> None:
    believed = 0
    for seed in range(40):
        _, memory = memory_of(as_series(np.random.default_rng(seed).standard_normal(800)))
        assert memory is not None
        believed += memory.believable
    assert believed <= 2
