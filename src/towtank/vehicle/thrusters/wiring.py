"""Thrusters that push the other way than a file says, and outputs that are exchanged: in words, and in the file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from towtank.core.arrays import Array
from towtank.digits import joined
from towtank.vehicle.vehicle import Vehicle

__all__ = ["Wiring", "rewired"]


@dataclass(frozen=True)
class Wiring:
    """How recordings have the thrusters, against the vehicle's file.

    Attributes:
        turned: thrusters (0 ..) that push the other way. swapped: two whose outputs are exchanged, or none.
    """

    turned: tuple[int, ...] = ()
    swapped: tuple[int, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.turned or self.swapped)

    def said(self, vehicle: Vehicle) -> str:
        """It in plain words, for the vehicle as its file has it."""
        words = []
        if self.swapped:
            words.append(f"the outputs of thrusters {_named(self.swapped, vehicle)} are swapped")
        if self.turned:
            many = "thrusters" if len(self.turned) > 1 else "thruster"
            push = "push" if len(self.turned) > 1 else "pushes"
            words.append(f"{many} {_named(self.turned, vehicle)} {push} the other way than the file says")
        return ", and ".join(words)

    def matrix(self, B: Array) -> Array:
        """Return the wrench (6, n) [N, N m per N], body FRD, of each output as wired; B: as the file has it."""
        out = B.copy()
        if self.swapped:
            a, b = self.swapped
            out[:, [a, b]] = out[:, [b, a]]
        out[:, list(self.turned)] *= -1.0
        return out


def _named(which: Sequence[int], vehicle: Vehicle) -> str:
    return joined([f"{k + 1} ({vehicle.thrusters[k].name})" for k in which])


def rewired(vehicle: Vehicle, wiring: Wiring) -> Vehicle:
    """Return the vehicle with these outputs swapped and then these outputs' thrusters turned round; none is moved.

    A swapped pair changes places in the file: the first output then drives the second thruster.
    """
    thrusters = list(vehicle.thrusters)
    if wiring.swapped:
        a, b = wiring.swapped
        thrusters[a], thrusters[b] = (
            thrusters[b].model_copy(update={"name": thrusters[a].name}),
            thrusters[a].model_copy(update={"name": thrusters[b].name}),
        )
    for k in wiring.turned:
        turned = tuple(-x + 0.0 for x in thrusters[k].direction)
        thrusters[k] = thrusters[k].model_copy(update={"direction": turned})
    return vehicle.model_copy(update={"thrusters": tuple(thrusters)})
