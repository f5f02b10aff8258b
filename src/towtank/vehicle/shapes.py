"""Shapes of arrays at the public edge: wrong ones are told in one line."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.errors import InputError

__all__ = ["broadcast_rows", "last_axis"]


def last_axis(values: ArrayLike, count: int, name: str, meaning: str) -> Array:
    """Return `values` as float64 (..., count). Raises InputError for another last axis or for what is not numbers."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: not an array of numbers; expected shape (..., {count}): {meaning}") from None
    if array.ndim == 0 or array.shape[-1] != count:
        raise InputError(f"{name}: found shape {array.shape}, expected (..., {count}): {meaning}")
    return array


def broadcast_rows(arrays: dict[str, Array]) -> tuple[tuple[int, ...], list[Array]]:
    """Return the common leading shape and the arrays as contiguous rows (n, k). Raises InputError where none fits."""
    try:
        shape = np.broadcast_shapes(*(array.shape[:-1] for array in arrays.values()))
    except ValueError:
        found = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
        raise InputError(f"leading shapes do not fit together: {found}") from None
    rows = [
        np.ascontiguousarray(np.broadcast_to(array, (*shape, array.shape[-1]))).reshape(-1, array.shape[-1])
        for array in arrays.values()
    ]
    return shape, rows
