"""By which channels the motion along each axis is known: what `STANDARD` says of each, by axis.

A speed tells it, and so does what it is the rate or the integral of: a depth tells heave, a heading yaw, an
accelerometer what pushes the body. Learning takes each of these as a measurement.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from towtank.digits import joined, short
from towtank.recording.grids.timing import sampling_rate
from towtank.recording.recording import Recording
from towtank.recording.standard import (
    EULER,
    LINEAR_VELOCITY,
    MEASURED,
    POSE,
    QUATERNION,
    STANDARD,
    VELOCITIES,
    WORLD_VELOCITY,
)

__all__ = ["CHANNELS_OF", "AxisKnown", "Witness", "axes_shown", "judged_by", "known_by", "known_text"]

_DIRECT = ("m/s", "rad/s", "m", "rad", "m/s^2")  # units of what shows a motion, the most direct first
CHANNELS_OF: Mapping[str, Mapping[str, str]] = {  # axis -> channel -> what it is in words, the most direct first
    axis: {
        name: STANDARD[name].shows
        for unit in _DIRECT
        for name in MEASURED
        if (STANDARD[name].axis, STANDARD[name].unit) == (axis, unit)
    }
    for axis in ("surge", "sway", "heave", "roll", "pitch", "yaw")
}
_MADE_OF = {
    **dict.fromkeys(EULER, QUATERNION),
    **dict.fromkeys(LINEAR_VELOCITY, (*WORLD_VELOCITY, *QUATERNION)),
}  # what stands for a channel that is not there by itself


@dataclass(frozen=True)
class Witness:
    """One channel that tells of an axis: its name, what it is in words, and its rate [Hz]."""

    channel: str
    by: str
    rate_hz: float

    @property
    def text(self) -> str:
        """As "depth, 10 Hz"."""
        return f"{self.by}, {short(self.rate_hz, 2)} Hz" if self.rate_hz == self.rate_hz else self.by


@dataclass(frozen=True)
class AxisKnown:
    """An axis ("surge" .. "yaw"), and what tells of it, the most direct first; nothing where that is empty."""

    axis: str
    witnesses: tuple[Witness, ...]

    @property
    def text(self) -> str:
        """As "heave by depth, 10 Hz, and acceleration, 100 Hz"; "surge by no channel of its own"."""
        return f"{self.axis} by {', and '.join(each.text for each in self.witnesses) or 'no channel of its own'}"


def axes_shown(measured: Collection[str]) -> tuple[bool, ...]:
    """Return of which axes (6,) the motion is measured, from the names of the channels that are."""
    return tuple(any(name in measured for name in channels) for channels in CHANNELS_OF.values())


def known_by(*recordings: Recording) -> tuple[AxisKnown, ...]:
    """Return by what each of the six axes is known in recordings, at the highest rate of a channel in any of them."""
    each = [(name, rate) for run in recordings for name in MEASURED if (rate := _rate(run, name)) is not None]
    rates = dict(sorted(each, key=lambda pair: pair[1]))
    return tuple(
        AxisKnown(axis, tuple(Witness(name, by, rates[name]) for name, by in channels.items() if name in rates))
        for axis, channels in CHANNELS_OF.items()
    )


def known_text(known: Sequence[AxisKnown]) -> str:
    """Return in words by what axes are known, and of which nothing of their own tells."""
    told = "; ".join(each.text for each in known if each.witnesses)
    silent = [each.axis for each in known if not each.witnesses]
    return "; ".join(part for part in (told, f"no channel tells of {joined(silent)}" if silent else "") if part)


def judged_by(measured: Collection[str]) -> tuple[str, ...]:
    """Return by which channels a prediction is judged: of each axis its speed, where that is not measured its pose.

    Args:
        measured: names of the channels that are.
    """
    found = ([name for name in (speed, pose) if name in measured] for speed, pose in zip(VELOCITIES, POSE, strict=True))
    return tuple(names[0] for names in found if names)


def _rate(recording: Recording, name: str) -> float | None:
    """Return the rate [Hz] of a channel, of a quaternion that of its angles; None where it is not measured."""
    known = name if name in recording else next(iter(_MADE_OF.get(name, ())), name)
    needed = (name,) if known == name else _MADE_OF[name]
    if not all(each in recording and len(recording[each].measured) for each in needed):
        return None
    return sampling_rate(recording[known].measured.t)
