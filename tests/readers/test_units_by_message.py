"""What an autopilot's messages mean by their names: units, signs, fixes, arrays, parts of a bag."""

from __future__ import annotations

import sqlite3

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.readers import read
from towtank.readers.common.column_names import suggestion
from towtank.readers.common.skeleton import found_tables, mapping_skeleton
from towtank.readers.dataflash.reader import tables_of
from towtank.readers.ros.types import types_of

from .encoders import dive_bin
from .ros_bags import Said, multi_array, write_bag2


@pytest.mark.parametrize(
    "table, field, quantity, channel, scale",
    [
        ("GLOBAL_POSITION_INT", "vx", "world velocity", "vn", 0.01),  # cm/s
        ("GLOBAL_POSITION_INT", "vz", "world velocity", "vd", 0.01),
        ("LOCAL_POSITION_NED", "vy", "world velocity", "ve", 1.0),  # m/s
        ("RAW_IMU", "xgyro", "rates", "p", 1e-3),  # mrad/s
        ("SCALED_IMU2", "zacc", "specific force", "az", 9.80665e-3),  # thousandths of g
        ("ATTITUDE", "yawspeed", "rates", "r", 1.0),
    ],
)
def test_fields_of_mavlink_have_the_units_of_their_messages(table, field, quantity, channel, scale):
    found = suggestion(field, table, "MAVLink")
    assert found is not None
    assert (found.quantity, found.channel, found.scale) == (quantity, channel, pytest.approx(scale))


def test_angles_of_dataflash_are_degrees_and_heights_point_up():
    roll, height = suggestion("Roll", "ATT", "DataFlash"), suggestion("altitude_m")
    assert roll is not None
    assert height is not None
    assert (roll.unit, roll.scale) == ("deg", pytest.approx(np.pi / 180.0))
    assert (height.channel, height.scale) == ("z", -1.0)


@pytest.mark.parametrize("status, fixed", [(2, False), (3, True), (4, True)])
def test_satellites_are_there_from_a_fix_in_three_dimensions_on(tmp_path, status, fixed):
    log = dive_bin(dvl=False)
    log.define("GPS", "QBBIHB", "TimeUS,I,Status,GMS,GWk,NSats")
    for k in range(5):
        log.add("GPS", 104_000_000 + 100_000 * k, 0, status, 259_200_000 + 100 * k, 2290, 12)
    path = tmp_path / "dive.BIN"
    path.write_bytes(log.data)
    (filtered,) = [content for content in read(path).contents if content.name == "XKF1[0]"]
    assert ("satellites alone aid it, and are not heard under water" in filtered.reason) is fixed
    assert ("vn" in filtered.used) is not fixed  # else the filter's word is taken that its velocity is aided


def test_an_array_in_a_record_is_a_column_for_each_element(tmp_path):
    log = dive_bin(1.0)
    number, size = 250, 3 + 8 + 64
    log.data += (
        b"\xa3\x95\x80" + bytes((number, size)) + b"ISBD" + b"Qa".ljust(16, b"\0") + b"TimeUS,x".ljust(64, b"\0")
    )
    values = np.arange(-16, 16, dtype="<i2")
    for k in range(3):
        stamp = np.array([100_000_000 + k], "<u8").tobytes()
        log.data += bytes((0xA3, 0x95, number)) + stamp + (values + k).astype("<i2").tobytes()
    path = tmp_path / "dive.BIN"
    path.write_bytes(log.data)
    table = tables_of(path).tables["ISBD"]
    assert [f"x[{k}]" in table for k in (0, 31, 32)] == [True, True, False]
    for k in (0, 1, 31):
        np.testing.assert_array_equal(table[f"x[{k}]"], [k - 16, k - 15, k - 14])


@pytest.mark.parametrize("damage", [b"\xa3\x95", b"\xa3\x95\xff", b"\xa3\x95\x80", b"\xa3\x95\x97" + b"\0" * 9])
def test_bytes_that_look_like_the_start_of_a_record_cost_the_records_they_fall_on(tmp_path, damage):
    whole, broken = tmp_path / "whole.BIN", tmp_path / "broken.BIN"
    data = bytes(dive_bin().data)
    whole.write_bytes(data)
    at = data.index(b"\xa3\x95", len(data) // 2)
    broken.write_bytes(data[:at] + damage + data[at:])
    one, two = read(whole), read(broken)
    assert one.names == two.names
    for name in one.names:
        assert len(two[name]) >= len(one[name]) - 1
        np.testing.assert_array_equal(two[name].values[-20:], one[name].values[-20:])
    assert two.repairs.damaged >= 1


def test_the_parts_of_a_bag_are_one_log_in_order_of_time(tmp_path):
    said = [Said("/thrusters", 0.02 * k, "std_msgs/msg/Float64MultiArray", multi_array([k, -k])) for k in range(40)]
    said += [Said("/depth", 0.02 * k, "std_msgs/msg/Float64MultiArray", multi_array([0.1 * k])) for k in range(20)]
    whole = write_bag2(tmp_path / "whole", said)
    parts = tmp_path / "parts"
    parts.mkdir()
    (parts / "metadata.yaml").write_bytes((whole / "metadata.yaml").read_bytes())
    half = int(sqlite3.connect(whole / "whole.db3").execute("SELECT avg(timestamp) FROM messages").fetchone()[0])
    for name, late in (("parts_0.db3", "<"), ("parts_1.db3", ">=")):
        (parts / name).write_bytes((whole / "whole.db3").read_bytes())
        database = sqlite3.connect(parts / name)
        database.execute(f"DELETE FROM messages WHERE NOT timestamp {late} ?", (half,))
        database.commit()
        database.close()
    mapping = {"columns": {"z": "/depth.data[0]", "u": "/thrusters.data[1]"}, "thrusters": ["/thrusters.data[0]"]}
    one, two = read(whole, mapping), read(parts, mapping)
    assert one.names == two.names
    for name in one.names:
        np.testing.assert_array_equal(one[name].t, two[name].t)
        np.testing.assert_array_equal(one[name].values, two[name].values)
    assert len(two["u"]) == 40
    assert two.repairs.disorder == 0


def test_types_are_understood_from_idl_of_several_parts():
    line = "=" * 80 + "\n"
    depth = "module rov { module msg { struct Depth { double z; rov::msg::Note note; }; }; };\n"
    note = "module rov { module msg { struct Note { long code; }; }; };\n"
    definition = f"{line}IDL: rov/msg/Depth\n{depth}{line}IDL: rov/msg/Note\n{note}"
    types = types_of("rov/msg/Depth", definition, "ros2idl", ros1=False)
    assert [name for name, _ in types["rov/msg/Depth"]] == ["z", "note"]
    assert [name for name, _ in types["rov/msg/Note"]] == ["code"]


@pytest.mark.parametrize("look", [read, found_tables])
def test_what_a_library_raises_is_said_in_one_line(tmp_path, monkeypatch, look):
    path = tmp_path / "dive.csv"
    path.write_text("t,u\n0,1\n1,2\n2,3\n")

    def broken(*arguments: object) -> None:
        raise ZeroDivisionError("no rows\nat all")

    for name in ("read_csv", "read_columns"):
        monkeypatch.setattr(f"towtank.recording.tables.csv.{name}", broken)
    with pytest.raises(InputError) as said:
        look(path)
    assert str(said.value) == f"{path}: damaged, cannot be read as CSV (no rows)"


def test_a_file_that_the_system_does_not_give_is_said_in_its_words(tmp_path, monkeypatch):
    path = tmp_path / "dive.csv"
    path.write_text("t,u\n0,1\n1,2\n2,3\n")

    def broken(*arguments: object) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr("towtank.recording.tables.csv.read_csv", broken)
    with pytest.raises(InputError) as said:
        read(path)
    assert str(said.value) == f"{path}: cannot be read (Input/output error)"


def test_a_skeleton_lists_what_it_does_not_name_in_lines_that_fit(tmp_path):
    path = tmp_path / "dive.BIN"
    path.write_bytes(dive_bin().data)
    lines = mapping_skeleton(path).text.splitlines()
    rest = lines[lines.index("# What else the log holds:") :]
    assert max(map(len, rest)) <= 120
    at = rest.index(
        "#   BARO[1], 10 Hz: TimeUS (1e+08 .. 1.039e+08), I (always 1), Alt (-2.39 .. -2), Press (119600 .. 123422)"
    )
    assert rest[at + 1] == "#     Temp (always 12)"
    assert not any("GyrX" in line for line in rest)  # it is named above
