"""Memory of a process that takes and frees large arrays: what is free goes back to the system."""

from __future__ import annotations

import ctypes
import sys

__all__ = ["return_what_is_free"]

_MMAP_THRESHOLD = -3  # M_MMAP_THRESHOLD of mallopt(3)
_LARGE = 1 << 20  # bytes


def return_what_is_free() -> None:
    """Keep arrays of a megabyte and more in mappings of their own, which end when they do.

    The C library of Linux raises that limit to 32 MB as such arrays are freed, and then keeps what is free between
    others for itself: of an hour at 100 Hz some 30 MB. Elsewhere, and with other libraries, nothing happens.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_MMAP_THRESHOLD, _LARGE)
