"""One small log of every kind that can be read, made here: nothing recorded is needed."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from towtank.recording import Recording

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "readers"))

from encoders import dive_bin, dive_tlog

__all__ = ["SMALL_LOGS", "small_logs"]

_PARAMETERS = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 7)} | {"BARO2_GND_PRESS": 1e5, "MOT_1_DIRECTION": -1.0}


def _run() -> Recording:
    t = np.arange(0.0, 3.0, 0.02)
    columns = {
        "u": np.sin(t),
        "r": np.cos(t),
        "z": 1.0 + 0.1 * t,
        "cmd_1": np.sign(np.sin(3.0 * t)),
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


def _ros(kind: str) -> Callable[[Path], Path]:
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
            return ros.write_bag1(folder / "run.bag", said)
        if kind == "mcap":
            return ros.write_mcap2(folder / "ros.mcap", said)
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
    "ros1": _ros("bag"),
    "ros2": _ros("db3"),
    "matlab": _matlab,
}


def small_logs() -> dict[str, tuple[str, bytes]]:
    """Return name -> suffix and bytes of one whole file of each kind."""
    found: dict[str, tuple[str, bytes]] = {}
    for name, write in SMALL_LOGS.items():
        with tempfile.TemporaryDirectory() as folder:
            path = write(Path(folder))
            found[name] = path.suffix, path.read_bytes()
    return found
