"""Sensors away from the body's origin, which nobody told the learner: are coefficients right all the same?

    python benchmarks/studies/place_study.py [--runs 40] [--only dvl] [--output place.json]

A vehicle tumbles for 30 s under all its thrusters in water that stirs it. `imu`: gyros and an accelerometer measure;
`dvl`: gyros, a DVL, depth and attitude; `all`: these and the accelerometer; `camera`: motion capture, the pose alone.
Each `here`, at the body's origin; `off`, the accelerometer, the DVL, or what the camera tracks 0.12 m ahead of it,
0.06 m to starboard, 0.08 m up, so that it feels or shows the turning, too; and `taken`, off, but taken for being at the
origin. Two thrusters give less or more than their curves say (8 %), and all lag by 0.05 s. Of every coefficient that is
called identified: how far from the truth, in deviations that are stated.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from unittest.mock import patch

import numpy as np
from by_case import by_case
from summary import Check
from tumbling import named, true_vehicle, tumble

from towtank.identification import learn_recordings
from towtank.identification.data.samples import Samples
from towtank.identification.model.parameters import PLACES
from towtank.identification.model.prior import further_unknowns
from towtank.identification.offline import joint
from towtank.recording.standard import ACCELERATIONS, EULER, LINEAR_VELOCITY, POSE, RATES
from towtank.simulation import Ins, Mocap
from towtank.simulation.sensors.sensor import Sensors

_OFF = (0.12, 0.06, -0.08)
_INERTIAL = (*RATES, *ACCELERATIONS)
BY_DVL = (*LINEAR_VELOCITY, *RATES, *EULER, "z")
CASES: dict[str, tuple[Sensors, Sequence[str]]] = {
    "imu here": (Ins(), _INERTIAL),
    "imu off": (Ins(imu_place=_OFF), _INERTIAL),
    "imu taken": (Ins(imu_place=_OFF), _INERTIAL),
    "dvl here": (Ins(), BY_DVL),
    "dvl off": (Ins(dvl_place=_OFF), BY_DVL),
    "dvl taken": (Ins(dvl_place=_OFF), BY_DVL),
    "all here": (Ins(), (*BY_DVL, *ACCELERATIONS)),
    "all off": (Ins(imu_place=_OFF), (*BY_DVL, *ACCELERATIONS)),
    "camera here": (Mocap(), POSE),
    "camera off": (Mocap(place=_OFF), POSE),
    "camera taken": (Mocap(place=_OFF), POSE),
}
ALONG = {"X_udot": -8.0, "Y_vdot": -12.0, "Z_wdot": -15.0}
Found = dict[str, tuple[float, float]]


def learned(case: str, seed: int) -> Found:
    """Return of every coefficient identified: relative error, and error in deviations."""
    gains = 1.0 + 0.08 * np.random.default_rng([seed, 1]).standard_normal(2)
    truth = true_vehicle(lag=0.05, f1=float(gains[0]), f3=float(gains[1])).with_coefficients(ALONG)
    sensors, measured = CASES[case]
    run = tumble(truth, seed=seed, seconds=30.0, sensors=sensors, measured=measured)
    with patch.object(joint, "further_unknowns", _no_places) if "taken" in case else nullcontext():
        learning = learn_recordings(named(), [run])
    out = {}
    for each in learning.estimate.coefficients:
        if each.identified:
            true = truth.coefficient(each.name)
            error = each.value - true
            out[each.name] = (error / true if true else float("nan"), error / each.std)
    return out


def _no_places(samples: Sequence[Samples]) -> tuple[str, ...]:
    return tuple(name for name in further_unknowns(samples) if name not in PLACES)


def checks(case: str, found: Sequence[Found]) -> list[Check]:
    """Return what must hold of one case."""
    off = np.abs([deviations for run in found for _, deviations in run.values()])
    inertias = [error for run in found for name, (error, _) in run.items() if name.endswith("dot") and error == error]
    figures = {
        "95 % intervals that hold": (float(np.mean(off < 1.96)), 0.9, math.inf),
        "beyond 4 deviations": (float(np.mean(off > 4.0)), -math.inf, 0.005),
        "errors in deviations, root mean square": (float(np.sqrt(np.mean(off**2))), -math.inf, 1.2),
        "median error of added masses": (float(np.median(np.abs(inertias))), -math.inf, 0.15),
    }
    if "taken" in case:
        return [Check(f"{case}: {name}", value) for name, (value, _, _) in figures.items()]
    return [Check(f"{case}: {name}", value, low, high) for name, (value, low, high) in figures.items()]


def row(found: Found) -> dict[str, str]:
    """Return a run as its table shows it."""
    off = np.array([deviations for _, deviations in found.values()])
    beyond = sorted(
        (name for name, (_, size) in found.items() if abs(size) > 1.96), key=lambda name: -abs(found[name][1])
    )
    return {
        "identified": str(off.size),
        "root mean square": f"{np.sqrt(np.mean(off**2)):.2f}",
        "beyond 1.96": ", ".join(f"{name} {found[name][1]:+.1f}" for name in beyond),
    }


if __name__ == "__main__":
    sys.exit(by_case("place", __doc__ or "", CASES, learned, row, checks))
