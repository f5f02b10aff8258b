"""The vehicle record: matrices, restoring, coefficients by name, warnings, immutability."""

import copy
import pickle

import numpy as np
import pytest
from pydantic import ValidationError

from towtank.core.layout import I_CONSTANT, I_MASS_INVERSE, I_MOMENT, I_WEIGHT, N_PARAMETERS
from towtank.errors import InputError
from towtank.vehicle import (
    COEFFICIENTS,
    FORWARD_SPEED,
    RESTORING,
    Buoyancy,
    Coefficient,
    PolynomialCurve,
    Provenance,
    RigidBody,
    Thruster,
    Vehicle,
    VehicleWarning,
    describe,
    faults,
    index,
    load_vehicle,
    mirror,
    unit,
)
from towtank.vehicle.records import same_unit

BODY = RigidBody(mass=20.0, inertia=(0.4, 0.6, 0.7))
PLAIN = Vehicle(name="plain", rigid_body=BODY)


def with_values(**values):
    return PLAIN.with_coefficients(values)


def test_seamor_has_table_one():
    vehicle = load_vehicle("seamor")
    table = {
        "X_udot": -27.08, "X_uu": -61.117, "Y_vdot": -25.952, "Y_vv": -139.81, "Z_wdot": -68.576, "Z_ww": -51.724,
        "K_pdot": -61.683, "K_pp": -12.0, "M_qdot": -79.411, "M_qq": -56.61, "N_rdot": -0.154, "N_rr": -1.772,
    }  # fmt: skip
    assert {name: vehicle.coefficient(name) for name in table} == table
    np.testing.assert_allclose(np.diag(vehicle.mass_matrix), [47.48, 46.352, 88.976, 62.112, 80.02, 0.763], rtol=1e-12)
    assert vehicle.weight_minus_buoyancy == pytest.approx(0.0, abs=1e-12)


def test_vlbv300_total_sway_mass_is_the_printed_one_times_g():
    plausible = load_vehicle("vlbv300")
    with pytest.warns(VehicleWarning):
        printed = load_vehicle("vlbv300_as_published")
    assert plausible.mass_matrix[1, 1] == pytest.approx(printed.mass_matrix[1, 1] * 9.81, abs=1e-3)
    assert plausible.coefficient("Y_vv") == pytest.approx(printed.coefficient("Y_vv") * 9.81, abs=5e-3)


def test_parameters_hold_the_matrices():
    vehicle = load_vehicle("rexrov")
    p = vehicle.parameters
    assert p.shape == (N_PARAMETERS,)
    assert not p.flags.writeable
    assert p is vehicle.parameters
    np.testing.assert_array_equal(p[:I_MASS_INVERSE].reshape(6, 6), vehicle.mass_matrix)
    np.testing.assert_array_equal(vehicle.mass_matrix, vehicle.mass_matrix.T)
    np.testing.assert_allclose(p[36:72].reshape(6, 6) @ vehicle.mass_matrix, np.eye(6), atol=1e-9)
    assert p[72] == -74.82
    assert p[108 + 35] == -523.27
    assert p[I_WEIGHT] == vehicle.weight_minus_buoyancy < 0.0
    np.testing.assert_array_equal(p[I_MOMENT:I_CONSTANT], vehicle.restoring_moment)
    assert vehicle.mass_matrix[2, 5] == pytest.approx(10.7745)
    assert vehicle.rigid_body_matrix[3, 4] == -1.44  # FLU product of inertia, turned
    assert vehicle.rigid_body_matrix[4, 5] == 2.6


def test_rigid_body_about_the_origin_for_any_centre_of_gravity():
    r = np.array([0.1, -0.2, 0.3])
    vehicle = Vehicle(name="v", rigid_body=RigidBody(mass=20.0, inertia=np.diag([0.4, 0.6, 0.7]), centre_of_gravity=r))
    S = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
    expected = np.block([[20 * np.eye(3), -20 * S], [20 * S, np.diag([0.4, 0.6, 0.7]) - 20 * S @ S]])
    np.testing.assert_allclose(vehicle.mass_matrix, expected, atol=1e-14)


def test_mirrors_are_filled_and_averaged():
    one = with_values(Y_rdot=-2.0)
    assert one.mass_matrix[5, 1] == one.mass_matrix[1, 5] == 2.0
    assert one.coefficient("N_vdot") == -2.0
    both = with_values(Y_rdot=-2.0, N_vdot=-3.0)
    assert both.added_mass_matrix[5, 1] == 2.5
    assert any("Y_rdot = -2 and N_vdot = -3 differ" in line for line in both.warnings)
    assert with_values(Y_rdot=-2.0, N_vdot=-2.0 - 1e-7).warnings == one.warnings
    assert both.with_coefficients({"N_vdot": -1.0}).coefficient("Y_rdot") == -1.0


def test_restoring_from_geometry_and_from_measurement():
    vehicle = Vehicle(
        name="v",
        rigid_body=RigidBody(mass=10.0, inertia=(1, 1, 1), centre_of_gravity=(0.01, 0.0, 0.02)),
        buoyancy=Buoyancy(force=100.0, centre=(0.0, 0.0, -0.05)),
    )
    assert vehicle.coefficient("W_minus_B") == pytest.approx(98.1 - 100.0)
    np.testing.assert_allclose(vehicle.restoring_moment, [0.981, 0.0, 98.1 * 0.02 + 5.0])
    measured = vehicle.with_coefficients({"BG_z": Coefficient(value=4.0, std=0.1), "W_minus_B": 1.5})
    assert measured.coefficient("BG_z") == 4.0
    assert measured.coefficient("BG_x") == pytest.approx(0.981)
    assert measured.parameters[I_WEIGHT] == 1.5
    assert measured.restoring.BG_z == Coefficient(value=4.0, std=0.1, unit="N m/rad")
    assert Vehicle(name="n", rigid_body=BODY).weight_minus_buoyancy == 0.0


def test_with_coefficients_leaves_the_original_alone():
    vehicle = load_vehicle("vlbv300")
    before = vehicle.parameters.copy()
    change = {"X_uu": Coefficient(value=-50.0, std=1.0)}
    learned = vehicle.with_coefficients(change, provenance=Provenance(source="log"))
    assert learned.coefficient("X_uu") == -50.0
    assert learned.hydrodynamics["X_uu"].unit == "kg/m"
    assert learned.provenance.source == "log"
    assert learned.parameters[108] == -50.0
    np.testing.assert_array_equal(vehicle.parameters, before)
    assert learned != vehicle
    assert learned.with_coefficients({}) == learned


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"X_uuu": 1.0}, 'did you mean "X_uu"'),
        ({"X_uu": np.nan}, "X_uu: value: found nan, expected a finite number"),
        ({"X_uu": "a"}, 'X_uu: found the text "a"'),
        ({"X_uu": Coefficient(value=1.0, unit="N")}, 'X_uu: unit: found "N", expected "kg/m"'),
    ],
)
def test_with_coefficients_tells_what_is_wrong(changes, message):
    with pytest.raises(InputError) as caught:
        PLAIN.with_coefficients(changes)
    assert message in str(caught.value)


def test_records_are_frozen():
    vehicle = load_vehicle("seamor")
    with pytest.raises(ValidationError):
        vehicle.name = "other"
    with pytest.raises(TypeError, match="frozen"):
        vehicle.hydrodynamics["X_uu"] = Coefficient(value=1.0)
    with pytest.raises(TypeError, match="frozen"):
        vehicle.hydrodynamics.clear()
    with pytest.raises(ValueError, match="read-only"):
        vehicle.mass_matrix[0, 0] = 1.0


def test_records_pickle_copy_and_hash():
    vehicle = load_vehicle("vlbv300")
    _ = vehicle.parameters
    pickled = pickle.loads(pickle.dumps(vehicle))
    for again in (pickled, copy.deepcopy(vehicle), copy.copy(vehicle), vehicle.model_copy()):
        assert again == vehicle
        assert hash(again) == hash(vehicle)
        assert not again.parameters.flags.writeable
    changed = vehicle.model_copy(update={"rigid_body": BODY})
    assert changed.mass_matrix[0, 0] != vehicle.mass_matrix[0, 0]


def test_singular_mass_is_readable_but_does_not_move():
    flat = Vehicle(name="flat", rigid_body=RigidBody(mass=15.0, inertia=(0.0, 0.0, 1.7)))
    assert any("singular in row K" in line for line in flat.warnings)
    with pytest.raises(InputError, match="flat: the total mass matrix is singular in row K"):
        _ = flat.parameters


def test_indefinite_mass_moves_with_a_warning():
    vehicle = with_values(X_udot=30.0)
    assert any("not positive definite (total inertia of X -10)" in line for line in vehicle.warnings)
    assert np.isfinite(vehicle.parameters).all()
    coupled = with_values(Y_rdot=-10.0, Y_vdot=-1.0)
    assert any("couplings are too large" in line for line in coupled.warnings)


WARNINGS = [
    (with_values(Y_vdot=17.0), "Y_vdot = +17 is positive: a negative added mass is not physical"),
    (with_values(Y_vdot=-1.0, N_rdot=-1.0, Y_rdot=-1.5), "added-mass matrix is not positive semidefinite"),
    (with_values(K_p=0.3), "K_p = +0.3 is positive: this drag feeds energy in"),
    (with_values(N_rr=0.3), "N_rr = +0.3 is positive"),
    (with_values(Y_v=-1.0, N_r=-1.0, Y_r=3.0), "linear damping can feed energy in"),
    (with_values(BG_z=-1.0), "BG_z = -1 N m/rad is negative: the centre of buoyancy lies below"),
    (with_values(W_minus_B=50.0), "W - B = 50 N is 25% of the weight 196.2 N: the vehicle sinks fast"),
    (with_values(X_u=-5.0, X_uu=-20.0, X_u2=26.0), "X_u2 = +26 outweighs the drag of its axis: at u = +1 m/s it feeds"),
    (with_values(N_rr=-2.0, N_r2=-3.0), "N_r2 = -3 outweighs the drag of its axis: at r = -1 rad/s it feeds energy in"),
    (
        with_values(inflow_loss=-0.1),
        "inflow_loss = -0.1 s/m is negative: thrusters that gain from inflow feed energy in",
    ),
    (Vehicle(name="v", rigid_body=RigidBody(mass=1.0, inertia=(1.0, 1.0, 3.0))), "larger than the sum of the others"),
    (Vehicle(name="v", rigid_body=RigidBody(mass=1.0, inertia=(-1.0, 1.0, 1.0))), "not all are above 0"),
]


@pytest.mark.parametrize("vehicle, expected", WARNINGS, ids=[w[:20] for _, w in WARNINGS])
def test_what_is_not_physical_is_said(vehicle, expected):
    assert any(expected in line for line in vehicle.warnings)


def test_thruster_doubts_are_said_once_for_equal_thrusters():
    vehicle = load_vehicle("vlbv300")
    assert len(vehicle.warnings) == 1
    assert "fitted for commands of 10 to 60 from neutral; up to 102 it is extrapolated" in vehicle.warnings[0]
    dip = PolynomialCurve(coefficients=(0.0, 10.0, -4.0), limits=(-2.0, 2.0))
    far = Thruster(name="a", position=(280.0, 0, 0), direction=(1, 0, 0), curve=dip)
    lines = PLAIN.model_copy(update={"thrusters": (far,)}).warnings
    assert any("millimetres" in line for line in lines)
    assert any("more command then gives less force" in line for line in lines)


@pytest.mark.parametrize("name", FORWARD_SPEED)
def test_units_of_forward_speed_terms_give_a_force_or_a_moment(name):
    """Unit times u times the other velocity is N or N m."""
    speeds = "m^2" if name[3] in "uvw" else "m rad"
    assert same_unit(unit(name), f"{'N' if name[0] in 'XYZ' else 'N m'} s^2/({speeds})")
    assert PLAIN.with_coefficients({name: Coefficient(value=-1.0, unit=unit(name))}).coefficient(name) == -1.0
    with pytest.raises(InputError, match="convert the value to SI"):
        PLAIN.with_coefficients({name: Coefficient(value=-1.0, unit="N s/m")})


def test_forward_speed_terms_that_feed_energy_in_are_told():
    up = PLAIN.with_coefficients({"Y_uv": 3.0, "M_uw": 4.0, "Z_uq": -4.0})
    assert len(faults(up)) == 1
    assert "Y_uv = +3 is positive" in faults(up)[0]
    assert not any("Z_uw" in line for line in up.warnings)  # a pair of opposite signs does no work


def test_forward_speed_terms_that_hold_the_munk_moment_are_doubted():
    """REMUS 100 (Prestero, MIT, 2001) prints sums with parts of the added mass in them; without these it is sound."""
    printed = {"Y_uv": -28.6, "Y_ur": 5.22, "N_uv": -24.0, "N_ur": -2.0}
    X_udot, Y_vdot, Y_rdot = -0.93, -35.5, 1.93
    lift = {"Y_uv": -28.6, "Y_ur": 5.22 - X_udot, "N_uv": -24.0 - (Y_vdot - X_udot), "N_ur": -2.0 - Y_rdot}
    assert any("Munk" in line for line in PLAIN.with_coefficients(printed).warnings)
    assert not any("Munk" in line for line in PLAIN.with_coefficients(lift).warnings)


def test_a_plain_vehicle_has_no_warnings():
    assert PLAIN.warnings == ()


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_asymmetric_drag_up_to_the_drag_of_its_axis_is_no_doubt(sign):
    assert with_values(X_u=-5.0, X_uu=-20.0, X_u2=25.0 * sign).warnings == ()


def test_a_loss_of_thrust_that_may_be_nothing_is_no_fault():
    for loss in (Coefficient(value=-0.02, std=0.01), 0.0, 0.2):
        assert PLAIN.with_coefficients({"inflow_loss": loss}).warnings == ()
    assert faults(PLAIN.with_coefficients({"inflow_loss": Coefficient(value=-0.04, std=0.01)}))


@pytest.mark.parametrize("axis", range(6))
def test_asymmetric_drag_has_the_unit_of_quadratic_drag(axis):
    velocity, row = "uvwpqr"[axis], "XYZKMN"[axis]
    name = f"{row}_{velocity}2"
    assert index(name) == ("asymmetric", axis, axis)
    assert unit(name) == unit(f"{row}_{velocity}{velocity}")
    assert PLAIN.with_coefficients({name: -1.5}).parameters[163 + axis] == -1.5


def test_loss_of_thrust_with_inflow_is_a_coefficient_like_others():
    vehicle = PLAIN.with_coefficients({"inflow_loss": Coefficient(value=0.12, std=0.03, unit="s/m")})
    assert vehicle.coefficient("inflow_loss") == vehicle.parameters[169] == 0.12
    assert vehicle.deviation("inflow_loss") == 0.03
    assert vehicle.hydrodynamics["inflow_loss"].unit == unit("inflow_loss") == "s/m"
    assert describe("inflow_loss") == "loss of thrust with inflow"
    assert mirror("inflow_loss") == "inflow_loss"
    assert PLAIN.coefficient("inflow_loss") == 0.0
    with pytest.raises(InputError, match="convert the value to SI"):
        PLAIN.with_coefficients({"inflow_loss": Coefficient(value=0.12, unit="m/s")})


def test_names():
    assert index("X_udot") == ("mass", 0, 0)
    assert index("N_vdot") == ("mass", 5, 1)
    assert index("M_ww") == ("quadratic", 4, 2)
    assert mirror("Y_rdot") == "N_vdot"
    for name in COEFFICIENTS:
        assert mirror(mirror(name)) == name
        assert describe(name)
        assert unit(name)
    assert describe("X_uu") == "quadratic damping: surge force per u|u|"
    assert index("N_uv") == ("forward", 5, 1)
    assert describe("N_uv") == "forward-speed term: yaw moment per u v"
    assert mirror("N_uv") == "N_uv"
    assert unit("M_uq") == "kg m"
    assert set(RESTORING) < set(COEFFICIENTS)


@pytest.mark.parametrize("written", ["kg/m", "N s^2/m^2", "kg·m/m²"])
def test_equal_units_are_one(written):
    assert PLAIN.with_coefficients({"X_uu": Coefficient(value=-1.0, unit=written)}).hydrodynamics["X_uu"].unit == "kg/m"
