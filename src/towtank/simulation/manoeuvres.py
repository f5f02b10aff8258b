"""Manoeuvres by name: what to do with a vehicle so that its coefficients show.

`surge-sine`, `yaw-stairs`, `all-multisine`, ..: an axis (or all at once) and a wave form; `tank-session`: all axes in
turn; `paper-stairs`, `paper-square`. The wrench goes through the pseudo-inverse of the thrusters, so that a sway
test does not yaw.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.recording.channel import read_only
from towtank.simulation import paper_runs, tank_session
from towtank.simulation.excitation import AXES, available_rows, fit_to_thrusters, tempo, usual_amplitudes
from towtank.simulation.inputs import finite_array, positive, step_count
from towtank.simulation.signals import FORMS
from towtank.simulation.streams import stream
from towtank.vehicle import Vehicle, allocate, thruster_wrench

__all__ = ["MANOEUVRES", "BuiltIn", "Manoeuvre", "manoeuvre"]

_MOMENT_OF_FORCES = ("surge", "heave")  # what moves a vehicle in pitch that cannot be commanded in pitch


@dataclass(frozen=True)
class BuiltIn:
    """A manoeuvre of the registry: one line about it, its axes, its wave form, its usual duration [s]."""

    description: str
    axes: tuple[str, ...]
    form: str
    duration: float = 60.0


@dataclass(frozen=True, eq=False)
class Manoeuvre:
    """Inputs over time. The arrays are read-only.

    Attributes:
        name: of the built-in, or of where it came from.
        t: times (n,) [s], 0, dt, ..; each input holds from its time on.
        dt: step [s].
        wrench: what the thrusters give at steady state (n, 6) [N, N m], body FRD.
        commands: thruster commands (n, m) in the units of their curves; None for a vehicle without thrusters.
    """

    name: str
    t: Array
    dt: float
    wrench: Array
    commands: Array | None = None

    def __post_init__(self) -> None:
        for name in ("t", "wrench", "commands"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def inputs(self) -> dict[str, Any]:
        """The arguments for `simulate`: `simulate(vehicle, **manoeuvre.inputs)`."""
        if self.commands is None:
            return {"wrench": self.wrench, "dt": self.dt}
        return {"commands": self.commands, "dt": self.dt}


def _registry() -> dict[str, BuiltIn]:
    found = {}
    for axis in (*AXES, "all"):
        for form, shape in FORMS.items():
            along = "all axes at once" if axis == "all" else axis
            found[f"{axis}-{form}"] = BuiltIn(f"{along}: {shape.description}", AXES if axis == "all" else (axis,), form)
    found["tank-session"] = BuiltIn("all axes in turn, out and back, rest between", tank_session.ORDER, "square", 120.0)
    found["paper-stairs"] = BuiltIn("surge: commands 13 18 23 28 ahead, then astern", ("surge",), "stairs", 16.5)
    found["paper-square"] = BuiltIn("surge: commands +-30, period 5 s", ("surge",), "square", 20.5)
    return found


MANOEUVRES: dict[str, BuiltIn] = _registry()


def manoeuvre(
    name: str,
    vehicle: Vehicle,
    *,
    duration: float | None = None,
    dt: float = 0.01,
    amplitude: ArrayLike | None = None,
    seed: int = 0,
) -> Manoeuvre:
    """Return the inputs of a built-in manoeuvre for a vehicle.

    Args:
        duration: [s], default that of the built-in; rounded to whole steps.
        dt: step [s].
        amplitude: [N] or [N m] of its axis, or six numbers X .. N; commands for the paper's runs. Default:
            about a third of what the thrusters can give within the range of their fit, but no more than
            a gentle motion needs; without thrusters an acceleration of 0.4 m/s^2 or 0.1 .. 0.4 rad/s^2.
        seed: of the random wave forms.

    Pitch that cannot be commanded (all horizontal thrusters in one plane) is excited by surge and heave together.

    Raises:
        InputError: an unknown name (the nearest one is named), an axis that the vehicle cannot command, a bad number.
    """
    if name not in MANOEUVRES:
        raise InputError(f'unknown manoeuvre "{name}"{nearest(name, MANOEUVRES) or "; see manoeuvre list"}')
    built_in = MANOEUVRES[name]
    dt = positive("dt", dt)
    t = np.arange(step_count(built_in.duration if duration is None else duration, dt), dtype=np.float64) * dt
    if name.startswith("paper-"):
        return _paper_run(name, vehicle, t, dt, amplitude)
    size = usual_amplitudes(vehicle) if amplitude is None else _given_amplitudes(built_in, amplitude)
    make = _in_turn if name == "tank-session" else _at_once
    wrench = make(built_in, vehicle, t, size, seed)
    if not vehicle.thrusters:
        return Manoeuvre(name, t, dt, wrench)
    if amplitude is None:
        wrench = fit_to_thrusters(vehicle, wrench)
    commands = allocate(vehicle, wrench)
    return Manoeuvre(name, t, dt, thruster_wrench(vehicle, commands), commands)


def _given_amplitudes(built_in: BuiltIn, amplitude: ArrayLike) -> Array:
    size = finite_array("amplitude", amplitude, (), (6,))
    if size.ndim == 0 and len(built_in.axes) > 1:
        raise InputError("amplitude: found one number for several axes, expected six: X Y Z [N] K M N [N m]")
    return np.full(6, float(size)) if size.ndim == 0 else size


def _rows(axis: str, vehicle: Vehicle) -> tuple[int, ...]:
    """Return the rows of the wrench that excite an axis; none where the vehicle cannot command it."""
    rows, row = available_rows(vehicle), AXES.index(axis)
    if row in rows:
        return (row,)
    substitutes = tuple(AXES.index(other) for other in _MOMENT_OF_FORCES)
    return substitutes if axis == "pitch" and set(substitutes) <= set(rows) else ()


def _at_once(built_in: BuiltIn, vehicle: Vehicle, t: Array, size: Array, seed: int) -> Array:
    """Return the wrench (n, 6) with all axes of the built-in that the vehicle can command driven together."""
    if len(built_in.axes) == 1:
        rows = _rows(built_in.axes[0], vehicle)
        stretch = tempo(vehicle, AXES.index(built_in.axes[0]))
    else:
        rows, stretch = available_rows(vehicle), 0.0
    if not rows:
        can = ", ".join(AXES[row] for row in available_rows(vehicle))
        raise InputError(f"{vehicle.name}: the thrusters cannot command {built_in.axes[0]}; they can command {can}")
    form = FORMS[built_in.form]
    out = np.zeros((t.size, 6))
    for lane, row in enumerate(rows):
        generator = stream(seed, "manoeuvre", built_in.form, AXES[row])
        period = form.period * (stretch or tempo(vehicle, row))
        out[:, row] = size[row] * form.wave(t, period, generator, (lane, len(rows)))
    return out


def _in_turn(built_in: BuiltIn, vehicle: Vehicle, t: Array, size: Array, seed: int) -> Array:
    """Return the wrench (n, 6) of a tank session over the axes that the vehicle can command, with a trim of W - B."""
    axes = [axis for axis in built_in.axes if _rows(axis, vehicle)]
    share = (t[-1] + t[1] if t.size > 1 else 1.0) / len(axes)
    out = np.zeros((t.size, 6))
    for k, axis in enumerate(axes):
        for lane, row in enumerate(_rows(axis, vehicle)):
            stretch = tempo(vehicle, AXES.index(axis)) * (1.0 + 0.3 * lane)
            generator = stream(seed, "manoeuvre", "tank-session", axis)
            wave = tank_session.session_wave(t, k * share, (k + 1) * share, stretch, generator)
            out[:, row] += size[row] * wave
    if 2 in available_rows(vehicle):
        out[:, 2] -= vehicle.weight_minus_buoyancy
    return out


_ORDERS: dict[str, tuple[Callable[[Array, float], Array], float]] = {
    "paper-stairs": (paper_runs.stairs_orders, 28.0),
    "paper-square": (paper_runs.square_orders, 30.0),
}


def _paper_run(name: str, vehicle: Vehicle, t: Array, dt: float, amplitude: ArrayLike | None) -> Manoeuvre:
    orders_of, usual = _ORDERS[name]
    orders = orders_of(t, usual if amplitude is None else float(finite_array("amplitude", amplitude, ())))
    if vehicle.thrusters:
        commands = paper_runs.paper_commands(vehicle, orders)
        return Manoeuvre(name, t, dt, thruster_wrench(vehicle, commands), commands)
    wrench = np.zeros((t.size, 6))
    wrench[:, 0] = paper_runs.paper_force(orders)
    return Manoeuvre(name, t, dt, wrench)
