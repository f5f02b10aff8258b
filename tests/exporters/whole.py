"""A vehicle that has every kind of coefficient and of thruster curve, and random states of a vehicle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from towtank import load_vehicle
from towtank.core.arrays import Array
from towtank.exporters.request import speed_range
from towtank.vehicle import Vehicle

THRUSTERS = [
    {
        "name": "ahead 1",
        "curve": {
            "kind": "polynomial",
            "coefficients": [0.0684, -0.03366, 0.006736],
            "dead_band": 5,
            "limits": [-102, 102],
        },
    },
    {
        "name": "ahead 2",
        "curve": {
            "kind": "polynomial",
            "coefficients": [0.0, 20.0, 31.0],
            "reverse": [0.0, 15.0, 25.0],
            "neutral": 1500,
            "scale": 400,
            "dead_band": 28,
            "limits": [1100, 1900],
            "voltage": {"nominal": 16.0, "exponent": 1.6, "reverse_exponent": 1.4},
        },
    },
    {
        "name": "side",
        "curve": {"kind": "polynomial", "coefficients": [0.1, 8.0, 0.3, 1.2], "odd": False, "limits": [-3, 4]},
    },
    {
        "name": "lift 1",
        "curve": {"kind": "table", "command": [-1, -0.4, -0.05, 0.05, 0.5, 1], "force": [-31, -9, 0, 0, 12, 42]},
    },
    {"name": "lift 2", "curve": {"kind": "quadratic", "forward": 0.0004, "reverse": 0.0003, "limits": [-400, 350]}},
    {"name": "free", "curve": {"kind": "quadratic", "forward": 0.5}},
]
PLACES = [
    ([-0.3, 0.2, 0.05], [1.0, 0.2, 0.0]),
    ([-0.3, -0.2, 0.05], [1.0, -0.2, 0.0]),
    ([0.1, 0.0, 0.1], [0.0, 1.0, 0.0]),
    ([0.2, 0.1, 0.0], [0.0, 0.1, -1.0]),
    ([-0.2, 0.1, 0.0], [0.0, 0.0, 1.0]),
    ([0.0, -0.2, 0.1], [0.3, 0.5, 0.8]),
]


def whole_vehicle() -> Vehicle:
    """A RexROV of a hundredth, with terms of every kind beside its full matrices."""
    base = load_vehicle("rexrov")
    chance = np.random.default_rng(3)
    values = {name: 0.01 * each.value for name, each in base.hydrodynamics.items()}
    for row, column in ((i, j) for i in range(6) for j in range(6) if i != j):
        values[f"{'XYZKMN'[row]}_{'uvwpqr'[column]}"] = float(chance.uniform(-0.05, 0.05))
        values[f"{'XYZKMN'[row]}_{'uvwpqr'[column] * 2}"] = float(chance.uniform(-0.5, 0.5))
    lift = {
        "Y_uv": -8.0,
        "Y_ur": 1.5,
        "N_uv": -2.0,
        "N_ur": -3.0,
        "K_up": -0.6,
        "Z_uw": -9.0,
        "Z_uq": -1.0,
        "M_uw": 0.5,
    }
    drag = {"X_u2": 1.1, "Y_v2": -0.7, "Z_w2": 2.0, "K_p2": 0.01, "M_q2": -0.02, "N_r2": 0.03, "M_uq": -2.5}
    held = {"X_0": 0.4, "Y_0": -0.2, "Z_0": 0.6, "K_0": 0.05, "M_0": -0.1, "N_0": 0.02}
    thrusters = [
        {**each, "position": position, "direction": direction, "gain": 1.0 + 0.05 * k, "time_constant": 0.05 * (k % 3)}
        for k, (each, (position, direction)) in enumerate(zip(THRUSTERS, PLACES, strict=True))
    ]
    return Vehicle.model_validate(
        {
            "name": "Whole */ -- \"vehicle\" '''\n1",
            "rigid_body": {
                "mass": 18.6,
                "inertia": [[0.525, -0.0144, -0.033], [-0.0144, 0.794, 0.026], [-0.033, 0.026, 0.691]],
                "centre_of_gravity": [0.01, -0.02, 0.03],
            },
            "restoring": {"W_minus_B": -2.5, "BG_x": 0.3, "BG_y": -0.2, "BG_z": 6.0},
            "hydrodynamics": {**values, **lift, **drag, **held, "inflow_loss": 0.07},
            "thrusters": [{**each, "name": str(each["name"]).replace(" ", "_")} for each in thrusters],
        }
    )


class States(NamedTuple):
    """Poses, velocities and wrenches (n, 6) each."""

    eta: Array
    nu: Array
    tau: Array


def random_states(vehicle: Vehicle, count: int, seed: int = 0) -> States:
    """Any attitude, velocities as the thrusters make them, wrenches that accelerate as much in a second."""
    chance = np.random.default_rng(seed)
    speeds = speed_range(vehicle)
    eta = chance.uniform(-1.0, 1.0, (count, 6)) * np.array([5.0, 5.0, 5.0, np.pi, 0.49 * np.pi, np.pi])
    nu = chance.uniform(-1.0, 1.0, (count, 6)) * speeds
    tau = chance.uniform(-1.0, 1.0, (count, 6)) @ np.diag(np.abs(vehicle.mass_matrix @ speeds))
    return States(eta, nu, tau)


def random_commands(vehicle: Vehicle, count: int, seed: int = 0) -> Array:
    """Commands within and somewhat beyond the limits of every thruster."""
    chance = np.random.default_rng(seed)
    out = np.empty((count, len(vehicle.thrusters)))
    for k, thruster in enumerate(vehicle.thrusters):
        curve = thruster.curve
        low, high = curve.limits or (curve.rest - 2.0, curve.rest + 2.0)
        out[:, k] = chance.uniform(low - 0.1 * (high - low), high + 0.1 * (high - low), count)
        out[::7, k] = curve.rest
    return out
