"""Thruster wrenches: every row is r x f. The rows with the paper's errata mended, allocation, saturation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from towtank.errors import InputError
from towtank.vehicle import (
    PolynomialCurve,
    Thruster,
    allocatable_axes,
    allocate,
    catalog_names,
    configuration_matrix,
    curve_force,
    load_vehicle,
    thruster_forces,
    thruster_wrench,
)

ALPHA_AFT, ALPHA_FWD, BETA = np.radians([45.0, 35.0, 18.0])
LH1, LH2, LV, Z_H, Z_V = 0.15, 0.5588, 0.24, 0.08, -0.095
AFT_PORT, AFT_STBD, FWD_PORT, FWD_STBD, VERT_PORT, VERT_STBD = range(6)


@pytest.fixture(scope="module")
def vlbv300():
    return load_vehicle("vlbv300")


def test_rows_of_the_vlbv300_are_the_corrected_ones(vlbv300):
    rng = np.random.default_rng(1)
    f = rng.normal(size=(50, 6))
    X, Y, Z, K, M, N = (f @ configuration_matrix(vlbv300).T).T
    AP, AS, FP, FS, VL, VR = f.T
    ca, sa, cf, sf = np.cos(ALPHA_AFT), np.sin(ALPHA_AFT), np.cos(ALPHA_FWD), np.sin(ALPHA_FWD)
    horizontal = FS * sf + AS * sa - FP * sf - AP * sa
    np.testing.assert_allclose(X, (AP + AS) * ca - (FP + FS) * cf, atol=1e-11)
    np.testing.assert_allclose(Y, horizontal - (VL - VR) * np.sin(BETA), atol=1e-11)
    np.testing.assert_allclose(Z, (VL + VR) * np.cos(BETA), atol=1e-11)
    lever = np.cos(BETA) * LV / 2 - Z_V * np.sin(BETA)
    np.testing.assert_allclose(K, (VR - VL) * lever - Z_H * horizontal, atol=1e-11)
    np.testing.assert_allclose(M, Z_H * X, atol=1e-11)
    turn = (AP - AS) * ca * LH1 / 2 + (AP - AS) * sa * LH2 / 2 + (FS - FP) * (cf * LH1 / 2 + sf * LH2 / 2)
    np.testing.assert_allclose(N, turn, atol=1e-11)


@settings(max_examples=40, deadline=None)
@given(st.floats(0, 102))
def test_pure_surge_does_not_yaw(command):
    vehicle = load_vehicle("vlbv300")
    wrench = thruster_wrench(vehicle, [command, command, -command, -command, 0.0, 0.0])
    assert wrench[5] == pytest.approx(0.0, abs=1e-12)
    assert wrench[1] == pytest.approx(0.0, abs=1e-12)
    thrust = float(curve_force(vehicle.thrusters[0].curve, command))
    assert wrench[0] == pytest.approx(2 * (np.cos(ALPHA_AFT) + np.cos(ALPHA_FWD)) * thrust)


def test_bluerov_2016_has_the_published_map():
    f = np.random.default_rng(2).normal(size=(20, 6))
    f1, f2, f3, f4, f5, f6 = f.T
    wrench = f @ configuration_matrix(load_vehicle("bluerov_2016")).T
    expected = [
        f3 + f4,
        -f6,
        -f1 - f2 - f5,
        0.11 * f1 - 0.11 * f2,
        0.19 * f1 + 0.19 * f2 - 0.17 * f5,
        0.11 * f3 - 0.11 * f4,
    ]
    np.testing.assert_allclose(wrench, np.transpose(expected), atol=1e-15)


def test_bluerov2_heavy_moves_the_way_it_should():
    T = configuration_matrix(load_vehicle("bluerov2_heavy_as_published"))
    ahead = T @ [1, 1, -1, -1, 0, 0, 0, 0]
    assert ahead[0] == pytest.approx(2 * np.sqrt(2))
    np.testing.assert_allclose(ahead[[1, 2, 5]], 0.0, atol=1e-3)  # the printed angles have three digits
    up = T @ [0, 0, 0, 0, 1, 1, 1, 1]
    np.testing.assert_allclose(up, [0, 0, -4, 0, 0, 0], atol=3e-3)
    np.testing.assert_array_equal(configuration_matrix(load_vehicle("bluerov2_heavy")), -T)


def test_axes_that_only_follow_others_are_left_out(vlbv300):
    assert allocatable_axes(vlbv300) == (0, 1, 2, 5, 3)  # M = z_H X
    assert allocatable_axes(load_vehicle("bluerov_2016")) == (0, 1, 2, 5, 3, 4)
    assert allocatable_axes(load_vehicle("blueboat")) == (0, 5)
    assert allocatable_axes(load_vehicle("lauv")) == (0,)


@pytest.mark.filterwarnings("ignore::towtank.vehicle.VehicleWarning")
@pytest.mark.parametrize("name", catalog_names())
def test_allocation_gives_the_wrench(name):
    vehicle = load_vehicle(name)
    axes = list(allocatable_axes(vehicle))
    rng = np.random.default_rng(3)
    wanted = np.zeros((40, 6))
    wanted[:, axes] = rng.uniform(-1, 1, (40, len(axes))) * np.where(np.array(axes) < 3, 8.0, 0.8)
    commands = allocate(vehicle, wanted)
    steps = sum(0.5 * abs(float(curve_force(t.curve, t.curve.rest + t.curve.dead_band))) for t in vehicle.thrusters)
    got = thruster_wrench(vehicle, commands)
    np.testing.assert_allclose(got[:, axes], wanted[:, axes], atol=1e-8 + steps)


def test_a_sway_command_does_not_yaw(vlbv300):
    wrench = thruster_wrench(vlbv300, allocate(vlbv300, [0, 20, 0, 0, 0, 0]))
    np.testing.assert_allclose(wrench, [0, 20, 0, 0, 0, 0], atol=1e-9)


def test_saturation_keeps_the_direction(vlbv300):
    wanted = np.array([[300.0, 100.0, -50.0, 2.0, 0.0, 20.0], [1.0, 2.0, 3.0, 0.0, 0.0, 0.0]])
    commands = allocate(vlbv300, wanted)
    assert np.max(np.abs(commands[0])) == pytest.approx(102.0)
    got = thruster_wrench(vlbv300, commands)
    axes = [0, 1, 2, 3, 5]
    share = got[0, axes] / wanted[0, axes]
    np.testing.assert_allclose(share, share[0], rtol=1e-9)
    assert 0.0 < share[0] < 1.0
    np.testing.assert_allclose(got[1, axes], wanted[1, axes], atol=1e-8)


def test_allocation_in_any_shape_with_nan(vlbv300):
    wanted = np.zeros((2, 3, 6))
    wanted[0, 0, 0] = 10.0
    wanted[1, 2] = np.nan
    commands = allocate(vlbv300, wanted)
    assert commands.shape == (2, 3, 6)
    assert np.all(np.isnan(commands[1, 2]))
    assert np.isfinite(commands[0]).all()
    assert np.all(commands[0, 1] == 0.0)


def test_voltage_lowers_the_reach_of_allocation():
    vehicle = load_vehicle("bluerov2_heavy")
    commands = allocate(vehicle, [40.0, 0, 0, 0, 0, 0], voltage=12.0)
    assert thruster_wrench(vehicle, commands, voltage=12.0)[0] == pytest.approx(40.0)
    assert thruster_wrench(vehicle, commands, voltage=16.0)[0] > 45.0


def test_voltage_broadcasts_over_time():
    vehicle = load_vehicle("bluerov2_heavy")
    forces = thruster_forces(vehicle, np.full((3, 8), 1800.0), voltage=[12.0, 14.0, 16.0])
    assert forces.shape == (3, 8)
    assert np.all(np.diff(forces[:, 0]) > 0.0)
    assert thruster_forces(vehicle, np.full(8, 1800.0), voltage=[12.0, 14.0]).shape == (2, 8)


def test_wrong_shapes_are_told(vlbv300):
    with pytest.raises(InputError, match=r"commands: found shape \(5,\), expected \(\.\.\., 6\): one for each"):
        thruster_wrench(vlbv300, np.zeros(5))
    with pytest.raises(InputError, match=r"wrench: found shape \(2, 5\), expected \(\.\.\., 6\): X Y Z K M N"):
        allocate(vlbv300, np.zeros((2, 5)))
    bare = vlbv300.model_copy(update={"thrusters": ()})
    with pytest.raises(InputError, match="has no thrusters"):
        thruster_wrench(bare, [])


def test_one_thruster_that_only_pushes_ahead():
    curve = PolynomialCurve(coefficients=(0.0, 1.0), reverse=(0.0,), limits=(-10.0, 10.0))
    propeller = Thruster(name="p", position=(-1, 0, 0), direction=(2, 0, 0), curve=curve)
    vehicle = load_vehicle("lauv").model_copy(update={"thrusters": (propeller,)})
    np.testing.assert_allclose(allocate(vehicle, [[5, 0, 0, 0, 0, 0], [-5, 0, 0, 0, 0, 0]]), [[5.0], [0.0]], atol=1e-9)


def test_a_gain_scales_force_and_is_allocated_for(vlbv300):
    weak = tuple(each.model_copy(update={"gain": 0.6}) for each in vlbv300.thrusters)
    vehicle = vlbv300.model_copy(update={"thrusters": weak})
    commands = np.linspace(-60.0, 60.0, 6)
    np.testing.assert_allclose(thruster_forces(vehicle, commands), 0.6 * thruster_forces(vlbv300, commands))
    wrench = [5.0, 0.0, 3.0, 0.0, 0.4, 1.0]
    np.testing.assert_allclose(thruster_wrench(vehicle, allocate(vehicle, wrench)), wrench, atol=1e-6)
