"""Held commands: values in force and exact interval means under a delay."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from towtank.recording import held_at, held_mean, standard_channel
from towtank.recording.grids.grid import stack_held

STAMPS = np.array([0.0, 0.25, 1.0])
VALUES = np.array([[1.0, 10.0], [2.0, 20.0], [-3.0, -30.0]])


def test_each_value_holds_until_the_next() -> None:
    at = np.array([-0.1, 0.0, 0.2, 0.25, 0.9, 1.0, 9.0])
    assert np.array_equal(held_at(STAMPS, VALUES, at)[:, 0], [np.nan, 1, 1, 2, 2, -3, -3], equal_nan=True)
    assert np.array_equal(held_at(STAMPS, VALUES, at, 0.1)[:, 0], [np.nan, np.nan, 1, 1, 2, 2, -3], equal_nan=True)
    assert held_at(np.empty(0), np.empty((0, 2)), at).shape == (7, 2)


def test_means_by_hand() -> None:
    t = np.array([0.0, 0.5, 1.5, 2.0])
    assert np.allclose(held_mean(STAMPS, VALUES, t, 0.0)[:, 0], [1.5, 2 * 0.5 - 3 * 0.5, -3])
    late = held_mean(STAMPS, VALUES, t, 0.25)
    assert np.isnan(late[0]).all()
    assert np.allclose(late[1:, 1], [20 * 0.75 - 30 * 0.25, -30])
    assert held_mean(STAMPS, VALUES, t[:1], 0.0).shape == (0, 2)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(0, 300), min_size=1, max_size=20, unique=True).map(sorted),
    st.lists(st.integers(0, 400), min_size=2, max_size=20, unique=True).map(sorted),
    st.integers(0, 30),
    st.integers(0, 2**32 - 1),
)
def test_means_equal_the_integral(stamps: list[int], times: list[int], delay: int, seed: int) -> None:
    """All times are multiples of 1/128 s, where a sum over fine steps is the integral."""
    values = np.random.default_rng(seed).normal(size=(len(stamps), 2))
    t_command, t = np.array(stamps) / 128, np.array(times) / 128
    found = held_mean(t_command, values, t, delay / 128)
    fine = held_at(t_command, values, (np.arange(0, 400) + 0.5) / 128, delay / 128)
    expected = np.array([fine[a:b].mean(axis=0) for a, b in pairwise(times)])
    assert np.allclose(found, expected, atol=1e-12, equal_nan=True)


def test_a_command_on_the_grid_is_returned_exactly() -> None:
    t = 1.7e9 + np.arange(1001) / 100
    values = np.random.default_rng(3).normal(size=(1000, 3))
    assert np.array_equal(held_mean(t[:-1], values, t, 0.0), values)
    assert np.array_equal(held_at(t[:-1], values, t)[:-1], values)


def test_commands_of_several_stamps_stack() -> None:
    a = standard_channel("cmd_a", [0.0, 1.0], [1.0, 2.0])
    b = standard_channel("cmd_b", [0.5, 0.75, 1.0], [5.0, np.nan, 6.0])
    t, values = stack_held([a, b])
    assert np.array_equal(t, [0, 0.5, 1])
    assert np.array_equal(values, [[1, np.nan], [1, 5], [2, 6]], equal_nan=True)
    assert stack_held([])[0].size == 0
