"""Filtered regressors, exact in discrete time.

For x_dot = Phi theta the paper filters both sides with 1/(s + a), its (41)-(46). Over one sample interval

    x[k+1] - x[k] = sum_j theta_j int phi_j dt

is exact; passing both sides through the SAME recursion f[k+1] = exp(-a h) f[k] + increment[k] keeps it exact for every
a, every input and any start. The one error left is the quadrature of phi_j over one interval:

    held       a command between two digital updates: h phi
    hermite    a smooth function with one-sided slopes known: h (f0 + f1) / 2 + h^2 (f0' - f1') / 12, error O(h^5)
    cubic      a smooth function from four samples at equal spacing, causal: error O(h^5)
"""

from __future__ import annotations

import math

from towtank.core.arrays import Array, inlined_kernel, kernel

__all__ = ["accumulate_into", "cubic_increment", "filter_increments", "hermite_increment"]


@inlined_kernel
def hermite_increment(f0: float, f1: float, slope0: float, slope1: float, h: float) -> float:
    """Integral over [0, h] of the cubic with values f0, f1 and one-sided slopes slope0, slope1 at its ends."""
    return 0.5 * h * (f0 + f1) + h * h / 12.0 * (slope0 - slope1)


@inlined_kernel
def cubic_increment(f_2: float, f_1: float, f0: float, f1: float, h: float) -> float:
    """Integral over [0, h] of the cubic through samples at -2h, -h, 0, h (Adams-Moulton, fourth order)."""
    return h * (9.0 * f1 + 19.0 * f0 - 5.0 * f_1 + f_2) / 24.0


@inlined_kernel
def accumulate_into(filtered: Array, increment: Array, decay: float, n: int) -> None:
    """filtered = decay filtered + increment for the first `n` places; decay = exp(-a h)."""
    for i in range(n):
        filtered[i] = decay * filtered[i] + increment[i]


@kernel
def filter_increments(increments: Array, dt: Array, a: float) -> Array:
    """Filter increments (n, m) over intervals dt (n,) [s] with the constant a [1/s]; returns (n, m)."""
    out = increments.copy()
    for k in range(1, increments.shape[0]):
        decay = math.exp(-a * dt[k])
        for j in range(increments.shape[1]):
            out[k, j] += decay * out[k - 1, j]
    return out
