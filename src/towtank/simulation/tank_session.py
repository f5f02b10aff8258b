"""A session in a tank: one axis after the other, rest in between, out and back so that the walls stay away.

The order is the paper's: surge, sway, heave, roll, yaw, pitch, since pitch needs what surge and heave taught. Each axis
gets whole periods of a square wave, large and small in turn: switching excites the inertia, two speeds tell linear from
quadratic damping. A vehicle that is not neutral is trimmed: a constant heave force holds it against W - B.
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.simulation.signals import square

__all__ = ["ORDER", "session_wave"]

ORDER = ("surge", "sway", "heave", "roll", "yaw", "pitch")

_LEVELS = np.array([1.0, 0.6])
_REST = 0.15  # of the time of an axis, half of it before
_PERIOD = 5.0  # s


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
    return np.where(active, wave * _LEVELS[k.astype(np.intp) % _LEVELS.size], 0.0)
