"""Cross-validation: windows that cover everything once, honest fits, and a jackknife that checks what is claimed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from towtank.errors import InputError
from towtank.identification import Estimate
from towtank.recording import Recording
from towtank.validation import cross_validate, validate
from towtank.validation.cross_validation import split
from towtank.vehicle import Vehicle

from .errors import boat, noisy_run


def counted(seconds: float, start: float = 0.0) -> Recording:
    t = start + np.arange(round(seconds * 10) + 1) / 10
    return Recording.from_table(t, {"u": np.sin(t), "X": np.cos(t)})


@given(
    lengths=st.lists(st.floats(2.0, 40.0), min_size=1, max_size=4),
    windows=st.integers(2, 6),
    start=st.floats(-100.0, 1e6),
)
@settings(max_examples=40, deadline=None)
def test_every_sample_is_left_out_at_most_once(lengths: list[float], windows: int, start: float) -> None:
    recordings = [counted(round(length, 1), round(start, 1)) for length in lengths]
    total = sum(recording.duration for recording in recordings)
    if total / windows < 1.0:
        return
    found = split(recordings, windows)
    assert len(found) == windows
    samples = sum(len(recording["u"]) for recording in recordings)
    left_out = 0
    for one in found:
        out = sum(len(recording["u"]) for recording in one.left_out)
        kept = sum(len(recording["u"]) for recording in one.kept)
        left_out += out
        assert out + kept <= samples
        for k, first, last in one.windows:
            assert recordings[k].start <= first < last <= recordings[k].end
    assert left_out <= samples
    assert left_out >= samples - 11 * 2 * len(lengths) * windows


def test_windows_of_one_recording() -> None:
    found = split([counted(10.0, 5.0)], 5)
    assert [one.windows for one in found] == [
        ((0, pytest.approx(5.0 + 2 * k), pytest.approx(7.0 + 2 * k)),) for k in range(5)
    ]
    assert sum(len(one.left_out[0]["u"]) for one in found) == 101
    assert [len(one.kept) for one in found] == [1, 2, 2, 2, 1]
    assert all(kept["X"].t[0] == pytest.approx(kept.start) for one in found for kept in one.kept)


@dataclass(frozen=True)
class Told:
    """A learning that says what it is told."""

    estimate: Estimate
    model: Vehicle


def mean_of_u(vehicle: Vehicle, recordings: Sequence[Recording]) -> Told:
    """Learn "X_u" as a mean of independent samples, with the deviation that a mean has."""
    values = np.concatenate([recording["u"].values for recording in recordings])
    n = values.size
    estimate = Estimate(
        names=("X_u", "X_uu"),
        values=np.array([values.mean(), -30.0]),
        std=np.array([values.std() / np.sqrt(n), np.nan]),
        covariance=np.diag([values.var() / n, np.nan]),
        identified=(True, False),
        reasons=(None, "held"),
        sums=(),
        axes=(),
        duration=1.0,
        samples=n,
    )
    return Told(estimate, vehicle)


def boastful(vehicle: Vehicle, recordings: Sequence[Recording]) -> Told:
    told = mean_of_u(vehicle, recordings)
    return replace(told, estimate=replace(told.estimate, std=0.2 * told.estimate.std))


def noise(seed: int) -> Recording:
    t = np.arange(1001) / 10
    values = np.random.default_rng(seed).standard_normal(1001)
    return Recording.from_table(t, {"u": values, "X": np.ones(1001)})


def test_the_jackknife_is_the_deviation_of_a_mean() -> None:
    ratios, alarms = [], 0
    for seed in range(60):
        (one,) = cross_validate(boat(), [noise(seed)], windows=8, learn=mean_of_u).coefficients
        assert one.name == "X_u"
        assert one.values.shape == (8,)
        ratios.append(one.spread / one.claimed)
        alarms += one.overconfident
    assert np.sqrt(np.mean(np.square(ratios))) == pytest.approx(1.0, abs=0.15)
    assert alarms <= 3


def test_a_claim_too_good_is_found() -> None:
    found = [cross_validate(boat(), [noise(seed)], windows=8, learn=boastful).coefficients[0] for seed in range(10)]
    assert sum(one.overconfident for one in found) >= 9


def test_learning_in_turn() -> None:
    told = []

    def learn(vehicle: Vehicle, recordings: Sequence[Recording]) -> Told:
        return Told(mean_of_u(vehicle, recordings).estimate, boat(X_u=-10.0 - len(told)))

    found = cross_validate(
        boat(), [noisy_run(1)], windows=4, learn=learn, progress=lambda text, share: told.append((text, share))
    )
    assert [text for text, _ in told][:3] == ["learning on everything", "learning without window 1 of 4", told[2][0]]
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert len(found.folds) == 4
    assert len(found.scores.predictions) == 4
    assert found.scores.fit["v"] is None
    for fold in found.folds:
        ((k, start, end),) = fold.windows
        assert k == 0
        assert fold.fit["u"] == pytest.approx(
            validate(fold.model, [noisy_run(1)], window=(start, float(np.nextafter(end, start)))).fit["u"], abs=0.5
        )
    assert found.seen.fit["u"] > found.scores.fit["u"]  # type: ignore[operator]


def unchanged(vehicle: Vehicle, recordings: Sequence[Recording]) -> Told:
    return Told(mean_of_u(vehicle, [noise(1)]).estimate, vehicle)


def test_a_window_that_cannot_be_predicted_is_noted() -> None:
    log = noisy_run(1)
    dark = log.replace([type(log[c])(c, log[c].t[:700], log[c].values[:700], log[c].unit, log[c].frame) for c in "ur"])
    found = cross_validate(boat(), [dark], windows=4, learn=unchanged)
    assert found.folds[3].fit["u"] is None
    assert found.folds[3].note
    assert found.folds[0].note == ""


@pytest.mark.parametrize("windows, expected", [(1, "2 windows or more"), (0, "2 windows"), (100, "use fewer")])
def test_windows_that_are_none(windows: int, expected: str) -> None:
    with pytest.raises(InputError, match=expected):
        cross_validate(boat(), [noisy_run(1)], windows=windows, learn=mean_of_u)


def test_no_recording() -> None:
    with pytest.raises(InputError, match="at least one"):
        cross_validate(boat(), [], learn=mean_of_u)


def test_what_cannot_be_learned_names_the_window() -> None:
    calls = []

    def fails(vehicle: Vehicle, recordings: Sequence[Recording]) -> Told:
        calls.append(recordings)
        if len(calls) > 2:
            raise InputError("nothing moves")
        return mean_of_u(vehicle, recordings)

    with pytest.raises(InputError, match=r"without window 2 of 3 \(20 to 40 s\): nothing moves"):
        cross_validate(boat(), [noisy_run(1)], windows=3, learn=fails)
