"""The signals that the page draws, in the order of their columns."""

from __future__ import annotations

import math
from dataclasses import dataclass

from towtank.vehicle import Vehicle

__all__ = ["ACCELERATION", "COMMANDS", "POSE", "VELOCITY", "WRENCH", "Signal", "signals_of"]

POSE, VELOCITY, ACCELERATION, WRENCH = slice(0, 6), slice(6, 12), slice(12, 15), slice(15, 21)
COMMANDS = 21  # the first column of the commands; voltage stands behind them

_DEGREES = 180.0 / math.pi


@dataclass(frozen=True)
class Signal:
    """One column: its name, the chart that it stands in, the unit shown, and by what SI is multiplied for that."""

    name: str
    chart: str
    unit: str
    scale: float = 1.0


def signals_of(vehicle: Vehicle) -> tuple[Signal, ...]:
    """Return the signals of a vehicle."""
    return (
        *(Signal(name, "position", "m") for name in ("x", "y", "z")),
        *(Signal(name, "attitude", "°", _DEGREES) for name in ("phi", "theta", "psi")),
        *(Signal(name, "velocity", "m/s") for name in ("u", "v", "w")),
        *(Signal(name, "rates", "°/s", _DEGREES) for name in ("p", "q", "r")),
        *(Signal(name, "acceleration", "m/s²") for name in ("ax", "ay", "az")),
        *(Signal(name, "force", "N") for name in ("X", "Y", "Z")),
        *(Signal(name, "moment", "N m") for name in ("K", "M", "N")),
        *(Signal(thruster.name, "commands", "units of the curve") for thruster in vehicle.thrusters),
        Signal("voltage", "voltage", "V"),
    )
