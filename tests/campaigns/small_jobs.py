"""Jobs that processes perform in tests of processes; they import nothing, so that each process begins at once."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

__all__ = ["doubled", "environment", "unlucky"]


def doubled(number: int) -> int:
    """Return twice a number, from a process that dies over 13 and raises over 14."""
    if number == 13:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 14:
        raise KeyError("fourteen")
    return 2 * number


def environment(name: str) -> str | None:
    """Return a variable of the process."""
    return os.environ.get(name)


def unlucky(number: int, mark: str) -> int:
    """Return a number, from a process that dies the first time that it is asked."""
    path = Path(mark)
    if not path.exists():
        path.touch()
        time.sleep(0.1)
        os.abort()
    return number
