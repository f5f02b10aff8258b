"""Manoeuvres: one axis moves and the others do not; the vehicle stays upright and near; the paper's runs as printed."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.recording import Recording
from towtank.simulation import AXES, FORMS, MANOEUVRES, manoeuvre, manoeuvre_from_recording, simulate, usual_amplitudes
from towtank.vehicle import Vehicle, allocatable_axes, load_vehicle, thruster_wrench

from .vessels import table, vessel


def loaded(name: str) -> Vehicle:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return load_vehicle(name)


def test_registry() -> None:
    assert {f"{axis}-{form}" for axis in (*AXES, "all") for form in FORMS} <= set(MANOEUVRES)
    assert {"tank-session", "paper-stairs", "paper-square"} <= set(MANOEUVRES)
    assert all(m.description and "\n" not in m.description for m in MANOEUVRES.values())


@pytest.mark.parametrize("name", sorted(MANOEUVRES))
def test_every_manoeuvre_runs(name: str) -> None:
    for vehicle in (vessel(), vessel(thrusters=())):
        found = manoeuvre(name, vehicle, duration=10.0)
        assert found.wrench.shape == (1000, 6)
        assert np.isfinite(found.wrench).all()
        assert found.wrench.any()
        assert (found.commands is None) == (not vehicle.thrusters)
        assert not found.wrench.flags.writeable


@pytest.mark.parametrize("axis", ["surge", "sway", "heave", "roll", "yaw"])
@pytest.mark.parametrize("vehicle", ["vlbv300", "bluerov2_heavy"])
def test_the_other_axes_stay_at_zero(axis: str, vehicle: str) -> None:
    """What the thrusters can set, they set: a sway test does not yaw."""
    rov, row = loaded(vehicle), AXES.index(axis)
    found = manoeuvre(f"{axis}-square", rov, duration=10.0).wrench
    largest = np.abs(found[:, row]).max()
    assert largest == pytest.approx(usual_amplitudes(rov)[row], rel=1e-3)
    others = [other for other in allocatable_axes(rov) if other != row]
    assert np.abs(found[:, others]).max() < 2e-3 * largest


def test_amplitude() -> None:
    found = manoeuvre("sway-square", vessel(), amplitude=5.0).wrench
    assert np.abs(found[:, 1]).max() == pytest.approx(5.0, rel=1e-9)
    sizes = np.array([5.0, 4.0, 3.0, 0.3, 0.0, 0.2])
    many = manoeuvre("all-square", vessel(), amplitude=sizes).wrench
    np.testing.assert_allclose(np.abs(many).max(axis=0)[[0, 1, 2, 3, 5]], sizes[[0, 1, 2, 3, 5]], atol=0.2)
    with pytest.raises(InputError, match="one number for several axes"):
        manoeuvre("all-square", vessel(), amplitude=5.0)


def test_pitch_through_surge_and_heave() -> None:
    found = manoeuvre("pitch-square", loaded("vlbv300")).wrench
    assert np.abs(found[:, [0, 2]]).max(axis=0).min() > 5.0
    assert np.abs(found[:, 4]).max() > 0.5  # the horizontal thrusters lie below the origin
    with pytest.raises(InputError, match=r"cannot command sway; they can command surge, yaw"):
        manoeuvre("sway-sine", loaded("blueboat"))


def test_all_axes_at_once_leave_the_thrusters_room() -> None:
    rov = loaded("bluerov2_heavy")
    found = manoeuvre("all-telegraph", rov, seed=3)
    assert found.commands is not None
    assert np.abs(found.commands - 1500.0).max() < 400.0
    assert np.linalg.cond(np.corrcoef(found.wrench.T)) < 20.0


@pytest.mark.parametrize("name", ["vlbv300", "bluerov2", "bluerov2_heavy", "bluerov_2016"])
def test_a_tank_session_stays_in_the_tank_and_upright(name: str) -> None:
    rov = loaded(name)
    session = manoeuvre("tank-session", rov)
    assert session.t.size == 12000
    run = simulate(rov, **session.inputs)
    place = table(run, "xyz")
    assert np.ptp(place, axis=0).max() < 5.0
    assert np.abs(table(run, ("phi", "theta"))).max() < 0.8
    speeds = np.abs(table(run, "uvwpqr")).max(axis=0)
    assert speeds[[0, 1, 2]].min() > 0.25
    assert speeds[[3, 4, 5]].min() > 0.2
    still = np.abs(session.wrench[:100] - [0, 0, -rov.weight_minus_buoyancy, 0, 0, 0]).max()
    assert still < 0.6  # half a step at the dead band


def test_seeds() -> None:
    first, again, other = (manoeuvre("yaw-prbs", vessel(), seed=seed).wrench for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize("name, levels", [("paper-stairs", [13, 18, 23, 28]), ("paper-square", [30])])
def test_the_runs_of_the_paper(name: str, levels: list[int]) -> None:
    rov = loaded("vlbv300")
    found = manoeuvre(name, rov)
    assert found.commands is not None
    assert not found.wrench[:50].any()
    assert sorted(set(np.abs(found.commands[50:, 0]))) == levels
    assert not found.commands[:, 4:].any()
    half = 800 if name == "paper-stairs" else 250
    np.testing.assert_array_equal(found.commands[50 : 50 + half], -found.commands[50 + half : 50 + 2 * half])
    level = levels[-1]
    force = 2.0 * (np.cos(np.pi / 4) + np.cos(np.radians(35.0))) * (0.006736 * level**2 - 0.03366 * level + 0.0684)
    assert found.wrench[:, 0].max() == pytest.approx(force, rel=1e-9)
    np.testing.assert_allclose(found.wrench[:, [1, 5]], 0.0, atol=1e-12)
    bare = manoeuvre(name, vessel(thrusters=())).wrench
    np.testing.assert_allclose(bare[:, 0], found.wrench[:, 0], atol=1e-12)


def test_the_runs_of_the_paper_ask_for_a_fitting_amplitude() -> None:
    weak = vessel()
    small = weak.thrusters[0].curve.model_copy(update={"limits": (-1.0, 1.0), "dead_band": 0.0})
    thrusters = tuple(t.model_copy(update={"curve": small}) for t in weak.thrusters)
    with pytest.raises(InputError, match=r'limits -1 \.\. 1 of thruster "ap"; give an amplitude'):
        manoeuvre("paper-square", vessel(thrusters=thrusters))
    found = manoeuvre("paper-square", vessel(thrusters=thrusters), amplitude=0.5)
    assert found.commands is not None
    assert found.commands.max() == 0.5


def test_unknown_names_are_answered_with_the_nearest() -> None:
    with pytest.raises(InputError, match='unknown manoeuvre "surge-sin"; did you mean "surge-sine"'):
        manoeuvre("surge-sin", vessel())


def test_from_a_recording_of_commands() -> None:
    rov = vessel()
    table_ = Recording.from_table([2.0, 2.5, 4.0], {"cmd_ap": [10, 20, 30], "cmd_vs": [np.nan, 40, 50]}, source="a.csv")
    found = manoeuvre_from_recording(table_, rov)
    assert found.commands is not None
    assert found.name == "a.csv"
    np.testing.assert_array_equal(found.commands[[0, 49, 50, 199, 200], 0], [10, 10, 20, 20, 30])
    np.testing.assert_array_equal(found.commands[[0, 49, 50, 199, 200], 5], [0, 0, 40, 40, 50])
    assert not found.commands[:, 1].any()
    np.testing.assert_array_equal(found.wrench, thruster_wrench(rov, found.commands))
    assert manoeuvre_from_recording(table_, rov, duration=1.0).t.size == 100


def test_from_a_recording_that_the_simulator_made() -> None:
    rov = vessel()
    for name, maker in (("all-prbs", rov), ("yaw-sine", vessel(thrusters=()))):
        original = manoeuvre(name, maker, duration=5.0)
        run = simulate(rov, **original.inputs)
        found = manoeuvre_from_recording(run, rov)
        np.testing.assert_allclose(found.wrench, original.wrench, atol=1e-12)
        np.testing.assert_allclose(table(simulate(rov, **found.inputs)), table(run), atol=1e-12)


def test_recordings_that_do_not_fit() -> None:
    with pytest.raises(InputError, match='"cmd_apx" commands a thruster that vessel lacks; did you mean "cmd_ap"'):
        manoeuvre_from_recording(Recording.from_table([0.0], {"cmd_apx": [1.0]}), vessel())
    with pytest.raises(InputError, match="neither commands"):
        manoeuvre_from_recording(Recording.from_table([0.0], {"u": [1.0]}), vessel())
