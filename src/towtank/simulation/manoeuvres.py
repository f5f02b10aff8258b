"""Manoeuvres by name: what to do with a vehicle so that its coefficients show.

`surge-sine`, `yaw-stairs`, `all-multisine`, ..: an axis (or all at once) and a wave form; `tank-session`: all axes in
turn; `paper-stairs`, `paper-square`. The wrench goes through the pseudo-inverse of the thrusters, so that a sway
test does not yaw.

The two surge experiments of the paper: stairs and square wave with equal commands on all horizontal thrusters.

Stairs: 13, 18, 23, 28 for 2 s each ahead, then the same astern. Square: +-30, period 5 s. Both after 0.5 s at rest.

A session in a tank: one axis after the other, rest in between, out and back so that the walls stay away.

The order is the paper's: surge, sway, heave, roll, yaw, pitch, since pitch needs what surge and heave taught. Each axis
gets whole periods of a square wave, large and small in turn: switching excites the inertia, two speeds tell linear from
quadratic damping. A vehicle that is not neutral is trimmed: a constant heave force holds it against W - B.

A recording of commands or wrenches as a manoeuvre: the inputs of a log, or of a table written by hand.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.recording import Channel, Recording, held_at, median_step
from towtank.recording.channel import read_only
from towtank.recording.standard import COMMAND_PREFIX, WRENCH, is_command
from towtank.simulation.excitation import AXES, available_rows, fit_to_thrusters, tempo, usual_amplitudes
from towtank.simulation.inputs import finite_array, positive, step_count, stream
from towtank.simulation.signals import FORMS, square
from towtank.vehicle import AnyVehicle, Vehicle, allocate, configuration_matrix, thruster_wrench, vehicle_of

__all__ = [
    "MANOEUVRES",
    "ORDER",
    "REST",
    "BuiltIn",
    "Manoeuvre",
    "manoeuvre",
    "manoeuvre_from_recording",
    "paper_commands",
    "paper_force",
    "session_wave",
    "square_orders",
    "stairs_orders",
]

_MOMENT_OF_FORCES = ("surge", "heave")  # what moves a vehicle in pitch that cannot be commanded in pitch
REST = 0.5  # s
_LEVELS = np.array([13.0, 18.0, 23.0, 28.0]) / 28.0
_LEVEL_TIME = 2.0  # s
_PERIOD = 5.0  # s
_HORIZONTAL = 0.3  # least part of a thruster's force along x
_FITTED = (0.0684, -0.03366, 0.006736)  # the paper's (7), newtons of |command|
_DEAD_BAND = 5.0
ORDER = ("surge", "sway", "heave", "roll", "yaw", "pitch")
_SESSION_LEVELS = np.array([1.0, 0.6])
_REST = 0.15  # of the time of an axis, half of it before


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
    found["tank-session"] = BuiltIn("all axes in turn, out and back, rest between", ORDER, "square", 120.0)
    found["paper-stairs"] = BuiltIn("surge: commands 13 18 23 28 ahead, then astern", ("surge",), "stairs", 16.5)
    found["paper-square"] = BuiltIn("surge: commands +-30, period 5 s", ("surge",), "square", 20.5)
    return found


MANOEUVRES: dict[str, BuiltIn] = _registry()


def manoeuvre(
    name: str,
    vehicle: AnyVehicle,
    *,
    duration: float | None = None,
    dt: float = 0.01,
    amplitude: ArrayLike | None = None,
    seed: int = 0,
) -> Manoeuvre:
    """Return the inputs of a built-in manoeuvre for a vehicle.

    Args:
        vehicle: or its name in the catalog, or the path of its file.
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
    vehicle, dt = vehicle_of(vehicle), positive("dt", dt)
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
            wave = session_wave(t, k * share, (k + 1) * share, stretch, generator)
            out[:, row] += size[row] * wave
    if 2 in available_rows(vehicle):
        out[:, 2] -= vehicle.weight_minus_buoyancy
    return out


def _paper_run(name: str, vehicle: Vehicle, t: Array, dt: float, amplitude: ArrayLike | None) -> Manoeuvre:
    orders_of, usual = _ORDERS[name]
    orders = orders_of(t, usual if amplitude is None else float(finite_array("amplitude", amplitude, ())))
    if vehicle.thrusters:
        commands = paper_commands(vehicle, orders)
        return Manoeuvre(name, t, dt, thruster_wrench(vehicle, commands), commands)
    wrench = np.zeros((t.size, 6))
    wrench[:, 0] = paper_force(orders)
    return Manoeuvre(name, t, dt, wrench)


def stairs_orders(t: Array, amplitude: float) -> Array:
    """Return the orders (n,) of the stairs, positive ahead; the last step is `amplitude` (28 in the paper)."""
    k = np.floor((t - REST) / _LEVEL_TIME + 1e-9).astype(np.intp)
    return np.where(k < 0, 0.0, amplitude * np.concatenate([_LEVELS, -_LEVELS])[k % 8])


def square_orders(t: Array, amplitude: float) -> Array:
    """Return the orders (n,) of the square wave, ahead first; `amplitude` is 30 in the paper."""
    k = np.floor((t - REST) / (0.5 * _PERIOD) + 1e-9).astype(np.intp)
    return np.where(k < 0, 0.0, amplitude * (1.0 - 2.0 * (k % 2)))


_ORDERS: dict[str, tuple[Callable[[Array, float], Array], float]] = {
    "paper-stairs": (stairs_orders, 28.0),
    "paper-square": (square_orders, 30.0),
}


def paper_commands(vehicle: Vehicle, orders: Array) -> Array:
    """Return the commands (n, m): the order on each horizontal thruster with the sign that pushes ahead.

    Raises:
        InputError: no thruster pushes along x, or a command would be beyond the limits of its thruster.
    """
    ahead = configuration_matrix(vehicle)[0]
    if not (np.abs(ahead) > _HORIZONTAL).any():
        raise InputError(f"{vehicle.name}: no thruster pushes along x, so there is no surge run")
    out = np.empty((orders.size, ahead.size))
    for k, thruster in enumerate(vehicle.thrusters):
        curve = thruster.curve
        out[:, k] = curve.rest + (orders * np.sign(ahead[k]) if abs(ahead[k]) > _HORIZONTAL else 0.0)
        low, high = (-math.inf, math.inf) if curve.limits is None else curve.limits
        if out[:, k].min() < low or out[:, k].max() > high:
            raise InputError(
                f"{vehicle.name}: commands of +-{np.abs(orders).max():g} are beyond the limits {low:g} .. {high:g} "
                f'of thruster "{thruster.name}"; give an amplitude in its unit'
            )
    return out


def paper_force(orders: Array) -> Array:
    """Return the surge force (n,) [N] of the paper's vehicle, X = 2 (cos 45 + cos 35) F(order)."""
    size = np.abs(orders)
    force = np.where(size < _DEAD_BAND, 0.0, np.polynomial.polynomial.polyval(size, _FITTED))
    return 2.0 * (math.cos(math.radians(45.0)) + math.cos(math.radians(35.0))) * np.sign(orders) * force


def session_wave(t: Array, start: float, end: float, stretch: float, generator: np.random.Generator) -> Array:
    """Return the wave (n,) within -1 .. 1 of the axis whose turn is from start to end [s]; zero elsewhere.

    Args:
        stretch: by what factor the period of 5 s is stretched; it is shortened to fit a whole number of them.
    """
    begin = start + 0.5 * _REST * (end - start)
    busy = (1.0 - _REST) * (end - start)
    periods = max(round(busy / (_PERIOD * stretch)), 1)
    period = busy / periods
    local = t - begin
    k = np.floor(local / period + 1e-9)
    active = (k >= 0) & (k < periods)
    wave = square(np.where(active, local, 0.0), period, generator)
    return np.where(active, wave * _SESSION_LEVELS[k.astype(np.intp) % _SESSION_LEVELS.size], 0.0)


def manoeuvre_from_recording(
    recording: Recording, vehicle: Vehicle, *, dt: float = 0.01, duration: float | None = None
) -> Manoeuvre:
    """Return the inputs of a recording on a grid of dt [s] that begins with its first input.

    Values hold until the next one comes; a thruster without a column rests. Commands are taken before a wrench.
    The last input holds as long as its predecessor did.

    Args:
        duration: [s], default to the end of the recording's last input.

    Raises:
        InputError: no input in the recording, or a command for a thruster that the vehicle lacks.
    """
    dt = positive("dt", dt)
    prefix = f"{recording.source}: " if recording.source else ""
    commands = [recording[name].measured for name in recording.names if is_command(name)]
    wrench = [recording[name].measured for name in WRENCH if name in recording]
    given = [channel for channel in commands or wrench if len(channel)]
    if not given:
        raise InputError(f"{prefix}found neither commands (cmd_<thruster>) nor a wrench (X Y Z K M N)")
    start = min(float(channel.t[0]) for channel in given)
    end = max(float(channel.t[-1]) + _last_hold(channel, dt) for channel in given)
    n = max(round((end - start if duration is None else positive("duration", duration)) / dt), 1)
    t = np.arange(n, dtype=np.float64) * dt
    name = recording.source or "recording"
    if not commands:
        return Manoeuvre(name, t, dt, _held(given, WRENCH, t + start, np.zeros(6)))
    names = tuple(f"{COMMAND_PREFIX}{thruster.name}" for thruster in vehicle.thrusters)
    for channel in given:
        if channel.name not in names:
            hint = nearest(channel.name, names) or f"; it has {', '.join(names) or 'no thrusters'}"
            raise InputError(f'{prefix}"{channel.name}" commands a thruster that {vehicle.name} lacks{hint}')
    orders = _held(given, names, t + start, np.array([thruster.curve.rest for thruster in vehicle.thrusters]))
    return Manoeuvre(name, t, dt, thruster_wrench(vehicle, orders), orders)


def _last_hold(channel: Channel, dt: float) -> float:
    """Return how long the last value of a channel is taken to hold [s]."""
    step = median_step(channel.t)
    return dt if np.isnan(step) else step


def _held(given: Sequence[Channel], names: Sequence[str], t: Array, rest: Array) -> Array:
    """Return the values (n, len(names)) in force at the times t (n,); `rest` before the first one or without any."""
    out = np.tile(rest, (t.size, 1))
    by_name = {channel.name: channel for channel in given}
    for j, name in enumerate(names):
        if name in by_name:
            values = held_at(by_name[name].t, by_name[name].values[:, None], t)[:, 0]
            out[:, j] = np.where(np.isnan(values), rest[j], values)
    return out
