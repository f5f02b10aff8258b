"""Forward and inverse dynamics of vehicles: consistency, broadcasting, the signs that the paper has wrong."""

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.vehicle import catalog_names, forward_dynamics, inverse_dynamics, load_vehicle


@pytest.mark.filterwarnings("ignore::towtank.vehicle.VehicleWarning")
@pytest.mark.parametrize("name", catalog_names())
def test_inverse_undoes_forward(name):
    vehicle = load_vehicle(name)
    rng = np.random.default_rng(5)
    eta, nu, tau = rng.uniform(-1, 1, (3, 20, 6))
    nu_dot = forward_dynamics(vehicle, eta, nu, tau)
    scale = np.abs(vehicle.mass_matrix).max()
    np.testing.assert_allclose(inverse_dynamics(vehicle, eta, nu, nu_dot), tau, atol=1e-12 * scale)


def test_leading_shapes_broadcast():
    vehicle = load_vehicle("vlbv300")
    rng = np.random.default_rng(6)
    eta, nu, tau = rng.normal(size=6), rng.normal(size=(4, 1, 6)), rng.normal(size=(3, 6))
    out = forward_dynamics(vehicle, eta, nu, tau)
    assert out.shape == (4, 3, 6)
    np.testing.assert_allclose(out[2, 1], forward_dynamics(vehicle, eta, nu[2, 0], tau[1]), rtol=1e-12)
    assert forward_dynamics(vehicle, np.zeros(6), np.zeros(6), [0] * 6).shape == (6,)
    assert forward_dynamics(vehicle, np.zeros((0, 6)), np.zeros(6), np.zeros(6)).shape == (0, 6)


def test_published_surge():
    vehicle = load_vehicle("seamor")
    nu_dot = forward_dynamics(vehicle, np.zeros(6), [0.5, 0, 0, 0, 0, 0], [30.0, 0, 0, 0, 0, 0])
    assert nu_dot[0] == pytest.approx((30.0 - 61.117 * 0.25) / 47.48, rel=1e-12)


def test_munk_moment():
    vehicle = load_vehicle("vlbv300").with_coefficients({"N_r": 0.0})
    nu_dot = forward_dynamics(vehicle, np.zeros(6), [1.0, 0.1, 0, 0, 0, 0], np.zeros(6))
    assert nu_dot[5] * vehicle.mass_matrix[5, 5] == pytest.approx((-16.75 + 19.519) * 0.1, rel=1e-9)


def test_restoring_rights_the_vehicle():
    vehicle = load_vehicle("vlbv300")
    nu_dot = forward_dynamics(vehicle, [0, 0, 0, 0.1, 0.2, 0], np.zeros(6), np.zeros(6))
    BG_z = vehicle.coefficient("BG_z")
    assert nu_dot[3] * vehicle.mass_matrix[3, 3] == pytest.approx(-BG_z * np.cos(0.2) * np.sin(0.1))
    assert nu_dot[4] * vehicle.mass_matrix[4, 4] == pytest.approx(-BG_z * np.sin(0.2))


def test_heavy_vehicle_sinks_and_light_one_rises():
    down = forward_dynamics(load_vehicle("bluerov2_heavy"), np.zeros(6), np.zeros(6), np.zeros(6))
    up = forward_dynamics(load_vehicle("rexrov"), np.zeros(6), np.zeros(6), np.zeros(6))
    assert down[2] > 0.0 > up[2]


def test_nan_in_one_row_stays_there():
    vehicle = load_vehicle("vlbv300")
    eta = np.zeros((3, 6))
    eta[1] = np.nan
    out = forward_dynamics(vehicle, eta, np.zeros(6), np.ones(6))
    assert np.isfinite(out[[0, 2]]).all()
    assert np.isnan(out[1]).any()


def test_wrong_shapes_are_told():
    vehicle = load_vehicle("vlbv300")
    with pytest.raises(InputError, match=r"nu: found shape \(5,\), expected \(\.\.\., 6\): u v w p q r"):
        forward_dynamics(vehicle, np.zeros(6), np.zeros(5), np.zeros(6))
    with pytest.raises(InputError, match=r"leading shapes do not fit together: eta \(2, 6\), nu \(3, 6\)"):
        inverse_dynamics(vehicle, np.zeros((2, 6)), np.zeros((3, 6)), np.zeros(6))
    with pytest.raises(InputError, match="tau: not an array of numbers"):
        forward_dynamics(vehicle, np.zeros(6), np.zeros(6), "abcdef")
    with pytest.raises(InputError, match="eta: found shape"):
        forward_dynamics(vehicle, 3.0, np.zeros(6), np.zeros(6))
