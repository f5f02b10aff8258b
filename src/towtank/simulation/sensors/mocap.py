"""Motion capture: poses of a marker body, with noise, jumps where markers are hidden, and dropouts.

When a marker is occluded, the solver shifts the body: for 0.1 to 0.5 s the position is off by 10 to 50 mm in some
direction, for 1.4 % of the time. The figures are those of the tank experiments that the estimators are judged by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.recording.channel import Channel, read_only
from towtank.recording.frames.rotations import rotate
from towtank.recording.standard import POSE
from towtank.simulation.inputs import stream
from towtank.simulation.motion import Motion
from towtank.simulation.sensors.sensor import (
    Place,
    channels,
    require_non_negative,
    require_places,
    require_positive,
    sampled,
)

__all__ = ["Mocap", "intervals"]


@dataclass(frozen=True)
class Mocap:
    """Position x y z of a place of the body, and attitude phi theta psi. Angles go on beyond a full turn.

    Attributes:
        rate: [Hz], at most once a step.
        noise_mm, noise_mrad: standard deviation of the white noise on position [mm] and angles [mrad].
        jump_fraction: expected part of the time with an offset of the position.
        jump_mm, jump_s: smallest and largest offset [mm] and its duration [s], uniform between them.
        dropout_fraction, dropout_s: expected part of the time without a pose (NaN), and the durations [s].
        place: whose position it is (3,) [m], body FRD.

    Raises:
        InputError: a number is out of range.
    """

    rate: float = 100.0
    noise_mm: float = 1.0
    noise_mrad: float = 1.0
    jump_fraction: float = 0.014
    jump_mm: tuple[float, float] = (10.0, 50.0)
    jump_s: tuple[float, float] = (0.1, 0.5)
    dropout_fraction: float = 0.0
    dropout_s: tuple[float, float] = (0.1, 0.5)
    place: Place = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        require_positive(self, "rate")
        require_places(self, "place")
        require_non_negative(self, "noise_mm", "noise_mrad", "jump_fraction", "dropout_fraction")
        for name in ("jump_fraction", "dropout_fraction"):
            if getattr(self, name) >= 1.0:
                raise InputError(f"Mocap: {name}: found {getattr(self, name)}, expected less than 1")
        for name in ("jump_mm", "jump_s", "dropout_s"):
            low, high = getattr(self, name)
            if not 0.0 <= low <= high < np.inf or high == 0.0:
                raise InputError(f"Mocap: {name}: found ({low}, {high}), expected (smallest, largest), above 0")

    def observe(self, motion: Motion, seed: int) -> list[Channel]:
        """Return the six pose channels, at common times."""
        steps = sampled(motion, self.rate)
        t, pose = read_only(motion.t[steps]), motion.eta[steps]
        pose[:, :3] += rotate(motion.q[steps], np.array(self.place))
        pose[:, :3] += 1e-3 * self.noise_mm * stream(seed, "mocap", "position").standard_normal((steps.size, 3))
        pose[:, 3:] += 1e-3 * self.noise_mrad * stream(seed, "mocap", "attitude").standard_normal((steps.size, 3))
        pose[:, :3] += self._jumps(t, stream(seed, "mocap", "jumps"))
        which = intervals(t, self.dropout_fraction, self.dropout_s, stream(seed, "mocap", "dropouts"))
        pose[which >= 0] = np.nan
        return channels(POSE, t, pose)

    def _jumps(self, t: Array, generator: np.random.Generator) -> Array:
        """Return the offsets (n, 3) [m] of hidden markers: constant during each jump, zero between."""
        which = intervals(t, self.jump_fraction, self.jump_s, generator)
        count = int(which.max(initial=-1)) + 1
        direction = generator.standard_normal((count, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        size = 1e-3 * generator.uniform(*self.jump_mm, size=(count, 1))
        offsets = np.vstack([size * direction, np.zeros((1, 3))])
        return offsets[which]  # -1, no jump, takes the last row


def intervals(
    t: Array, fraction: float, durations: tuple[float, float], generator: np.random.Generator
) -> NDArray[np.intp]:
    """Return which of the random intervals each of the times (n,) lies in, -1 for none.

    Durations are uniform, the pauses between them exponential, so that `fraction` of the time is covered on average.
    """
    which = np.full(t.size, -1, dtype=np.intp)
    if fraction <= 0.0:
        return which
    pause = 0.5 * sum(durations) * (1.0 / fraction - 1.0)
    start, number = float(t[0]), 0
    while True:
        start += generator.exponential(pause)
        if start > t[-1]:
            return which
        end = start + generator.uniform(*durations)
        which[np.searchsorted(t, start) : np.searchsorted(t, end)] = number
        start, number = end, number + 1
