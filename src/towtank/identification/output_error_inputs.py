"""The inputs of a free run: held commands of a recording given in time, and the wrench that comes of them."""

from __future__ import annotations

import math

from towtank.core.arrays import Array, kernel
from towtank.identification.held_input import HeldInput, held_means_into, held_push

__all__ = ["due", "force_now", "forward_to", "next_change", "wrench_into"]


@kernel
def due(input_t: Array, input_force: Array, held: HeldInput, given: int, end: float) -> int:
    """Push the inputs that act before `end`; return how many have been given by now."""
    early = min(held.delay[0], 0.0)
    while given < input_t.shape[0] and input_t[given] + early <= end:
        held_push(held, input_t[given], input_force[given])
        given += 1
    return given


@kernel
def forward_to(input_t: Array, input_force: Array, held: HeldInput, given: int, end: float, pushed: Array) -> int:
    """Take the inputs forward to `end`, one at a time so that their ring never overflows."""
    early = min(held.delay[0], 0.0)
    while given < input_t.shape[0] and input_t[given] + early <= end:
        held_push(held, input_t[given], input_force[given])
        held_means_into(held, min(input_t[given] + held.delay[0], end), pushed)
        given += 1
    held_means_into(held, end, pushed)
    pushed[1:] = 0.0
    return given


@kernel
def next_change(input_t: Array, held: HeldInput, given: int) -> float:
    """Return when the next input begins to act [s]; infinite after the last."""
    ring, following = held.times.shape[0], int(held.counters[1]) + 1
    if following < int(held.counters[0]):
        return float(held.times[following % ring])
    return float(input_t[given] + held.delay[0]) if given < input_t.shape[0] else math.inf


@kernel
def wrench_into(shape: Array, pushed: Array, gain: Array, wrench: Array) -> bool:
    """Write the wrench of the pushed inputs three times into `wrench` (3, 6); whether it is the one that was there.

    Their derivatives, in the other rows of `pushed`, are made those of the thrusts; a gain's own is by the input.
    """
    for i in range(6):
        wrench[0, i] = 0.0
    for a in range(gain.shape[0]):
        pushed[1, a] *= gain[a]
        pushed[2, a] *= gain[a]
        force = gain[a] * pushed[0, a]
        if force != 0.0:
            for i in range(6):
                wrench[0, i] += shape[i, a] * force
    same = True
    for i in range(6):
        same = same and wrench[0, i] == wrench[1, i]
        wrench[1, i] = wrench[0, i]
        wrench[2, i] = wrench[0, i]
    return same


@kernel
def force_now(held: HeldInput, t: float, pushed: Array) -> None:
    """Write the force just after t: a thruster without lag has answered already; derivatives are not needed twice."""
    ring = held.times.shape[0]
    active, given = int(held.counters[1]), int(held.counters[0])
    while active + 1 < given and held.times[(active + 1) % ring] <= t:
        active += 1
    for a in range(held.force.shape[0]):
        if held.lag[a] > 0.0:
            target = held.values[active % ring, a]
            pushed[0, a] = held.force[a]
            pushed[1, a] = (held.force[a] - target) / held.lag[a]
            pushed[2, a] = held.lag[a] * held.slope[a]
        else:
            pushed[0, a] = held.values[active % ring, a]
            pushed[1, a] = 0.0
            pushed[2, a] = 0.0
