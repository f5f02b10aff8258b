"""What a caller hands to the simulators, checked and put into arrays.

Independent random streams from one seed, by name: asking for one never changes another.
"""

from __future__ import annotations

import math
import zlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.errors import InputError

__all__ = ["finite_array", "initial_states", "positive", "step_count", "stream"]


def finite_array(name: str, value: ArrayLike, *shapes: tuple[int | str, ...]) -> Array:
    """Return `value` as a new float64 array of one of the shapes, e.g. ("n", 6): a text stands for any length.

    Raises:
        InputError: not numbers, none of the shapes, or a number that is not finite.
    """
    try:
        array = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: expected numbers ({error})") from error
    if not any(_fits(array.shape, shape) for shape in shapes):
        expected = " or ".join(f"({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})" for shape in shapes)
        raise InputError(f"{name}: found shape {array.shape}, expected {expected}")
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        place = tuple(int(i) for i in bad[0])
        raise InputError(f"{name}: found {array[place]} at {list(place)}, expected finite numbers")
    return array


def _fits(found: tuple[int, ...], expected: tuple[int | str, ...]) -> bool:
    return len(found) == len(expected) and all(
        isinstance(e, str) or f == e for f, e in zip(found, expected, strict=True)
    )


def positive(name: str, value: Any, unit: str = "s") -> float:
    """Return `value` as a float. Raises InputError unless it is a finite number above 0."""
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name}: found {value!r}, expected a number above 0 [{unit}]") from error
    if not (math.isfinite(number) and number > 0.0):
        raise InputError(f"{name}: found {number:g} {unit}, expected a number above 0")
    return number


def step_count(duration: float, dt: float) -> int:
    """Return the number of steps of dt [s] in a duration [s]. Raises InputError if there is none."""
    n = round(positive("duration", duration) / dt)
    if n < 1:
        raise InputError(f"duration: found {duration:g} s, expected at least one step of {dt:g} s")
    return n


def initial_states(eta0: Array, nu0: Array) -> Array:
    """Return states (..., 13) of poses eta0 (..., 6) [m, rad] and velocities nu0 (..., 6)."""
    q = quaternions_from_eulers(np.ascontiguousarray(eta0[..., 3:].reshape(-1, 3))).reshape(*eta0.shape[:-1], 4)
    return np.ascontiguousarray(np.concatenate([eta0[..., :3], q, nu0], axis=-1))


def stream(seed: int, *names: str) -> np.random.Generator:
    """Return the random generator of `seed` that belongs to `names`, e.g. ("dvl", "noise").

    Raises:
        InputError: the seed is not a whole number >= 0.
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed: found {seed!r}, expected a whole number, 0 or more")
    key = tuple(zlib.crc32(name.encode()) for name in names)
    return np.random.default_rng(np.random.SeedSequence(int(seed), spawn_key=key))
