"""The real recordings that models are learned from and judged by, and how their columns are read.

A model never sees the runs that it is judged by. What must hold of each figure stands beside it.
"""

from __future__ import annotations

import argparse
import os
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from report import show

from towtank.identification import Learner, LogLearning, learn_recordings
from towtank.recording import ColumnMapping, Recording, read_csv
from towtank.validation import validate
from towtank.vehicle import Vehicle, load_vehicle

__all__ = [
    "BOAT_HALVES",
    "BOAT_MAP",
    "POOL",
    "POOL_MAP",
    "POOL_RUNS",
    "SPINS",
    "Case",
    "Learned",
    "asked",
    "boat",
    "data_folder",
    "model_fit",
    "pool",
    "real_fit",
    "sea",
    "streamed",
    "wrongly_wired",
]

POOL_MAP = """
thrusters = ["pwm1", "pwm2", "pwm3", "pwm4", "pwm5", "pwm6"]
columns = { ax = "acc_x", ay = "acc_y", az = "acc_z", p = "gyro_p", q = "gyro_q", r = "gyro_r" }
"""
BOAT_MAP = """
thrusters = ["pwm_left", "pwm_right"]
[columns]
x = "north_m"
y = "east_m"
psi = { from = "yaw_deg", scale = 0.017453292519943295 }
u = "u"
v = "v"
r = "r"
"""
_SEA_COLUMNS = (
    'u = "dvl_u"\nv = "dvl_v"\nw = "dvl_w"\np = "p"\nq = "q"\nr = "r"\nphi = "phi"\ntheta = "theta"\npsi = "psi"\n'
    'z = "depth_m"\n'
)
_SEA_BACKWARDS = (3, 4, 6, 7)  # motors that push the other way than the vehicle's file has it


@dataclass(frozen=True)
class Case:
    """Runs to learn from, a run to judge by, channels with the fit [%] that must be reached, and the restart [s]."""

    learned: tuple[str, ...]
    judged: str
    horizon: float | None
    least: tuple[tuple[str, float], ...]

    @property
    def name(self) -> str:
        """The case in words."""
        restart = "" if self.horizon is None else f" by {self.horizon:g} s"
        return f"{' + '.join(self.learned)} -> {self.judged}{restart}"


_TUMBLING = ("pitch_roll_1", "all_2")
POOL = (
    Case(("yaw_1",), "yaw_2", None, (("r", 76.0),)),
    Case(("yaw_1", "yaw_2"), "yaw_3", None, (("r", 57.0),)),
    Case(_TUMBLING, "pitch_roll_2", None, (("p", 70.0), ("q", 66.0))),
    Case(_TUMBLING, "all_3", 3.0, (("p", 62.0), ("q", 57.0), ("r", 47.0))),
    Case(_TUMBLING, "all_3", None, (("p", 43.0), ("q", 54.0), ("r", 40.0))),
)
POOL_RUNS = ("yaw_1", "yaw_2", "yaw_3", "pitch_roll_1", "pitch_roll_2", "all_2", "all_3")
SPINS = ("226", "228")  # the boat turns on the spot: there is no surge to predict
BOAT_HALVES = (("220", "222", "223", "224"), ("225", "226", "228", "234"))


def data_folder() -> Path | None:
    """Return the folder of recordings: `$TOWTANK_DATA`, else `shared/data` beside the repository; None if absent."""
    named = os.environ.get("TOWTANK_DATA")
    folder = Path(named) if named else Path(__file__).resolve().parents[3] / "shared" / "data"
    return folder if folder.is_dir() else None


def asked(text: str | None, arguments: Sequence[str] | None) -> tuple[Path | None, Path | None]:
    """Read the one option of a study of real recordings: return where to write, and the recordings, None if absent."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path)
    output: Path | None = parser.parse_args(arguments).output
    data = data_folder()
    if data is None:
        show("no recordings: set TOWTANK_DATA")
    return output, data


def real_fit(learning: LogLearning, judged: Recording, horizon: float | None = None) -> dict[str, float]:
    """Return the fit [%] of every channel of a run predicted freely by what was learned."""
    return model_fit(learning.model, judged, horizon)


def model_fit(model: Vehicle, judged: Recording, horizon: float | None = None) -> dict[str, float]:
    """Return the fit [%] of every channel of a run predicted freely by a model."""
    found = validate(model, [judged], horizon=horizon).fit
    return {name: value for name, value in found.items() if value is not None}


def streamed(vehicle: Vehicle, recordings: Sequence[Recording]) -> Vehicle:
    """Return the model of the streaming filter alone after one recording after the other."""
    learner = Learner(vehicle)
    for recording in recordings:
        learner.run(recording)
    return learner.model()


class Learned:
    """Recordings of one vehicle, read and learned from once."""

    def __init__(self, vehicle: Vehicle, folder: Path, mapping: str, pattern: str) -> None:
        self.vehicle, self.folder, self.pattern = vehicle, folder, pattern
        self.mapping = ColumnMapping.model_validate(tomllib.loads(mapping))
        self.read = cache(self._read)
        self.learn = cache(self._learn)

    def _read(self, name: str) -> Recording:
        found = sorted(self.folder.glob(self.pattern.format(name)))
        if not found:
            raise FileNotFoundError(f"{self.folder / self.pattern.format(name)}: no such recording")
        return read_csv(found[0], self.mapping)

    def _learn(self, *names: str) -> LogLearning:
        return learn_recordings(self.vehicle, [self.read(name) for name in names])


def pool(data: Path) -> Learned:
    """The first BlueROV in a pool: thrusters as PWM, rotation by gyros alone."""
    return Learned(load_vehicle("bluerov_2016"), data / "bluerov_pool_2016", POOL_MAP, "{}_2016*.csv")


def boat(data: Path) -> Learned:
    """The surface craft with two thrusters."""
    return Learned(load_vehicle("blueboat_2024"), data / "blueboat_2024", BOAT_MAP, "log_{}.csv")


def wrongly_wired(vehicle: Vehicle) -> Vehicle:
    """The surface craft as its makers draw it: the thruster called left to port."""
    other_side = [
        each.model_copy(update={"position": (each.position[0], -each.position[1], each.position[2])})
        for each in vehicle.thrusters
    ]
    return vehicle.model_copy(update={"thrusters": tuple(other_side)})


def sea(data: Path) -> tuple[Vehicle, Sequence[Recording]]:
    """The BlueROV2 with a DVL at sea, under feedback in a current: vehicle, and the two halves of the run."""
    vehicle = load_vehicle("bluerov2_heavy_as_published")
    rows = []
    for k, thruster in enumerate(vehicle.thrusters, 1):
        turned = "scale = -1.0, offset = 3000.0" if k in _SEA_BACKWARDS else "scale = 1.0"
        rows.append(f'cmd_{thruster.name} = {{ from = "pwm{k}", {turned} }}\n')
    mapping = ColumnMapping.model_validate(tomllib.loads("[columns]\n" + _SEA_COLUMNS + "".join(rows)))
    run = read_csv(data / "bluerov2_dvl_sea_2026" / "run_20hz.csv", mapping)
    middle = 0.5 * (run.start + run.end)
    return vehicle, (run.window(run.start, middle), run.window(float(np.nextafter(middle, np.inf)), run.end))
