"""Mutated logs: cut, bits flipped, bytes taken out, put in, spliced from other formats. Only InputError escapes."""

from __future__ import annotations

import random
import resource
import time
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from towtank.errors import InputError
from towtank.readers.registry import READERS
from towtank.recording import Recording
from towtank.recording.mcap_log import McapLog, Quantity

from .ros_bags import write_bag1, write_bag2, write_mcap2
from .test_matlab import save_73
from .test_mcap_json import dive
from .test_mcap_json import write as write_json
from .test_rosbag import session_of_registered

EACH = 60
SLOWEST = 2.0  # s
MEMORY = 400.0  # MB more than before
T = 0.02 * np.arange(200)


def _own(folder: Path) -> Path:
    Recording.from_table(T, {"u": np.sin(T), "psi": np.where(T > 1.0, T, np.nan)}).write(folder / "a.mcap")
    return folder / "a.mcap"


def _live(folder: Path) -> Path:
    log = McapLog.open(folder / "a.mcap")
    log.source("gyro", [Quantity("r", "rad/s", "FRD")])
    for k in range(1000):
        log.write("gyro", 0.01 * k, 0.1 * k)
        log.write_raw("udp", 0.01 * k, bytes(k % 9))
        if k % 100 == 0:
            log.flush()
    log.flush()
    return folder / "a.mcap"


def _mat(folder: Path) -> Path:
    scipy.io.savemat(folder / "a.mat", {"t": T, "u": T, "dive": {"t": T, "r": [{"x": T}, {"x": T}], "name": "x"}})
    return folder / "a.mat"


MAKERS = {
    "our recording": _own,
    "a live log": _live,
    "ROS 2 in MCAP": lambda folder: write_mcap2(folder / "a.mcap", session_of_registered(60)),
    "JSON in MCAP": lambda folder: write_json(folder / "a.mcap", dive(60)),
    "ROS 1 bag": lambda folder: write_bag1(folder / "a.bag", session_of_registered(60)),
    "ROS 1 bag, bz2": lambda folder: write_bag1(folder / "a.bag", session_of_registered(60), "BZ2"),
    "ROS 2 in SQLite": lambda folder: write_bag2(folder / "bag", session_of_registered(60)) / "bag.db3",
    "MATLAB 5": _mat,
    "MATLAB 7.3": lambda folder: save_73(folder / "a.mat", dive={"t": T, "u": T, "name": "tank"}),
}


def mutated(data: bytes, other: bytes, draw: random.Random) -> bytes:
    changed = bytearray(data)
    at = draw.randrange(len(data))
    kind = draw.randrange(6)
    if kind == 0:
        return data[:at]
    if kind == 1:
        for _ in range(draw.randrange(1, 20)):
            changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
    elif kind == 2:
        del changed[at : at + draw.randrange(1, 300)]
    elif kind == 3:
        changed[at:at] = draw.randbytes(draw.randrange(1, 100))
    elif kind == 4:
        start = draw.randrange(len(other))
        changed[at : at + 500] = other[start : start + 500]
    else:
        changed[at : at + 8] = bytes([draw.choice([0x00, 0x7F, 0xFF])]) * 8
    return bytes(changed)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {name: make(tmp_path_factory.mktemp("whole")) for name, make in MAKERS.items()}


@pytest.mark.parametrize("name", list(MAKERS))
def test_mutated_files(files: dict[str, Path], tmp_path: Path, name: str) -> None:
    data = files[name].read_bytes()
    others = [path.read_bytes() for path in files.values()]
    reader = next(each for each in READERS if each.recognises(data[: 1 << 16], files[name].suffix))
    draw = random.Random(sum(map(ord, name)))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    readable, lines = 0, []
    for _ in range(EACH):
        path = tmp_path / f"mutated{files[name].suffix}"
        path.write_bytes(mutated(data, draw.choice(others), draw))
        start = time.perf_counter()
        try:
            reader.read(path, None)
            readable += 1
        except InputError as error:
            lines.append(str(error))
        assert time.perf_counter() - start < SLOWEST
    assert all("\n" not in line and str(tmp_path) in line for line in lines)
    assert readable > EACH / 10
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024.0 < MEMORY
