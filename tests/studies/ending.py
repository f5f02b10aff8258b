"""Work for processes of their own that ends them; it needs nothing that takes long to import."""

from __future__ import annotations

import math
import os


def root_or_end(value: float) -> float:
    """Return the square root; of 4, end the process."""
    if value == 4.0:
        os.abort()
    return math.sqrt(value)
