"""Segments: movements of some seconds that begin near rest, made of telegraphs, multisines or chirps of a wrench.

A segment is a small record, so that a plan can be written down, changed in one place by a search, and driven by hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np

from towtank.core.arrays import Array
from towtank.planning.forecast import RATE
from towtank.simulation import available_rows, usual_amplitudes
from towtank.vehicle import Vehicle, allocate

__all__ = ["FORMS", "LONGEST", "SHORTEST", "Segment", "changed", "commands_of", "drawn_segment", "full_wrench"]

SHORTEST, LONGEST = 6.0, 12.0  # s
_QUICKEST, _SLOWEST = 0.4, 2.5  # s between two switches of a telegraph
_BY_HAND = (1.2, 3.0)  # s between them that a pilot can follow,
_AT_ONCE = 2  # on as many axes
_AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
Form = Literal["telegraph", "multisine", "chirp"]
T = TypeVar("T")


@dataclass(frozen=True)
class Segment:
    """A movement.

    Attributes:
        form: telegraph (full one way or the other), multisine or chirp. duration: [s].
        rows: of the wrench that are driven, 0..5 for X .. N. amplitude: of each [N, N m].
        switches: times [s] at which each telegraph turns, for each row; of the other forms the frequencies [Hz].
        signs: with which each row begins; of a multisine the phases [rad] of its frequencies.
    """

    form: Form
    duration: float
    rows: tuple[int, ...]
    amplitude: tuple[float, ...]
    switches: tuple[tuple[float, ...], ...]
    signs: tuple[tuple[float, ...], ...]

    @property
    def axes(self) -> str:
        """The axes in words."""
        return "all axes" if len(self.rows) == 6 else ", ".join(_AXES[row] for row in self.rows)

    @property
    def wrench(self) -> Array:
        """The wrench (n, 6) at `RATE` [N, N m], body FRD."""
        t = np.arange(round(self.duration * RATE)) / RATE
        out = np.zeros((t.size, 6))
        for row, amplitude, numbers, signs in zip(self.rows, self.amplitude, self.switches, self.signs, strict=True):
            out[:, row] = amplitude * _WAVES[self.form](t, np.array(numbers), np.array(signs), self.duration)
        return out


def _telegraph(t: Array, switches: Array, signs: Array, duration: float) -> Array:
    turned = np.searchsorted(np.sort(switches), t, "right")
    return np.asarray(signs[0] * np.where(turned % 2, -1.0, 1.0))


def _multisine(t: Array, frequencies: Array, phases: Array, duration: float) -> Array:
    waves = np.sin(2.0 * np.pi * np.outer(t, frequencies) + phases)
    return np.asarray(waves.sum(axis=1) / max(float(np.abs(waves.sum(axis=1)).max(initial=0.0)), 1e-12))


def _chirp(t: Array, ends: Array, signs: Array, duration: float) -> Array:
    rate = np.log(ends[1] / ends[0]) / duration
    return np.asarray(signs[0] * np.sin(2.0 * np.pi * ends[0] * np.expm1(rate * t) / rate))


_WAVES = {"telegraph": _telegraph, "multisine": _multisine, "chirp": _chirp}
FORMS = tuple(_WAVES)


def full_wrench(vehicle: Vehicle) -> Array:
    """Return the largest force or moment (6,) of each axis alone, 0 where it cannot be commanded [N, N m].

    No more than what makes a gentle motion where thrusters could turn the vehicle over.
    """
    return np.asarray(3.0 * usual_amplitudes(vehicle))


def drawn_segment(
    vehicle: Vehicle,
    generator: np.random.Generator,
    *,
    duration: float,
    rows: tuple[int, ...] | None = None,
    form: Form = "telegraph",
    by_hand: bool = False,
    first: tuple[int, ...] = (),
) -> Segment:
    """Return a random segment on the axes that the vehicle can be driven along, or on those named.

    By hand: on one or two of them, one of `first` among these, with switches that a pilot can follow.
    """
    rows = available_rows(vehicle) if rows is None else rows
    if by_hand:
        many = int(generator.integers(1, min(_AT_ONCE, len(rows)) + 1))
        one = int(generator.choice([row for row in first if row in rows] or rows))
        others = generator.choice([row for row in rows if row != one] or [one], many - 1, replace=False)
        rows = tuple(sorted({one, *others.tolist()}))
    full = full_wrench(vehicle)
    share = 1.0 / np.sqrt(len(rows))  # thrusters are shared
    least = 0.2 if by_hand else 0.5
    amplitude = tuple(float(full[row] * generator.uniform(least, 1.0) * share) for row in rows)
    switches, signs = [], []
    for _ in rows:
        if form == "telegraph":
            switches.append(_turns(generator, duration, *(_BY_HAND if by_hand else (_QUICKEST, _SLOWEST))))
            signs.append((float(generator.choice((-1.0, 1.0))),))
        elif form == "multisine":
            switches.append(tuple(np.sort(generator.uniform(0.15, 1.2, 4)).tolist()))
            signs.append(tuple(generator.uniform(0.0, 2.0 * np.pi, 4).tolist()))
        else:
            switches.append((float(generator.uniform(0.1, 0.3)), float(generator.uniform(0.6, 1.5))))
            signs.append((float(generator.choice((-1.0, 1.0))),))
    return Segment(form, duration, rows, amplitude, tuple(switches), tuple(signs))


def _turns(generator: np.random.Generator, duration: float, quickest: float, slowest: float) -> tuple[float, ...]:
    slow = generator.uniform(quickest, slowest)
    turns, t = [], float(generator.uniform(0.5 * quickest, slow))
    while t < duration:
        turns.append(t)
        t += float(generator.uniform(quickest, 2.0 * slow - quickest))
    return tuple(turns) or (0.5 * duration,)


def changed(segment: Segment, generator: np.random.Generator, *, by_hand: bool = False) -> Segment:
    """Return a segment changed in one place: a switch moved, an axis stronger or weaker, begun the other way.

    By hand: a switch that would come too soon after another falls away.
    """
    k = int(generator.integers(len(segment.rows)))
    kind = generator.random()
    if kind < 0.6:
        numbers = np.array(segment.switches[k])
        j = int(generator.integers(numbers.size))
        if segment.form == "telegraph":
            numbers[j] = np.clip(numbers[j] + generator.normal(0.0, 0.4), 0.1, segment.duration - 0.1)
        else:
            numbers[j] *= np.exp(generator.normal(0.0, 0.15))
        own = tuple(np.sort(numbers).tolist())
        if by_hand and segment.form == "telegraph":
            own = _apart(own, segment.duration) or segment.switches[k]
        return replace(segment, switches=_with(segment.switches, k, own))
    if kind < 0.85:
        grown = float(segment.amplitude[k] * np.exp(generator.normal(0.0, 0.25)))
        return replace(segment, amplitude=_with(segment.amplitude, k, grown))
    return replace(segment, signs=_with(segment.signs, k, tuple(-each for each in segment.signs[k])))


def _apart(switches: tuple[float, ...], duration: float) -> tuple[float, ...]:
    """Return those of the switches [s] that a pilot can follow."""
    kept: list[float] = []
    for t in switches:
        if t - (kept[-1] if kept else -0.5 * _BY_HAND[0]) >= _BY_HAND[0] and duration - t >= 0.5 * _BY_HAND[0]:
            kept.append(t)
    return tuple(kept)


def _with(values: tuple[T, ...], k: int, value: T) -> tuple[T, ...]:
    return (*values[:k], value, *values[k + 1 :])


def commands_of(segment: Segment, vehicle: Vehicle) -> Array:
    """Return the commands (n, m) at `RATE`, within the thrusters' limits; forces below a dead band rest."""
    return allocate(vehicle, segment.wrench)
