"""The hover study, cut short: the default keeps what it knows, exponential forgetting does not."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

import hover_study


@pytest.mark.parametrize("scheme", hover_study.SCHEMES)
def test_zeros_change_nothing(scheme):
    assert hover_study.zeros_change_nothing(scheme)


def test_what_must_hold_holds_on_plain_regressors():
    courses = {
        scheme: [hover_study.on_regressors(scheme, seed) for seed in (100, 101)] for scheme in hover_study.SCHEMES
    }
    assert hover_study.failures("short", courses) == []
    for kept, lost in zip(courses["directional"], courses["exponential"], strict=True):
        assert kept.at(300.0) < 2.0
        assert lost.at(300.0) > 50.0


def test_failures_are_told():
    t = hover_study.READ
    bad = hover_study.Course(t, np.linspace(0.0, 500.0, t.size), np.linspace(1.0, 1e4, t.size) ** 2, np.full(81, 0.1))
    told = hover_study.failures("short", {"directional": [bad], "exponential": [bad]})
    assert len(told) == 3
