"""Runs that nobody steers: exact as the simulator, counted by touches, and the tank that would hold them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from towtank import load_vehicle, simulate
from towtank.planning import RATE, Outlook, Segment, Space, Unsteered, draws_of, unsteered
from towtank.planning.segments import commands_of

SEGMENT = Segment(
    "telegraph", 6.0, (0, 1, 2), (20.0, 15.0, 15.0), ((2.0, 4.0), (3.0,), (5.0,)), ((1.0,), (-1.0,), (1.0,))
)


def test_each_run_is_the_simulators() -> None:
    """Delay, lags and the thrust that is lost to inflow are in it."""
    outlook = replace(Outlook.of(load_vehicle("bluerov2_heavy")), disturbance=(0.0,) * 6)
    space = Space.from_text("5x5x2.5")
    found = unsteered(outlook, [SEGMENT], space, vehicles=3, forces=1, seed=5)
    for k, truth in enumerate(draws_of(outlook, 3, 5)):
        run = simulate(
            truth, commands=commands_of(SEGMENT, outlook.vehicle), dt=1.0 / RATE, substeps=2, eta0=space.eta0
        )
        there = np.column_stack([run[name].values for name in "xyz"])
        np.testing.assert_allclose(found.paths[0][k], there, atol=1e-9)


def test_forces_differ_from_run_to_run_and_the_seed_repeats_them() -> None:
    outlook = Outlook.of(load_vehicle("bluerov2_heavy"))
    first, again, other = (unsteered(outlook, [SEGMENT], None, vehicles=2, forces=2, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.paths[0], again.paths[0])
    ends = first.paths[0][:, -1]
    assert np.linalg.norm(ends[0] - ends[1]) > 0.01
    assert not np.allclose(first.paths[0], other.paths[0])
    assert first.left.shape == (1, 4)
    assert first.leaves == (0.0,)
    assert first.whole == 0.0


def test_touches_are_counted_for_each_segment_and_for_the_whole() -> None:
    space = Space.from_text("4x4x2")
    still = np.tile([0.0, 0.0, 1.0], (5, 1))
    away = still + np.linspace(0.0, 2.0, 5)[:, None] * np.array([1.0, 0.0, 0.0])
    lost = np.where(np.arange(5)[:, None] > 2, np.nan, still)
    found = Unsteered((np.array([still, still, away, still]), np.array([away, still, away, lost])), space, 0.5)
    assert found.leaves == (0.25, 0.75)
    assert found.whole == 0.75


def test_the_tank_that_holds_them_is_as_large_as_they_go() -> None:
    away = np.zeros((100, 3, 3))
    away[:, 1, 0] = np.linspace(0.01, 1.0, 100)
    away[:, 2, 1] = -np.linspace(2.0, 0.02, 100)
    found = Unsteered((away,), None, 0.25)
    x, y, z = found.room(0.9)
    assert x == pytest.approx(2.0 * (0.95 + 0.25))  # five at either end stay out
    assert y == pytest.approx(2.0 * (1.9 + 0.25), abs=0.03)
    assert z == pytest.approx(0.5)
    inside = (np.abs(away) <= 0.5 * np.array(found.room(0.9)) - 0.25 + 1e-9).all(axis=(1, 2))
    assert inside.mean() >= 0.9
    away[:10] = np.nan
    assert np.isinf(found.room(0.95)).any()
