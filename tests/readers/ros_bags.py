"""Bags made by hand, with the writers of rosbags and mcap: the same messages in every container."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START = 1_700_000_000_000_000_000  # ns
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)


class Said(NamedTuple):
    """One message: topic, time of recording [s], its type and its fields (texts, numbers, dictionaries of them)."""

    topic: str
    t: float
    kind: str
    fields: dict[str, Any]


def register(kind: str, definition: str) -> None:
    """Make a type of one's own known to both generations."""
    for store in (ROS1, ROS2):
        if kind not in store.fielddefs:
            store.register(get_types_from_msg(definition, kind))


def header(t: float, frame: str, offset: float = 0.0) -> dict[str, Any]:
    """Return a header whose stamp is t [s] after the start, on a clock that is `offset` ahead."""
    stamp = START + round((t + offset) * 1e9)
    return {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": frame}


def xyz(values: Iterable[float]) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))


def xyzw(values: Iterable[float]) -> dict[str, float]:
    """Return a quaternion given as w x y z."""
    w, x, y, z = map(float, values)
    return {"x": x, "y": y, "z": z, "w": w}


def imu(t: float, frame: str, q: Sequence[float], rates: Sequence[float], force: Sequence[float]) -> dict[str, Any]:
    covariance = np.zeros(9)
    return {
        "header": header(t, frame),
        "orientation": xyzw(q),
        "orientation_covariance": covariance,
        "angular_velocity": xyz(rates),
        "angular_velocity_covariance": covariance,
        "linear_acceleration": xyz(force),
        "linear_acceleration_covariance": covariance,
    }


def odometry(
    t: float, frame: str, child: str, place: Sequence[float], q: Sequence[float], linear: Any, angular: Any
) -> dict[str, Any]:
    return {
        "header": header(t, frame),
        "child_frame_id": child,
        "pose": {"pose": {"position": xyz(place), "orientation": xyzw(q)}, "covariance": np.zeros(36)},
        "twist": {"twist": {"linear": xyz(linear), "angular": xyz(angular)}, "covariance": np.zeros(36)},
    }


def multi_array(values: Sequence[float], dtype: str = "float64") -> dict[str, Any]:
    return {"layout": {"dim": [], "data_offset": 0}, "data": np.array(values, dtype=dtype)}


def _built(store: Any, kind: str, fields: dict[str, Any]) -> Any:
    given = dict(fields)
    if kind == "std_msgs/msg/Header" and store is ROS1:
        given = {"seq": 0, **given}
    for name, (node, detail) in store.fielddefs[kind][1]:
        if int(node) == 2:  # a message within the message
            given[name] = _built(store, detail, given[name])
    return store.types[kind](**given)


def cdr(said: Said) -> bytes:
    return bytes(ROS2.serialize_cdr(_built(ROS2, said.kind, said.fields), said.kind))


def definition(kind: str) -> bytes:
    return ROS2.generate_msgdef(kind, ros_version=2)[0].encode()


def write_bag1(path: Path, messages: Sequence[Said], compression: str = "") -> Path:
    bag = Writer1(path)
    if compression:
        bag.set_compression(Writer1.CompressionFormat[compression])
    with bag as writer:
        connections: dict[str, Any] = {}
        for said in messages:
            if said.topic not in connections:
                connections[said.topic] = writer.add_connection(said.topic, said.kind, typestore=ROS1)
            data = ROS1.serialize_ros1(_built(ROS1, said.kind, said.fields), said.kind)
            writer.write(connections[said.topic], START + round(said.t * 1e9), data)
    return path


def write_bag2(
    folder: Path, messages: Sequence[Said], storage: str = "SQLITE3", version: int = 9, more: Sequence[Any] = ()
) -> Path:
    bag = Writer2(folder, version=version, storage_plugin=StoragePlugin[storage])
    if more:
        bag.set_compression(*more)
    with bag as writer:
        connections: dict[str, Any] = {}
        for said in messages:
            if said.topic not in connections:
                connections[said.topic] = writer.add_connection(said.topic, said.kind, typestore=ROS2)
            writer.write(connections[said.topic], START + round(said.t * 1e9), cdr(said))
    return folder


def write_mcap2(
    path: Path,
    messages: Sequence[Said],
    *,
    chunk_size: int = 4096,
    compression: CompressionType = CompressionType.ZSTD,
    end: bool = True,
    **more: Any,
) -> Path:
    """Write ROS 2 messages by mcap's own writer; without `end` as a recorder leaves it that was killed."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_size, compression=compression, **more)
        writer.start(profile="ros2")
        schemas: dict[str, int] = {}
        channels: dict[str, int] = {}
        for said in messages:
            if said.kind not in schemas:
                schemas[said.kind] = writer.register_schema(said.kind, "ros2msg", definition(said.kind))
            if said.topic not in channels:
                channels[said.topic] = writer.register_channel(said.topic, "cdr", schemas[said.kind])
            moment = START + round(said.t * 1e9)
            writer.add_message(channels[said.topic], moment, cdr(said), moment)
        if end:
            writer.finish()
        else:
            writer.flush()
    return path
