"""What the thrusters did over an interval: held commands, delayed, through each thruster's first-order lag, exactly.

A digital command acts from its time stamp (plus the delay) until the next one. Over any interval the force of a lagged
thruster is then a sum of exponentials, integrated here in closed form:

    int_0^h f dt = F h + (f0 - F) T (1 - exp(-h/T)),   f(h) = F + (f0 - F) exp(-h/T)

The mean force over an interval of length h answers to the delay by -(f1 - f0)/h, and, since T f' = F - f, to the time
constant by -(f1 - f0 + T (s1 - s0))/h, where s = df/dT.

The ring of past commands is bounded; memory does not grow with the log.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array, kernel

__all__ = [
    "ZeroOrderHold",
    "force_integral_into",
    "forces_now_into",
    "hold_force",
    "mean_forces_into",
    "new_zero_order_hold",
    "restored_hold",
]

_RING = 1024  # commands
_COUNTERS = np.dtype((np.record, [("received", np.float64), ("in_force", np.float64)]))


class ZeroOrderHold(NamedTuple):
    """Ring of held values and the lag's state; arrays are changed in place."""

    times: Array  # (ring,) time stamp of each command, the delay added
    values: Array  # (ring, m) steady force that each command asks for
    counters: NDArray[Any]  # (1,) record: commands received, index of the command in force
    force: Array  # (m,) force now
    slope: Array  # (m,) d force now / d time constant [N/s]
    lag: Array  # (m,) time constants [s]
    clock: Array  # (1,) time up to which `force` has been advanced; NaN before the start
    delay: Array  # (1,) command delay [s]


def new_zero_order_hold(m: int, lag: Array, delay: float) -> ZeroOrderHold:
    """Return an empty input of m forces with time constants `lag` (m,) [s] behind a delay [s]."""
    return ZeroOrderHold(
        times=np.full(_RING, np.nan),
        values=np.zeros((_RING, m)),
        counters=np.zeros(1, dtype=_COUNTERS),
        force=np.zeros(m),
        slope=np.zeros(m),
        lag=np.ascontiguousarray(lag, dtype=np.float64),
        clock=np.full(1, np.nan),
        delay=np.array([float(delay)]),
    )


def restored_hold(arrays: Mapping[str, Any], prefix: str) -> ZeroOrderHold:
    """Return an input from its arrays, kept by name behind a prefix."""
    kept = {name: arrays[prefix + name] for name in ZeroOrderHold._fields}
    return ZeroOrderHold(**{**kept, "counters": kept["counters"].view(_COUNTERS)})


@kernel
def hold_force(held: ZeroOrderHold, t: float, value: Array) -> None:
    """Add the steady force `value` (m,) asked for at time t [s]; not finite or out of order is passed over."""
    ring = held.times.shape[0]
    counters = held.counters[0]
    received = int(counters.received)
    due = t + held.delay[0]
    if not math.isfinite(due):
        return
    for j in range(value.shape[0]):
        if not math.isfinite(value[j]):
            return
    if received > 0 and not due >= held.times[(received - 1) % ring]:
        return
    held.times[received % ring] = due
    for j in range(value.shape[0]):
        held.values[received % ring, j] = value[j]
    if received == 0:
        for j in range(value.shape[0]):
            held.force[j] = value[j]
    counters.received = received + 1.0
    if received + 1 - int(counters.in_force) > ring:
        counters.in_force = received + 1.0 - ring


@kernel
def force_integral_into(held: ZeroOrderHold, end: float, out: Array) -> bool:
    """Write int force dt (m,) from the clock to `end` into `out` and advance the clock; it never goes back.

    Before the first command the first command is taken as held. Where the clock has not been started, thrusters have
    answered since then, and the integral is 0. Returns whether any command has come yet.
    """
    m = held.force.shape[0]
    ring = held.times.shape[0]
    for j in range(m):
        out[j] = 0.0
    received = int(held.counters[0].received)
    now = held.clock[0]
    if end <= now:
        return received > 0
    held.clock[0] = end
    if received == 0:
        return False
    active = int(held.counters[0].in_force)
    started = math.isfinite(now)
    if not started:
        now = min(held.times[active % ring], end)
    while now < end:
        until = end
        if active + 1 < received:
            change = held.times[(active + 1) % ring]
            if change <= now:
                active += 1
                continue
            until = min(until, change)
        h = until - now
        for j in range(m):
            target = held.values[active % ring, j]
            T = held.lag[j]
            if T > 0.0:
                gone = -math.expm1(-h / T)
                away = held.force[j] - target
                out[j] += target * h + away * T * gone
                held.slope[j] = (held.slope[j] + away * h / (T * T)) * (1.0 - gone)
                held.force[j] -= away * gone
            else:
                out[j] += target * h
                held.force[j] = target
        now = until
    held.counters[0].in_force = float(active)
    if not started:
        for j in range(m):
            out[j] = 0.0
    return True


@kernel
def mean_forces_into(held: ZeroOrderHold, end: float, out: Array) -> bool:
    """Write over the time from the clock to `end`: mean force, d mean / d delay, d mean / d ln T, into `out` (3, m).

    The clock advances, as with `force_integral_into`; returns whether any command has come yet.
    """
    m = held.force.shape[0]
    h = end - held.clock[0]
    for j in range(m):
        out[1, j] = held.force[j]
        out[2, j] = held.slope[j]
    known = force_integral_into(held, end, out[0])
    if not h > 0.0:  # the clock had not been started
        for j in range(m):
            out[0, j] = held.force[j]
            out[1, j] = 0.0
            out[2, j] = 0.0
        return known
    for j in range(m):
        out[0, j] /= h
        rise = held.force[j] - out[1, j]
        T = held.lag[j]
        out[1, j] = -rise / h
        out[2, j] = -T * (rise + T * (held.slope[j] - out[2, j])) / h
    return known


@kernel
def forces_now_into(held: ZeroOrderHold, out: Array) -> None:
    """Write force now and d force / d ln T over what `mean_forces_into` has written into `out` (3, m).

    The row between them is that of the force now as it stands: by the delay it answers with its change over the step.
    """
    for j in range(held.force.shape[0]):
        out[0, j] = held.force[j]
        out[2, j] = held.lag[j] * held.slope[j]
