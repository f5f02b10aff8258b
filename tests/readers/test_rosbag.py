"""ROS bags in every container: the same messages, the same recording; cut and damaged ones as far as they go."""

from __future__ import annotations

import sqlite3
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_typestore

from towtank.errors import InputError
from towtank.readers import read
from towtank.readers.ros.bag1 import scan_rosbag1
from towtank.readers.ros.bag2 import scan_rosbag2
from towtank.readers.ros.layout import decode
from towtank.readers.ros.types import types_of
from towtank.recording import ColumnMapping, Recording

from .ros_bags import (
    START,
    Said,
    header,
    imu,
    multi_array,
    odometry,
    register,
    write_bag1,
    write_bag2,
    write_mcap2,
    xyz,
)

N = 300
register(
    "rov_msgs/msg/Ping", "std_msgs/Header header\nfloat32[3] speed\nrov_msgs/Beam[] beams\nstring remark\nbool good"
)
register("rov_msgs/msg/Beam", "int8 number\nfloat64 range\nstring name")


def session(n: int = N) -> list[Said]:
    """Odometry, an IMU, thrusters, and a message of one's own with arrays and texts that change their lengths."""
    said = []
    for k in range(n):
        t = 0.02 * k
        angle = 0.005 * k
        q = [np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]
        place = odometry(t, "odom", "base_link", [t, 2 * t, -1 - t], q, [0.5, 0.1 * t, -t], [0, 0, 0.25])
        beams = [{"number": -b, "range": 1.5 * b + k, "name": "x" * b} for b in range(k % 4)]
        ping = {"header": header(t, "dvl"), "speed": np.array([k, -k, 0.5], "f4"), "beams": beams}
        said += [
            Said("/odom", t, "nav_msgs/msg/Odometry", place),
            Said("/imu/data", t + 0.004, "sensor_msgs/msg/Imu", imu(t, "", q, [0.1 * k, 0, -1], [0.1, 0.001 * k, 9.8])),
            Said("/thrusters", t + 0.006, "std_msgs/msg/Float64MultiArray", multi_array([k, -k, 0])),
            Said("/ping", t + 0.008, "rov_msgs/msg/Ping", {**ping, "remark": "é" * (k % 3), "good": k % 5 > 0}),
        ]
    return said


def session_of_registered(n: int = N) -> list[Said]:
    """The same with the beams as messages."""
    from .ros_bags import ROS2

    def built(said: Said) -> Said:
        if said.topic != "/ping":
            return said
        beam = ROS2.types["rov_msgs/msg/Beam"]
        return said._replace(fields={**said.fields, "beams": [beam(**each) for each in said.fields["beams"]]})

    return [built(said) for said in session(n)]


MAPPING = ColumnMapping.model_validate(
    {"columns": {"u": "/ping.speed[0]", "z": "/ping.beams[2].range", "r": "/imu/data.angular_velocity.z"}}
)


def containers(folder: Path) -> dict[str, Path]:
    said = session_of_registered()
    (folder / "d").mkdir()
    database = write_bag2(folder / "d" / "bag", said) / "bag.db3"
    old = folder / "old.db3"  # a recording of before 2023 has no definitions
    old.write_bytes(database.read_bytes())
    with sqlite3.connect(old) as connection:
        connection.execute("DROP TABLE message_definitions")
    connection.close()
    return {
        "bag": write_bag1(folder / "a.bag", said),
        "bz2": write_bag1(folder / "b.bag", said, "BZ2"),
        "lz4": write_bag1(folder / "c.bag", said, "LZ4"),
        "folder": database.parent,
        "old": old,
        "mcaps": write_bag2(folder / "f", said, "MCAP"),
        "by message": write_bag2(folder / "g", said, more=(CompressionMode.MESSAGE, CompressionFormat.ZSTD)),
        "by file": write_bag2(folder / "h", said, more=(CompressionMode.FILE, CompressionFormat.ZSTD)),
        "mcap": write_mcap2(folder / "i.mcap", said),
        "db3": database,
    }


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return containers(tmp_path_factory.mktemp("bags"))


NAMES = (*"xyz", "qw", "qx", "qy", "qz", *"uvw", *"pqr", "ax", "ay", "az", "cmd_1", "cmd_2", "cmd_3")
KINDS = ["bag", "bz2", "lz4", "folder", "old", "mcaps", "by message", "by file", "mcap", "db3"]


def told(run: Recording) -> dict[str, tuple[bytes, bytes]]:
    return {name: (channel.t.tobytes(), channel.values.tobytes()) for name, channel in run.channels.items()}


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_messages_in_any_container(bags: dict[str, Path], kind: str) -> None:
    run, reference = read(bags[kind]), read(bags["bag"])
    assert run.names == NAMES
    assert told(run) == told(reference)
    assert not run.repairs
    assert run.notes == reference.notes
    assert run.attributes == {"clock": "recorder", "epoch": "2023-11-14T22:13:20+00:00"}
    assert [(each.name, each.count, each.used) for each in run.contents] == [
        ("/odom", N, ("x", "y", "z", "u", "v", "w")),
        ("/imu/data", N, ("qw", "qx", "qy", "qz", "p", "q", "r", "ax", "ay", "az")),
        ("/thrusters", N, ("cmd_1", "cmd_2", "cmd_3")),
        ("/ping", N, ()),
    ]
    if kind != "old":
        assert "speed[3], beams[].number, beams[].range, good" in run.contents[3].reason


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "old"])
def test_a_message_of_ones_own_by_a_mapping(bags: dict[str, Path], kind: str) -> None:
    run = read(bags[kind], MAPPING)
    assert run.names == ("u", "z", "r")
    assert np.array_equal(run["u"].values, np.arange(N))
    assert np.array_equal(run["z"].values, 3.0 + np.arange(N)[np.arange(N) % 4 == 3])
    assert np.allclose(run["r"].values, -1.0)


def test_without_a_definition_it_is_listed_and_refused(bags: dict[str, Path]) -> None:
    reason = next(each.reason for each in read(bags["old"]).contents if each.name == "/ping")
    assert reason == "not decoded: its definition is neither in the file nor known"
    with pytest.raises(InputError, match=r'no "/ping\.speed\[0\]"'):
        read(bags["old"], MAPPING)


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_every_number_is_that_of_the_library(bags: dict[str, Path], kind: str) -> None:
    """Whole columns read by one view of the bytes against objects made message by message."""
    scan = scan_rosbag1 if kind == "bag" else lambda path, wanted: (_mcap_topics(path), None)
    topics, _ = scan(bags[kind], lambda name, kind: True)
    with AnyReader([bags[kind]]) as bag:
        said: dict[str, list[Any]] = {}
        for connection, _, raw in bag.messages():
            said.setdefault(connection.topic, []).append(bag.deserialize(raw, connection.msgtype))
    checked = 0
    for topic in topics:
        assert topic.raw is not None
        types = types_of(topic.kind, *topic.definition, kind == "bag")
        found = decode(topic.raw, topic.kind, types, ros1=kind == "bag")
        assert found.good.all()
        for path, column in found.columns.items():
            expected = [_at(message, path) for message in said[topic.name]]
            assert np.array_equal(column, expected, equal_nan=True), path
            checked += len(expected)
        if topic.name == "/odom":
            assert found.texts["child_frame_id"] == ("base_link",) * N
    assert checked > 19_000


def _mcap_topics(path: Path) -> Any:
    from towtank.readers.mcap.scan import scan_mcap

    return scan_mcap(path, lambda heading: True).topics


def _at(message: Any, path: str) -> float:
    value = message
    for part in path.replace("[", ".").replace("]", "").split("."):
        if part.isdigit():
            if int(part) >= len(value):
                return float("nan")
            value = value[int(part)]
        else:
            value = getattr(value, part)
    return float(value)


def test_big_endian_messages(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    message = store.types["geometry_msgs/msg/Vector3"](x=1.5, y=-2.0, z=1e300)
    from towtank.readers.common.raw_messages import RawMessages

    raw = RawMessages.of(
        [bytes(store.serialize_cdr(message, message.__msgtype__, little_endian=k % 2 == 0)) for k in range(6)]
    )
    found = decode(raw, message.__msgtype__, types_of(message.__msgtype__, "", "", False), ros1=False)
    assert found.good.all()
    assert np.array_equal(found.columns["z"], np.full(6, 1e300))


def test_a_bag_cut_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rosbags.rosbag1.writer.Writer.__init__", _small_chunks())
    data = write_bag1(tmp_path / "a.bag", session_of_registered()).read_bytes()
    whole = read(tmp_path / "a.bag")
    counts = []
    for cut in range(len(data) // 4, len(data), len(data) // 40):
        (tmp_path / "cut.bag").write_bytes(data[:cut])
        part = read(tmp_path / "cut.bag")
        counts.append(len(part["cmd_1"]))
        assert np.array_equal(part["cmd_1"].values, whole["cmd_1"].values[: counts[-1]])
        assert any("no end" in line for line in part.repairs.lines)
    assert counts == sorted(counts)
    assert counts[-1] == N


def _small_chunks() -> Any:
    from rosbags.rosbag1.writer import Writer

    original = Writer.__init__

    def init(self: Any, path: Any) -> None:
        original(self, path)
        self.chunk_threshold = 4096

    return init


def test_reading_goes_on_behind_a_broken_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rosbags.rosbag1.writer.Writer.__init__", _small_chunks())
    data = bytearray(write_bag1(tmp_path / "a.bag", session_of_registered()).read_bytes())
    at = data.find(b"op=\x05", len(data) // 3)
    data[at - 4 : at] = b"\xff\xff\xff\xff"
    (tmp_path / "b.bag").write_bytes(data)
    part = read(tmp_path / "b.bag")
    assert 0.8 * N < len(part["cmd_1"]) < N
    assert part["cmd_1"].values[-1] == N - 1
    assert any("make no record" in line for line in part.repairs.lines)


def test_broken_pages_of_a_database(bags: dict[str, Path], tmp_path: Path) -> None:
    data = bytearray(bags["db3"].read_bytes())
    page = 4096
    middle = len(data) // page // 2 * page
    data[middle : middle + page] = bytes(page)
    (tmp_path / "a.db3").write_bytes(data)
    part = read(tmp_path / "a.db3")
    assert 0.8 * N < len(part["cmd_1"]) < N
    assert part["cmd_1"].values[-1] == N - 1
    assert 0 < part.repairs.damaged < 0.8 * N
    assert any("broken" in line for line in part.repairs.lines)


def test_a_database_that_is_no_bag(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "a.db3") as database:
        database.execute("CREATE TABLE birds (name TEXT)")
    database.close()
    with pytest.raises(InputError, match="without topics and messages"):
        read(tmp_path / "a.db3")


def test_the_latest_messages_may_stand_in_the_journal(tmp_path: Path, bags: dict[str, Path]) -> None:
    (tmp_path / "a.db3").write_bytes(bags["db3"].read_bytes())
    database = sqlite3.connect(tmp_path / "a.db3", isolation_level=None)
    database.execute("PRAGMA journal_mode = wal")
    database.execute("DELETE FROM messages WHERE id > 1000")
    assert len(read(tmp_path / "a.db3")["cmd_1"]) == 250
    database.close()


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.bag", b"#ROSBAG V1.2\n" + bytes(99), "found '#ROSBAG V1.2', expected a ROS bag of version 2.0"),
        ("a.bag", b"#ROSBAG V2.0\n", r"no message that can be used; it has no messages"),
        ("a.bag", b"#ROSBAG V2.0\n" + b"\xff" * 100_000, "no message that can be used"),
        ("a.db3", b"SQLite format 3\0" + bytes(2000), "not a readable ROS 2 bag|without topics"),
    ],
)
def test_foreign_and_empty_files_are_one_line(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message) as raised:
        read(tmp_path / name)
    assert "\n" not in str(raised.value)


def test_a_wrong_suffix_does_not_matter(bags: dict[str, Path], tmp_path: Path) -> None:
    for kind, name in (("bag", "a.mcap"), ("mcap", "b.bag"), ("db3", "c.csv")):
        (tmp_path / name).write_bytes(bags[kind].read_bytes())
        assert told(read(tmp_path / name)) == told(read(bags["bag"]))


def test_an_array_that_claims_to_be_huge_is_damaged(tmp_path: Path) -> None:
    good = session_of_registered(50)
    path = write_mcap2(tmp_path / "a.mcap", good, enable_crcs=False)
    topic = next(topic for topic in _mcap_topics(path) if topic.name == "/thrusters")
    assert topic.raw is not None
    data = topic.raw.data.copy()
    size = int(topic.raw.size[0])
    for row in (3, 17):
        struct.pack_into("<I", data, row * size + 12, 0xFFFF_FFFF)
    from towtank.readers.common.raw_messages import RawMessages

    found = decode(
        RawMessages(data, topic.raw.size), topic.kind, types_of(topic.kind, *topic.definition, False), ros1=False
    )
    assert np.array_equal(np.flatnonzero(~found.good), [3, 17])
    assert np.array_equal(found.columns["data[0]"][found.good], np.delete(np.arange(50.0), [3, 17]))


def test_messages_out_of_order_are_sorted_and_counted(tmp_path: Path) -> None:
    said = session_of_registered(40)
    said[8:12], said[12:16] = said[12:16], said[8:12]
    for path in (
        write_bag1(tmp_path / "a.bag", said),
        write_bag2(tmp_path / "b", said),
        write_mcap2(tmp_path / "c.mcap", said),
    ):
        run = read(path)
        assert np.array_equal(run["cmd_1"].values, np.arange(40))
        assert run.repairs.disorder == 4


def test_no_message_is_wanted_that_means_nothing(bags: dict[str, Path]) -> None:
    topics, _ = scan_rosbag2(bags["db3"], lambda name, kind: name == "/imu/data")
    kept = {topic.name: topic.raw is not None for topic in topics}
    assert kept == {"/odom": False, "/imu/data": True, "/thrusters": False, "/ping": False}
    assert {len(topic) for topic in topics} == {N}
    assert min(int(topic.log_time[0]) for topic in topics) == START


def test_topics_of_two_types_are_two_tables(tmp_path: Path) -> None:
    said = session_of_registered(20)
    vector = {"header": header(0.0, "base_link"), "vector": xyz([1, 2, 3])}
    path = write_mcap2(tmp_path / "a.mcap", [*said, Said("/velocity", 0.5, "geometry_msgs/msg/Vector3Stamped", vector)])
    assert [each.name for each in read(path).contents][-1] == "/velocity"
