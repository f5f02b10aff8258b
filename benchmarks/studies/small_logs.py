"""One small log of every kind that can be read, made here: nothing recorded is needed."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.recording import Recording

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "readers"))

from encoders import dive_bin, dive_tlog

__all__ = ["SMALL_LOGS", "blueos_messages", "small_logs", "write_json", "write_matlab_73"]

_PARAMETERS = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 7)} | {"BARO2_GND_PRESS": 1e5, "MOT_1_DIRECTION": -1.0}


def _run() -> Recording:
    t = np.arange(0.0, 3.0, 0.02)
    columns = {
        "u": np.sin(t),
        "r": np.cos(t),
        "z": 1.0 + 0.1 * t,
        "X": 20.0 * np.sign(np.sin(3.0 * t)),
        "N": 5.0 * np.sign(np.cos(2.0 * t)),
        "voltage": 16.0 - t,
    }
    columns["z"][::2] = np.nan
    return Recording.from_table(t, columns, source="a small run")


def _of_ours(suffix: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        _run().write(folder / f"run{suffix}")
        return folder / f"run{suffix}"

    return write


def _written(folder: Path, name: str, data: bytes) -> Path:
    (folder / name).write_bytes(data)
    return folder / name


def _live(folder: Path) -> Path:
    """A live session's file: samples of several rates, raw packets, an event."""
    from towtank.recording.event import Event
    from towtank.recording.mcap.format import Quantity
    from towtank.recording.mcap.log import McapLog

    with McapLog.open(folder / "live.mcap") as log:
        log.source("gyro", [Quantity("r", "rad/s", "FRD")])
        log.source("dvl", [Quantity("u", "m/s", "FRD"), Quantity("v", "m/s", "FRD")])
        log.source("force", [Quantity("X", "N", "FRD"), Quantity("N", "N m", "FRD")])
        for k in range(300):
            t = 0.01 * k
            log.write("gyro", t, float(np.sin(3.0 * t)))
            log.write_raw("udp", t, bytes(k % 9))
            if k % 10 == 0:
                log.write("dvl", t, float(np.sin(t)), np.nan)
                log.write("force", t, 20.0 * float(np.sign(np.sin(3.0 * t))), 1.0)
            if k % 100 == 0:
                log.flush()
        log.write_event(Event(1.0, "mark", "a word"))
    return folder / "live.mcap"


def _blueos(folder: Path) -> Path:
    """MAVLink in JSON in MCAP, as BlueOS records it."""
    return write_json(folder / "blueos.mcap", blueos_messages(60))


def blueos_messages(count: int) -> list[tuple[str, float, Any]]:
    """Return topic, time [s] and content of the messages of a short dive."""
    said = [("mavlink/out", 0.0, _said("HEARTBEAT", custom_mode=19, base_mode={"bits": 81}))]
    for k in range(count):
        t = 0.05 * k
        attitude = {
            "roll": 0.01 * k,
            "pitch": 0.2,
            "yaw": 1.0,
            "rollspeed": 0.1,
            "pitchspeed": 0.0,
            "yawspeed": 0.1 * t,
        }
        outputs = {f"servo{n}_raw": 1500 + n * k % 400 for n in range(1, 9)}
        said.append(("mavlink/out", t, _said("ATTITUDE", time_boot_ms=5000 + 50 * k, **attitude)))
        said.append(("mavlink/out", t, _said("SERVO_OUTPUT_RAW", time_usec=5_000_000 + 50_000 * k, port=0, **outputs)))
    return said


def _said(kind: str, **fields: Any) -> dict[str, Any]:
    header = {"system_id": 1, "component_id": 1, "sequence": 0}
    return {"header": header, "message": {"type": kind, **fields}}


def write_json(path: Path, messages: Sequence[tuple[str, float, Any]]) -> Path:
    """Write messages of JSON, or bytes as they are, by mcap's own writer."""
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=20_000)
        writer.start()
        schema = writer.register_schema("mavlink", "jsonschema", b"{}")
        channels: dict[str, int] = {}
        for topic, t, content in messages:
            if topic not in channels:
                channels[topic] = writer.register_channel(topic, "json", schema)
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            moment = min(max(1_700_000_000_000_000_000 + round(t * 1e9), 0), 2**64 - 1)
            writer.add_message(channels[topic], moment, data, moment)
        writer.finish()
    return path


def _ros(kind: str, **more: Any) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        import ros_bags as ros

        said = []
        for k in range(60):
            t = 0.05 * k
            place, level = (0.1 * t, 0.0, -1.0), (1.0, 0.0, 0.0, 0.0)
            said.append(
                ros.Said(
                    "/imu", t, "sensor_msgs/msg/Imu", ros.imu(t, "base_link", level, (0.0, 0.0, t), (0.0, 0.0, 9.8))
                )
            )
            pose = ros.odometry(t, "odom", "base_link", place, level, (0.1, 0.0, 0.0), (0.0, 0.0, 0.1))
            said.append(ros.Said("/odom", t, "nav_msgs/msg/Odometry", pose))
            said.append(ros.Said("/cmd", t, "std_msgs/msg/Float64MultiArray", ros.multi_array([0.1, t])))
        if kind == "bag":
            return ros.write_bag1(folder / "run.bag", said, **more)
        if kind == "mcap":
            return ros.write_mcap2(folder / "ros.mcap", said, **more)
        return next(ros.write_bag2(folder / "bag", said).glob("*.db3"))

    return write


def _matlab(folder: Path) -> Path:
    from scipy.io import savemat

    run = _run()
    savemat(
        folder / "run.mat",
        {name: channel.values for name, channel in run.channels.items() if name != "z"} | {"t": run["u"].t},
    )
    return folder / "run.mat"


def _matlab_73(folder: Path) -> Path:
    run = _run()
    columns = {name: channel.values for name, channel in run.channels.items() if name != "z"}
    return write_matlab_73(folder / "run73.mat", {"t": run["u"].t, **columns})


def write_matlab_73(path: Path, variables: Mapping[str, Array]) -> Path:
    """Write vectors as version 7.3 does: HDF5 behind a block of text, arrays transposed."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in variables.items():
            file.create_dataset(name, data=np.atleast_2d(values).T).attrs["MATLAB_class"] = np.bytes_("double")
    data = bytearray(path.read_bytes())
    data[:19] = b"MATLAB 7.3 MAT-file"
    path.write_bytes(data)
    return path


SMALL_LOGS: dict[str, Callable[[Path], Path]] = {
    "csv": _of_ours(".csv"),
    "parquet": _of_ours(".parquet"),
    "dataflash": lambda folder: _written(folder, "dive.BIN", bytes(dive_bin(3.0, parameters=_PARAMETERS).data)),
    "dataflash-text": lambda folder: _written(
        folder, "dive.log", "\n".join(dive_bin(1.5, parameters=_PARAMETERS).text).encode()
    ),
    "tlog": lambda folder: _written(
        folder, "dive.tlog", bytes(dive_tlog(4.0, parameters=_PARAMETERS, versions=(1, 2)).data)
    ),
    "mcap": _of_ours(".mcap"),
    "mcap-ros": _ros("mcap"),
    "mcap-ros-cut": _ros("mcap", end=False),
    "mcap-live": _live,
    "mcap-json": _blueos,
    "ros1": _ros("bag"),
    "ros1-bz2": _ros("bag", compression="BZ2"),
    "ros1-lz4": _ros("bag", compression="LZ4"),
    "ros2": _ros("db3"),
    "matlab": _matlab,
    "matlab-7.3": _matlab_73,
}


def small_logs() -> dict[str, tuple[str, bytes]]:
    """Return name -> suffix and bytes of one whole file of each kind."""
    found: dict[str, tuple[str, bytes]] = {}
    for name, write in SMALL_LOGS.items():
        with tempfile.TemporaryDirectory() as folder:
            path = write(Path(folder))
            found[name] = path.suffix, path.read_bytes()
    return found
