"""An accelerometer away from the body's origin, which nobody told the learner: are coefficients right all the same?

    python benchmarks/studies/accelerometer_study.py [--runs 40] [--only off] [--output accelerometer.json]

A vehicle tumbles for 30 s under all its thrusters in water that stirs it; gyros and an accelerometer measure, as in a
log of a camera or of an autopilot without a DVL. `origin`: the accelerometer is at the body's origin. `off`: 0.12 m
ahead of it, 0.06 m to starboard, 0.08 m up, so that it feels how fast the vehicle turns, too. Two thrusters give less
or more than their curves say (8 %), and all lag by 0.05 s. Of every coefficient that is called identified: how far from
the truth, in deviations that are stated.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from by_case import by_case
from summary import Check
from tumbling import named, true_vehicle, tumble

from towtank.identification import learn_recordings

CASES = {"origin": (0.0, 0.0, 0.0), "off": (0.12, 0.06, -0.08)}
ALONG = {"X_udot": -8.0, "Y_vdot": -12.0, "Z_wdot": -15.0}
Found = dict[str, tuple[float, float]]


def learned(case: str, seed: int) -> Found:
    """Return of every coefficient identified: relative error, and error in deviations."""
    gains = 1.0 + 0.08 * np.random.default_rng([seed, 1]).standard_normal(2)
    truth = true_vehicle(lag=0.05, f1=float(gains[0]), f3=float(gains[1])).with_coefficients(ALONG)
    learning = learn_recordings(named(), [tumble(truth, seed=seed, seconds=30.0, place=CASES[case])])
    out = {}
    for each in learning.estimate.coefficients:
        if each.identified:
            true = truth.coefficient(each.name)
            error = each.value - true
            out[each.name] = (error / true if true else float("nan"), error / each.std)
    return out


def checks(case: str, found: Sequence[Found]) -> list[Check]:
    """Return what must hold of one case."""
    off = np.abs([deviations for run in found for _, deviations in run.values()])
    inertias = [error for run in found for name, (error, _) in run.items() if name.endswith("dot") and error == error]
    return [
        Check(f"{case}: 95 % intervals that hold", float(np.mean(off < 1.96)), low=0.9, note=f"of {off.size}"),
        Check(f"{case}: beyond 4 deviations", float(np.mean(off > 4.0)), high=0.005),
        Check(f"{case}: errors in deviations, root mean square", float(np.sqrt(np.mean(off**2))), high=1.2),
        Check(f"{case}: median error of added masses", float(np.median(np.abs(inertias))), high=0.15),
    ]


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
    sys.exit(by_case("accelerometer", __doc__ or "", CASES, learned, row, checks))
