"""Forecasts: the bound of the field for one axis, what learning then states, and what more data can only do."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from towtank import InputError, load_vehicle, simulate
from towtank.core.arrays import Array
from towtank.identification import learn_recordings
from towtank.planning import INSTRUMENTS, RATE, Outlook, design, diagonal, draws_of, forecast
from towtank.planning.forecast import quantity_of
from towtank.simulation import Mocap, OrnsteinUhlenbeck, manoeuvre
from towtank.vehicle import Vehicle

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from bound import surge_bound
from experiments import experiment


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("bluerov2_heavy")


def multisine(vehicle: Vehicle, seconds: float = 8.0) -> Array:
    commands = manoeuvre("all-multisine", vehicle, duration=seconds, dt=1.0 / RATE, seed=1).commands
    assert commands is not None
    return commands


def test_of_one_axis_it_is_the_bound_of_the_field() -> None:
    """Cramer and Rao's, computed another way: the information of a whole record, with the force's covariance."""
    made = experiment("s2-square")
    bound = surge_bound(made)
    outlook = Outlook.of(made.truth, "pose")
    known = outlook.known.only(["X_udot", "X_uu"])
    scale = abs(made.truth.coefficient("X_uu"))
    known = replace(known, covariance=np.diag([1.0, scale**2]) * 1e4)  # nothing is known before
    force = (0.5 / made.truth.mass_matrix[0, 0], *(1e-6,) * 5)
    outlook = replace(outlook, known=known, disturbance=force)
    commands = made.commands[:: round(100.0 / RATE)]
    found = forecast(outlook, made.truth, commands)
    expected = bound.at(made.duration)
    assert made.free == ("X_udot", "X_uu")  # whose bound is that of the total inertia's logarithm
    np.testing.assert_allclose(found.relative(made.free), expected, rtol=0.1)


def test_learning_states_what_was_promised(vehicle: Vehicle) -> None:
    outlook = Outlook.of(vehicle, "pose", force=0.5)
    commands, wanted = multisine(vehicle), diagonal(Outlook.of(vehicle))
    promised = forecast(outlook, vehicle, commands).relative(wanted)
    run = simulate(
        vehicle,
        commands=np.repeat(commands, 4, axis=0),
        dt=0.01,
        sensors=Mocap(),
        disturbance=OrnsteinUhlenbeck(std=(0.5,) * 3 + (0.05,) * 3, time_constant=2.0),
        seed=3,
    )
    learned = {each.name: each for each in learn_recordings(vehicle, [run], free_runs=False).estimate.coefficients}
    size = [
        vehicle.mass_matrix["XYZKMN".index(name[0]), "XYZKMN".index(name[0])]
        if name.endswith("dot")
        else vehicle.coefficient(name)
        for name in wanted
    ]
    stated = np.array([learned[name].std for name in wanted]) / np.abs(size)
    np.testing.assert_array_less(0.75 * promised, stated)
    np.testing.assert_array_less(stated, 1.4 * promised)


def test_data_never_take_knowledge_away(vehicle: Vehicle) -> None:
    outlook = Outlook.of(vehicle, "pose")
    first = forecast(outlook, vehicle, multisine(vehicle))
    second = forecast(outlook.after(first.covariance), vehicle, multisine(vehicle))
    scale = 1.0 / outlook.known.std
    before, after, last = (
        each * np.outer(scale, scale) for each in (outlook.known.covariance, first.covariance, second.covariance)
    )
    assert np.linalg.eigvalsh(before - after)[0] > -1e-9
    assert np.linalg.eigvalsh(after - last)[0] > -1e-6
    assert second.information(diagonal(outlook)) > first.information(diagonal(outlook))


@pytest.mark.parametrize("sensors", INSTRUMENTS)
def test_what_is_measured_less_well_is_known_less_well(vehicle: Vehicle, sensors: str) -> None:
    wanted, commands = diagonal(Outlook.of(vehicle)), multisine(vehicle)
    outlook = Outlook.of(vehicle, sensors)
    coarse = {name: (rate, 3.0 * std) for name, (rate, std) in INSTRUMENTS[sensors].channels.items()}
    worse = replace(outlook, instruments=replace(INSTRUMENTS[sensors], channels=coarse))
    found, less = (forecast(each, vehicle, commands).information(wanted) for each in (outlook, worse))
    assert less < found - 1.0


def test_draws_move_and_brake(vehicle: Vehicle) -> None:
    outlook = Outlook.of(load_vehicle("vlbv300"))
    draws = draws_of(outlook, 12, seed=4)
    assert draws == draws_of(outlook, 12, seed=4)
    rest = np.zeros((50, 6))
    for each in draws:
        run = simulate(each, wrench=rest, dt=0.05, nu0=[0.5, 0.3, 0.2, 0.3, 0.2, 0.5])
        assert np.isfinite(run["u"].values).all()


def test_a_search_finds_more_than_chance_and_the_same_again(vehicle: Vehicle) -> None:
    outlook = Outlook.of(vehicle)
    wanted = diagonal(outlook)
    few, many, again = (design(outlook, wanted, tries=n, draws=2, seed=5) for n in (1, 12, 12))
    assert many.score > few.score
    assert many.segment == again.segment
    assert many.tries == 12


def test_a_damping_that_is_nothing_counts_beside_the_other() -> None:
    vehicle = load_vehicle("vlbv300")
    assert quantity_of(vehicle, "X_u") == pytest.approx(0.3 * abs(vehicle.coefficient("X_uu")))
    assert quantity_of(vehicle, "X_udot") == 1.0
    assert quantity_of(vehicle, "delay") == 1.0


def test_what_is_wrong_is_said(vehicle: Vehicle) -> None:
    with pytest.raises(InputError, match='--sensors: found "sonar"'):
        Outlook.of(vehicle, "sonar")
    with pytest.raises(InputError, match="has no thrusters"):
        Outlook.of(vehicle.model_copy(update={"thrusters": ()}))
    with pytest.raises(InputError, match='--want: "X_uuu" is no unknown'):
        design(Outlook.of(vehicle), ["X_uuu"])
    with pytest.raises(InputError, match="6 to 12 s"):
        design(Outlook.of(vehicle), ["X_uu"], duration=30.0)
