"""The catalog: everything loads, every number has its origin, published values stand."""

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.vehicle import catalog_names, catalog_text, load_vehicle

PROMISED = {
    "blueboat", "bluerov2", "bluerov2_heavy", "bluerov2_heavy_wu", "bluerov_2016", "lauv", "rexrov", "seamor",
    "vlbv300", "vlbv300_as_published",
}  # fmt: skip


def test_promised_vehicles_are_there():
    assert set(catalog_names()) >= PROMISED
    with pytest.raises(InputError, match='did you mean "rexrov"'):
        catalog_text("rexrof")


@pytest.mark.filterwarnings("ignore::towtank.vehicle.VehicleWarning")
@pytest.mark.parametrize("name", catalog_names())
def test_every_number_has_its_origin(name):
    vehicle = load_vehicle(name)
    assert vehicle.name == name
    assert vehicle.description
    assert vehicle.provenance.source
    assert vehicle.provenance.notes
    assert vehicle.rigid_body.source
    assert vehicle.buoyancy.source
    assert all(coefficient.source for coefficient in vehicle.hydrodynamics.values())
    assert all(thruster.source and thruster.curve.source for thruster in vehicle.thrusters)
    assert all(catalog_text(name).isascii() for name in catalog_names())


@pytest.mark.parametrize("name", sorted(PROMISED - {"vlbv300_as_published"}))
def test_only_the_printed_table_is_not_physical(name, recwarn):
    load_vehicle(name)
    assert not recwarn.list


def test_the_printed_table_is_warned():
    with pytest.warns(UserWarning, match=r"Y_vdot = \+17\.0621 is positive"):
        vehicle = load_vehicle("vlbv300_as_published")
    assert vehicle.coefficient("Y_vv") == -7.334


PUBLISHED = {
    "bluerov2_heavy": {"X_udot": -6.36, "N_rdot": -0.222, "X_u": -13.7, "M_q": -0.8, "Y_vv": -217, "N_rr": -1.5},
    "bluerov2_heavy_wu": {"Z_wdot": -14.57, "K_p": -0.07, "X_uu": -18.18},
    "bluerov2": {"Y_vdot": -18.5, "N_r": -4.64, "Z_ww": -74.23},
    "rexrov": {"X_udot": -779.79, "K_vdot": -409.44, "X_qdot": 165.54, "M_q": -309.77, "N_rr": -523.27},
    "lauv": {"X_udot": -1, "Y_r": 11.5, "Z_q": -11.5, "M_w": 3.1, "N_v": -3.1, "Y_vv": -80},
    "vlbv300": {"X_udot": -19.519, "Y_vdot": -16.75, "Y_vv": -71.95, "N_rr": -0.3491, "BG_z": 20.9 * 9.81 * 0.02},
    "bluerov_2016": {"K_p": -0.884, "M_qq": -0.335, "N_r": -1.028},
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_published_values(name):
    vehicle = load_vehicle(name)
    assert {key: vehicle.coefficient(key) for key in PUBLISHED[name]} == pytest.approx(PUBLISHED[name])


def test_bluerov_2016_has_the_published_sums():
    M = load_vehicle("bluerov_2016").mass_matrix
    np.testing.assert_allclose(np.diag(M)[3:], [0.834, 0.799, 1.125], atol=1e-12)


def test_bluerov2_heavy_net_weight():
    assert load_vehicle("bluerov2_heavy").weight_minus_buoyancy == pytest.approx(9.81 * 0.1, rel=1e-6)
