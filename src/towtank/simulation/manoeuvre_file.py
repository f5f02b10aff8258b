"""A recording of commands or wrenches as a manoeuvre: the inputs of a log, or of a table written by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.recording import Channel, Recording, held_at, median_step
from towtank.recording.standard import COMMAND_PREFIX, WRENCH, is_command
from towtank.simulation.inputs import positive
from towtank.simulation.manoeuvres import Manoeuvre
from towtank.vehicle import Vehicle, thruster_wrench

__all__ = ["manoeuvre_from_recording"]


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
