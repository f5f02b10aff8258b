"""The last half minute of all signals that the page draws, out of the instants that a session hands over."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.dashboard.feed import Instant
from towtank.vehicle import Vehicle, thruster_wrench

__all__ = ["ACCELERATION", "COMMANDS", "POSE", "VELOCITY", "WRENCH", "Motion", "Signal", "signals_of"]

POSE, VELOCITY, ACCELERATION, WRENCH = slice(0, 6), slice(6, 12), slice(12, 15), slice(15, 21)
COMMANDS = 21  # the first column of the commands; voltage stands behind them
_DEGREES = 180.0 / math.pi
_STEP = 0.0095  # s: what comes within it is one row, so that no more than about 100 rows are drawn a second
_SPAN = 3000  # rows that are kept
_VECTORS = {"pose": POSE, "velocity": VELOCITY, "acceleration": ACCELERATION, "wrench": WRENCH}


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


class Motion:
    """Rows of signals over time, the newest `_SPAN` of them; NaN where nothing was measured or commanded."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._width = len(signals_of(vehicle))
        self._t = np.empty(2 * _SPAN)
        self._rows = np.empty((2 * _SPAN, self._width))
        self._count = 0
        self._open: Array | None = None  # the row that may still grow
        self._open_t = -np.inf
        self._voltage: float | None = None

    def add(self, instants: Sequence[Instant]) -> tuple[Array, Array]:
        """Take instants; return times (n,) [s] and values (n, width) of the rows that they completed."""
        t, rows = [], []
        for stamp, arguments in instants:
            if stamp < self._open_t:
                continue
            if self._open is None or stamp - self._open_t >= _STEP:
                if self._open is not None:
                    t.append(self._open_t)
                    rows.append(self._open)
                self._open, self._open_t = np.full(self._width, np.nan), stamp
            self._put(self._open, arguments)
        if not rows:
            return np.empty(0), np.empty((0, self._width))
        values, times = np.array(rows), np.array(t)
        self._fill_wrench(values)
        self._keep(times, values)
        return times, values

    def last(self, seconds: float) -> tuple[Array, Array]:
        """Return times (n,) [s] and values (n, width) of the last `seconds`; not copied."""
        t = self._t[: self._count]
        first = int(np.searchsorted(t, t[-1] - seconds)) if t.size else 0
        return t[first:], self._rows[first : self._count]

    def _put(self, row: Array, arguments: Mapping[str, Any]) -> None:
        for name, value in arguments.items():
            if name == "commands":
                row[COMMANDS : COMMANDS + len(value)] = value
            elif name == "voltage":
                row[-1] = value
            elif name in _VECTORS:
                place = row[_VECTORS[name]]
                np.copyto(place, value, where=np.isfinite(value))

    def _fill_wrench(self, values: Array) -> None:
        """Put in the wrench of the thrusters at steady state, where they were commanded."""
        commands = values[:, COMMANDS:-1]
        commanded = np.isfinite(commands).all(axis=1) if commands.shape[1] else np.zeros(len(values), dtype=bool)
        if commanded.any():
            voltage = values[commanded, -1] if np.isfinite(values[commanded, -1]).all() else None
            values[commanded, WRENCH] = thruster_wrench(self._vehicle, commands[commanded], voltage)

    def _keep(self, t: Array, rows: Array) -> None:
        t, rows = t[-_SPAN:], rows[-_SPAN:]
        n = t.size
        if self._count + n > 2 * _SPAN:
            kept = _SPAN - n
            self._t[:kept] = self._t[self._count - kept : self._count]
            self._rows[:kept] = self._rows[self._count - kept : self._count]
            self._count = kept
        self._t[self._count : self._count + n] = t
        self._rows[self._count : self._count + n] = rows
        self._count += n
