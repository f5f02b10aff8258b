"""Learning from whole recordings by the joint filter, with free runs as the second judge; and input that is odd."""

from __future__ import annotations

import contextlib
from typing import Any

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.identification import LogLearning, learn_recordings
from towtank.identification.data.samples import N_MEASURED, samples_of
from towtank.identification.simulation_error.cross_validation import columns_of, error_reduction
from towtank.recording import Channel, Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, simulate
from towtank.vehicle import Coefficient

from .runs import TRUTH, box, unknown, waves

FREE = ("X_udot", "X_uu")
TANK = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05))


def run(seconds: float, seed: int = 0, *, push: float = 25.0, period: float = 1.2, **more: Any) -> Recording:
    wrench = waves(round(100 * seconds), 0.01, (0, push, period), square=True)
    return simulate(box(), wrench=wrench, **{"sensors": Mocap(), "seed": seed, **more})


def learn(*recordings: Recording, **more: Any) -> LogLearning:
    return learn_recordings(unknown(box(), **TRUTH), recordings, **{"delay": 0.0, **more})


def test_with_a_random_force_the_filter_is_kept() -> None:
    for seed in range(3):
        learning = learn(run(20.0, seed, disturbance=TANK), free=FREE)
        assert learning.method == "joint"
        assert any(f"free: {', '.join(FREE)}" in text for text in learning.remarks)
        for name in FREE:
            found = learning.estimate[name]
            assert abs(found.value - TRUTH[name]) < 4.0 * found.std


def test_with_noise_alone_either_judge_is_near_the_truth() -> None:
    learning = learn(run(10.0), free=FREE)
    for name in FREE:
        assert learning.estimate[name].value == pytest.approx(TRUTH[name], rel=0.02)


def test_output_error_where_it_is_asked_for() -> None:
    learning = learn(run(10.0, disturbance=TANK), free=FREE, method="output-error")
    assert learning.method == "output-error"
    assert any("free runs" in text for text in learning.remarks)


def test_the_outcome_says_what_it_found_besides_coefficients() -> None:
    learning = learn(run(10.0), free=FREE)
    assert learning.delay == 0.0
    assert np.isnan(learning.delay_std)
    assert np.isnan(learning.lag)
    assert learning.levels is not None
    assert learning.levels.noise[0] == pytest.approx(1e-3, rel=0.3)
    assert learning.remarks


def test_a_prior_is_taken_in() -> None:
    known = unknown(box(), **TRUTH).with_coefficients({"X_udot": Coefficient(value=-10.0, std=0.01, unit="kg")})
    learning = learn(run(4.0, disturbance=TANK), free=FREE, prior=known)
    assert learning.estimate["X_udot"].value == pytest.approx(-10.0, abs=0.05)
    assert learning.estimate["X_udot"].std <= 0.011


def test_couplings_may_be_asked_for() -> None:
    wrench = waves(2000, 0.01, (1, 25.0, 1.2), (5, 3.0, 0.9), square=True)
    log = simulate(box(), wrench=wrench, sensors=Mocap())
    learning = learn(log, free=("Y_vdot", "Y_vv", "N_rdot", "N_rr", "Y_rdot", "N_v"))
    for name in ("Y_rdot", "N_v"):
        assert abs(learning.estimate[name].value) < 4.0 * learning.estimate[name].std + 0.05


def test_progress_does_not_go_back() -> None:
    told: list[float] = []
    learn(run(8.0), progress=lambda text, share: told.append(share))
    assert told == sorted(told)
    assert told[-1] <= 1.0


# -- input that is odd


def blank(log: Recording, name: str) -> Recording:
    old = log[name]
    return log.replace([Channel(name, old.t, np.full(old.t.size, np.nan), old.unit, old.frame)])


@pytest.mark.parametrize("method", ["joint", "output-error"])
@pytest.mark.parametrize("seconds", [0.5, 1.0, 2.0])
def test_a_very_short_log_gives_an_estimate_or_says_why_not(seconds: float, method: str) -> None:
    log = run(2.0).window(0.0, seconds)
    with contextlib.suppress(InputError):
        learning = learn(log, method=method)
        assert all(c.identified == (c.reason is None) for c in learning.estimate.coefficients)


def test_what_cannot_be_learned_from_is_refused_in_one_line() -> None:
    log = run(3.0)
    for bad, words in (
        ([], "at least one"),
        ([log.without(*"XYZKMN")], "nothing to learn from"),
        ([log.without("x", "y", "z", "phi", "theta", "psi")], "no motion"),
    ):
        with pytest.raises(InputError, match=words):
            learn(*bad)


def test_a_channel_without_any_value_is_as_if_it_were_not_there() -> None:
    log = run(8.0, sensors="perfect")
    learning = learn(blank(log, "v"), free=FREE)
    assert learning.estimate["X_udot"].value == pytest.approx(-10.0, rel=0.02)


@pytest.mark.parametrize("push", [0.0, 10.0], ids=["no command", "one constant command"])
def test_commands_that_never_change(push: float) -> None:
    wrench = np.zeros((1000, 6))
    wrench[:, 0] = push
    learning = learn(simulate(box(), wrench=wrench, sensors=Mocap()), delay=None)
    for c in learning.estimate.coefficients:
        assert c.identified == (c.reason is None)
        assert np.isfinite(c.value)
        assert c.std > 0.0
    for name in ("K_pp", "M_qq", "N_rr"):  # it did not turn
        assert not learning.estimate[name].identified


# -- comparing free runs


def test_the_error_reduction_is_a_share_of_the_square_error_and_no_window_alone_decides() -> None:
    rng = np.random.default_rng(0)
    old = np.full((12, N_MEASURED), np.nan)
    old[:, 6] = 1.0 + 0.2 * rng.random(12)
    half = error_reduction(0.5 * old, old, (0, 6))
    assert half.mean == pytest.approx(0.47, abs=0.03)
    assert half.beyond(2.0, 0.05)
    assert not error_reduction(old, old, (0, 6)).beyond(2.0, 0.05)
    one = 0.9 * old
    one[3] = np.inf
    assert -0.3 < error_reduction(one, old, (0, 6)).mean < 0.1
    lost = np.full((12, N_MEASURED), np.inf)
    assert error_reduction(lost, old, (6,)).mean == -np.inf
    assert error_reduction(old, lost, (6,)).mean == np.inf


def test_columns_that_tell_of_coefficients() -> None:
    assert columns_of(("X_udot", "delay", "lag", "gain_left")) == (0, 6, 15)
    assert columns_of(("BG_z", "N_r")) == (3, 4, 5, 9, 10, 11)
    assert columns_of(("W_minus_B",)) == (2, 8, 17)


def test_recordings_stay_as_they_are() -> None:
    log = run(6.0)
    before = samples_of(log, box()).values.copy()
    learn(log)
    assert np.array_equal(samples_of(log, box()).values, before, equal_nan=True)


def test_gyro_and_depth_tell_what_they_tell_and_are_right() -> None:
    """Sway and heave show in how they turn the vehicle; nothing of the speeds themselves is measured."""
    vehicle = box()
    wrench = waves(2000, 0.02, (0, 15.0, 0.5), (5, 1.0, 0.4), square=True)
    force = OrnsteinUhlenbeck(std=(0.3, 0.3, 0.3, 0.02, 0.02, 0.02), time_constant=2.0)
    run = simulate(vehicle, wrench=wrench, dt=0.02, sensors=Ins(), disturbance=force, seed=1)
    run = run.without("phi", "theta", "psi", "u", "v", "w", "ax", "ay", "az")
    learning = learn_recordings(unknown(vehicle), [run])
    off = {c.name: abs(c.value - vehicle.coefficient(c.name)) / c.std for c in learning.estimate.coefficients}
    assert {name: round(each, 1) for name, each in off.items() if each > 4.0} == {}
    assert np.mean(np.array(list(off.values())) < 1.96) > 0.85
    for name in ("N_rdot", "N_rr"):
        assert learning.estimate[name].identified
    for name in ("K_0", "M_0"):
        found = learning.estimate[name]
        assert not found.identified
        assert "of the prior's deviation" in str(found.reason)
    assert learning.current is None  # nothing is measured over ground
