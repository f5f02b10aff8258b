"""Array types and the compiler switch shared by all kernels."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

from towtank.core.fingerprint import bind_cache

__all__ = ["Array", "inlined_kernel", "kernel", "parallel_kernel"]

Array = NDArray[np.float64]
_F = TypeVar("_F", bound=Callable[..., Any])

# Contraction lets the compiler fuse multiply and add. Reassociation is left out: it would cancel the x - x of isfinite.
_FAST = {"contract", "nsz"}


def kernel(function: _F) -> _F:
    """Compile `function` on first use and keep the machine code on disk; other threads run beside it."""
    compiled: _F = numba.njit(cache=True, error_model="numpy", fastmath=_FAST, nogil=True)(function)
    bind_cache(compiled)
    return compiled


def parallel_kernel(function: _F) -> _F:
    """As `kernel`, with `numba.prange` loops spread over all processor cores."""
    compiled: _F = numba.njit(cache=True, error_model="numpy", fastmath=_FAST, parallel=True)(function)
    bind_cache(compiled)
    return compiled


def inlined_kernel(function: _F) -> _F:
    """As `kernel`, always inlined: array shapes that are constant in the caller become constants here."""
    compiled: _F = numba.njit(cache=True, error_model="numpy", fastmath=_FAST, forceinline=True, nogil=True)(function)
    bind_cache(compiled)
    return compiled
