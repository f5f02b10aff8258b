"""What there is to say about each channel of a recording: rate, span, holes, range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from towtank.recording.channel import Channel
from towtank.recording.grids.timing import find_gaps, sampling_rate
from towtank.recording.recording import Recording
from towtank.recording.standard import is_held

__all__ = ["ChannelFacts", "channel_facts"]


@dataclass(frozen=True)
class ChannelFacts:
    """One channel. Times in s, values in `unit`; None where there is nothing to say.

    Attributes:
        missing: samples that the usual step would have had and that are not there, in holes long or short.
        gaps: holes too long to interpolate over; none for an input, which holds.
        changes: how often an input changes; None for a measurement.
    """

    name: str
    unit: str
    frame: str
    rate_hz: float
    samples: int
    start_s: float
    end_s: float
    missing: int
    gaps: int
    longest_gap_s: float | None
    min: float
    max: float
    changes: int | None


def channel_facts(recording: Recording) -> list[ChannelFacts]:
    """Return the facts of every channel that has a value, in the recording's order."""
    return [_facts(channel) for channel in recording.channels.values() if len(channel.measured)]


def _facts(channel: Channel) -> ChannelFacts:
    known = channel.measured
    t, values = known.t, known.values
    held = is_held(channel.name)
    steps = np.diff(t)
    rate = sampling_rate(t)
    absent = int(np.maximum(np.rint(steps * rate) - 1.0, 0.0).sum()) if t.size > 1 and not held else 0
    gaps = find_gaps(t) if not held else np.empty(0, dtype=np.intp)
    return ChannelFacts(
        name=channel.name,
        unit=channel.unit,
        frame=channel.frame,
        rate_hz=rate,
        samples=t.size,
        start_s=float(t[0]),
        end_s=float(t[-1]),
        missing=absent,
        gaps=int(gaps.size),
        longest_gap_s=float(steps[gaps].max()) if gaps.size else None,
        min=float(values.min()),
        max=float(values.max()),
        changes=int(np.count_nonzero(np.diff(values))) if held else None,
    )
