"""Speeds that were smoothed before anyone saw them, beside a pose that was not.

    python benchmarks/studies/smooth_study.py [--runs 20] [--only 1.2] [--output smooth.json]

A box is pushed in surge and turned in yaw at random for 80 s, a new wrench every 1.2 s, in water that stirs it. Pose
and rates are measured at 20 Hz, by sensors with white noise. `raw`: as they are. `smooth 0.3`, `smooth 1.2`: rates are
means over so many seconds about each sample, as a tool makes them afterwards. `filtered 0.3`, `filtered 0.05`: they
have gone through a low-pass filter of first order, the latter of one sample. `heading wanders`: raw rates beside a
heading that walks at random, as of a compass near thrusters; `so beside a quiet gyro`: with a tenth of the noise. How
many 95 % intervals of yaw's coefficients and of all hold the truth, the error of the total yaw inertia, and the
deviation that is stated of N_rdot.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from by_case import by_case
from pushed_box import CASES, flight, true_box
from summary import Check

from towtank.identification import learn_recordings

YAW = ("N_rdot", "N_r", "N_rr")
Found = tuple[dict[str, float], float, float]


def learned(case: str, seed: int) -> Found:
    """Return by how many deviations each identified coefficient is off, the relative error of the total yaw inertia,
    and the deviation of N_rdot [kg m^2]."""
    truth = true_box()
    learning = learn_recordings(truth.model_copy(update={"hydrodynamics": {}}), [flight(case, seed)], free_runs=False)
    off = {
        each.name: (each.value - truth.coefficient(each.name)) / each.std
        for each in learning.estimate.coefficients
        if each.identified and each.std
    }
    own = truth.rigid_body.inertia[2]
    error = (own - learning.model.coefficient("N_rdot")) / (own - truth.coefficient("N_rdot")) - 1.0
    return off, error, float(learning.estimate["N_rdot"].std or np.nan)


def checks(case: str, found: Sequence[Found]) -> list[Check]:
    """Return what must hold of one case."""
    every = np.abs([each for off, _, _ in found for each in off.values()])
    yaw = np.abs([off[name] for off, _, _ in found for name in YAW if name in off])
    error = float(np.sqrt(np.mean([error**2 for _, error, _ in found])))
    stated = float(np.median([std for _, _, std in found]))
    return [
        Check(
            f"{case}: 95 % intervals of all coefficients that hold", float(np.mean(every < 1.96)), low=0.9, high=0.99
        ),
        Check(f"{case}: those of yaw", float(np.mean(yaw < 1.96)), low=0.85),
        Check(f"{case}: beyond 4 deviations", float(np.mean(every > 4.0)), high=0.005),
        Check(f"{case}: RMSE of the total yaw inertia", error, high=0.02),
        Check(f"{case}: stated of N_rdot, median", stated, note="kg m^2"),
    ]


def row(found: Found) -> dict[str, str]:
    """Return a run as its table shows it."""
    off, error, std = found
    return {
        "identified": str(len(off)),
        "off in deviations (yaw)": ", ".join(f"{name} {off[name]:+.1f}" for name in YAW if name in off),
        "error of the yaw inertia %": f"{100.0 * error:+.2f}",
        "± N_rdot": f"{std:.4f}",
    }


if __name__ == "__main__":
    sys.exit(by_case("smooth", __doc__ or "", CASES, learned, row, checks))
