"""What watches the vehicle: the contract of all sensors, perfect ones, and several together.

A sensor samples the true motion at the steps of the simulation, as often as its rate asks and at most once a step. Each
of its channels has its own times, and its noise comes from a random stream of its own: another rate or noise of one
instrument changes nothing in the others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.recording.channel import Channel, read_only, standard_channel
from towtank.recording.standard import ACCELERATIONS, POSE, VELOCITIES
from towtank.simulation.motion import Motion

__all__ = [
    "Perfect",
    "Place",
    "Sensors",
    "Together",
    "channels",
    "require_non_negative",
    "require_places",
    "require_positive",
    "sampled",
]

Place = tuple[float, float, float]  # in the body, FRD [m]


class Sensors(Protocol):
    """Anything that turns true motion into channels. Frozen: the same motion and seed give the same channels."""

    def observe(self, motion: Motion, seed: int) -> list[Channel]:
        """Return the channels measured, reproducible by `seed`."""


@dataclass(frozen=True)
class Perfect:
    """Pose and velocity, exact, at every step; with `accelerometer` the specific force too."""

    accelerometer: bool = False

    def observe(self, motion: Motion, seed: int) -> list[Channel]:
        """Return x y z phi theta psi u v w p q r, and ax ay az where asked for."""
        t = read_only(motion.t)
        exact = channels(POSE, t, motion.eta) + channels(VELOCITIES, t, motion.nu)
        return exact + (channels(ACCELERATIONS, t, motion.specific_force()) if self.accelerometer else [])


@dataclass(frozen=True)
class Together:
    """Several sensors on one vehicle, each as it measures by itself.

    Raises:
        InputError: on observing, two of them measure the same channel.
    """

    sensors: tuple[Sensors, ...]

    def observe(self, motion: Motion, seed: int) -> list[Channel]:
        """Return the channels of all, in order."""
        measured = [channel for each in self.sensors for channel in each.observe(motion, seed)]
        names = [channel.name for channel in measured]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f'sensors: "{name}" is measured by {names.count(name)} of them, expected one')
        return measured


def sampled(motion: Motion, rate: float) -> NDArray[np.intp]:
    """Return the steps at which a sensor of `rate` [Hz] samples: the nearest to k / rate, each once."""
    every = max(1.0 / (rate * motion.dt), 1.0)
    count = math.floor((motion.t.size - 1) / every * (1.0 + 1e-12)) + 1
    steps = np.rint(np.arange(count) * every).astype(np.intp)
    inside: NDArray[np.intp] = steps[steps < motion.t.size]
    return inside


def channels(names: Sequence[str], t: Array, values: Array) -> list[Channel]:
    """Return one standard channel per column of `values` (n, len(names)), all at the times `t` (n,)."""
    return [standard_channel(name, t, values[:, j]) for j, name in enumerate(names)]


def require_positive(record: object, *names: str) -> None:
    """Raise InputError unless these attributes of a sensor are finite numbers above 0."""
    for name in names:
        value = getattr(record, name)
        if not (math.isfinite(value) and value > 0.0):
            raise InputError(f"{type(record).__name__}: {name}: found {value}, expected a number above 0")


def require_places(record: object, *names: str) -> None:
    """Raise InputError unless these attributes of a sensor are three finite numbers each."""
    for name in names:
        value = getattr(record, name)
        if np.shape(value) != (3,) or not np.isfinite(value).all():
            what = f"{type(record).__name__}: {name}"
            raise InputError(f"{what}: found {value}, expected three numbers [m], as (0.1, 0.0, 0.0)")


def require_non_negative(record: object, *names: str) -> None:
    """Raise InputError unless these attributes of a sensor are finite numbers, 0 or more."""
    for name in names:
        value = getattr(record, name)
        if not (math.isfinite(value) and value >= 0.0):
            raise InputError(f"{type(record).__name__}: {name}: found {value}, expected 0 or more")
