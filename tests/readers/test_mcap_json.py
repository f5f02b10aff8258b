"""JSON in MCAP: MAVLink as BlueOS records it gives what a telemetry log gives; other topics by a mapping."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from towtank.errors import InputError
from towtank.readers import read
from towtank.readers.common.raw_messages import RawMessages, Topic
from towtank.readers.common.tables import Table
from towtank.readers.mcap.json import is_mavlink, json_table, mavlink_tables
from towtank.recording import ColumnMapping

START = 1_700_000_000_000_000_000


def write(path: Path, messages: Iterable[tuple[str, float, Any]]) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=20_000)
        writer.start()
        schema = writer.register_schema("mavlink", "jsonschema", b"{}")
        channels: dict[str, int] = {}
        for topic, t, content in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schema)
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            moment = START + round(t * 1e9)
            writer.add_message(channels[topic], moment, data, moment)
        writer.finish()
    return path


def said(kind: str, component: int = 1, **fields: Any) -> dict[str, Any]:
    return {
        "header": {"system_id": 1, "component_id": component, "sequence": 0},
        "message": {"type": kind, **fields},
    }


def heartbeat() -> dict[str, Any]:
    return said(
        "HEARTBEAT",
        custom_mode=19,
        mavtype={"type": "MAV_TYPE_SUBMARINE"},
        autopilot={"type": "MAV_AUTOPILOT_ARDUPILOTMEGA"},
        base_mode={"bits": 81},
        system_status={"type": "MAV_STATE_ACTIVE"},
        mavlink_version=3,
    )


def parameter(name: str, value: float) -> dict[str, Any]:
    return said(
        "PARAM_VALUE",
        param_value=value,
        param_count=900,
        param_index=1,
        param_id=list(name.ljust(16, "\0")),
        param_type={"type": "MAV_PARAM_TYPE_REAL32"},
    )


def dive(n: int = 200) -> list[tuple[str, float, Any]]:
    out = "mavlink/out"
    messages: list[tuple[str, float, Any]] = [(out, 0.0, heartbeat())]
    messages += [(out, 0.1, parameter(f"SERVO{k}_FUNCTION", 32.0 + k)) for k in (1, 2)]
    messages += [(out, 0.1, parameter("MOT_2_DIRECTION", -1.0))]
    for k in range(n):
        t = 0.2 + 0.05 * k
        attitude = {"roll": 0.01 * k, "pitch": None if k == 5 else 0.2, "yaw": 1.0, "yawspeed": 0.1 * k}
        rates = {"rollspeed": 0.0, "pitchspeed": 0.0, "time_boot_ms": 5000 + 50 * k}
        servos = {f"servo{j}_raw": 1500 + j * k % 400 for j in range(1, 9)}
        messages.append((out, t, said("ATTITUDE", **attitude, **rates)))
        messages.append((out, t, said("SERVO_OUTPUT_RAW", time_usec=(5000 + 50 * k) * 1000, port=0, **servos)))
        messages.append(("mavlink/1/1/ATTITUDE", t, said("ATTITUDE", **attitude, **rates)))
    return messages


def test_mavlink_of_a_vehicle_that_runs_blueos(tmp_path: Path) -> None:
    run = read(write(tmp_path / "a.mcap", dive()))
    assert run.names == ("phi", "theta", "psi", "p", "q", "r", "cmd_1", "cmd_2", "armed", "mode")
    assert np.allclose(run["phi"].values, 0.01 * np.arange(200))
    assert len(run["theta"]) == 199
    assert np.allclose(run["r"].values, 0.1 * np.arange(200))
    assert np.array_equal(run["cmd_1"].values, 1500 + np.arange(200))
    assert np.array_equal(run["cmd_2"].values, 3000 - (1500 + 2 * np.arange(200) % 400))
    assert np.allclose(np.diff(run["r"].t), 0.05)
    assert run.attributes["epoch"] == "2023-11-14T22:13:20+00:00"
    counts = {each.name: each.count for each in run.contents}
    assert counts == {"HEARTBEAT": 1, "PARAM_VALUE": 3, "ATTITUDE": 200, "SERVO_OUTPUT_RAW": 200}


def test_without_the_topic_of_all_messages_those_of_each_type_are_taken(tmp_path: Path) -> None:
    messages = [("mavlink/1/1/HEARTBEAT", 0.0, heartbeat()), *(each for each in dive() if each[0] != "mavlink/out")]
    run = read(write(tmp_path / "a.mcap", messages))
    assert np.allclose(run["phi"].values, 0.01 * np.arange(200))


def test_broken_messages_are_counted(tmp_path: Path) -> None:
    odd = [b"{", b"[]", b'{"header": 3}', b"\xff\xfe", b'{"header": {"system_id": 1}, "message": {}}', b"[" * 100_000]
    run = read(write(tmp_path / "a.mcap", [*dive(), *(("mavlink/out", 11.0, each) for each in odd)]))
    assert run.repairs.damaged == len(odd)
    assert len(run["phi"]) == 200


def test_topics_of_any_other_kind_by_a_mapping(tmp_path: Path) -> None:
    def tracked(k: int) -> dict[str, Any]:
        return {"body": {"position": [k, 2.0 * k, True], "name": "rov"}, "quality": 0.9 if k % 2 else None}

    messages = [("/tracker", 0.01 * k, tracked(k)) for k in range(100)]
    path = write(tmp_path / "a.mcap", [*messages, ("/tracker", 2.0, b"}")])
    mapping = ColumnMapping.model_validate(
        {"columns": {"x": "/tracker.body.position[1]", "u": "/tracker.quality"}, "world": "NED"}
    )
    run = read(path, mapping)
    assert np.array_equal(run["x"].values, 2.0 * np.arange(100))
    assert len(run["u"]) == 50
    assert run.repairs.damaged == 1
    with pytest.raises(InputError, match="no message that can be used; it has /tracker; name what is what"):
        read(path)
    both = write(tmp_path / "b.mcap", [*dive(), *messages])
    mixed = ColumnMapping.model_validate({"columns": {"x": "/tracker.body.position[0]", "phi": "ATTITUDE.roll"}})
    assert np.array_equal(read(both, mixed)["x"].values, np.arange(100))
    assert next(each for each in read(both).contents if each.name == "/tracker").reason == (
        "beside MAVLink messages nothing else is taken"
    )


def test_a_telemetry_log_and_the_same_messages_in_json(data: Path, tmp_path: Path) -> None:
    """Every channel to the bit, and the same said of every message."""
    whole = data / "ardusub_samples" / "small.tlog"
    if not whole.is_file():
        pytest.skip(f"no {whole}")
    tlog = tmp_path / "a.tlog"
    tlog.write_bytes(whole.read_bytes()[:400_000])
    from pymavlink import mavutil
    from pymavlink.dialects.v20 import ardupilotmega

    def told(message: Any, name: str) -> Any:
        value = getattr(message, name)
        enum = message.fieldenums_by_name.get(name)
        if isinstance(value, (bytes, str)):
            return list((value if isinstance(value, str) else value.decode(errors="replace")).ljust(16, "\0"))
        if enum and message.fielddisplays_by_name.get(name) == "bitmask":
            return {"bits": value}
        if enum and value in ardupilotmega.enums[enum]:
            return {"type": ardupilotmega.enums[enum][value].name}
        return None if isinstance(value, float) and value != value else value

    messages: list[tuple[str, float, Any]] = []
    log = mavutil.mavlink_connection(str(tlog))
    while (message := log.recv_match()) is not None:
        if message.get_type() != "BAD_DATA":
            fields = {"mavtype" if name == "type" else name: told(message, name) for name in message.fieldnames}
            head = {"system_id": message.get_srcSystem(), "component_id": message.get_srcComponent()}
            moment = message._timestamp - START / 1e9
            messages.append(
                ("mavlink/out", moment, {"header": head, "message": {"type": message.get_type(), **fields}})
            )
    log.close()
    found, reference = read(write(tmp_path / "a.mcap", messages)), read(tlog)
    assert found.names == reference.names
    for name in reference.names:
        assert np.array_equal(found[name].values, reference[name].values), name
        assert np.allclose(found[name].t, reference[name].t, atol=1e-6)
    assert found.notes == reference.notes
    lines = {each.name: (each.count, each.used, each.reason) for each in found.contents}
    assert lines == {each.name: (each.count, each.used, each.reason) for each in reference.contents}


def tabled(*messages: Any) -> tuple[Table, int]:
    data = [each if isinstance(each, bytes) else json.dumps(each).encode() for each in messages]
    times = START + np.arange(len(data)) * 10**9
    return json_table(Topic("/own", "", "json", times, RawMessages.of(data)), START)


def test_fields_of_every_shape_are_columns_by_their_path() -> None:
    found, damaged = tabled(
        {"a": 1, "on": True, "deep": {"x": 1.5, "list": [1, 2]}, "name": "first\0rest", "word": ["o", "k", "\0", "x"]},
        {"a": None, "on": False, "deep": {"list": [3]}, "b": 10**400, "name": "second", "word": []},
        b"{broken",
        5,
    )
    assert damaged == 1
    assert (found.t.tolist(), found.kind) == ([0.0, 1.0, 3.0], "JSON")
    nan = np.nan
    expected = {
        **{"a": [1.0, nan, nan], "on": [1.0, 0.0, nan], "b": [nan, nan, nan], "value": [nan, nan, 5.0]},
        **{"deep.x": [1.5, nan, nan], "deep.list[0]": [1.0, 3.0, nan], "deep.list[1]": [2.0, nan, nan]},
    }
    assert found.columns.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(found.columns[name], values, name)
    assert found.text == {"name": ("first", "second", ""), "word": ("ok", "", "")}


def test_long_lists_deep_objects_and_many_fields_are_cut() -> None:
    nested: Any = 1.0
    for _ in range(12):
        nested = {"in": nested}
    found, _ = tabled({"list": list(range(100)), "deep": nested, **{f"f{k:03}": k for k in range(600)}})
    assert sum(name.startswith("list[") for name in found.columns) == 64
    assert not any(name.startswith("deep") for name in found.columns)
    assert len(found.columns) == 512
    seven: Any = 1.0
    for _ in range(7):
        seven = {"in": seven}
    assert list(tabled({"deep": seven})[0].columns) == ["deep" + ".in" * 7]


def test_a_topic_that_is_not_kept_has_times_alone() -> None:
    found, damaged = json_table(Topic("/own", "kind", "json", START + np.arange(3), None), START)
    assert (len(found), found.columns, found.kind, damaged) == (3, {}, "kind", 0)


@pytest.mark.parametrize(
    ("name", "encoding", "told"),
    [
        ("mavlink/1/1/ATTITUDE", "json", True),
        ("/mavlink/out", "json", True),
        ("mavlink", "json", False),
        ("mavlink/out", "cdr", False),
        ("x/mavlink/out", "json", False),
    ],
)
def test_topics_of_mavlink_are_known_by_name_and_encoding(name: str, encoding: str, told: bool) -> None:
    assert is_mavlink(name, encoding) is told


def test_constants_are_numbers_by_their_names() -> None:
    submarine = {"mavtype": {"type": "MAV_TYPE_SUBMARINE"}, "base_mode": {"bits": 81}, "autopilot": "MAV_AUTOPILOT_PX4"}
    flags = "MAV_MODE_FLAG_SAFETY_ARMED | MAV_MODE_FLAG_HIL_ENABLED"
    data = [
        said("HEARTBEAT", **submarine),
        said("HEARTBEAT", mavtype={"type": "NO_SUCH_NAME"}, flags=flags),
        {"header": {}, "message": {}},
        said("HEARTBEAT", component=190),
    ]
    raw = RawMessages.of([json.dumps(each).encode() for each in data])
    topic = Topic("mavlink/out", "", "json", START + np.arange(4) * 10**9, raw)
    tables, senders, damaged = mavlink_tables([topic], START)
    assert damaged == 1
    assert sorted(str(each) for each in senders.values()) == ["1.1", "1.190"]
    [own] = [table for name, table in tables.items() if str(senders[name]) == "1.1"]
    np.testing.assert_array_equal(own["type"], [12.0, np.nan])
    np.testing.assert_array_equal(own["base_mode"], [81.0, np.nan])
    np.testing.assert_array_equal(own["autopilot"], [12.0, np.nan])
    np.testing.assert_array_equal(own["flags"], [np.nan, 128.0 + 32.0])
