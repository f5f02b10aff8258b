"""The vLBV300 in its tank: the vehicle, one axis at a time, with the errors of the real chain at will."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from chain import Array, Chain

from towtank import Recording, Vehicle, load_vehicle, simulate
from towtank.simulation import Manoeuvre, Mocap, OrnsteinUhlenbeck, Sensors, manoeuvre

DELAY = 0.2  # s, from command to thrust
PUSH = OrnsteinUhlenbeck(std=0.5, time_constant=2.0)  # N
CALM = OrnsteinUhlenbeck(std=0.1, time_constant=2.0)  # N
CALM_YAW = OrnsteinUhlenbeck(std=0.01, time_constant=2.0, axes=("N",))  # N m

# axis -> row of the wrench, coordinate, velocity, added mass, drag coefficient
AXES = {
    "surge": (0, "x", "u", "X_udot", "X_uu"),
    "sway": (1, "y", "v", "Y_vdot", "Y_vv"),
    "heave": (2, "z", "w", "Z_wdot", "Z_ww"),
    "yaw": (5, "psi", "r", "N_rdot", "N_rr"),
}


def tank_vehicle() -> Vehicle:
    """Return the vlbv300 with its horizontal thrusters at z = 0, so that surge stays surge as the paper assumes."""
    vehicle = load_vehicle("vlbv300")
    level = []
    for thruster in vehicle.thrusters:
        x, y, z = thruster.position
        horizontal = thruster.direction[2] == 0.0
        level.append(thruster.model_copy(update={"position": (x, y, 0.0 if horizontal else z)}))
    return vehicle.model_copy(update={"thrusters": tuple(level)})


def without_coefficients(vehicle: Vehicle, axis: str) -> Vehicle:
    """Return the vehicle as it is before an axis was learned."""
    _, _, _, mass, drag = AXES[axis]
    return vehicle.with_coefficients({mass: 0.0, drag: 0.0})


def true_values(vehicle: Vehicle, axis: str) -> tuple[float, float]:
    """Return mass and drag M, D of an axis."""
    row, _, _, _, drag = AXES[axis]
    return float(vehicle.mass_matrix[row, row]), -vehicle.coefficient(drag)


def with_values(vehicle: Vehicle, axis: str, mass: float, drag: float) -> Vehicle:
    """Return the vehicle with mass and drag M, D of an axis replaced."""
    row, _, _, added, quadratic = AXES[axis]
    return vehicle.with_coefficients({added: float(vehicle.rigid_body_matrix[row, row]) - mass, quadratic: -drag})


@dataclass(frozen=True)
class Conditions:
    """What the tank does to a run: sensors, command delay [s], disturbance, thruster lag [s]."""

    sensors: Sensors | str = "perfect"
    delay: float = 0.0
    disturbance: OrnsteinUhlenbeck | None = None
    lag: float = 0.0

    @property
    def random(self) -> bool:
        """Whether two seeds give two runs."""
        return self.disturbance is not None or self.sensors != "perfect"


REAL = Conditions(sensors=Mocap(), delay=DELAY, disturbance=PUSH)


@dataclass(frozen=True, eq=False)
class TankRun:
    """One run along one axis: what was measured, and what was asked for."""

    axis: str
    recording: Recording
    asked: Manoeuvre

    @property
    def t(self) -> Array:
        """Times (n,) [s]."""
        return self.recording[AXES[self.axis][1]].t

    @property
    def coordinate(self) -> Array:
        """Coordinate along the axis as measured (n,) [m, rad]."""
        return self.recording[AXES[self.axis][1]].values

    @property
    def force(self) -> Array:
        """Steady force of the commands (n - 1,) [N, N m]."""
        return self.asked.wrench[:, AXES[self.axis][0]]

    def velocity(self, chain: Chain) -> Array:
        """Velocity (n,) as measured, or by differences of the pose, turned into the body."""
        row, _, name, *_ = AXES[self.axis]
        if name in self.recording:
            return self.recording[name].values
        if self.axis == "yaw":
            return chain.velocity(self.t, self.coordinate)
        angles = np.column_stack([self.recording[angle].values for angle in ("phi", "theta", "psi")])
        rates = np.column_stack([chain.velocity(self.t, self.recording[axis].values) for axis in "xyz"])
        out: Array = np.einsum("ni,ni->n", body_axes(angles)[:, :, row], rates)
        return out


def run(vehicle: Vehicle, axis: str, name: str, conditions: Conditions, seed: int = 0, **options: Any) -> TankRun:
    """Perform a manoeuvre by name under these conditions."""
    asked = manoeuvre(name, vehicle, **options)
    if conditions.lag:
        lagging = tuple(t.model_copy(update={"time_constant": conditions.lag}) for t in vehicle.thrusters)
        vehicle = vehicle.model_copy(update={"thrusters": lagging})
    recording = simulate(
        vehicle,
        **asked.inputs,
        sensors=conditions.sensors,
        delay=conditions.delay,
        disturbance=conditions.disturbance,
        seed=seed,
    )
    return TankRun(axis, recording, asked)


def body_axes(angles: Array) -> Array:
    """Return the rotation from body to NED (n, 3, 3) of phi, theta, psi (n, 3): its columns are the body's axes."""
    (s1, s2, s3), (c1, c2, c3) = np.sin(angles.T), np.cos(angles.T)
    rows = [
        [c3 * c2, c3 * s2 * s1 - s3 * c1, s3 * s1 + c3 * c1 * s2],
        [s3 * c2, c3 * c1 + s3 * s2 * s1, s3 * s2 * c1 - c3 * s1],
        [-s2, c2 * s1, c2 * c1],
    ]
    matrices: Array = np.moveaxis(np.array(rows), -1, 0)
    return matrices


def percent(values: tuple[float, float], true: tuple[float, float]) -> Array:
    """Return the errors of mass and drag (2,) in percent."""
    errors: Array = 100.0 * (np.array(values) / np.array(true) - 1.0)
    return errors
