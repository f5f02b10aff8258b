"""What the water does to the vehicle: it pushes at random, and goes to and fro in waves.

Tank walls, tether and eddies push as an Ornstein-Uhlenbeck process per axis, d' = -d / T + white noise, stationary with
standard deviation sigma. Its exact discrete form over a step dt is d[k+1] = a d[k] + sigma sqrt(1 - a^2) n[k],
a = exp(-dt / T), n white with variance 1, d[0] = sigma n. It acts in the body frame and is held over each step.

Waves are Airy's linear ones in deep water, as a vehicle much smaller than their length meets them: the water about it
moves as one, in an orbit (Fossen 2021, section 10.2). The sum of components of about one period and one direction:

    v_w(t) = sum a_i [cos h_i cos(w_i t + e_i), sin h_i cos(w_i t + e_i), b sin(w_i t + e_i)],   NED

Where the vehicle is in the orbit, and how the motion dies out with depth, does not enter: it holds for a vehicle that
stays about one depth and moves by much less than a wavelength (56 m at 6 s) while one wave passes.

In a frame that moves with such water the equations of motion hold unchanged in the relative velocity, but gravity is
R^T (g e_z - dv_w/dt): what accelerates the displaced water (Froude and Krylov) acts at the centre of buoyancy, inertia
at the centre of gravity, as buoyancy and weight do. A neutrally buoyant body with one centre feels nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array, kernel
from towtank.errors import InputError, nearest
from towtank.recording.standard import WRENCH
from towtank.simulation.inputs import finite_array, stream

__all__ = ["OrnsteinUhlenbeck", "RisingCurrent", "WaterMotion", "Waves"]

_COMPONENTS = 12
_BAND = 0.1  # deviation of the components' periods, of the period
_SHORTEST = 0.5  # of the period, of any component
_SPREAD = 0.3  # rad, deviation of their directions
_RISES = 5.0  # periods over which waves come up


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


class WaterMotion(NamedTuple):
    """Displacement, velocity and acceleration of the water (n, 3) each [m, m/s, m/s^2], NED."""

    displacement: Array
    velocity: Array
    acceleration: Array


@dataclass(frozen=True)
class Waves:
    """Waves at the vehicle's depth.

    Attributes:
        rms: standard deviation of the horizontal velocity of the water [m/s].
        period: about which the periods of the components lie [s].
        heading: where they go [rad], from north to east; the components within some 17 degrees.
        vertical: share of the horizontal velocity that the vertical one is: 1 in deep water, 0 along a near bottom.
        begin: the water is still until then [s], and in full motion five periods later; from the start where 0.

    Raises:
        InputError: a number is not finite or out of range.
    """

    rms: float = 0.05
    period: float = 6.0
    heading: float = 0.0
    vertical: float = 1.0
    begin: float = 0.0

    def __post_init__(self) -> None:
        for name, least in (("rms", 0.0), ("period", 0.0), ("heading", -math.inf), ("vertical", 0.0), ("begin", 0.0)):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= least):
                limit = f", {least:g} or more" if math.isfinite(least) else ""
                raise InputError(f"waves: {name}: found {value}, expected a finite number{limit}")
        if self.period == 0.0:
            raise InputError("waves: period: found 0 s, expected more")

    def motion(self, t: Array, seed: int) -> WaterMotion:
        """Return how the water moves at the times t (n,) [s]; the displacement is 0 at t = 0."""
        draw = stream(seed, "waves")
        periods = self.period * np.maximum(1.0 + _BAND * draw.standard_normal(_COMPONENTS), _SHORTEST)
        headings = self.heading + _SPREAD * draw.standard_normal(_COMPONENTS)
        phases = draw.uniform(0.0, 2.0 * math.pi, _COMPONENTS)
        size = self.rms * math.sqrt(2.0 / _COMPONENTS)
        out = WaterMotion(*(np.zeros((t.size, 3)) for _ in range(3)))
        for w, heading, phase in zip(2.0 * math.pi / periods, headings, phases, strict=True):
            along = size * np.array([math.cos(heading), math.sin(heading), 0.0])
            down = size * np.array([0.0, 0.0, self.vertical])
            angle = w * t + phase
            c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
            out.velocity[:] += along * c + down * s
            out.acceleration[:] += w * (down * c - along * s)
            out.displacement[:] += (along * (s - math.sin(phase)) - down * (c - math.cos(phase))) / w
        return _risen(t, out, self.begin, _RISES * self.period) if self.begin > 0.0 else out


@dataclass(frozen=True)
class RisingCurrent:
    """A current that begins to flow where the water was still: out of a harbour, or as the tide turns.

    Attributes:
        velocity: of the water [m/s], NED, once it flows.
        begin: when it begins [s]. seconds: until it flows in full; in between it grows smoothly.

    Raises:
        InputError: a number is not finite or out of range.
    """

    velocity: tuple[float, float, float]
    begin: float = 0.0
    seconds: float = 20.0

    def __post_init__(self) -> None:
        finite_array("rising current: velocity", self.velocity, (3,))
        for name in ("begin", "seconds"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"rising current: {name}: found {value}, expected a finite number, 0 or more")
        if self.seconds == 0.0:
            raise InputError("rising current: seconds: found 0, expected more")

    def motion(self, t: Array, seed: int) -> WaterMotion:
        """Return how the water moves at the times t (n,) [s]; no part of it is random."""
        full, still = np.broadcast_to(np.array(self.velocity), (t.size, 3)), np.zeros((t.size, 3))
        return _risen(t, WaterMotion(still, full, still), self.begin, self.seconds)


def _risen(t: Array, full: WaterMotion, begin: float, seconds: float) -> WaterMotion:
    """Return a motion as it comes up: its velocity times a share that goes smoothly from 0 to 1, from `begin` on."""
    from scipy.integrate import cumulative_trapezoid  # slow to import, seldom needed

    angle = math.pi * np.clip((t - begin) / seconds, 0.0, 1.0)[:, None]
    share, rate = 0.5 - 0.5 * np.cos(angle), 0.5 * math.pi / seconds * np.sin(angle)
    velocity = share * full.velocity
    moved = cumulative_trapezoid(velocity, t, axis=0, initial=0.0)
    return WaterMotion(moved, velocity, share * full.acceleration + rate * full.velocity)


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
