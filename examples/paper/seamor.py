"""The Seamor of the paper's Table I, its six experiments, and a learner that follows them sample by sample.

Sensors are perfect: velocity and attitude at 100 Hz, the wrench known. The centre of buoyancy was never published; here
it is put above the centre of gravity, so that there is a righting moment to find.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from towtank import Vehicle, load_vehicle, simulate
from towtank.identification import PaperLearner
from towtank.vehicle import Buoyancy

Array = NDArray[np.float64]
Inputs = Literal["smooth", "held"]

RATE = 100.0  # Hz
RIGHTING = 4.0  # N m/rad, B (z_G - z_B)

# Table I as printed: coefficient -> truth, estimate
TABLE_I = {
    "X_udot": ("-27.08", "-27.08"),
    "X_uu": ("-61.117", "-61.117"),
    "Y_vdot": ("-25.952", "-25.952"),
    "Y_vv": ("-139.81", "-139.81"),
    "Z_wdot": ("-68.576", "-68.576"),
    "Z_ww": ("-51.724", "-51.724"),
    "K_pdot": ("-61.683", "-61.683"),
    "K_pp": ("-12.0", "-12.0"),
    "M_qdot": ("-79.411", "-82.363"),
    "M_qq": ("-56.61", "-58.77"),
    "N_rdot": ("-0.154", "-0.154"),
    "N_rr": ("-1.772", "-1.772"),
}


@dataclass(frozen=True)
class Experiment:
    """Sines on some rows of the wrench: (row, amplitude [N, N m], frequency [rad/s]), for so many seconds."""

    name: str
    sines: tuple[tuple[int, float, float], ...]
    duration: float = 40.0

    def wrench(self, t: Array) -> Array:
        """Return X Y Z K M N (..., 6) [N, N m] at times (...) [s]."""
        out = np.zeros((*np.shape(t), 6))
        for row, amplitude, frequency in self.sines:
            out[..., row] = amplitude * np.sin(frequency * t)
        return out


# The paper's order: pitch comes last, since it needs what surge and heave have taught.
EXPERIMENTS = (
    Experiment("surge", ((0, 40.0, 0.8),)),
    Experiment("sway", ((1, 60.0, 0.8),)),
    Experiment("heave", ((2, 40.0, 0.8),)),
    Experiment("roll", ((3, 30.0, 0.8),)),
    Experiment("yaw", ((5, 4.0, 0.8),)),
    Experiment("pitch", ((0, 40.0, 0.8), (2, -60.0, 0.5))),
)


@dataclass(frozen=True, eq=False)
class Run:
    """One experiment as measured: times (n,) [s], pose (n, 6), velocity (n, 6), and wrench (n, 6) from each time on."""

    t: Array
    pose: Array
    velocity: Array
    wrench: Array


def truth(righting: float = RIGHTING) -> Vehicle:
    """Return the Seamor with its centre of buoyancy so high that B (z_G - z_B) is `righting` [N m/rad]."""
    vehicle = load_vehicle("seamor")
    force = vehicle.buoyant_force
    return vehicle.model_copy(update={"buoyancy": Buoyancy(force=force, centre=(0.0, 0.0, -righting / force))})


def rigid_body_only() -> Vehicle:
    """Return what is known before the first experiment: mass, moments of inertia, and that it floats."""
    return load_vehicle("seamor").model_copy(update={"name": "seamor_unknown", "hydrodynamics": {}})


def perform(vehicle: Vehicle, experiment: Experiment, inputs: Inputs) -> Run:
    """Simulate an experiment with a continuous ("smooth") wrench, or with one held from sample to sample ("held")."""
    dt = 1.0 / RATE
    times = np.arange(round(experiment.duration * RATE), dtype=np.float64) * dt
    if inputs == "smooth":
        log = simulate(vehicle, wrench=experiment.wrench, dt=dt, duration=experiment.duration)
    else:
        log = simulate(vehicle, wrench=experiment.wrench(times), dt=dt)
    t = log["u"].t
    pose = np.column_stack([log[name].values for name in ("x", "y", "z", "phi", "theta", "psi")])
    velocity = np.column_stack([log[name].values for name in "uvwpqr"])
    return Run(t, pose, velocity, experiment.wrench(t))


def learn(vehicle: Vehicle, runs: Sequence[Run], *, inputs: Inputs, a: float, free: Sequence[str]) -> PaperLearner:
    """Return a learner that has seen the runs, one sample after the other.

    Args:
        vehicle: what is known beforehand.
        a: filter constant [1/s].
        free: names of the coefficients to learn.
    """
    learner = PaperLearner(vehicle, a=a, inputs=inputs, free=free)
    for run in runs:
        learner.restart()
        for t, pose, velocity, wrench in zip(run.t, run.pose, run.velocity, run.wrench, strict=True):
            learner.update(t, pose=pose, velocity=velocity, wrench=wrench)
    return learner
