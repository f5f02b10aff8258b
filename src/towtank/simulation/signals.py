"""Wave forms that excite a vehicle, all within -1 .. 1.

Each takes the times t (n,) [s] from 0 on, a period [s], a random generator (used where the form is random), and its
lane (i, of): when several axes are excited at once, lane i of `of` gets a signal that is as good as uncorrelated to
the others.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array

__all__ = ["FORMS", "Form", "Lane", "chirp", "multisine", "prbs", "ramp", "sine", "square", "stairs", "telegraph"]

Lane = tuple[int, int]
_SINGLE: Lane = (0, 1)
_STRETCH = 1.17  # from lane to lane the period grows by this factor, which no small whole ratio meets
_STAIRS = (0.25, 0.5, 0.75, 1.0)


def sine(t: Array, period: float, generator: np.random.Generator, lane: Lane = _SINGLE) -> Array:
    """Return sin(2 pi t / period)."""
    return np.sin(_angle(t, period, lane))


def ramp(t: Array, period: float, generator: np.random.Generator, lane: Lane = _SINGLE) -> Array:
    """Return a triangle: from 0 up to 1, down to -1 and back, once a period."""
    triangle: Array = 2.0 / np.pi * np.arcsin(np.sin(_angle(t, period, lane)))
    return triangle


def stairs(t: Array, period: float, generator: np.random.Generator, lane: Lane = _SINGLE) -> Array:
    """Return four equal steps up in one direction for half a period, then the same in the other direction."""
    eighth = np.floor(8.0 * (_angle(t, period, lane) / (2.0 * np.pi) + 1e-9)).astype(np.intp) % 8
    return np.array([*_STAIRS, *(-s for s in _STAIRS)])[eighth]


def square(t: Array, period: float, generator: np.random.Generator, lane: Lane = _SINGLE) -> Array:
    """Return +1 for a quarter of the period, -1 for half of it, +1 for the last quarter: out and back."""
    quarter = np.floor(4.0 * (_angle(t, period, lane) / (2.0 * np.pi) + 1e-9)).astype(np.intp) % 4
    return np.array([1.0, -1.0, -1.0, 1.0])[quarter]


def chirp(t: Array, period: float, generator: np.random.Generator, lane: Lane = _SINGLE) -> Array:
    """Return a sine whose period falls from two to a fifth of `period`, by equal factors in equal times."""
    end = t[-1] if t.size > 1 else 1.0
    place = (t / end * (1.0 - 1e-12) + lane[0] / lane[1]) % 1.0  # later lanes start later in the sweep
    frequency = 0.5 / period * 10.0**place
    steps = np.diff(t, append=2.0 * t[-1] - t[-2] if t.size > 1 else end)
    phase = 2.0 * np.pi * np.cumsum(frequency * steps)
    sweep: Array = np.sin(np.concatenate([[0.0], phase[:-1]]))
    return sweep


def prbs(t: Array, period: float, generator: np.random.Generator, lane: Lane = _SINGLE) -> Array:
    """Return a maximum-length pseudo-random binary sequence with a tenth of `period` to the bit; random start."""
    from scipy.signal import max_len_seq

    bit = np.floor(10.0 * t / period + 1e-9).astype(np.intp)
    order = min(max(math.ceil(math.log2(bit[-1] + 2)), 5), 16)
    sequence = 2.0 * max_len_seq(order)[0] - 1.0
    return np.asarray(sequence[(bit + generator.integers(sequence.size)) % sequence.size])


def multisine(t: Array, period: float, generator: np.random.Generator, lane: Lane = _SINGLE) -> Array:
    """Return equal sines on the harmonics of the duration between periods of 3 and 1/5 `period`, random start.

    Schroeder's phases -pi j (j - 1) / J keep the crest low (IEEE Trans. Inf. Theory 16 (1970) 85); lanes share out the
    harmonics, so that the signals of different lanes are orthogonal.
    """
    step = t[1] - t[0] if t.size > 1 else period
    duration = t.size * step
    highest = min(5.0 * duration / period, 0.25 * t.size)
    lines = np.arange(max(math.ceil(duration / (3.0 * period)), 1), int(highest) + 1)
    lines = lines[lines % lane[1] == lane[0]] if lines.size >= lane[1] else np.array([1 + lane[0]])
    begin = generator.uniform()
    out = np.zeros(t.size)
    for j, k in enumerate(lines, start=1):
        out += np.cos(2.0 * np.pi * k * (t / duration + begin) - np.pi * j * (j - 1) / lines.size)
    out /= np.abs(out).max()
    return out


def telegraph(t: Array, period: float, generator: np.random.Generator, lane: Lane = _SINGLE) -> Array:
    """Return +-1 that switches after random times: at least a twentieth of `period`, a quarter of it on average."""
    intervals = 0.05 * period + generator.exponential(0.2 * period, size=int(20.0 * t[-1] / period) + 2)
    switches = np.searchsorted(np.cumsum(intervals), t, side="right")
    first = 1.0 if generator.uniform() < 0.5 else -1.0
    return np.where(switches % 2, -first, first)


def _angle(t: Array, period: float, lane: Lane) -> Array:
    return 2.0 * np.pi / (period * _STRETCH ** lane[0]) * t


@dataclass(frozen=True)
class Form:
    """A wave form: what it is, its function, and its usual period [s] for a vehicle of some tens of kilograms."""

    description: str
    wave: Callable[[Array, float, np.random.Generator, Lane], Array]
    period: float


FORMS: dict[str, Form] = {
    "sine": Form("sine of 10 s", sine, 10.0),
    "ramp": Form("slow triangle of 20 s, up and down in both directions", ramp, 20.0),
    "stairs": Form("four steps up, 2 s each, then the same in reverse", stairs, 16.0),
    "square": Form("full ahead and full astern, 5 s out and back", square, 5.0),
    "chirp": Form("sine sweep from 20 s to 2 s", chirp, 10.0),
    "prbs": Form("pseudo-random binary sequence, 0.6 s to the bit", prbs, 6.0),
    "multisine": Form("sum of sines from 0.03 to 0.5 Hz with a low crest", multisine, 10.0),
    "telegraph": Form("full ahead or full astern, switched at random, every 2 s on average", telegraph, 8.0),
}
