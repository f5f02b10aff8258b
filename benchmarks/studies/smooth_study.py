"""Speeds that were smoothed before anyone saw them, beside a pose that was not.

    python benchmarks/studies/smooth_study.py [--runs 20] [--only 1.2] [--output smooth.json]

A box is pushed in surge and turned in yaw at random for 80 s, a new wrench every 1.2 s, in water that stirs it. Pose
and rates are measured at 20 Hz, by sensors with white noise. `raw`: as they are. `smooth 0.3`, `smooth 1.2`: rates are
means over so many seconds about each sample, as a tool makes them afterwards. `heading wanders`: raw rates beside a
heading that walks at random, as of a compass near thrusters. How many 95 % intervals of yaw's coefficients and of all
hold the truth, and the error of the total yaw inertia.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from report import checks_table, show
from rich.table import Table
from runner import arguments, over, write_json
from summary import Check

from towtank.core.arrays import Array
from towtank.identification import learn_recordings
from towtank.recording import Recording
from towtank.simulation import OrnsteinUhlenbeck, simulate
from towtank.vehicle import Vehicle

__all__ = ["CASES", "flight", "mean_over", "true_box"]

STEP, ROWS, HELD = 0.05, 1600, 24  # s; rows; of them a wrench is held
NOISE = {"x": 5e-3, "y": 5e-3, "z": 5e-3, "phi": 2e-3, "theta": 2e-3, "psi": 2e-3, "p": 1e-3, "q": 1e-3, "r": 1e-3}
SPEED_NOISE = {"u": 1e-2, "v": 1e-2, "w": 1e-2}
STIRRED = OrnsteinUhlenbeck(std=(0.3, 0.3, 0.3, 0.01, 0.01, 0.02))
WALK = 0.03  # rad in a second
CASES = {"raw": (0.0, 0.0), "smooth 0.3": (0.3, 0.0), "smooth 1.2": (1.2, 0.0), "heading wanders": (0.0, WALK)}
YAW = ("N_rdot", "N_r", "N_rr")
TRUTH = {
    "X_udot": -10.0, "Y_vdot": -20.0, "Z_wdot": -25.0, "K_pdot": -0.5, "M_qdot": -0.6, "N_rdot": -0.8,
    "X_uu": -30.0, "Y_vv": -60.0, "Z_ww": -70.0, "K_pp": -1.0, "M_qq": -1.5, "N_rr": -2.0,
}  # fmt: skip
Found = tuple[dict[str, float], float]


def true_box() -> Vehicle:
    """A neutral vehicle of 20 kg without thrusters, quadratic drag, its centre of buoyancy 2 cm above its origin."""
    return Vehicle.model_validate(
        {
            "name": "box",
            "rigid_body": {"mass": 20.0, "inertia": (1.0, 1.2, 1.5)},
            "buoyancy": {"centre": (0.0, 0.0, -0.02)},
            "hydrodynamics": TRUTH,
        }
    )


def mean_over(x: Array, seconds: float) -> Array:
    """Return means over a time about each sample (n,)."""
    n = round(seconds / STEP) | 1
    return np.convolve(np.pad(x, n // 2, mode="edge"), np.ones(n) / n, mode="valid")


def flight(case: str, seed: int, *, speeds: bool = False) -> Recording:
    """Return a run as it was recorded: wrench, pose, rates, and the speeds."""
    smoothed, walk = CASES[case]
    noise = {**NOISE, **(SPEED_NOISE if speeds else {})}
    rng = np.random.default_rng(seed)
    wrench = np.zeros((ROWS, 6))
    for first in range(0, ROWS, HELD):
        wrench[first : first + HELD, 5] = rng.choice([-3.0, 3.0])
        wrench[first : first + HELD, 0] = rng.choice([-15.0, 0.0, 15.0])
    run = simulate(true_box(), wrench=wrench, dt=STEP, disturbance=STIRRED, seed=seed)
    columns = {name: run[name].values + std * rng.normal(size=len(run[name])) for name, std in noise.items()}
    columns["psi"] += np.cumsum(walk * np.sqrt(STEP) * rng.normal(size=len(run["psi"])))
    if smoothed:
        columns |= {name: mean_over(columns[name], smoothed) for name in "pqr"}
    channels = [run[name].with_values(values) for name, values in columns.items()]
    return run.without(*"uvwpqr").replace(channels)


def learned(case: str, seed: int) -> Found:
    """Return by how many deviations each identified coefficient is off, and the relative error of the yaw inertia."""
    truth = true_box()
    learning = learn_recordings(truth.model_copy(update={"hydrodynamics": {}}), [flight(case, seed)], free_runs=False)
    off = {
        each.name: (each.value - truth.coefficient(each.name)) / each.std
        for each in learning.estimate.coefficients
        if each.identified and each.std
    }
    own = truth.rigid_body.inertia[2]
    return off, (own - learning.model.coefficient("N_rdot")) / (own - truth.coefficient("N_rdot")) - 1.0


def checks(case: str, found: Sequence[Found]) -> list[Check]:
    """Return what must hold of one case."""
    every = np.abs([each for off, _ in found for each in off.values()])
    yaw = np.abs([off[name] for off, _ in found for name in YAW if name in off])
    error = float(np.sqrt(np.mean([error**2 for _, error in found])))
    return [
        Check(
            f"{case}: 95 % intervals of all coefficients that hold", float(np.mean(every < 1.96)), low=0.9, high=0.99
        ),
        Check(f"{case}: those of yaw", float(np.mean(yaw < 1.96)), low=0.85),
        Check(f"{case}: beyond 4 deviations", float(np.mean(every > 4.0)), high=0.005),
        Check(f"{case}: RMSE of the total yaw inertia", error, high=0.02),
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where everything that must hold holds."""
    options = arguments(__doc__ or "", 20, argv)
    cases = [name for name in CASES if not options.only or any(each in name for each in options.only.split(","))]
    seeds = range(options.seed, options.seed + options.runs)
    held: list[Check] = []
    documents = {}
    for case in cases:
        found = over(f"smooth, {case}", learned, [(case, seed) for seed in seeds], options.workers)
        table = Table(title=f"{case}, {len(seeds)} runs", title_justify="left")
        for name in ("seed", "identified", "off in deviations (yaw)", "error of the yaw inertia %"):
            table.add_column(name)
        for seed, (off, error) in zip(seeds, found, strict=True):
            words = ", ".join(f"{name} {off[name]:+.1f}" for name in YAW if name in off)
            table.add_row(str(seed), str(len(off)), words, f"{100.0 * error:+.2f}")
        show(table)
        held += checks(case, found)
        documents[case] = found
    show(checks_table("must hold", held))
    write_json(options.output, {"study": "smooth", "cases": documents, "checks": [each.document() for each in held]})
    return 0 if all(check.met for check in held) else 1


if __name__ == "__main__":
    sys.exit(main())
