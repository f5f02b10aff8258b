"""Wherever a vehicle is taken, its name in the catalog or the path of its file is taken as well."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import towtank as tt
from towtank.errors import InputError
from towtank.simulation import manoeuvre
from towtank.validation import validate
from towtank.vehicle import allocate, catalog_names, vehicle_of


@pytest.fixture(params=["name", "path", "text"])
def named(request: pytest.FixtureRequest, tmp_path: Path) -> Any:
    if request.param == "name":
        return "seamor"
    tt.save_vehicle("seamor", tmp_path / "mine.toml")
    return tmp_path / "mine.toml" if request.param == "path" else str(tmp_path / "mine.toml")


def test_dynamics(named: Any) -> None:
    vehicle, rng = tt.load_vehicle("seamor"), np.random.default_rng(0)
    eta, nu, tau = rng.normal(size=(3, 5, 6))
    commands = rng.normal(size=(5, len(vehicle.thrusters)))
    assert np.array_equal(allocate(named, tau), allocate(vehicle, tau))
    plans = [manoeuvre("surge-sine", each, duration=2.0).commands for each in (named, vehicle)]
    assert np.array_equal(*plans)
    assert np.array_equal(tt.forward_dynamics(named, eta, nu, tau), tt.forward_dynamics(vehicle, eta, nu, tau))
    assert np.array_equal(tt.inverse_dynamics(named, eta, nu, tau), tt.inverse_dynamics(vehicle, eta, nu, tau))
    assert np.array_equal(tt.thruster_wrench(named, commands), tt.thruster_wrench(vehicle, commands))


def test_simulation(named: Any) -> None:
    vehicle, wrench = tt.load_vehicle("seamor"), np.full((50, 6), 2.0)
    assert tt.simulate(named, wrench=wrench) == tt.simulate(vehicle, wrench=wrench)
    changed = tt.simulate(named, wrench=wrench, changes=[(0.2, "vlbv300")])
    assert changed == tt.simulate(vehicle, wrench=wrench, changes=[(0.2, tt.load_vehicle("vlbv300"))])
    assert np.array_equal(
        tt.simulate_batch([named, "vlbv300"], wrench=wrench).nu,
        tt.simulate_batch([vehicle, tt.load_vehicle("vlbv300")], wrench=wrench).nu,
    )
    assert np.array_equal(tt.simulate_batch(named, wrench=wrench).nu, tt.simulate_batch(vehicle, wrench=wrench).nu)


def test_learning_and_judging(named: Any) -> None:
    vehicle = tt.load_vehicle("seamor")
    run = tt.simulate(vehicle, wrench=np.tile([[20.0, 0, 0, 0, 0, 0]], (200, 1)))
    for method in ("joint", "paper"):
        assert tt.Learner(named, method=method).vehicle == vehicle
    assert validate(named, [run]).fit == validate(vehicle, [run]).fit
    prior = tt.learn(run, named, method="paper", free="X_udot,X_uu").model
    assert tt.Learner(named, prior=prior, known={"other": "vlbv300"}).vehicle == vehicle


def test_what_is_no_vehicle_is_refused() -> None:
    for wrong, said in ((3, "found 3"), (None, "found nothing"), ("seamr", 'did you mean "seamor"')):
        with pytest.raises(InputError, match=said):
            vehicle_of(wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="vehicles only"):
        tt.simulate_batch(["seamor", 3], wrench=np.zeros((5, 6)))  # type: ignore[list-item]


@pytest.mark.filterwarnings("ignore::towtank.vehicle.VehicleWarning")
@pytest.mark.parametrize("name", catalog_names())
def test_a_vehicle_shows_itself_in_one_line_and_as_a_table(name: str) -> None:
    vehicle = tt.load_vehicle(name)
    assert len(repr(vehicle)) < 120
    assert repr(vehicle).startswith(f"<Vehicle {name}: ")
    html = vehicle._repr_html_()
    assert all(f">{coefficient}</td>" in html for coefficient in vehicle.hydrodynamics)
