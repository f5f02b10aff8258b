"""Independent random streams from one seed, by name: asking for one never changes another."""

from __future__ import annotations

import zlib

import numpy as np

from towtank.errors import InputError

__all__ = ["stream"]


def stream(seed: int, *names: str) -> np.random.Generator:
    """Return the random generator of `seed` that belongs to `names`, e.g. ("dvl", "noise").

    Raises:
        InputError: the seed is not a whole number >= 0.
    """
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise InputError(f"seed: found {seed!r}, expected a whole number, 0 or more")
    key = tuple(zlib.crc32(name.encode()) for name in names)
    return np.random.default_rng(np.random.SeedSequence(int(seed), spawn_key=key))
