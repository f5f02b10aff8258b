"""Channels of any times on one common grid: inputs held, motion interpolated, gaps left open."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.attitude import eulers_from_quaternions, quaternions_from_eulers
from towtank.errors import InputError, nearest
from towtank.recording.channel import in_one_block
from towtank.recording.cleaning import Kind, dead_channels, find_spikes
from towtank.recording.frames.world_velocity import with_body_velocity
from towtank.recording.grids.grid import Flags, Grid, stack_held
from towtank.recording.grids.timing import (
    Weights,
    check_span,
    common_samples,
    find_gaps,
    interpolation_weights,
    quaternion_samples,
    sampling_rate,
)
from towtank.recording.recording import Recording
from towtank.recording.repairs import Repairs
from towtank.recording.standard import COMMAND_PREFIX, EULER, MEASURED, QUATERNION, WRENCH, is_command

__all__ = ["MAXIMUM_RATE", "align"]

MAXIMUM_RATE = 200.0  # Hz, unless asked for
_ATTITUDE = slice(3, 6)
_PARTS = {
    "pose": slice(0, 6),
    "velocity": slice(6, 12),
    "acceleration": slice(12, 15),
    "further": slice(15, None),
}


def align(
    recording: Recording,
    *,
    rate: float | None = None,
    commands: Sequence[str] | None = None,
    gap: float | None = None,
    spikes: bool = True,
) -> Grid:
    """Bring a recording to a common grid.

    Motion is interpolated linearly (attitude on the shortest arc), inputs are held from their own stamps.
    Nothing is extrapolated and no gap bridged. The grid passes through the samples of the fastest motion
    channel and spans all motion.

    Args:
        recording: in NED and FRD.
        rate: of the grid [Hz]; default: the rate of the fastest motion channel, at most 200 Hz.
        commands: the thrusters, in the order of the columns wanted, as `aft_port` or `cmd_aft_port`; default:
            all.
        gap: longest step [s] that is interpolated over; default: three median steps of the channel, at least
            0.15 s.
        spikes: take isolated outliers of one sample as not measured.

    Raises:
        InputError: there is no motion, fewer than 4 samples of it, a command is missing, `rate` is not
            positive.
    """
    recording = with_body_velocity(recording)
    series = _motion_series(recording)
    prefix = f"{recording.source}: " if recording.source else ""
    if not series:
        raise InputError(
            f"{prefix}no motion in it, expected pose, velocity, rates or specific force; found {_names(recording)}"
        )
    inputs = [recording[name] for name in _command_channels(recording, commands, prefix)]
    details: list[str] = []
    spiked = gaps = missing = 0
    for item in series:
        missing += item.missing
        if spikes:
            found = find_spikes(item.t, item.values, item.kind, gap)
            if found.size:
                spiked += int(found.size)
                details.append(f"{found.size} spike{'s' if found.size > 1 else ''} in {item.label}")
                item.drop(found)
    distinct = {item.t.tobytes(): item for item in series}
    for item in distinct.values():
        holes = find_gaps(item.t, gap)
        gaps += int(holes.size)
        if holes.size:
            lost = float(np.diff(item.t)[holes].sum())
            details.append(f"{lost:.3g} s of gaps in {', '.join(s.label for s in series if s.same_times(item))}")

    t, rate = _grid_times(series, rate, prefix)
    motion = np.full((t.size, len(MEASURED)), np.nan)
    fresh = np.zeros((t.size, len(MEASURED)), dtype=np.bool_)
    weights: dict[bytes, Weights] = {}
    for item in series:
        key = item.t.tobytes()
        if key not in weights:
            weights[key] = interpolation_weights(item.t, t, gap)
        item.place(weights[key], motion)
        fresh[:, item.columns] = _nearest_rows(item.t, t, rate)[:, None]
    fresh &= ~np.isnan(motion)
    fresh.flags.writeable = False
    parts = {name: in_one_block(motion[:, part]) for name, part in _PARTS.items()}
    del motion

    command_t, command_values = stack_held(inputs)
    wrench_t, wrench_values = _stack_wrench(recording)
    repairs = recording.repairs + Repairs(
        nan=missing, spikes=spiked, gaps=gaps, dead=dead_channels(recording), details=tuple(details)
    )
    return Grid(
        t=t,
        rate=rate,
        **parts,
        fresh=fresh,
        voltage=_voltage(recording, t),
        thrusters=tuple(channel.name.removeprefix(COMMAND_PREFIX) for channel in inputs),
        command_t=command_t,
        command_values=command_values,
        wrench_t=wrench_t,
        wrench_values=wrench_values,
        source=recording.source,
        repairs=repairs,
    )


class _Series:
    """Samples that are interpolated together: one channel, or a whole attitude as a quaternion."""

    def __init__(self, label: str, columns: slice, t: Array, values: Array, kind: Kind, missing: int) -> None:
        self.label, self.columns, self.t, self.kind, self.missing = label, columns, t, kind, missing
        self.values = values

    def drop(self, rows: NDArray[np.intp]) -> None:
        self.t, self.values = np.delete(self.t, rows), np.delete(self.values, rows, axis=0)

    def same_times(self, other: _Series) -> bool:
        return self.t is other.t or np.array_equal(self.t, other.t)

    def place(self, weights: Weights, motion: Array) -> None:
        if self.kind == "quaternion":
            angles = eulers_from_quaternions(weights.rotation(self.values))
            angles[:, 0], angles[:, 2] = _unwrapped(angles[:, 0]), _unwrapped(angles[:, 2])
            motion[:, self.columns] = angles
        else:
            values = np.unwrap(self.values) if self.kind == "angle" else self.values
            motion[:, self.columns] = weights.linear(values)[:, None]


def _motion_series(recording: Recording) -> list[_Series]:
    """Every motion channel with a value; roll, pitch and yaw together where all three have common times."""
    series: list[_Series] = []
    whole = _whole_attitude(recording)
    if whole is not None:
        series.append(whole)
    for column, name in enumerate(MEASURED):
        if name not in recording or (whole is not None and name in EULER):
            continue
        channel = recording[name].measured
        if len(channel):
            kind: Kind = "angle" if name in ("phi", "psi") else "linear"
            missing = len(recording[name]) - len(channel)
            series.append(_Series(name, slice(column, column + 1), channel.t, channel.values, kind, missing))
    return series


def _whole_attitude(recording: Recording) -> _Series | None:
    if all(name in recording for name in QUATERNION):
        t, q = quaternion_samples(recording)
        names: tuple[str, ...] = QUATERNION
    elif all(name in recording for name in EULER):
        t, angles = common_samples([recording[name] for name in EULER])
        if t.size < max(len(recording[name].measured) for name in EULER):
            return None  # angles of several rates: each is interpolated by itself
        q = quaternions_from_eulers(angles)
        names = EULER
    else:
        return None
    if not t.size:
        return None
    missing = max(len(recording[name]) for name in names) - t.size
    return _Series("attitude", _ATTITUDE, t, q, "quaternion", missing)


def _command_channels(recording: Recording, commands: Sequence[str] | None, prefix: str) -> list[str]:
    known = [name for name in recording.names if is_command(name)]
    if commands is None:
        return known
    wanted = [name if is_command(name) else COMMAND_PREFIX + name for name in commands]
    for name in wanted:
        if name not in recording:
            found = ", ".join(known) or "no commands"
            raise InputError(f'{prefix}no channel "{name}"{nearest(name, known)}; found {found}')
    return wanted


def _grid_times(series: Sequence[_Series], rate: float | None, prefix: str) -> tuple[Array, float]:
    samples = max(item.t.size for item in series)
    if samples < 4:
        raise InputError(f"{prefix}found {samples} samples of motion, expected at least 4")
    fastest = max((item for item in series if item.t.size > 1), key=lambda item: sampling_rate(item.t))
    if rate is None:
        rate = min(sampling_rate(fastest.t), MAXIMUM_RATE)
    elif not (math.isfinite(rate) and rate > 0.0):
        raise InputError(f"{prefix}found a rate of {rate!r} Hz, expected a positive number")
    check_span([item.t for item in series], rate, prefix)
    start = min(float(item.t[0]) for item in series)
    end = max(float(item.t[-1]) for item in series)
    origin = float(fastest.t[0])
    first = math.ceil((start - origin) * rate - 1e-3)
    last = math.floor((end - origin) * rate + 1e-3)
    return origin + np.arange(first, last + 1) / rate, rate


def _nearest_rows(samples: Array, t: Array, rate: float) -> Flags:
    rows = np.rint((samples - t[0]) * rate).astype(np.intp)
    flags = np.zeros(t.size, dtype=np.bool_)
    flags[rows[(rows >= 0) & (rows < t.size)]] = True
    return flags


def _unwrapped(angle: Array) -> Array:
    """Unwrap an angle (n,) that is NaN in places, from one known value to the next."""
    known = ~np.isnan(angle)
    result = angle.copy()
    result[known] = np.unwrap(angle[known])
    return result


def _stack_wrench(recording: Recording) -> tuple[Array, Array]:
    present = [name for name in WRENCH if name in recording and len(recording[name].measured)]
    t, known = stack_held([recording[name] for name in present])
    values = np.full((t.size, len(WRENCH)), np.nan)
    values[:, [WRENCH.index(name) for name in present]] = known
    return t, values


def _voltage(recording: Recording, t: Array) -> Array:
    if "voltage" in recording and len(known := recording["voltage"].measured):
        return np.interp(t, known.t, known.values)
    return np.full(t.size, np.nan)


def _names(recording: Recording) -> str:
    return ", ".join(recording.names)
