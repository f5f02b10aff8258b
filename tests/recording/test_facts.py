"""What is said of each channel of a recording."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.recording import Recording
from towtank.recording.facts import channel_facts


def test_a_measured_channel_has_a_rate_a_span_holes_and_a_range() -> None:
    t = np.arange(200) / 10.0
    keep = np.ones(200, dtype=np.bool_)
    keep[[20, 50, 51]] = False  # short holes
    keep[100:120] = False  # a gap
    u = np.where(np.arange(200) == 150, np.nan, np.sin(t))  # a sample that is not there
    [facts] = channel_facts(Recording.from_table(t[keep], {"u": u[keep]}))
    assert (facts.name, facts.unit, facts.frame) == ("u", "m/s", "FRD")
    assert facts.rate_hz == pytest.approx(10.0)
    assert (facts.samples, facts.missing, facts.gaps) == (200 - 24, 24, 1)
    assert (facts.start_s, facts.end_s) == (0.0, pytest.approx(19.9))
    assert facts.longest_gap_s == pytest.approx(2.1)
    assert (facts.min, facts.max) == (np.nanmin(u[keep]), np.nanmax(u[keep]))
    assert facts.changes is None


def test_an_input_holds_and_is_told_by_how_often_it_changes() -> None:
    t = np.array([0.0, 1.0, 2.0, 3.0, 30.0, 31.0])
    [facts] = channel_facts(Recording.from_table(t, {"cmd_1": np.array([1.0, 1.0, 2.0, 2.0, 3.0, 3.0])}))
    assert (facts.missing, facts.gaps, facts.longest_gap_s, facts.changes) == (0, 0, None, 2)


def test_one_sample_alone_has_no_holes_and_a_channel_without_values_is_left_out() -> None:
    t = np.array([0.0, 1.0])
    [facts] = channel_facts(Recording.from_table(t, {"u": np.array([np.nan, 2.0]), "v": np.full(2, np.nan)}))
    assert (facts.name, facts.samples, facts.missing, facts.gaps, facts.longest_gap_s) == ("u", 1, 0, 0, None)


def test_two_samples_have_nothing_between_them() -> None:
    [facts] = channel_facts(Recording.from_table(np.array([0.0, 5.0]), {"u": np.array([1.0, 2.0])}))
    assert (facts.samples, facts.missing) == (2, 0)
