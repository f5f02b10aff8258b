"""Velocity through the water: a Pitot log or another speed log (forward alone), an ADCP on water track (all three)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from towtank.errors import InputError
from towtank.recording.channel import Channel, read_only
from towtank.recording.standard import RELATIVE_VELOCITY
from towtank.simulation.inputs import stream
from towtank.simulation.motion import Motion
from towtank.simulation.sensors.sensor import channels, require_non_negative, require_positive, sampled

__all__ = ["WaterTrack"]


@dataclass(frozen=True)
class WaterTrack:
    """Velocity u_w v_w w_w of the body origin relative to the water, body FRD.

    Attributes:
        rate: [Hz], at most once a step.
        noise: standard deviation of the white noise [m/s]. That of one axis does not depend on which others there are.
        axes: the channels measured; ("u_w",) is a Pitot log.

    Raises:
        InputError: a number is out of range; `axes` is empty, names another channel, or one twice.
    """

    rate: float = 5.0
    noise: float = 0.01
    axes: tuple[str, ...] = RELATIVE_VELOCITY

    def __post_init__(self) -> None:
        require_positive(self, "rate")
        require_non_negative(self, "noise")
        if not self.axes or len(set(self.axes)) < len(self.axes) or not set(self.axes) <= set(RELATIVE_VELOCITY):
            known = " ".join(RELATIVE_VELOCITY)
            raise InputError(f"WaterTrack: axes: found {self.axes!r}, expected one or more of {known}, each once")

    def observe(self, motion: Motion, seed: int) -> list[Channel]:
        """Return the channels of `axes`, at common times."""
        steps = sampled(motion, self.rate)
        columns = [RELATIVE_VELOCITY.index(name) for name in self.axes]
        white = stream(seed, "water track", "noise").standard_normal((steps.size, len(RELATIVE_VELOCITY)))
        velocity = motion.nu_r[steps][:, columns] + self.noise * white[:, columns]
        return channels(self.axes, read_only(motion.t[steps]), np.ascontiguousarray(velocity))
