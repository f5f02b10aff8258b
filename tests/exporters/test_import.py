"""Vehicles out of other people's files: frames and signs undone, doubts said, nothing dropped in silence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.app.commands import command, document, refused

from towtank import InputError, export, import_vehicle, load_vehicle
from towtank.exporters.importing.known import doubts_of
from towtank.vehicle import COEFFICIENTS, Vehicle, VehicleWarning, configuration_matrix, index

UUV = """<?xml version="1.0"?>
<robot name="small">
  <link name="small/base_link">
    <inertial><mass value="18.0"/><origin xyz="0 0 -0.02" rpy="0 0 0"/>
      <inertia ixx="0.5" ixy="0.01" ixz="0.02" iyy="0.8" iyz="0.03" izz="0.9"/></inertial>
  </link>
  <link name="small/thruster_0"><inertial><mass value="0.5"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <joint name="small/thruster_0_joint" type="continuous">
    <parent link="small/base_link"/><child link="small/thruster_0"/>
    <origin xyz="-0.4 0.1 0.05" rpy="0 0 1.5707963267948966"/><axis xyz="1 0 0"/>
  </joint>
  <gazebo><plugin name="uuv_plugin" filename="libuuv_underwater_object_ros_plugin.so">
    <fluid_density>1028.0</fluid_density><flow_velocity_topic>hydrodynamics/current</flow_velocity_topic>
    <link name="small/base_link">
      <neutrally_buoyant>0</neutrally_buoyant><volume>0.018</volume>
      <center_of_buoyancy>0.01 0.02 0.06</center_of_buoyancy>
      <hydrodynamic_model>
        <type>fossen</type>
        <added_mass>4 0.5 0 0 0 0  0.5 16 0 0 0 0.7  0 0 16 0 -0.7 0  0 0 0 0.1 0 0  0 0 -0.7 0 1.3 0  0 0.7 0 0 0 1.3
        </added_mass>
        <linear_damping>-2 -23 -23 -0.3 -9 -9</linear_damping>
        <linear_damping_forward_speed>0 -8 0 0 0 -3</linear_damping_forward_speed>
        <quadratic_damping>-3 0 0 0 0 1  0 -80 0 0 0 0  0 0 -80 0 0 0  0 0 0 -0.1 0 0  0 0 0 0 -9 0  0 0 0 0 0 -9
        </quadratic_damping>
      </hydrodynamic_model>
    </link>
  </plugin></gazebo>
  <gazebo><plugin name="t0" filename="libuuv_thruster_ros_plugin.so">
    <linkName>small/thruster_0</linkName><jointName>small/thruster_0_joint</jointName><thrusterID>0</thrusterID>
    <gain>2</gain><clampMin>-10</clampMin><clampMax>20</clampMax><thrust_efficiency>0.5</thrust_efficiency>
    <dynamics><type>FirstOrder</type><timeConstant>0.05</timeConstant></dynamics>
    <conversion><type>Basic</type><rotorConstant>0.01</rotorConstant></conversion>
    <wobble>3</wobble>
  </plugin></gazebo>
</robot>
"""
SDF = """<sdf version="1.9"><model name="rov">
  <link name="frame"><pose>1 2 3 0 0 90</pose></link>
  <link name="base_link"><pose>0 0 0.1 0 0 0</pose>
    <inertial><pose>0 0 0.011 0 0 0</pose><mass>13</mass>
      <inertia><ixx>0.26</ixx><iyy>0.23</iyy><izz>0.37</izz></inertia></inertial>
    <collision name="c"><pose>0 0 0.06 0 0 0</pose>
      <geometry><box><size>0.457 0.575 0.05</size></box></geometry></collision>
    <sensor name="imu" type="imu"/>
  </link>
  <link name="prop"><pose>0.14 -0.092 0.1 -1.5707963267948966 1.5707963267948966 -0.7853981633974483</pose>
    <inertial><mass>0.002</mass><inertia><ixx>0.001</ixx><iyy>0.001</iyy><izz>0.001</izz></inertia></inertial></link>
  <joint name="prop_joint" type="revolute"><parent>base_link</parent><child>prop</child>
    <axis><xyz>0 0 -1</xyz></axis></joint>
  <plugin filename="gz-sim-hydrodynamics-system" name="gz::sim::systems::Hydrodynamics">
    <link_name>base_link</link_name><xDotU>5</xDotU><xUabsU>-58.42</xUabsU><yVabsV>-55.137</yVabsV>
    <zWabsW>-124.818</zWabsW><kPabsP>-4</kPabsP><mQabsQ>-4</mQabsQ><nRabsR>-4</nRabsR><xUU>-1</xUU><yUabsV>-2</yUabsV>
    <xQR>3</xQR><waves>1</waves>
  </plugin>
  <plugin filename="gz-sim-thruster-system" name="gz::sim::systems::Thruster">
    <joint_name>prop_joint</joint_name><thrust_coefficient>-0.02</thrust_coefficient>
    <propeller_diameter>0.1</propeller_diameter><use_angvel_cmd>true</use_angvel_cmd>
    <min_thrust_cmd>-150</min_thrust_cmd><max_thrust_cmd>150</max_thrust_cmd>
  </plugin>
  <plugin filename="ArduPilotPlugin" name="ArduPilotPlugin"/>
</model></sdf>
"""


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_uuv_simulator(tmp_path: Path) -> None:
    found = import_vehicle(written(tmp_path / "a.urdf", UUV))
    vehicle = found.vehicle
    assert found.source == "uuv-simulator"
    assert vehicle.rigid_body.mass == 18.5
    np.testing.assert_allclose(vehicle.rigid_body.centre_of_gravity, [-0.2 / 18.5, -0.05 / 18.5, 0.335 / 18.5])
    assert vehicle.buoyancy.centre == (0.01, -0.02, -0.06)
    assert vehicle.buoyancy.force == pytest.approx(1028.0 * 9.81 * 0.018, rel=1e-11)
    # hydrodynamic numbers stand in FRD there, none is turned
    expected = {"X_udot": -4.0, "X_vdot": -0.5, "Y_rdot": -0.7, "Z_qdot": 0.7, "Y_uv": -8.0, "N_ur": -3.0, "X_uu": -3.0}
    for name, value in expected.items():
        assert vehicle.coefficient(name) == value, name
    thruster = vehicle.thrusters[0]
    np.testing.assert_allclose(thruster.direction, [0.0, -1.0, 0.0], atol=1e-15)
    assert thruster.position == (-0.4, -0.1, -0.05)
    assert thruster.curve.static(np.array([3.0, -2.0])) == pytest.approx([0.5 * 0.01 * 36.0, -0.5 * 0.01 * 16.0])
    assert thruster.curve.limits == (-10.0, 20.0)
    assert thruster.time_constant == 0.05
    left = "\n".join(found.left)
    assert "X_rr = 1: acts on nothing there" in left
    assert "wobble" in left
    assert any("center_of_buoyancy" in each for each in found.doubts)


def classic() -> str:
    """The same vehicle as SDF of Gazebo classic."""
    plugins = UUV[UUV.index("<gazebo>") : UUV.rindex("</gazebo>")].replace("<gazebo>", "").replace("</gazebo>", "")
    return f"""<?xml version="1.0"?>
<sdf version="1.6"><world name="sea"><model name="ground"><static>1</static><link name="l"/></model><model name="small">
  <pose>0 0 -5 0 0 1</pose>
  <link name="small/base_link"><pose>0.1 0 0.2 0 0 0</pose>
    <inertial><mass>18.0</mass><pose>0 0 -0.02 0 0 0</pose><inertia><ixx>0.5</ixx><ixy>0.01</ixy><ixz>0.02</ixz>
      <iyy>0.8</iyy><iyz>0.03</iyz><izz>0.9</izz></inertia></inertial></link>
  <link name="small/thruster_0"><pose>-0.3 0.1 0.25 0 0 0.5</pose><inertial><mass>0.5</mass>
    <inertia><ixx>1e-4</ixx><iyy>1e-4</iyy><izz>1e-4</izz></inertia></inertial></link>
  <joint name="small/thruster_0_joint" type="revolute">
    <pose>0 0 0 0 0 1.0707963267948966</pose><parent>small/base_link</parent><child>small/thruster_0</child>
    <axis><xyz>1 0 0</xyz></axis></joint>
  {plugins}
</model></world></sdf>"""


def test_uuv_simulator_in_sdf_of_gazebo_classic_is_told_and_the_same_vehicle(tmp_path: Path) -> None:
    found = import_vehicle(written(tmp_path / "a.sdf", classic()))
    same = import_vehicle(written(tmp_path / "a.urdf", UUV)).vehicle
    assert found.source == "uuv-simulator"
    vehicle = found.vehicle
    assert vehicle.name == "small"
    assert vehicle.hydrodynamics == same.hydrodynamics
    assert vehicle.buoyancy == same.buoyancy
    np.testing.assert_allclose(vehicle.mass_matrix, same.mass_matrix, atol=1e-11)
    np.testing.assert_allclose(configuration_matrix(vehicle), configuration_matrix(same), atol=1e-12)
    assert vehicle.thrusters[0].curve == same.thrusters[0].curve
    assert "wobble" in "\n".join(found.left)
    assert "model ground" in found.left


XACRO = """<?xml version="1.0"?>
<robot name="$(arg name)" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="name" default="small"/>
  <xacro:include filename="$(find small_description)/urdf/thruster.xacro"/>
  <xacro:include filename="nowhere.xacro"/>
  <xacro:property name="mass" value="18.0"/>
  <xacro:property name="length" value="${2.0 * half}"/>
  <xacro:property name="half" value="0.2"/>
  <xacro:macro name="body" params="m:=1 *place **inertia">
    <link name="small/base_link"><inertial><mass value="${m}"/><xacro:insert_block name="place"/>
      <xacro:insert_block name="inertia"/></inertial></link>
  </xacro:macro>
  <xacro:body m="${mass}"><origin xyz="0 0 ${-mass / 900}" rpy="0 0 0"/>
    <box><inertia ixx="0.5" ixy="0.01" ixz="0.02" iyy="0.8" iyz="0.03" izz="0.9"/></box></xacro:body>
  <xacro:thruster number="0"><origin xyz="${-length} 0.1 0.05" rpy="0 0 ${pi / 2}"/></xacro:thruster>
  <xacro:unless value="${mass &gt; 10 and not false}"><nonsense/></xacro:unless>
  <xacro:lights count="2"/>
  REST
</robot>
"""
INCLUDED = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="thruster" params="number *origin">
    <link name="small/thruster_${number}"><inertial><mass value="0.5"/>
      <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
    <joint name="small/thruster_${number}_joint" type="continuous">
      <parent link="small/base_link"/><child link="small/thruster_${number}"/>
      <xacro:insert_block name="origin"/><axis xyz="1 0 0"/></joint>
  </xacro:macro>
</robot>
"""


def xacro(folder: Path, text: str) -> Path:
    """A package with a xacro that includes another."""
    inside = folder / "small_description"
    (inside / "urdf").mkdir(parents=True, exist_ok=True)
    (inside / "robots").mkdir(exist_ok=True)
    written(inside / "urdf" / "thruster.xacro", INCLUDED)
    return written(inside / "robots" / "small.urdf.xacro", text)


def test_a_xacro_is_expanded_without_ros(tmp_path: Path) -> None:
    rest = UUV[UUV.index("<gazebo>") : UUV.rindex("</robot>")]
    found = import_vehicle(xacro(tmp_path, XACRO.replace("REST", rest)))
    same = import_vehicle(written(tmp_path / "a.urdf", UUV)).vehicle
    assert found.source == "uuv-simulator"
    assert found.vehicle.model_copy(update={"provenance": same.provenance}) == same
    left = "\n".join(found.left)
    assert "xacro:include nowhere.xacro: no such file beside small.urdf.xacro" in left
    assert "xacro:lights: no such macro" in left


@pytest.mark.parametrize(
    ("rest", "words"),
    [
        ('<a b="${unknown}"/>', "no property unknown"),
        ('<a b="${__import__(1)}"/>', "not arithmetic"),
        ('<a b="${().__class__}"/>', "not arithmetic"),
        ('<a b="${9**9**9**9}"/>', "not arithmetic"),
        ('<a b="${1/0}"/>', "not arithmetic"),
        ('<a b="${sqrt(-1)}"/>', "not arithmetic"),
        ("<a b=\"${'a' * 100000}\"/>", "not arithmetic"),
        ('<a b="$(env HOME)"/>', "expected an argument with a default"),
        ('<xacro:if value="maybe"/>', "expected true, false or a number"),
        ('<xacro:insert_block name="x"/>', "which no macro was given"),
        ('<xacro:property name="p" value="${p}"/><a b="${p}"/>', "stands for itself"),
        ('<xacro:macro name="m" params="q"/><xacro:m/>', "a macro wants q"),
        ('<xacro:macro name="m" params="*q"/><xacro:m/>', "a macro wants a block"),
        ('<xacro:macro name="m"><a/><xacro:m/><xacro:m/></xacro:macro><xacro:m/>', "within each other"),
        (
            '<xacro:property name="p0" value="1"/>'
            + "".join(f'<xacro:property name="p{k + 1}" value="${{p{k} + p{k}}}"/>' for k in range(35))
            + '<a b="${p35}"/>',
            "expressions",
        ),
        (
            '<xacro:property name="p0" value="ha"/>'
            + "".join(f'<xacro:property name="p{k + 1}" value="${{p{k}}}${{p{k}}}"/>' for k in range(35))
            + '<a b="${p35}"/>',
            "characters",
        ),
        ('<xacro:include filename="small.urdf.xacro"/>', "none of them recognises it"),
        ("", "none of them recognises it"),
    ],
)
def test_a_xacro_that_is_not_understood_says_what_to_run(rest: str, words: str, tmp_path: Path) -> None:
    path = xacro(tmp_path, XACRO.replace("REST", rest))
    with pytest.raises(InputError) as error:
        import_vehicle(path)
    assert words in str(error.value)
    assert "xacro model.xacro > model.urdf" in str(error.value) or words.startswith(("none", "expected true", "within"))


@pytest.mark.parametrize(
    ("conversion", "commands", "forces"),
    [
        (
            "<type>Bessa</type><rotorConstantL>0.02</rotorConstantL><rotorConstantR>0.03</rotorConstantR>"
            "<deltaL>-16</deltaL><deltaR>36</deltaR>",
            [2.5, 4.0, -2.5, -1.5],
            [0.0, 0.5 * 0.03 * (64.0 - 36.0), -0.5 * 0.02 * (25.0 - 16.0), 0.0],
        ),
        (
            "<type>LinearInterp</type><inputValues>-10 0 10</inputValues><outputValues>-5 0 8</outputValues>",
            [2.5, -2.5, 9.0],
            [0.5 * 4.0, -0.5 * 2.5, 0.5 * 8.0],
        ),
    ],
)
def test_conversions_of_uuv_simulator(
    conversion: str, commands: list[float], forces: list[float], tmp_path: Path
) -> None:
    text = UUV.replace("<type>Basic</type><rotorConstant>0.01</rotorConstant>", conversion)
    [thruster] = import_vehicle(written(tmp_path / "a.urdf", text)).vehicle.thrusters
    np.testing.assert_allclose(thruster.curve.static(np.array(commands)), forces, atol=1e-12)


def test_gazebo_with_what_public_models_have_wrong(tmp_path: Path) -> None:
    found = import_vehicle(written(tmp_path / "a.sdf", SDF))
    vehicle, said, left = found.vehicle, "\n".join(found.doubts), "\n".join(found.left)
    assert vehicle.coefficient("X_udot") == 5.0
    for words in ("X_udot = 5: positive", "bluerov2_gz", "xUabsU meant", "link frame: no inertial", "Coriolis"):
        assert words in said, words
    for words in ("Hydrodynamics/waves", "yUabsV", "xQR", "plugin ArduPilotPlugin"):
        assert words in left, words
    assert "sensor" not in left
    # a negative coefficient turns the sense; the propeller's axis is that of its turned link
    T = configuration_matrix(vehicle)[:, 0]
    np.testing.assert_allclose(T[:2], [np.sqrt(0.5), -np.sqrt(0.5)], atol=1e-12)
    factor = vehicle.thrusters[0].curve.static(np.array([10.0]))[0]
    assert factor == pytest.approx(0.02 * 1000.0 * 1e-4 * 100.0)
    assert vehicle.buoyancy.centre == (0.0, 0.0, -0.06)
    assert all(each in vehicle.provenance.notes for each in (f"doubt: {line}" for line in found.doubts))


def test_added_mass_in_both_places_counts_twice_and_is_said(tmp_path: Path) -> None:
    path = export("lauv", "gz-sim", tmp_path / "m").files[0]
    text = path.read_text().replace("<water_density>", "<zDotW>-16</zDotW><water_density>")
    found = import_vehicle(written(path, text))
    assert found.vehicle.coefficient("Z_wdot") == 2.0 * load_vehicle("lauv").coefficient("Z_wdot")
    assert any("counts it twice" in each for each in found.doubts)


def test_models_that_are_known_are_told_by_their_numbers() -> None:
    def said(name: str) -> str:
        return "\n".join(doubts_of(load_vehicle(name)))

    assert "10.774 and 10.775" in said("rexrov")
    assert "LAUV" in said("lauv")
    assert "Wu (2018)" in said("bluerov2_heavy_wu")
    assert "62 and 79 kg m^2" in said("seamor")
    assert "Wu" not in said("bluerov2_heavy")


def test_every_coefficient_survives_the_way_through_gazebo(tmp_path: Path) -> None:
    """One at a time, so that no sign is hidden by another."""
    base = load_vehicle("rexrov")
    plain = base.model_copy(update={"hydrodynamics": {}, "thrusters": ()})
    names = [
        name for name in COEFFICIENTS if index(name)[0] in ("linear", "quadratic", "forward", "asymmetric", "mass")
    ]
    for k, name in enumerate(names[::3]):
        kind, i, j = index(name)
        if kind == "mass" and i > j:
            continue
        vehicle = Vehicle.model_validate(plain.model_dump() | {"hydrodynamics": {name: -1.0 - 0.1 * k}})
        found = import_vehicle(export(vehicle, "gz-sim", tmp_path / "m").files[0]).vehicle
        assert {key: each.value for key, each in found.hydrodynamics.items()} == {name: -1.0 - 0.1 * k}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not valid XML"),
        ("<sdf>", "not valid XML"),
        ("<html/>", "none of them recognises it"),
        ("<sdf/>", "found no <model>"),
        ('<sdf><model name="a"/></sdf>', "a model without links"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><sdf>&b;</sdf>', "document type or entities"),
        ('<!DOCTYPE a SYSTEM "file:///etc/passwd"><sdf/>', "document type or entities"),
        ('<!DOCTYPE z [<!ENTITY a "aaa"><!ENTITY b "&a;&a;">]><sdf>&b;</sdf>', "document type or entities"),
        ("<sdf>" + "<a>" * 100 + "</a>" * 100 + "</sdf>", "levels"),
        (SDF.replace("<mass>13</mass>", "<mass>${m}</mass>"), "expand the xacro first"),
        (SDF.replace("<mass>13</mass>", "<mass>nan</mass>"), "finite number"),
        (SDF.replace("<mass>13</mass>", "<mass>-20</mass>"), "expected a body's"),
        (SDF.replace("<child>prop</child>", "<child>pork</child>"), "expected a joint with its links"),
        (UUV.replace("-2 -23 -23 -0.3 -9 -9", "-2 -23"), "found 2 numbers, expected 6 or 36"),
        (UUV.replace("Basic", "Magic"), 'found a conversion "Magic"'),
    ],
)
def test_what_is_no_vehicle_is_one_clear_line(text: str, words: str, tmp_path: Path) -> None:
    path = written(tmp_path / "a.xml", text)
    with pytest.raises(InputError) as error:
        import_vehicle(path)
    assert words in str(error.value)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "a.sdf", SDF)
    ran = command("import", path, "-o", tmp_path / "b.toml")
    assert ran.code == 0
    assert "plugin ArduPilotPlugin" in ran.out
    assert "bluerov2_gz" in ran.err
    found = document("import", path, "-o", tmp_path / "c.toml")
    assert found["source"] == "gz-sim"
    assert found["coefficients"]["X_uu"] == -58.42
    with pytest.warns(VehicleWarning) as warned:
        assert load_vehicle(tmp_path / "c.toml").name == "rov"
    assert any("X_udot = +5 is positive" in str(each.message) for each in warned)
    assert "there are gz-sim" in refused("import", path, "--from", "gazebo")
    assert "ends in .toml" in refused("import", path, "-o", tmp_path / "b.yaml")
    assert "no such file" in refused("import", tmp_path / "none.sdf")
    assert "folder" in refused("import", tmp_path)
    monkeypatch.chdir(tmp_path)
    assert command("import", path).code == 0
    assert "rov.toml: is there already" in refused("import", path)
