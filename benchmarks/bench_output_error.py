"""Output error: seconds for a whole fit, all of its free runs, from a start 20 % off.

    python benchmarks/bench_output_error.py [--json]

First every fit must find the truth within four of its own deviations. One core; 60 s at 100 Hz, noise of 1 mm and
1 mrad with marker jumps. Surge: inertia and drag of the vLBV300, from the position on one axis, and from the whole
pose. Coupled: 13 coefficients of all axes, whole pose.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from figures import Figure, interleaved, report

from towtank.core.arrays import Array
from towtank.identification.output_error import OutputErrorFit, fit_output_error
from towtank.identification.parameters import FreeParameters, free_parameters
from towtank.identification.samples import Samples, samples_of
from towtank.simulation import Mocap, manoeuvre, simulate
from towtank.vehicle import Vehicle, load_vehicle

DURATION, DT = 60.0, 0.01  # s
SURGE = ("X_udot", "X_uu")
COUPLED = (
    "X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot", "BG_z", "X_uu", "Y_vv", "Z_ww", "K_pp", "M_qq", "N_rr"
)  # fmt: skip
LIMIT = 50.0  # ms, of the single axis
OFF = 0.2


def surge_vehicle() -> Vehicle:
    """The vLBV300 with its horizontal thrusters in the plane z = 0: surge thrust does not pitch it."""
    vehicle = load_vehicle("vlbv300")
    level = tuple(
        thruster.model_copy(update={"position": (*thruster.position[:2], 0.0)})
        if thruster.direction[2] == 0.0
        else thruster
        for thruster in vehicle.thrusters
    )
    return vehicle.model_copy(update={"thrusters": level})


def measured(vehicle: Vehicle, motion: str, columns: int) -> Samples:
    wrench = manoeuvre(motion, vehicle, duration=DURATION, dt=DT)
    run = simulate(vehicle, commands=wrench.commands, dt=DT, sensors=Mocap(), seed=1)
    samples = samples_of(run, vehicle)
    values = samples.values.copy()
    values[:, columns:] = np.nan
    return replace(samples, values=values)


def off(free: FreeParameters, theta: Array) -> Array:
    """Every coefficient too large or too small by a fifth, in turn."""
    side = np.where(np.arange(len(free)) % 2 == 0, 1.0 - OFF, 1.0 + OFF)
    return np.where(free.codes[:, 3] != 0, theta + np.log(side), theta * side)


def task(vehicle: Vehicle, names: tuple[str, ...], motion: str, columns: int) -> Callable[[], OutputErrorFit]:
    """A fit, proved before it is timed."""
    samples, free = measured(vehicle, motion, columns), free_parameters(vehicle, names)
    truth = free.theta(vehicle, delay=0.0, lag=0.0)
    start, noise = off(free, truth), np.full(15, 1e-3)

    def fit() -> OutputErrorFit:
        return fit_output_error([samples], vehicle.parameters, free, start, noise)

    found = fit()
    apart = np.abs(found.theta - truth) / np.sqrt(np.diag(found.covariance))
    if not found.converged or apart.max() > 4.0:
        raise SystemExit(f"not the truth, nothing timed: {names[int(apart.argmax())]} is {apart.max():.1f} std off")
    return fit


def measure() -> list[Figure]:
    surge = surge_vehicle()
    tasks = {
        "surge_position": task(surge, SURGE, "paper-square", 1),
        "surge_pose": task(surge, SURGE, "paper-square", 6),
        "coupled_pose": task(load_vehicle("vlbv300"), COUPLED, "all-multisine", 6),
    }
    runs = {name: fit().iterations for name, fit in tasks.items()}
    seconds = interleaved(dict(tasks), repeats=9)
    return [
        Figure(
            f"output_error_{name}_6000",
            1e3 * seconds[name],
            "ms",
            LIMIT if name == "surge_position" else None,
            note=f"{runs[name]} free runs",
        )
        for name in tasks
    ]


def main(argv: Sequence[str] | None = None) -> int:
    return report("output error", measure, argv)


def test_figures_are_met() -> None:
    assert main([]) == 0


if __name__ == "__main__":
    sys.exit(main())
