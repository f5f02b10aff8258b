"""Vehicle files: what is written is read again; what is wrong is told in one line with its place."""

import string

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from towtank.errors import InputError
from towtank.vehicle import (
    COEFFICIENTS,
    HYDRODYNAMIC,
    Buoyancy,
    Coefficient,
    PolynomialCurve,
    Provenance,
    QuadraticCurve,
    Restoring,
    RigidBody,
    TableCurve,
    Thruster,
    Vehicle,
    VehicleWarning,
    Voltage,
    catalog_names,
    load_vehicle,
    parse_vehicle,
    save_vehicle,
    unit,
    vehicle_text,
)

BODY = "[rigid_body]\nmass = 20.0\ninertia = [0.4, 0.6, 0.6]\n"
HEAD = 'name = "mine"\n' + BODY
THRUSTER = """
[[thrusters]]
name = "aft"
position = [-0.28, -0.075, 0.0]
direction = [0.707, -0.707, 0.0]
curve = { kind = "polynomial", coefficients = [0.0684, -0.03, 0.0067], odd = true, dead_band = 5, limits = [-102, 102] }
"""


def inertia(written):
    return HEAD.replace("[0.4, 0.6, 0.6]", written)


def thruster(old, new):
    assert old in THRUSTER
    return HEAD + THRUSTER.replace(old, new)


WRONG = {
    HEAD + "[hydrodynamics]\nX_uuu = -1": 'mine.toml: hydrodynamics.X_uuu: unknown key; did you mean "X_uu"?',
    HEAD + '[hydrodynamics]\nX_uu = "a"': 'hydrodynamics.X_uu: found the text "a", expected a number or {value',
    HEAD + "[hydrodynamics]\nX_uu = nan": "hydrodynamics.X_uu.value: found nan, expected a finite number",
    HEAD + "[hydrodynamics]\nX_uu = { std = 1 }": "hydrodynamics.X_uu.value: missing",
    HEAD + "[hydrodynamics]\nX_uu = { value = -1, std = -1 }": "hydrodynamics.X_uu.std: found -1, expected 0 or more",
    HEAD + "[hydrodynamics]\nX_uu = { value = -1, stdd = 1 }": 'X_uu.stdd: unknown key; did you mean "std"?',
    HEAD + '[hydrodynamics]\nX_uu = { value = -1, unit = "N" }': 'X_uu.unit: found "N", expected "kg/m"',
    HEAD + "[hydrodynamics]\nBG_z = 4": "hydrodynamics.BG_z: unknown key here; it belongs in the table [restoring]",
    HEAD + '[restoring]\nBG_z = { value = 4, unit = "N" }': 'restoring.BG_z.unit: found "N", expected "N m/rad"',
    HEAD + "[restoring]\nBG = 4": 'restoring.BG: unknown key; did you mean "BG_',
    HEAD + "[hydrodynamic]": 'hydrodynamic: unknown key; did you mean "hydrodynamics"?',
    BODY: "mine.toml: name: missing",
    'name = "mine"': "mine.toml: rigid_body: missing",
    "name = 3\n" + BODY: "name: found 3, expected a name",
    'name = " "\n' + BODY: "name: found",
    'name = "mine"\nrigid_body = 1': "rigid_body: found 1, expected a table",
    HEAD.replace("20.0", '"20"'): 'rigid_body.mass: found the text "20", expected a number',
    HEAD.replace("20.0", "true"): "rigid_body.mass: found true, expected a number",
    HEAD.replace("20.0", "inf"): "rigid_body.mass: found inf, expected a finite number",
    HEAD.replace("20.0", "-3"): "rigid_body.mass: found -3, expected a number above 0",
    HEAD.replace("20.0", "1" + "0" * 400): "rigid_body.mass: found a number too large",
    HEAD.replace("0.4, ", ""): "rigid_body.inertia: found 2 items, expected 3 numbers",
    HEAD.replace("0.4", '"a"'): 'rigid_body.inertia[0]: found the text "a", expected a finite number',
    inertia("[[1, 0, 0], [0.2, 1, 0], [0, 0, 1]]"): "rigid_body.inertia[1][0]: found 0.2, expected 0 as at [0][1]",
    inertia("[[1, 0], [0, 1], [0, 0, 1]]"): "rigid_body.inertia[0]: found 2 numbers, expected 3",
    HEAD + "centre_of_gravity = [0, 0]": "rigid_body.centre_of_gravity: found 2 numbers, expected 3 numbers [x, y, z]",
    HEAD
    + "center_of_gravity = [0, 0, 0]": 'rigid_body.center_of_gravity: unknown key; did you mean "centre_of_gravity"',
    HEAD + "[buoyancy]\nforce = -1": "buoyancy.force: found -1, expected 0 or more",
    "command_delay = -1\n" + HEAD: "command_delay: found -1, expected 0 or more",
    "scale_std = -0.1\n" + HEAD: "scale_std: found -0.1, expected a share of 0 or more and below 1",
    "scale_std = 1\n" + HEAD: "scale_std: found 1, expected a share of 0 or more and below 1",
    'scale_std = "5 %"\n' + HEAD: 'scale_std: found the text "5 %", expected a number',
    "scale_sdt = 0.1\n" + HEAD: 'scale_sdt: unknown key; did you mean "scale_std"?',
    "thrusters = 3\n" + HEAD: "thrusters: found 3, expected a list of tables; write [[thrusters]]",
    thruster("[[thrusters]]", "[thrusters]"): "thrusters: found a table, expected a list of tables",
    HEAD + THRUSTER + THRUSTER: 'thrusters[1].name: "aft" is already the name of thrusters[0]',
    thruster("aft", "a,b"): 'thrusters[0].name: found the text "a,b", expected letters',
    thruster("0.707", "0"): "thrusters[0].direction: found the zero vector",
    thruster("position", "place"): "thrusters[0].place: unknown key; known here: name, position",
    thruster("-0.28", '"x"'): 'thrusters[0].position[0]: found the text "x", expected a number (thruster "aft")',
    thruster('"polynomial"', '"polynom"'): 'curve.kind: found "polynom", expected polynomial, table',
    thruster('kind = "polynomial", ', ""): "thrusters[0].curve.kind: missing",
    thruster("[0.0684, -0.03, 0.0067]", "[]"): "thrusters[0].curve.coefficients: found a list of 0",
    thruster("dead_band = 5", "deadband = 5"): "thrusters[0].curve.deadband: unknown key; did you mean",
    thruster("[-102, 102]", "[102, -102]"): "thrusters[0].curve.limits: found [102, -102], expected [lowest, highest]",
    thruster("[-102, 102]", "[1100, 1900]"): "expected them to enclose the neutral command 0; set neutral",
    thruster("odd = true", "odd = 1.5"): "thrusters[0].curve.odd: found 1.5, expected true or false",
    thruster("odd = true", "odd = false, reverse = [1]"): "thrusters[0].curve.reverse: has no meaning",
}

PRIOR = HEAD + "[prior]\n"
WRONG |= {
    PRIOR + "X_uuu = { value = -1, std = 1 }": 'mine.toml: prior.X_uuu: unknown key; did you mean "X_uu"?',
    PRIOR + "dellay = { value = 0.1, std = 1 }": 'prior.dellay: unknown key; did you mean "delay"?',
    PRIOR + "X_uu = -60": "prior.X_uu.std: missing, expected a number above 0, as { value = -60, std = ... }",
    PRIOR + "X_uu = { value = -60, std = 0 }": "prior.X_uu.std: found 0, expected a number above 0",
    PRIOR + "X_uu = { value = -60, std = -1 }": "prior.X_uu.std: found -1, expected 0 or more",
    PRIOR + 'delay = { value = 0.1, std = 1, unit = "m" }': 'prior.delay.unit: found "m", expected "s"',
    PRIOR + "delay = { value = -0.1, std = 1 }": "prior.delay.value: found -0.1, expected 0 or more",
    PRIOR + "lag = { value = 0, std = 1 }": "prior.lag.value: found 0, expected a number above 0",
    PRIOR + "gain_aft = { value = -1, std = 1 }": "prior.gain_aft.value: found -1, expected a number above 0",
    PRIOR + "X_udot = { value = 21, std = 1 }": "prior.X_udot.value: found 21, expected less than the rigid body's 20",
    PRIOR + "Y_rdot = { value = 1, std = 1 }\nN_vdot = { value = 1, std = 1 }": 'stands there already as "N_vdot"',
    PRIOR + "gain_aff = { value = 1, std = 1 }\n" + THRUSTER: 'no thruster is "aff"; did you mean "aft"?',
}


@pytest.mark.parametrize("text", WRONG, ids=[expected[:40] for expected in WRONG.values()])
def test_wrong_file_is_told_with_its_place(text):
    with pytest.raises(InputError) as caught:
        parse_vehicle(text, "mine.toml")
    message = str(caught.value)
    assert WRONG[text] in message
    assert message.startswith("mine.toml")
    assert "\n" not in message
    assert len(message) < 320


def test_wrong_table_curves():
    head = HEAD + '[[thrusters]]\nname = "a"\nposition = [0, 0, 0]\ndirection = [1, 0, 0]\n'
    with pytest.raises(InputError, match=r"curve\.command\[2\]: found 1 after 2, expected rising commands"):
        parse_vehicle(head + 'curve = { kind = "table", command = [0, 2, 1], force = [0, 1, 2] }', "mine.toml")
    with pytest.raises(InputError, match=r"curve\.force: found 2 values, expected 3, one per command"):
        parse_vehicle(head + 'curve = { kind = "table", command = [0, 1, 2], force = [0, 1] }', "mine.toml")


def test_syntax_error_has_line_and_column(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\nmass = = 3\n')
    with pytest.raises(InputError, match=r"mine\.toml:2:8: not valid TOML: Invalid value"):
        load_vehicle(path)
    path.write_text(HEAD + "mass = 3\n")
    with pytest.raises(InputError, match=r"mine\.toml:5:\d+: not valid TOML: Cannot overwrite a value"):
        load_vehicle(path)
    path.write_text('name = "mine')
    with pytest.raises(InputError, match=r"mine\.toml.*not valid TOML"):
        load_vehicle(path)


def test_what_is_no_vehicle_file(tmp_path):
    with pytest.raises(InputError, match=r"no such file"):
        load_vehicle(tmp_path / "nowhere.toml")
    with pytest.raises(InputError, match=r'"seamr" is neither a file nor .* catalog; did you mean "seamor"\?'):
        load_vehicle("seamr")
    with pytest.raises(InputError, match=r"folder"):
        load_vehicle(tmp_path)
    binary = tmp_path / "log.toml"
    binary.write_bytes(b"name = \xff\xfe\x00")
    with pytest.raises(InputError, match=r"not UTF-8"):
        load_vehicle(binary)
    with pytest.raises(InputError):
        load_vehicle("bad\0name")


@pytest.mark.filterwarnings("ignore::towtank.vehicle.VehicleWarning")
@pytest.mark.parametrize("name", catalog_names())
def test_catalog_survives_saving(tmp_path, name):
    vehicle = load_vehicle(name)
    save_vehicle(vehicle, tmp_path / "copy.toml")
    assert load_vehicle(tmp_path / "copy.toml") == vehicle
    assert [path.name for path in tmp_path.iterdir()] == ["copy.toml"]


def test_saved_file_is_readable_in_git():
    text = vehicle_text(load_vehicle("vlbv300"))
    lines = text.splitlines()
    assert [line for line in lines if line.startswith('X_uu = {value = -41.343, unit = "kg/m", source = ')]
    assert "\n\n" in text
    assert "[[thrusters]]" in lines


def test_contract_example_is_read():
    vehicle = parse_vehicle(HEAD + "[hydrodynamics]\nX_udot = -27.08\n" + THRUSTER, "mine.toml")
    assert vehicle.hydrodynamics["X_udot"] == Coefficient(value=-27.08, unit="kg")
    assert np.linalg.norm(vehicle.thrusters[0].direction) == pytest.approx(1.0, abs=1e-15)


def test_what_is_known_before_is_kept_by_every_copy():
    vehicle = parse_vehicle(
        PRIOR + "X_uu = { value = -60, std = 20 }\ndelay = { value = 0.1, std = 0.02 }", "mine.toml"
    )
    assert vehicle.prior["X_uu"] == Coefficient(value=-60.0, std=20.0, unit="kg/m")
    assert vehicle.prior["delay"].unit == "s"
    assert vehicle.coefficient("X_uu") == 0.0
    assert vehicle.deviation("X_uu") is None
    changed = vehicle.with_coefficients({"X_uu": -50.0}).model_copy(update={"command_delay": 0.3})
    assert changed.prior == vehicle.prior
    with pytest.raises(TypeError, match="frozen"):
        vehicle.prior["X_u"] = Coefficient(value=-1.0, std=1.0)
    assert "[prior]" not in vehicle_text(load_vehicle("seamor"))


def test_unphysical_vehicle_is_read_with_a_warning(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(HEAD + "[hydrodynamics]\nY_vdot = 17.0\nX_u = 3.0\n")
    with pytest.warns(VehicleWarning) as caught:
        load_vehicle(path)
    assert sorted(str(w.message).split(": ", 1)[1][:7] for w in caught) == ["X_u = +", "Y_vdot "]


finite = st.floats(-1e6, 1e6, allow_subnormal=False)
positive = st.floats(1e-3, 1e6)
text = st.text(st.characters(blacklist_categories=["Cs"]), max_size=20)
vector = st.tuples(finite, finite, finite)
names = st.text(string.ascii_letters + string.digits + "_", min_size=1, max_size=8)


@st.composite
def coefficients(draw):
    return Coefficient(value=draw(finite), std=draw(st.none() | positive), source=draw(text))


@st.composite
def stated_before(draw):
    unknowns = ("X_uu", "BG_z", "Y_rdot", "delay", "lag", "gain_x.1", "latency_velocity", "imu_x")
    chosen = draw(st.lists(st.sampled_from(unknowns), unique=True, max_size=3))
    return {name: Coefficient(value=draw(positive), std=draw(positive), source=draw(text)) for name in chosen}


@st.composite
def curves(draw):
    neutral = draw(st.none() | st.floats(-10, 10))
    rest = neutral or 0.0
    common = {
        "neutral": neutral,
        "dead_band": draw(st.floats(0, 5)),
        "limits": draw(st.none() | st.just((rest - 20.0, rest + 30.0))),
        "voltage": draw(st.none() | st.builds(Voltage, nominal=positive, exponent=finite)),
        "source": draw(text),
    }
    kind = draw(st.sampled_from(["polynomial", "table", "quadratic"]))
    if kind == "quadratic":
        return QuadraticCurve(forward=draw(finite), reverse=draw(st.none() | finite), **common)
    if kind == "table":
        commands = sorted(draw(st.sets(finite, min_size=2, max_size=5)))
        common.update(limits=None)
        return TableCurve(command=commands, force=[draw(finite) for _ in commands], **common)
    powers = st.lists(finite, min_size=1, max_size=4)
    return PolynomialCurve(coefficients=draw(powers), reverse=draw(st.none() | powers), scale=draw(positive), **common)


@st.composite
def vehicles(draw):
    chosen = draw(st.lists(st.sampled_from(HYDRODYNAMIC), unique=True, max_size=6))
    thrusters, prior = [], draw(stated_before())
    for name in draw(st.lists(names, unique=True, max_size=2)):
        direction = draw(vector.filter(lambda v: max(map(abs, v)) > 1e-3))
        thrusters.append(
            Thruster(
                name=name,
                position=draw(vector),
                direction=direction,
                curve=draw(curves()),
                time_constant=draw(positive),
            )
        )
    moments = draw(st.tuples(positive, positive, positive))
    return Vehicle(
        name="v" + draw(text),
        description=draw(text),
        rigid_body=RigidBody(mass=draw(positive), inertia=moments, centre_of_gravity=draw(vector), source=draw(text)),
        buoyancy=Buoyancy(force=draw(st.none() | positive), centre=draw(vector)),
        restoring=Restoring(BG_z=draw(st.none() | coefficients()), W_minus_B=draw(st.none() | coefficients())),
        hydrodynamics={name: draw(coefficients()) for name in chosen},
        thrusters=[] if "gain_x.1" in prior else thrusters,
        prior=prior,
        command_delay=draw(st.just(0.0) | positive),
        scale_std=draw(st.none() | st.floats(0.0, 1.0, exclude_max=True)),
        provenance=Provenance(source=draw(text), notes=tuple(draw(st.lists(text, max_size=2)))),
    )


@settings(max_examples=60, deadline=None)
@given(vehicles())
def test_save_then_load_gives_an_equal_vehicle(vehicle):
    again = parse_vehicle(vehicle_text(vehicle), "round")
    assert again == vehicle
    assert hash(again) == hash(vehicle)


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=60) | st.sampled_from(list(COEFFICIENTS)).map(lambda n: HEAD + f"[hydrodynamics]\n{n} = [1]"))
def test_nonsense_is_an_input_error(nonsense):
    with pytest.raises(InputError):
        parse_vehicle(nonsense, "nonsense.toml")


def test_every_coefficient_has_a_unit():
    assert len(COEFFICIENTS) == 134
    assert unit("X_uu") == "kg/m"
    assert unit("X_udot") == "kg"
    assert unit("K_pp") == "kg m^2/rad^2"
    assert unit("K_pdot") == "kg m^2"
    assert unit("N_vdot") == unit("Y_rdot") == "kg m"
    assert unit("BG_z") == "N m/rad"
    with pytest.raises(InputError, match='did you mean "X_uu"'):
        unit("X_uuu")
