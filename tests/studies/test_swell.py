"""The study of pilots in waves: what it flies, and what it calls right."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from swell_study import AFTER, BEFORE, CASES, OTHER_WATER, Flight, checks, flown, right_steps, sticks

from towtank.recording.event import Event


def test_sticks_rest_and_are_pushed_as_fast_as_a_hand_can() -> None:
    moved = sticks(300.0, (0, 1, 2, 5), np.random.default_rng(1))
    assert np.abs(moved).max() <= 1.0
    assert np.abs(np.diff(moved, axis=0)).max() <= 0.01 / 0.35 + 1e-9
    assert not moved[:, 3:5].any()
    assert 0.2 < np.mean(moved[:, 0] == 0.0) < 0.5


@pytest.mark.parametrize("case", CASES)
def test_the_learner_is_told_of_rigid_body_and_thrusters_alone(case: str) -> None:
    told, run, when = flown(case, 1, minutes=0.5)
    assert not told.hydrodynamics
    assert told.restoring_moment == (0.0, 0.0, 0.0)
    assert ("x" in run) == ("camera" in case)
    assert ("u" in run) == ("dvl" in case)
    changes = case.split()[0] in ("payload", "shifted")
    assert math.isfinite(when) == (changes or case.split()[0] in OTHER_WATER)
    if changes:
        assert BEFORE <= when <= BEFORE + 5.0
        assert run.duration == pytest.approx(when + AFTER, abs=0.02)


@pytest.mark.parametrize(("case", "measured"), [("rising camera", "x"), ("flowing dvl", "u")])
def test_the_water_begins_to_move_when_the_study_says(
    monkeypatch: pytest.MonkeyPatch, case: str, measured: str
) -> None:
    monkeypatch.setattr("swell_study.CALM", (5.0, 8.0))
    _, moving, when = flown(case, 1, minutes=0.5)
    assert 5.0 <= when <= 8.0
    monkeypatch.setattr("swell_study.CALM", (100.0, 100.0))
    _, still, _ = flown(case, 1, minutes=0.5)
    moved = np.abs(moving[measured].values - still[measured].values)
    before = moving[measured].t < when
    assert not moved[before].any()
    assert np.nanmax(moved[~before]) > 1e-3  # m, m/s; waves need five periods to come up


def test_what_must_hold_of_a_case() -> None:
    silent = Flight(1200.0, [], math.inf, "", body=False)
    false = Flight(1200.0, ["37 s: thruster t0: 92 ± 4 % of its thrust"], math.inf, "", body=False)
    assert checks("waves dvl", [silent, silent, false])[0].met  # one in an hour
    assert not checks("waves dvl", [silent, false, false])[0].met
    assert not checks("rising dvl", [silent, silent, false])[1].met  # waves that nobody told
    assert not checks("flowing dvl", [silent, silent, false])[1].met
    noticed = [Flight(150.0, [], after, "", body=after < 5.0, right=1.0) for after in (0.9, 4.9, math.inf)]
    assert [each.value for each in checks("payload dvl", noticed)] == [4.9, pytest.approx(2 / 3), 1.0, 0.0]
    assert [each.met for each in checks("payload dvl", noticed)] == [True, False, True, True]
    assert not checks("payload dvl", [noticed[2], noticed[2], noticed[0]])[0].met


def test_steps_are_right_that_are_within_their_deviations() -> None:
    """A centre of gravity 12 mm ahead: the righting moment's x, and couplings of the mass matrix for a told one."""
    told = {"BG_x": 1.6, "BG_x_std": 0.05, "Y_rdot": -0.15, "Y_rdot_std": 0.01, "X_uu": 1.0, "X_uu_std": 0.1}
    event = Event(1.0, "change", "", {**told, "noticed": 2.0, "gain_t0": 0.5, "gain_t0_std": 0.1})
    assert right_steps("shifted dvl", event) == pytest.approx(2 / 3)
    assert math.isnan(right_steps("shifted dvl", Event(1.0, "change", "", {"noticed": 2.0})))
