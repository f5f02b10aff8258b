"""Numba kernels on plain arrays: attitude, inertia, damping, restoring, dynamics, integration, regression.

Import from the module that holds the idea, e.g. `from towtank.core.rk4 import simulate_run`: a kernel
compiles on its first call, and this package pulls none of them in by itself. The layer knows no vehicle, no
file and no unit; it imports NumPy, Numba and the standard library only.
"""

from __future__ import annotations

__all__: list[str] = []
