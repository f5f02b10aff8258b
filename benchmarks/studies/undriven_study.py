"""One axis driven, five left to the water: is what is said of the other five right?

    python benchmarks/studies/undriven_study.py [--runs 8] [--only yaw] [--output undriven.json]

A VideoRay Pro 4 of which mass, inertia and thrusters are told is driven by a square wave of surge or yaw for 40 s, in
water that pushes with 0.3 N and 0.02 N m (standard deviations) on every axis. `ins`: an inertial unit, a DVL and depth
measure, `camera`: motion capture. Of every coefficient that is called identified: how far from the truth, in deviations
that are stated; and the largest of the levels that are told for the water's push, as a multiple of what it is.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from by_case import by_case
from summary import Check

from towtank.identification import LogLearning, learn_recordings
from towtank.recording import Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.simulation.sensors.sensor import Sensors
from towtank.vehicle import Vehicle, load_vehicle

CASES: dict[str, tuple[str, Sensors]] = {
    "yaw ins": ("yaw-square", Ins()),
    "yaw camera": ("yaw-square", Mocap()),
    "surge ins": ("surge-square", Ins()),
    "surge camera": ("surge-square", Mocap()),
}
Wrench = tuple[float, float, float, float, float, float]
PUSH: Wrench = (0.3, 0.3, 0.3, 0.02, 0.02, 0.02)  # N, N m
LAG = 0.03  # s
_DT, _SECONDS = 0.02, 40.0


class Found(NamedTuple):
    """Errors of what is identified, in deviations; the largest level told, as a multiple of the true one."""

    off: dict[str, float]
    pushed: float


def told(vehicle: Vehicle) -> Vehicle:
    """Return what is known of a vehicle beforehand: mass, inertia, thrusters."""
    buoyancy = vehicle.buoyancy.model_copy(update={"centre": vehicle.rigid_body.centre_of_gravity})
    return vehicle.model_copy(update={"hydrodynamics": {}, "buoyancy": buoyancy})


def lagging(name: str) -> Vehicle:
    """Return a vehicle of the catalog whose thrusters lag."""
    vehicle = load_vehicle(name)
    late = tuple(each.model_copy(update={"time_constant": LAG}) for each in vehicle.thrusters)
    return vehicle.model_copy(update={"thrusters": late})


def driven(vehicle: Vehicle, how: str, sensors: Sensors, push: Wrench, seed: int) -> Recording:
    """Return a run in water that pushes."""
    inputs = manoeuvre(how, vehicle, duration=_SECONDS, dt=_DT).inputs
    water = OrnsteinUhlenbeck(push, 2.0, ("X", "Y", "Z", "K", "M", "N"))
    return simulate(vehicle, **inputs, sensors=sensors, disturbance=water, seed=seed)


def errors(truth: Vehicle, learning: LogLearning) -> dict[str, float]:
    """Return the error of everything that is identified, in deviations that are stated."""
    found = (each for each in learning.estimate.coefficients if each.identified)
    return {each.name: (each.value - truth.coefficient(each.name)) / each.std for each in found}


def learned(case: str, seed: int) -> Found:
    """Return what comes of one log."""
    truth = lagging("vlbv300")
    learning = learn_recordings(told(truth), [driven(truth, *CASES[case], PUSH, seed)])
    assert learning.levels is not None
    return Found(errors(truth, learning), float(np.max(learning.levels.disturbance / PUSH)))


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
    off = np.array(list(found.off.values()))
    beyond = sorted(found.off.items(), key=lambda each: -abs(each[1]))
    return {
        "identified": str(off.size),
        "root mean square": f"{np.sqrt(np.mean(off**2)):.2f}",
        "largest push": f"{found.pushed:.2f}",
        "beyond 1.96": ", ".join(f"{name} {size:+.1f}" for name, size in beyond if abs(size) > 1.96),
    }


if __name__ == "__main__":
    sys.exit(by_case("undriven", __doc__ or "", CASES, learned, row, checks))
