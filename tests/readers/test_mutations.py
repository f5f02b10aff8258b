"""Broken files of the kinds that `small_logs` does not make: live logs, JSON in MCAP, packed bags, MATLAB 7.3."""

from __future__ import annotations

import random
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.pace import within

from towtank.errors import InputError
from towtank.readers.registry import READERS
from towtank.recording.mcap.format import Quantity
from towtank.recording.mcap.log import McapLog

from .ros_bags import write_bag1, write_mcap2
from .test_matlab import save_73
from .test_mcap_json import dive
from .test_mcap_json import write as write_json
from .test_rosbag import session_of_registered

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from mutations import mutated

RUNS = 120
LONGEST = 2.0  # s
T = 0.02 * np.arange(200)


def _live(folder: Path) -> Path:
    log = McapLog.open(folder / "a.mcap")
    log.source("gyro", [Quantity("r", "rad/s", "FRD")])
    for k in range(1000):
        log.write("gyro", 0.01 * k, 0.1 * k)
        log.write_raw("udp", 0.01 * k, bytes(k % 9))
        if k % 100 == 0:
            log.flush()
    log.close()
    return folder / "a.mcap"


MAKERS: dict[str, Callable[[Path], Path]] = {
    "a live log": _live,
    "ROS 2 in MCAP, cut off": lambda folder: write_mcap2(folder / "a.mcap", session_of_registered(60), end=False),
    "JSON in MCAP": lambda folder: write_json(folder / "a.mcap", dive(60)),
    "ROS 1 bag, bz2": lambda folder: write_bag1(folder / "a.bag", session_of_registered(60), "BZ2"),
    "ROS 1 bag, lz4": lambda folder: write_bag1(folder / "a.bag", session_of_registered(60), "LZ4"),
    "MATLAB 7.3": lambda folder: save_73(folder / "a.mat", dive={"t": T, "u": T, "name": "tank"}),
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {name: make(tmp_path_factory.mktemp("whole")) for name, make in MAKERS.items()}


@pytest.mark.parametrize("name", list(MAKERS))
def test_nothing_escapes_the_reader_itself(files: dict[str, Path], tmp_path: Path, name: str) -> None:
    """Not even to the way in, which would turn any error into a line."""
    data = files[name].read_bytes()
    others = [path.read_bytes() for path in files.values()]
    reader = next(each for each in READERS if each.recognises(data[: 1 << 16], files[name].suffix))
    path = tmp_path / f"broken{files[name].suffix}"
    readable, lines = 0, []
    for seed in range(RUNS):
        what, broken = mutated(data, others, random.Random(f"{name} {seed}"))
        if not broken:
            continue  # an empty file is refused on the way in
        path.write_bytes(broken)
        with within(LONGEST, (seed, what)):
            try:
                reader.read(path, None)
                readable += 1
            except InputError as error:
                lines.append(str(error))
    assert all("\n" not in line and line.startswith(str(path)) for line in lines)
    assert readable > RUNS / 20
