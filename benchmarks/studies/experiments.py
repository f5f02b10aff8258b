"""The seeded experiments that the estimators are judged by.

s1-..      surge of the vLBV300 of the paper's Table II under motion capture of 1 or 5 mm, stairs or square wave
s2-..      the same at 1 mm with a random force in surge, 0.5 N, correlated over 2 s
delay-..   the same with a command delay of 0.15 s and a thruster lag of 0.10 s that the learner is not told
coupled-.. all axes of the vLBV300 at once for 60 s with a random wrench: pose; DVL, gyro and depth; gyro and depth

A surge experiment has the horizontal thrusters in the plane z = 0, so that it moves in surge alone; the learner sees
all six pose channels. What the learner is told is rigid body and thrusters, nothing of the coefficients to learn, and
of all others what they are, most of them nothing: an experiment is about as many unknowns as it names.
One seed is one run: the manoeuvre is always the same, noise, marker jumps and random forces differ.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from excitation import coupled_commands

from towtank.core.arrays import Array
from towtank.recording import Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import HYDRODYNAMIC, Coefficient, Provenance, Vehicle, index, load_vehicle

__all__ = ["COUPLED", "DELAYED", "DT", "EXPERIMENTS", "SURGE", "Experiment", "chosen", "experiment"]

DT = 0.01  # s
SURGE_TIME, COUPLED_TIME = 25.0, 60.0  # s
DELAY, LAG = 0.15, 0.10  # s
_DEPTH = 5.0  # m, where the coupled runs begin
SURGE_FREE = ("X_udot", "X_uu")
COUPLED_FREE = (
    "X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot", "BG_z", "X_uu", "Y_vv", "Z_ww", "K_pp", "M_qq", "N_rr"
)  # fmt: skip

SURGE = ("s1-1mm-stairs", "s1-1mm-square", "s1-5mm-stairs", "s1-5mm-square", "s2-stairs", "s2-square")
DELAYED = ("delay-s1-stairs", "delay-s1-square", "delay-s2-stairs", "delay-s2-square")
COUPLED = ("coupled-pose", "coupled-dvl", "coupled-gyro")
EXPERIMENTS = SURGE + DELAYED + COUPLED

_FORCE = OrnsteinUhlenbeck(std=0.5, time_constant=2.0, axes=("X",))
_WRENCH = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05), time_constant=2.0)
_ATTITUDE, _ACCELEROMETER, _DVL = ("phi", "theta", "psi"), ("ax", "ay", "az"), ("u", "v", "w")


@dataclass(frozen=True, eq=False)
class Experiment:
    """One experiment.

    Attributes:
        truth: the vehicle that is simulated. start: what the learner is told about it.
        free: names of the coefficients to learn.
        commands: (n, m), held for DT each.
        sensors: of the vehicle. hidden: channels of theirs that the learner does not get.
        disturbance: random wrench, None for none.
        delay_known: whether the learner may take the delay of `start` as it is.
        depth: of the start [m].
    """

    name: str
    truth: Vehicle
    start: Vehicle
    free: tuple[str, ...]
    commands: Array
    sensors: Mocap | Ins
    hidden: tuple[str, ...] = ()
    disturbance: OrnsteinUhlenbeck | None = None
    delay_known: bool = True
    depth: float = 0.0

    @property
    def eta0(self) -> Array:
        """Pose at the start (6,): level, heading north."""
        return np.array([0.0, 0.0, self.depth, 0.0, 0.0, 0.0])

    @property
    def duration(self) -> float:
        """Length of the run [s]."""
        return len(self.commands) * DT

    @property
    def unknowns(self) -> tuple[str, ...]:
        """The free coefficients and, where they are not known, `delay` and `lag`."""
        return self.free if self.delay_known else (*self.free, "delay", "lag")

    def record(self, seed: int) -> Recording:
        """Return the run of this seed as the learner gets it."""
        run = simulate(
            self.truth,
            commands=self.commands,
            dt=DT,
            eta0=self.eta0,
            sensors=self.sensors,
            disturbance=self.disturbance,
            seed=seed,
        )
        return run.without(*self.hidden)

    def quantity(self, name: str, coefficient: float) -> float:
        """Return what is judged: the total inertia for an added mass, else the coefficient itself."""
        kind, i, j = index(name)
        return float(self.truth.rigid_body_matrix[i, j]) - coefficient if kind == "mass" else coefficient

    @property
    def true_quantities(self) -> Array:
        """True value (k,) of what is judged for each free coefficient."""
        return np.array([self.quantity(name, self.truth.coefficient(name)) for name in self.free])


@cache
def experiment(name: str) -> Experiment:
    """Return the experiment of this name."""
    family, *rest = name.split("-")
    if family == "coupled":
        return _coupled(name, rest[0])
    truth = _surge_vehicle(DELAY, LAG) if family == "delay" else _surge_vehicle(0.0, 0.0)
    level = rest[0] if family == "delay" else family
    return Experiment(
        name=name,
        truth=truth,
        start=_known(truth, SURGE_FREE),
        free=SURGE_FREE,
        commands=_paper_commands(truth, rest[-1]),
        sensors=Mocap(noise_mm=5.0 if "5mm" in rest else 1.0),
        disturbance=_FORCE if level == "s2" else None,
        delay_known=family != "delay",
    )


def chosen(names: Iterable[str], only: str | None) -> tuple[str, ...]:
    """Return the names that match `only`: parts of names or shell patterns, separated by commas; None for all.

    Raises:
        ValueError: nothing matches.
    """
    names = tuple(names)
    if only is None:
        return names
    patterns = [part if any(c in part for c in "*?[") else f"*{part}*" for part in only.split(",")]
    found = tuple(name for name in names if any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns))
    if not found:
        raise ValueError(f'--only: nothing matches "{only}"; there are {", ".join(names)}')
    return found


def _coupled(name: str, sensors: str) -> Experiment:
    truth = load_vehicle("vlbv300")
    hidden = {"pose": (), "dvl": _ATTITUDE + _ACCELEROMETER, "gyro": _ATTITUDE + _ACCELEROMETER + _DVL}[sensors]
    return Experiment(
        name=name,
        truth=truth,
        start=_known(truth, COUPLED_FREE),
        free=COUPLED_FREE,
        commands=coupled_commands(truth, COUPLED_TIME, DT),
        sensors=Mocap() if sensors == "pose" else Ins(),
        hidden=hidden,
        disturbance=_WRENCH,
        depth=_DEPTH,
    )


def _paper_commands(vehicle: Vehicle, form: str) -> Array:
    commands = manoeuvre(f"paper-{form}", vehicle, duration=SURGE_TIME, dt=DT).commands
    if commands is None:
        raise ValueError(f"{vehicle.name} has no thrusters")
    return commands


def _surge_vehicle(delay: float, lag: float) -> Vehicle:
    """Return the vLBV300 with its horizontal thrusters in the plane z = 0: surge thrust does not pitch it."""
    vehicle = load_vehicle("vlbv300")
    thrusters = []
    for thruster in vehicle.thrusters:
        x, y, z = thruster.position
        height = 0.0 if thruster.direction[2] == 0.0 else z
        thrusters.append(thruster.model_copy(update={"position": (x, y, height), "time_constant": lag}))
    return vehicle.model_copy(update={"name": "vlbv300_surge", "thrusters": tuple(thrusters), "command_delay": delay})


def _known(truth: Vehicle, free: tuple[str, ...]) -> Vehicle:
    """Return the vehicle without the coefficients to learn, all others told, zeros too; its thrusters answer at once.

    What nobody tells would be held at what is usual for a body of this size, and a wrong linear drag makes the
    quadratic one wrong. A zero is told by its deviation of zero: without one a file says nothing by it.
    """
    told = {name: Coefficient(value=truth.coefficient(name), std=0.0) for name in HYDRODYNAMIC if name not in free}
    buoyancy = truth.buoyancy
    if "BG_z" in free:
        buoyancy = buoyancy.model_copy(update={"centre": truth.rigid_body.centre_of_gravity, "source": ""})
    return truth.model_copy(
        update={
            "description": "rigid body, thrusters, and what is not to be learned",
            "hydrodynamics": told,
            "buoyancy": buoyancy,
            "thrusters": tuple(thruster.model_copy(update={"time_constant": 0.0}) for thruster in truth.thrusters),
            "command_delay": 0.0,
            "provenance": Provenance(source="a simulated experiment"),
        }
    )
