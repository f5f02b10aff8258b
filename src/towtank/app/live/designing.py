"""Segments designed in a process of its own: it takes seconds, and learning must not wait for any of it.

The process ends with the session that began it, however that ends: its pipe is closed then.
"""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from towtank.errors import InputError
from towtank.planning import Outlook, forecast
from towtank.planning.coach import Next, next_segment
from towtank.vehicle import Vehicle

__all__ = ["Designer"]

_NICE = 5  # steps by which learning goes before designing


class Designer:
    """The process; `vehicle` is what its kernels are compiled for as it begins."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle, self._busy = vehicle, False
        self._begin()

    def _begin(self) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, self._vehicle), name="designer", daemon=True)
        self._process.start()
        theirs.close()

    @property
    def designs(self) -> bool:
        """Whether a segment is being designed."""
        return self._busy

    def ask(self, model: Vehicle, *given: Any, **settings: Any) -> None:
        """Have `next_segment` asked about a model; `answer` has what it says.

        Raises:
            InputError: the process has ended; the next call begins another.
        """
        with _ending():
            if not self._process.is_alive():
                self._begin()
            self._pipe.send((model, given, settings))
            self._busy = True

    def answer(self) -> Next | None:
        """Return what was found; None while it is being designed.

        Raises:
            InputError: the model cannot be planned for, or the process has ended.
        """
        try:
            with _ending():
                if not self._pipe.poll():
                    return None
                answer = self._pipe.recv()
        except InputError:
            self._busy = False
            raise
        self._busy = False
        if isinstance(answer, str):
            raise InputError(answer)
        found: Next = answer
        return found

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.terminate()
        self._process.join()


@contextlib.contextmanager
def _ending() -> Iterator[None]:
    try:
        yield
    except (EOFError, OSError) as error:
        raise InputError("the process that designs segments has ended") from error


def _work(pipe: Connection, vehicle: Vehicle) -> None:
    """Answer questions until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the session's
    with contextlib.suppress(AttributeError, OSError):  # not on every system
        os.nice(_NICE)
    with contextlib.suppress(InputError):  # said when it is asked for
        rest = np.array([[each.curve.rest for each in vehicle.thrusters]] * 10)
        forecast(Outlook.of(vehicle), vehicle, rest)
    with contextlib.suppress(EOFError, OSError):
        while True:
            model, given, settings = pipe.recv()
            try:
                pipe.send(next_segment(model, *given, **settings))
            except InputError as error:
                pipe.send(str(error))
