"""Keys of a terminal that are acted upon as they are pressed, and a key that must be held.

A terminal knows no key that is held, only one that repeats: the first press counts for nothing, each further one within
a quarter of a second is a sign that it is down. POSIX alone.
"""

from __future__ import annotations

import contextlib
import os
import select
import sys
import threading
import time
from collections.abc import Callable, Mapping
from typing import Self

__all__ = ["Keys", "can_read_keys"]

_TURN = 0.1  # s
_REPEATS = 0.25  # s between two signs of a key that is down


def can_read_keys() -> bool:
    """Whether standard input is a terminal whose keys can be read one by one."""
    return os.name == "posix" and sys.stdin is not None and sys.stdin.isatty()


class Keys:
    """Reads keys while it is entered.

    Args:
        pressed: what each key does. held: a key, and what a sign that it is down does.
        stream: descriptor of the terminal; None: standard input.
    """

    def __init__(
        self,
        pressed: Mapping[str, Callable[[], object]],
        held: tuple[str, Callable[[], object]],
        stream: int | None = None,
    ) -> None:
        self._pressed, self._held = pressed, held
        self._stream = sys.stdin.fileno() if stream is None else stream
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="keys", daemon=True)
        self._before: object = None

    def __enter__(self) -> Self:
        import termios
        import tty

        self._before = termios.tcgetattr(self._stream)
        tty.setcbreak(self._stream)
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        import termios

        self._stop.set()
        self._thread.join()
        with contextlib.suppress(termios.error):  # the terminal may be gone
            termios.tcsetattr(self._stream, termios.TCSADRAIN, self._before)  # type: ignore[arg-type]

    def _run(self) -> None:
        last = -1e9
        while not self._stop.is_set():
            if not select.select([self._stream], [], [], _TURN)[0]:
                continue
            try:
                data = os.read(self._stream, 64)
            except OSError:  # the terminal is gone, and the key with it
                return
            if not data:
                return
            for letter in data.decode("utf-8", errors="replace"):
                now = time.monotonic()
                if letter == self._held[0]:
                    if now - last <= _REPEATS:
                        self._held[1]()
                    last = now
                elif letter in self._pressed:
                    self._pressed[letter]()
