"""A random force that pushes the vehicle about: waves of the tank, tether, eddies.

An Ornstein-Uhlenbeck process per axis, d' = -d / T + white noise, stationary with standard deviation sigma. Its exact
discrete form over a step dt is d[k+1] = a d[k] + sigma sqrt(1 - a^2) n[k], a = exp(-dt / T), n white with variance 1,
d[0] = sigma n. It acts in the body frame and is held over each step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.errors import InputError, nearest
from towtank.recording.standard import WRENCH
from towtank.simulation.inputs import stream

__all__ = ["OrnsteinUhlenbeck"]


@dataclass(frozen=True)
class OrnsteinUhlenbeck:
    """A disturbance wrench on the body.

    Attributes:
        std: standard deviation on each of `axes`, or six numbers for X Y Z [N] and K M N [N m].
        time_constant: correlation time T [s].
        axes: axes that a single `std` acts on.

    Raises:
        InputError: a number is not finite or has the wrong sign, or an axis is unknown.
    """

    std: float | tuple[float, float, float, float, float, float] = 0.5
    time_constant: float = 2.0
    axes: tuple[str, ...] = ("X", "Y", "Z")

    def __post_init__(self) -> None:
        for axis in self.axes:
            if axis not in WRENCH:
                raise InputError(f'disturbance: unknown axis "{axis}"{nearest(axis, WRENCH)}; axes are X Y Z K M N')
        if not (math.isfinite(self.time_constant) and self.time_constant > 0.0):
            raise InputError(f"disturbance: found a time constant of {self.time_constant} s, expected a number above 0")
        std = np.asarray(self.std, dtype=np.float64)
        if std.shape not in ((), (6,)) or not (np.isfinite(std).all() and (std >= 0.0).all()):
            raise InputError(f"disturbance: found std {self.std}, expected a number or six, each 0 or more")
        if std.shape:
            object.__setattr__(self, "std", tuple(float(s) for s in std))

    @property
    def deviations(self) -> Array:
        """Standard deviations (6,) of X Y Z [N] and K M N [N m]."""
        if isinstance(self.std, tuple):
            return np.array(self.std)
        return np.array([self.std if axis in self.axes else 0.0 for axis in WRENCH])

    def sample(self, n: int, dt: float, seed: int) -> Array:
        """Return the wrench (n, 6) [N, N m], held over steps of dt [s]."""
        noise = np.column_stack([stream(seed, "disturbance", axis).standard_normal(n) for axis in WRENCH])
        return _recursion(noise, self.deviations, math.exp(-dt / self.time_constant))


@kernel
def _recursion(noise: Array, std: Array, a: float) -> Array:
    """Return the stationary process (n, 6) driven by white noise (n, 6)."""
    out = np.empty_like(noise)
    b = math.sqrt(1.0 - a * a)
    for j in range(noise.shape[1]):
        value = 0.0
        for i in range(noise.shape[0]):
            value = std[j] * noise[i, j] if i == 0 else a * value + b * std[j] * noise[i, j]
            out[i, j] = value
    return out
