"""One axis driven, five left to the water: is what is said of all six right?

    python benchmarks/studies/undriven_study.py [--runs 8] [--only yaw] [--output undriven.json]

A vehicle of which mass, inertia and thrusters are told is driven by a square wave of surge or yaw for 40 s, in water
that pushes on every axis. `ins`: an inertial unit, a DVL and depth measure, `camera`: motion capture. The VideoRay
Pro 4, whose thrusters lag by 30 ms, is pushed with 0.3 N and 0.02 N m (standard deviations). `drag`: the BlueROV2 as
published, whose yaw stops within 0.11 s, so that it lags as its thrusters do, by 50 ms, is pushed with 0.5 N and
0.035 N m. Of every coefficient that is called identified: how far from the truth, in deviations that are stated; and
the largest of the levels that are told for the water's push, as a multiple of what it is.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from by_case import by_case
from summary import Check

from towtank.identification import LogLearning, learn_recordings
from towtank.recording import Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.simulation.sensors.sensor import Sensors
from towtank.vehicle import Vehicle, load_vehicle

Wrench = tuple[float, float, float, float, float, float]
PUSH: Wrench = (0.3, 0.3, 0.3, 0.02, 0.02, 0.02)  # N, N m
HARDER: Wrench = (0.5, 0.5, 0.5, 0.035, 0.035, 0.035)
LAG = 0.03  # s
CASES: dict[str, tuple[str, str, Sensors, Wrench]] = {  # vehicle, what it does, what measures, what the water does
    "yaw ins": ("vlbv300", "yaw-square", Ins(), PUSH),
    "yaw camera": ("vlbv300", "yaw-square", Mocap(), PUSH),
    "surge ins": ("vlbv300", "surge-square", Ins(), PUSH),
    "surge camera": ("vlbv300", "surge-square", Mocap(), PUSH),
    "drag ins": ("bluerov2", "yaw-square", Ins(), HARDER),
    "drag camera": ("bluerov2", "yaw-square", Mocap(), HARDER),
}
_DT, _SECONDS = 0.02, 40.0


class Found(NamedTuple):
    """Errors of what is identified, in deviations; the largest level told, as a multiple of the true one."""

    off: dict[str, float]
    pushed: float


def told(vehicle: Vehicle) -> Vehicle:
    """Return what is known of a vehicle beforehand: mass, inertia, thrusters."""
    buoyancy = vehicle.buoyancy.model_copy(update={"centre": vehicle.rigid_body.centre_of_gravity})
    return vehicle.model_copy(update={"hydrodynamics": {}, "buoyancy": buoyancy})


def driven(case: str, seed: int) -> tuple[Vehicle, Recording]:
    """Return a vehicle as it is, thrusters that lag, and its run in water that pushes."""
    name, how, sensors, push = CASES[case]
    vehicle = load_vehicle(name)
    late = tuple(each.model_copy(update={"time_constant": each.time_constant or LAG}) for each in vehicle.thrusters)
    vehicle = vehicle.model_copy(update={"thrusters": late})
    inputs = manoeuvre(how, vehicle, duration=_SECONDS, dt=_DT).inputs
    water = OrnsteinUhlenbeck(push, 2.0, ("X", "Y", "Z", "K", "M", "N"))
    return vehicle, simulate(vehicle, **inputs, sensors=sensors, disturbance=water, seed=seed)


def errors(truth: Vehicle, learning: LogLearning) -> dict[str, float]:
    """Return the error of everything that is identified, in deviations that are stated."""
    found = (each for each in learning.estimate.coefficients if each.identified)
    return {each.name: (each.value - truth.coefficient(each.name)) / each.std for each in found}


def learned(case: str, seed: int) -> Found:
    """Return what comes of one log."""
    truth, run = driven(case, seed)
    learning = learn_recordings(told(truth), [run])
    assert learning.levels is not None
    return Found(errors(truth, learning), float(np.max(learning.levels.disturbance / np.array(CASES[case][3]))))


def checks(case: str, found: Sequence[Found]) -> list[Check]:
    """Return what must hold of one case."""
    off = np.abs([deviations for run in found for deviations in run.off.values()])
    return [
        Check(f"{case}: 95 % intervals that hold", float(np.mean(off < 1.96)), 0.9, math.inf),
        Check(f"{case}: beyond 4 deviations", float(np.mean(off > 4.0)), -math.inf, 0.005),
        Check(f"{case}: largest push told, median", float(np.median([run.pushed for run in found])), 0.5, 2.0),
    ]


def row(found: Found) -> dict[str, str]:
    """Return a run as its table shows it."""
    return {**row_of_errors(found.off), "largest push": f"{found.pushed:.2f}"}


def row_of_errors(off: Mapping[str, float]) -> dict[str, str]:
    """Return errors in deviations as a table shows them."""
    beyond = sorted(off.items(), key=lambda each: -abs(each[1]))
    return {
        "identified": str(len(off)),
        "root mean square": f"{np.sqrt(np.mean(np.square(list(off.values())))):.2f}",
        "beyond 1.96": ", ".join(f"{name} {size:+.1f}" for name, size in beyond if abs(size) > 1.96),
    }


if __name__ == "__main__":
    sys.exit(by_case("undriven", __doc__ or "", CASES, learned, row, checks))
