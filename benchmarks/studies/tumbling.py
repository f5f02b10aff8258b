"""A vehicle that tumbles under all its thrusters while only gyros measure; some give less than their curves say."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from towtank.recording import Recording
from towtank.recording.standard import RATES
from towtank.simulation import Ins, OrnsteinUhlenbeck, simulate
from towtank.simulation.sensors.sensor import Sensors
from towtank.vehicle import Vehicle, load_vehicle

__all__ = ["INERTIAS", "TURNING", "named", "true_vehicle", "tumble"]

WATER = OrnsteinUhlenbeck((5.0, 5.0, 5.0, 0.3, 0.3, 0.3), 0.5, ("X", "Y", "Z", "K", "M", "N"))
TURNING = {
    "K_pdot": -0.25, "M_qdot": -0.28, "N_rdot": -0.75, "K_p": -1.7, "M_q": -1.8, "N_r": -4.0, "BG_z": 1.3,
    "K_pp": 0.0, "M_qq": 0.0, "N_rr": 0.0,
}  # fmt: skip
INERTIAS = ("K_pdot", "M_qdot", "N_rdot")
_LEVELS = (1260.0, 1500.0, 1740.0)
_GYROS = Ins()
_KEPT = 0.6  # probability that a thruster stays as it is for another 0.2 s


def named() -> Vehicle:
    """The vehicle as its file has it, which a learner starts from."""
    return load_vehicle("bluerov_2016")


def true_vehicle(*, lag: float = 0.0, **gains: float) -> Vehicle:
    """The vehicle as it turns in truth, with the gains of some thrusters and a lag [s] of all."""
    vehicle = named().with_coefficients(TURNING)
    thrusters = tuple(
        each.model_copy(update={"gain": gains.get(each.name, 1.0), "time_constant": lag}) for each in vehicle.thrusters
    )
    return vehicle.model_copy(update={"thrusters": thrusters})


def tumble(
    vehicle: Vehicle,
    *,
    seed: int,
    seconds: float = 60.0,
    sensors: Sensors = _GYROS,
    measured: Sequence[str] = RATES,
    water: OrnsteinUhlenbeck = WATER,
) -> Recording:
    """All thrusters switched at random every 0.2 s or later, in stirred water; the commands, and what is measured.

    That is p, q, r at 100 Hz unless others are named.
    """
    random = np.random.default_rng(seed)
    steps = round(seconds / 0.2)
    levels = random.choice(_LEVELS, size=(steps, len(vehicle.thrusters)))
    kept = random.random(levels.shape) < _KEPT
    for k in range(1, steps):
        levels[k] = np.where(kept[k], levels[k - 1], levels[k])
    commands = np.repeat(levels, 20, axis=0)
    run = simulate(vehicle, commands=commands, dt=0.01, sensors=sensors, disturbance=water, seed=seed)
    return run.without(*(name for name in run if name not in measured and not name.startswith("cmd_")))
