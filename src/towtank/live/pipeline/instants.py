"""What belongs to one instant, as the learner takes it: pose, velocity, commands, from names and values.

A recording is taken apart into the samples that a live link would have given, in order of time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import euler_from_quaternion, rotation_from_euler
from towtank.recording import Recording
from towtank.recording.standard import (
    COMMAND_PREFIX,
    EULER,
    QUATERNION,
    SAMPLE,
    STATES,
    WORLD_VELOCITY,
    WRENCH,
    is_standard,
)
from towtank.vehicle import Vehicle

__all__ = ["Instants", "Row", "rows_of"]

_PLACE = {name: (group, k) for group, names in {**SAMPLE, "wrench": WRENCH}.items() for k, name in enumerate(names)}
_TOGETHER = 1e-6  # s: stamps closer than this are one instant
Row = tuple[float, tuple[str, ...], tuple[float, ...]]  # t [s], names, values


class Instants:
    """Turns the channels of one instant into the arguments of `Learner.update`.

    Commands and wrench hold until others come, thruster by thruster: what has not come yet keeps its last value, and
    before every thruster has been heard of there are none. A quaternion becomes Euler angles, a velocity in the world
    is turned by the last attitude.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._thrusters = {f"{COMMAND_PREFIX}{each.name}": k for k, each in enumerate(vehicle.thrusters)}
        self._angles: tuple[float, float, float] | None = None
        self.forget()

    def forget(self) -> None:
        """Forget the inputs in force."""
        self._commands = np.full(len(self._thrusters), np.nan)
        self._wrench = np.full(6, np.nan)
        self._voltage = math.nan

    def arguments(self, sample: Mapping[str, float]) -> dict[str, Any]:
        """Return the arguments for an instant's channels; those of nothing measured or commanded are left out."""
        out: dict[str, Any] = {}
        commanded = pushed = False
        for name, value in sample.items():
            if name in self._thrusters:
                if math.isfinite(value):
                    self._commands[self._thrusters[name]] = value
                    commanded = True
            elif name in _PLACE and math.isfinite(value):
                group, k = _PLACE[name]
                if group == "wrench":
                    self._wrench[k] = value
                    pushed = True
                else:
                    self._vector(out, group)[k] = value
        self._attitude(sample, out)
        if math.isfinite(voltage := sample.get("voltage", math.nan)):
            self._voltage = voltage
        if commanded and np.isfinite(self._commands).all():
            out["commands"] = self._commands.copy()
            if math.isfinite(self._voltage):
                out["voltage"] = self._voltage
        elif pushed and not self._thrusters_heard:
            out["wrench"] = self._wrench.copy()
        return out

    def in_force(self) -> dict[str, Any]:
        """Return the inputs in force as arguments, for a stretch that begins between two commands; none unknown."""
        if np.isfinite(self._commands).all() and self._thrusters:
            voltage = {"voltage": self._voltage} if math.isfinite(self._voltage) else {}
            return {"commands": self._commands.copy(), **voltage}
        pushed = np.isfinite(self._wrench).any() and not self._thrusters_heard
        return {"wrench": self._wrench.copy()} if pushed else {}

    def goes_on(self, sample: Mapping[str, float]) -> bool:
        """Whether an instant brings inputs, and those that are in force already: what came between has not mattered."""
        known = dict(zip(self._thrusters, self._commands.tolist(), strict=True))
        known |= dict(zip(WRENCH, self._wrench.tolist(), strict=True))
        told = [name for name in sample if name in known]
        return bool(told) and all(sample[name] == known[name] for name in told)

    @property
    def _thrusters_heard(self) -> bool:
        """Whether commands come: then a wrench beside them is their consequence, and not a second input."""
        return bool(self._thrusters) and bool(np.isfinite(self._commands).any())

    @staticmethod
    def _vector(out: dict[str, Any], group: str) -> Array:
        found: Array | None = out.get(group)
        if found is None:
            found = out[group] = np.full(len(SAMPLE[group]), np.nan)
        return found

    def _attitude(self, sample: Mapping[str, float], out: dict[str, Any]) -> None:
        if all(math.isfinite(sample.get(name, math.nan)) for name in QUATERNION):
            self._angles = euler_from_quaternion(*(sample[name] for name in QUATERNION))
            self._vector(out, "pose")[3:] = self._angles
        elif all(math.isfinite(sample.get(name, math.nan)) for name in EULER):
            self._angles = (sample["phi"], sample["theta"], sample["psi"])
        if self._angles is not None and all(math.isfinite(sample.get(name, math.nan)) for name in WORLD_VELOCITY):
            velocity = self._vector(out, "velocity")
            if not np.isfinite(velocity[:3]).any():
                turn = rotation_from_euler(*self._angles)
                velocity[:3] = turn.T @ np.array([sample[name] for name in WORLD_VELOCITY])


def rows_of(recording: Recording, after: float = -np.inf) -> Iterator[Row]:
    """Yield every instant later than `after` [s] with all that was measured, commanded or told of the autopilot."""
    names: list[str] = []
    stamps, owners, values = [], [], []
    for channel in recording.channels.values():
        if not (is_standard(channel.name) or channel.name in STATES):
            continue
        known = np.isfinite(channel.values) & (channel.t > after)
        stamps.append(channel.t[known])
        values.append(channel.values[known])
        owners.append(np.full(stamps[-1].size, len(names)))
        names.append(channel.name)
    if not names:
        return
    t = np.concatenate(stamps)
    order = np.argsort(t, kind="stable")
    t, owner, value = t[order], np.concatenate(owners)[order], np.concatenate(values)[order]
    if not t.size:
        return
    starts = np.flatnonzero(np.concatenate(([True], np.diff(t) > _TOGETHER)))
    for first, last in zip(starts, [*starts[1:], t.size], strict=True):
        yield (
            float(t[first]),
            tuple(names[k] for k in owner[first:last]),
            tuple(value[first:last].tolist()),
        )
