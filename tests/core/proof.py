"""How much to prove: sizes for compiled kernels and for the same kernels as plain Python, and inputs to try."""

from __future__ import annotations

from typing import TypeVar

import numba
import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

PLAIN = bool(numba.config.DISABLE_JIT)

_T = TypeVar("_T")


def sized(compiled: _T, plain: _T) -> _T:
    """The size of a proof: the first for compiled kernels, the second where they run as plain Python."""
    return plain if PLAIN else compiled


proof = settings(
    deadline=None,
    derandomize=True,
    database=None,
    max_examples=sized(100, 60),
    suppress_health_check=[HealthCheck.too_slow],
)


def numbers(limit: float) -> st.SearchStrategy[float]:
    return st.floats(-limit, limit, allow_subnormal=False)


def vectors(n: int, limit: float = 5.0) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float64, n, elements=numbers(limit))


def symmetric(n: int = 6, limit: float = 50.0) -> st.SearchStrategy[np.ndarray]:
    return hnp.arrays(np.float64, (n, n), elements=numbers(limit)).map(lambda A: (A + A.T) / 2)


eulers = st.tuples(numbers(np.pi), numbers(1.5), numbers(np.pi)).map(np.array)
seeds = st.integers(0, 2**32 - 1)
