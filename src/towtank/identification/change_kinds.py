"""What can change about a vehicle, by how much at a time, and which coefficients that touches.

A payload or a fouled hull: inertia, drag, weight in water, righting moment, in any combination. A thruster that is
fouled, worn or dead: its gain, one thruster at a time.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.joint_start import size_of
from towtank.identification.parameters import (
    CONSTANT,
    GAIN_PREFIX,
    IN_GAIN,
    LINEAR,
    MASS,
    MOMENT,
    PLAIN,
    QUADRATIC,
    WEIGHT,
    FreeParameters,
)
from towtank.vehicle import Vehicle

__all__ = ["BODY_PARTS", "Hypothesis", "hypotheses", "steps_of"]

BODY_PARTS = ("inertia", "drag", "weight", "righting")  # what a payload changes

_PARTS = {MASS: "inertia", LINEAR: "drag", QUADRATIC: "drag", WEIGHT: "weight", CONSTANT: "weight", MOMENT: "righting"}
_STEP = {MASS: 0.10, LINEAR: 0.25, QUADRATIC: 0.25, IN_GAIN: 0.4}  # of a logarithm
_SHARE = {MASS: 0.3, LINEAR: 0.5, QUADRATIC: 0.5, WEIGHT: 0.2, MOMENT: 0.2, CONSTANT: 0.5}  # of the size of the rest


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One way in which a vehicle may have changed.

    Attributes:
        parts: of `BODY_PARTS`, or the name of one free gain, as gain_port.
        steps: deviations (n,) of the step of every coordinate, 0 for those that it leaves alone.
        weight: logarithm of its probability among all ways.
    """

    parts: tuple[str, ...]
    steps: Array
    weight: float

    @property
    def thruster(self) -> str | None:
        """Name of the thruster that it blames; None for a change of the body."""
        return self.parts[0].removeprefix(GAIN_PREFIX) if self.parts[0].startswith(GAIN_PREFIX) else None


def steps_of(vehicle: Vehicle, free: FreeParameters) -> Array:
    """Return the deviations (n,) of a change of each coordinate; 0 for what does not change: delay and lag."""
    size = size_of(vehicle, free)
    out = np.zeros(len(free))
    for k in range(len(free)):
        kind, transform = int(free.codes[k, 0]), free.codes[k, 3]
        if transform == PLAIN:
            out[k] = _SHARE.get(kind, 0.0) * size[k]
        else:
            out[k] = _STEP.get(kind, 0.0)
    return out


def hypotheses(free: FreeParameters, steps: Array) -> tuple[Hypothesis, ...]:
    """Return every way: each combination of the parts of the body that are free, and each gain that is."""
    part = [_PARTS.get(int(code[0]), "") for code in free.codes]
    there = [name for name in BODY_PARTS if name in part]
    body = [chosen for count in range(1, len(there) + 1) for chosen in itertools.combinations(there, count)]
    gains = [k for k in range(len(free)) if free.codes[k, 0] == IN_GAIN and steps[k] > 0.0]
    families = bool(body) + bool(gains)
    out = []
    for chosen in body:
        taken = np.array([name in chosen for name in part])
        out.append(Hypothesis(chosen, np.where(taken, steps, 0.0), -float(np.log(families * len(body)))))
    for k in gains:
        alone = np.zeros(len(free))
        alone[k] = steps[k]
        out.append(Hypothesis((free.names[k],), alone, -float(np.log(families * len(gains)))))
    return tuple(out)
