"""Batches: each run is what a single simulation gives."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.simulation import simulate, simulate_batch

from .vessels import table, vessel

RUNS, STEPS = 19, 60  # more than one block of lanes, the last one not full
RNG = np.random.default_rng(3)
WRENCH = RNG.normal(size=(RUNS, STEPS, 6)) * [10, 8, 8, 0.5, 0.5, 1]
ETA0 = RNG.normal(size=(RUNS, 6)) * [1, 1, 1, 0.3, 0.3, 4]
NU0 = RNG.normal(size=(RUNS, 6)) * 0.2
CURRENT = (0.2, -0.1, 0.05)
VEHICLES = [vessel().with_coefficients({"X_uu": -20.0 - k}) for k in range(RUNS)]


def test_every_state_equals_single_runs() -> None:
    batch = simulate_batch(VEHICLES, wrench=WRENCH, eta0=ETA0, nu0=NU0, current=CURRENT, keep="all")
    assert batch.eta.shape == batch.nu.shape == (RUNS, STEPS + 1, 6)
    assert len(batch) == RUNS
    for k in (0, 7, 18):
        run = simulate(VEHICLES[k], wrench=WRENCH[k], eta0=ETA0[k], nu0=NU0[k], current=CURRENT)
        np.testing.assert_allclose(np.hstack([batch.eta[k], batch.nu[k]]), table(run), atol=1e-12)
    np.testing.assert_allclose(batch.t, np.arange(STEPS + 1) * 0.01)


@pytest.mark.parametrize("shared", [True, False])
def test_final_states_are_the_last_of_all(shared: bool) -> None:
    wrench = WRENCH[0] if shared else WRENCH
    settings: dict[str, Any] = {"wrench": wrench, "eta0": ETA0[0] * 0.1, "nu0": NU0, "current": CURRENT}
    final = simulate_batch(VEHICLES, **settings)
    every = simulate_batch(np.array([v.parameters for v in VEHICLES]), **settings, keep="all")
    assert final.eta.shape == (RUNS, 6)
    np.testing.assert_allclose(final.eta, every.eta[:, -1], atol=1e-12)
    np.testing.assert_allclose(final.nu, every.nu[:, -1], atol=1e-12)
    assert float(final.t) == pytest.approx(0.01 * STEPS)


def test_one_vehicle_and_many_wrenches() -> None:
    batch = simulate_batch(vessel(), wrench=WRENCH)
    one = simulate_batch([vessel()], wrench=WRENCH[4])
    np.testing.assert_allclose(batch.nu[4], one.nu[0], atol=1e-14)


@pytest.mark.parametrize(
    "arguments, complaint",
    [
        ({"vehicles": VEHICLES[:3], "wrench": WRENCH}, "do not agree: vehicles 3, wrench 19"),
        ({"vehicles": [], "wrench": WRENCH}, "found shape"),
        ({"vehicles": [vessel(), 1.0], "wrench": WRENCH}, "expected vehicles only"),
        ({"vehicles": np.zeros((2, 147)), "wrench": WRENCH}, r"parameters: found shape \(2, 147\)"),
        ({"vehicles": vessel(), "wrench": np.zeros(6)}, "wrench: found shape"),
        ({"vehicles": vessel(), "wrench": WRENCH, "keep": "some"}, "keep: found"),
    ],
)
def test_wrong_arguments_are_named(arguments: dict[str, Any], complaint: str) -> None:
    vehicles = arguments.pop("vehicles")
    with pytest.raises(InputError, match=complaint):
        simulate_batch(vehicles, **arguments)
