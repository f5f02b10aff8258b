"""Rates in the wrong unit, told by the attitude beside them: degrees taken for radians, or radians for degrees.

Both sides are means over the same cells of time, smoothed alike, at the lag that fits best. Regression of the measured
rate on the derived one makes the scale too small by the noise of that one, the other regression too large, so that the
truth lies between; a unit is off where all of that lies near 57.3 or its inverse. No motion and no noise is 57 times
another by chance, so that a few turns are enough.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import joined, short
from towtank.recording.channel import standard_channel
from towtank.recording.cleaning import find_spikes
from towtank.recording.consistency.signals import SMOOTHED, Signal, measured, memory_of, smooth_means, turning
from towtank.recording.grids.timing import is_sparse
from towtank.recording.recording import Recording
from towtank.recording.standard import EULER, RATES

__all__ = ["RateScale", "rate_scales", "with_rates_in_radians"]

_CELL, _PER_STEP = 0.05, 2  # s, at least; cells in the step of the slowest channel, at most
_LAG = 0.5  # s
_LEAST_CELLS = 6 * SMOOTHED
_FOLLOWS, _BEYOND_CHANCE = 0.3, 15.0  # share explained, and log likelihood ratio, for a scale to be told
_NEAR = math.log(1.35)  # of the logarithm of a scale, that it may be off a unit's
_BLOCKS = 12
_DEGREES = math.degrees(1.0)


class RateScale(NamedTuple):
    """How many times a measured rate is that of the attitude, and its deviation."""

    name: str
    scale: float
    std: float

    @property
    def text(self) -> str:
        """As "57.2 ± 0.3"."""
        return f"{self.scale:.3g} ± {self.std:.2g}"

    @property
    def off(self) -> float:
        """What it has to be multiplied by where its unit is wrong; 1 where it is not."""
        for unit in (_DEGREES, 1.0 / _DEGREES):
            if self.scale > 0.0 and abs(math.log(self.scale / unit)) < _NEAR:
                return 1.0 / unit
        return 1.0


def with_rates_in_radians(recording: Recording) -> Recording:
    """Return the recording with `p q r` in rad/s where their own attitude shows that they are not, with a note of it.

    Axes that tell nothing follow those that do, where these agree: the three come from one sensor.
    """
    present = [name for name in RATES if name in recording]
    scales = {each.name: each for each in rate_scales(recording)} if present else {}
    factors = {each.off for each in scales.values()}
    if not factors - {1.0}:
        return recording
    alone = factors.pop() if len(factors) == 1 else 1.0
    factor = {name: scales[name].off if name in scales else alone for name in present}
    notes, channels = [], []
    for wrong in (1.0 / _DEGREES, _DEGREES):
        names = [name for name in present if math.isclose(factor[name], wrong)]
        if not names:
            continue
        channels += [recording[name].with_values(wrong * recording[name].values) for name in names]
        notes.append(_said(recording, names, [scales[name] for name in names if name in scales], wrong))
    return recording.replace(channels).with_notes(*notes)


def _said(recording: Recording, names: list[str], scales: list[RateScale], factor: float) -> str:
    """Return what was mended, with what was found and what was done."""
    verb = "were" if len(names) > 1 else "was"
    found = joined([each.text for each in scales])
    largest = max((float(np.abs(recording[name].measured.values).max(initial=0.0)) for name in names), default=0.0)
    what = (
        f"{' '.join(names)} {verb} in degrees per second, not radians"
        if factor < 1.0
        else f"{' '.join(names)} {verb} scaled from degrees to radians once too often"
    )
    return (
        f"{what}: {found} times what the attitude does; multiplied by {factor:.6g}, so that the largest is "
        f"{short(factor * largest, 3)} rad/s, not {short(largest, 3)}"
    )


def rate_scales(recording: Recording) -> list[RateScale]:
    """Return the scale of each of `p q r` that the attitude tells; nothing of those that it does not."""
    recording = _without_spikes(recording)
    rates, turned = measured(recording, RATES), turning(recording)
    found = (_scale(name, rates[name], turned[name]) for name in RATES if name in rates and name in turned)
    return [each for each in found if each is not None]


def _without_spikes(recording: Recording) -> Recording:
    """Return the recording without isolated outliers of its rates and angles, as damaged messages make them."""
    cleaned = []
    for name in (*RATES, *EULER):
        if name in recording:
            channel = recording[name].measured
            spikes = find_spikes(channel.t, channel.values, "linear" if name in RATES else "angle")
            if spikes.size:
                t, values = np.delete(channel.t, spikes), np.delete(channel.values, spikes)
                cleaned.append(standard_channel(name, t, values))
    return recording.replace(cleaned) if cleaned else recording


def _scale(name: str, rate: Signal, turned: Signal) -> RateScale | None:
    """Return the scale of one axis; None where motion is too little, too noisy or too short to tell."""
    tracks = (*rate.tracks, *turned.tracks)
    start, end = max(float(track.t[0]) for track in tracks), min(float(track.t[-1]) for track in tracks)
    dt = max(_CELL, max(track.step for track in tracks) / _PER_STEP)
    if not (end - start) / dt > _LEAST_CELLS or is_sparse([track.t for track in tracks], 1.0 / dt):
        return None
    x, y = smooth_means([rate, turned], np.arange(start, end, dt)).T
    longest = round(_LAG / dt)
    pairs = [pair for lag in range(-longest, longest + 1) if (pair := _at(x, y, lag))[0].size > _LEAST_CELLS // 2]
    if not pairs:
        return None
    m, d = max(pairs, key=lambda pair: _share(*pair))
    share = _share(m, d)
    if share < _FOLLOWS:
        return None
    memory = float(memory_of(m[:, None], d[:, None], dt)[0])
    if -(m.size / memory) * math.log(max(1.0 - share, 1e-12)) < _BEYOND_CHANCE:
        return None
    scale = math.copysign(math.sqrt(float(m @ m) / float(d @ d)), float(m @ d))
    return RateScale(name, scale, _deviation(m, d))


def _at(x: Array, y: Array, lag: int) -> tuple[Array, Array]:
    """Return both (n,), x later by a lag [cells], where they are known, without their means."""
    n = x.size - abs(lag)
    m, d = x[max(lag, 0) : max(lag, 0) + n], y[max(-lag, 0) : max(-lag, 0) + n]
    known = np.isfinite(m) & np.isfinite(d)
    m, d = m[known], d[known]
    return (m - m.mean(), d - d.mean()) if m.size else (m, d)


def _share(m: Array, d: Array) -> float:
    """Return the share of a square that one explains of the other."""
    total = float(m @ m) * float(d @ d)
    return float(m @ d) ** 2 / total if total > 0.0 else 0.0


def _deviation(m: Array, d: Array) -> float:
    """Return the deviation of the scale, by leaving out one block of time at a time (jackknife)."""
    squares = [
        np.add.reduceat(each, np.linspace(0, m.size, _BLOCKS + 1).astype(np.intp)[:-1]) for each in (m * m, d * d)
    ]
    left = [np.sqrt(total.sum() - total) for total in squares]
    scales = left[0] / np.maximum(left[1], 1e-300)
    return float(np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum((scales - scales.mean()) ** 2)))
