"""What no underwater vehicle does, whatever else the log says: speeds and steps of time that are those of other units.

A log in one wrong unit throughout agrees with itself. But no vehicle goes 30 m/s for half of a run, and none is known
by a pose that comes every few seconds, or 20,000 times a second.
"""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import short
from towtank.recording.recording import Recording
from towtank.recording.standard import EULER, LINEAR_VELOCITY, POSE, POSITION, VELOCITIES

__all__ = ["impossible_sizes"]

_FEWEST = 20  # samples
_FASTEST = 30.0  # m/s, more than any but a rocket goes under water
_JUMP, _CLOSE = 0.8, 0.2  # rad from one sample to the next, with so many seconds between them at most
_SLOWEST, _QUICKEST = 5.0, 5e-5  # s between two samples of the quickest channel of motion


def impossible_sizes(recording: Recording) -> list[tuple[str, str]]:
    """Return channels and a sentence for each size that cannot be."""
    out = []
    fast = {name: _middle(np.abs(_values(recording, name))) for name in LINEAR_VELOCITY}
    out += _said({name: x for name, x in fast.items() if x > _FASTEST}, "are")
    if not out:
        travelled = {name: _travelled(recording, name) for name in POSITION}
        out += _said({name: x for name, x in travelled.items() if x > _FASTEST}, "change by")
    wild = [name for name in EULER if _jump(recording, name) > _JUMP]
    if wild:
        text = f"{' '.join(wild)} jump by more than {_JUMP:g} rad from sample to sample, half of the time"
        out.append((" ".join(wild), f"{text}: degrees, not radians, noise, or another column?"))
    step = min((_step(recording, name) for name in (*POSE, *VELOCITIES)), default=np.inf)
    if _SLOWEST < step < np.inf:
        text = f"samples come every {short(step, 3)} s: milliseconds, not seconds? (divide the times by 1000)"
        out.append(("t", text))
    elif step < _QUICKEST:
        text = f"samples come every {short(1e6 * step, 3)} µs: seconds taken for milliseconds? (multiply the times)"
        out.append(("t", text))
    return out


def _said(found: dict[str, float], verb: str) -> list[tuple[str, str]]:
    """Return one sentence for all channels that are too fast by half of the time."""
    if not found:
        return []
    names, most = " ".join(found), short(max(found.values()), 3)
    size = f"{names} {verb} {most} m/s or more half of the time, which no underwater vehicle does"
    return [(names, f"{size}: millimetres, not metres? (scale = 0.001 in the mapping)")]


def _values(recording: Recording, name: str) -> Array:
    return recording[name].measured.values if name in recording else np.empty(0)


def _middle(x: Array) -> float:
    return float(np.median(x)) if x.size >= _FEWEST else 0.0


def _travelled(recording: Recording, name: str) -> float:
    """Return by how much a coordinate changes in a second, half of the time [m/s]; of noise and jumps alone it is 0."""
    if name not in recording:
        return 0.0
    known = recording[name].measured
    seconds = np.arange(known.t[0], known.t[-1], 1.0) if len(known) >= _FEWEST else np.empty(0)
    if seconds.size < _FEWEST // 2:
        return 0.0
    return float(np.median(np.abs(np.diff(np.interp(seconds, known.t, known.values)))))


def _jump(recording: Recording, name: str) -> float:
    """Return the usual change of an angle from one sample to the next [rad]; 0 where they are far apart."""
    if name not in recording or _step(recording, name) > _CLOSE:
        return 0.0
    return float(np.median(np.abs(np.angle(np.exp(1j * np.diff(recording[name].measured.values))))))


def _step(recording: Recording, name: str) -> float:
    """Return the usual step of a channel [s]; infinity where it has too few samples."""
    if name not in recording:
        return np.inf
    t = recording[name].measured.t
    return float(np.median(np.diff(t))) if t.size >= _FEWEST else np.inf
