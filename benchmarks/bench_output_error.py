"""Output error: seconds for a whole fit, all of its free runs, from a start 20 % off.

    python benchmarks/bench_output_error.py [--json]

First every fit must find the truth within four of its own deviations. One core; 60 s at 100 Hz, noise of 1 mm and
1 mrad with marker jumps. Surge: inertia and drag of the vLBV300, from the position on one axis, and from the whole
pose. Coupled: 13 coefficients of all axes, whole pose.

Beside the single axis: `scipy.optimize.least_squares` (Huber's loss, finite differences) over the same unknowns, with
towtank's compiled simulator of all six axes, and with `solve_ivp` on the one equation of surge; it must find the same.
Neither takes marker jumps out, learns the noise or says how sure it is.
"""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from figures import Figure, interleaved, report
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

from towtank.core.arrays import Array
from towtank.core.rk4 import simulate_run
from towtank.identification.data.samples import N_MEASURED, Samples, samples_of
from towtank.identification.model.parameters import FreeParameters, free_parameters, put_parameters
from towtank.identification.simulation_error.fit import OutputErrorFit, fit_output_error
from towtank.identification.simulation_error.segments import CandidateModel
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
    start, noise = off(free, truth), np.full(N_MEASURED, 1e-3)

    def fit() -> OutputErrorFit:
        return fit_output_error([samples], CandidateModel(vehicle, free, start), noise)

    found = fit()
    apart = np.abs(found.theta - truth) / np.sqrt(np.diag(found.covariance))
    if not found.converged or apart.max() > 4.0:
        raise SystemExit(f"not the truth, nothing timed: {names[int(apart.argmax())]} is {apart.max():.1f} std off")
    return fit


class Plain:
    """What one writes with scipy: residuals of a free run of surge in (x, u at the start, ln inertia, X_uu)."""

    def __init__(self, run: Callable[[Array], Array], samples: Samples, start: Array) -> None:
        self.run, self.x, self.start = run, samples.values[:, 0], np.concatenate([[samples.values[0, 0], 0.0], start])
        self.scale = np.array([1e-3, 1e-3, 0.1, 0.1 * abs(start[1])])

    def unknowns(self, steps: Array) -> Array:
        return np.asarray(self.start + self.scale * (steps - 1.0))

    def residuals(self, steps: Array) -> Array:
        return (self.run(self.unknowns(steps)) - self.x) / 1e-3

    def __call__(self) -> Array:
        found = least_squares(self.residuals, np.ones(4), diff_step=1e-2, loss="huber", f_scale=2.0)
        return self.unknowns(found.x)[2:]


def simulator(vehicle: Vehicle, free: FreeParameters, samples: Samples) -> Callable[[Array], Array]:
    tau = (samples.input_force @ samples.B.T)[: len(samples) - 1, None, :]

    def run(unknowns: Array) -> Array:
        p, state = vehicle.parameters.copy(), np.zeros(13)
        put_parameters(p, free.codes, np.asarray(unknowns[2:]), np.empty((6, 6)))
        state[0], state[3], state[7] = unknowns[0], 1.0, unknowns[1]
        return np.asarray(simulate_run(p, state, tau, DT, np.zeros(3))[:, 0])

    return run


def integrator(samples: Samples) -> Callable[[Array], Array]:
    """From one change of the held force to the next."""
    force = (samples.input_force @ samples.B.T)[:, 0]
    edges = np.concatenate([[0], np.flatnonzero(np.diff(force)) + 1, [len(samples) - 1]])

    def run(unknowns: Array) -> Array:
        inertia, drag = np.exp(unknowns[2]), -unknowns[3]
        state, x = np.array(unknowns[:2]), np.empty(len(samples))
        for a, b in itertools.pairwise(edges):
            push = force[a]

            def rate(_t: float, y: Array, push: float = push) -> tuple[float, float]:
                return y[1], (push - drag * abs(y[1]) * y[1]) / inertia

            t = samples.t[a : b + 1]
            y = solve_ivp(rate, (t[0], t[-1]), state, t_eval=t, rtol=1e-8, atol=1e-10).y
            x[a : b + 1], state = y[0], y[:, -1]
        return x

    return run


def peers(fit: Callable[[], OutputErrorFit]) -> tuple[Plain, Plain]:
    """Both forms of the plain fit, proved before they are timed."""
    vehicle = surge_vehicle()
    samples, free = measured(vehicle, "paper-square", 1), free_parameters(vehicle, SURGE)
    start, found = off(free, free.theta(vehicle, delay=0.0, lag=0.0)), fit()
    both = (Plain(simulator(vehicle, free, samples), samples, start), Plain(integrator(samples), samples, start))
    for plain in both:
        apart = np.abs(plain() - found.theta) / np.sqrt(np.diag(found.covariance))
        if apart.max() > 4.0:  # marker jumps pull at it
            raise SystemExit(f"the plain fit finds something else, {apart.max():.1f} std away: nothing timed")
    return both


def measure() -> list[Figure]:
    surge = surge_vehicle()
    tasks = {
        "surge_position": task(surge, SURGE, "paper-square", 1),
        "surge_pose": task(surge, SURGE, "paper-square", 6),
        "coupled_pose": task(load_vehicle("vlbv300"), COUPLED, "all-multisine", 6),
    }
    runs = {name: fit().iterations for name, fit in tasks.items()}
    compiled, python = peers(tasks["surge_position"])
    seconds = interleaved({**tasks, "compiled": compiled}, repeats=9)
    begin = time.perf_counter()
    python()
    seconds["python"] = time.perf_counter() - begin
    figures = [
        Figure(
            f"output_error_{name}_6000",
            1e3 * seconds[name],
            "ms",
            LIMIT if name == "surge_position" else None,
            note=f"{runs[name]} free runs",
        )
        for name in tasks
    ]
    own = seconds["surge_position"]
    return [
        *figures,
        Figure("scipy_over_simulator", seconds["compiled"] / own, "x", note=f"{1e3 * seconds['compiled']:.0f} ms"),
        Figure("scipy_over_solve_ivp", seconds["python"] / own, "x", note=f"{seconds['python']:.1f} s"),
    ]


def main(argv: Sequence[str] | None = None) -> int:
    return report("output error", measure, argv)


def test_figures_are_met() -> None:
    assert main([]) == 0


if __name__ == "__main__":
    sys.exit(main())
