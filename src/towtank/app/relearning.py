"""The learning that cross-validation repeats."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from towtank.errors import InputError, nearest

if TYPE_CHECKING:
    from towtank.identification import LogLearning
    from towtank.recording import Recording
    from towtank.validation.cross_validation import Learn
    from towtank.vehicle import Vehicle

__all__ = ["learn_by"]

_METHODS = ("joint", "output-error", "paper")


def learn_by(method: str | None, delay: float | None) -> Learn:
    """Return what learns by a method, `learn`'s own where omitted. Raises InputError for an unknown one."""
    if method is not None and method not in _METHODS:
        expected = ", ".join(f'"{name}"' for name in _METHODS)
        raise InputError(f'--method: found "{method}", expected one of {expected}{nearest(method, _METHODS)}')

    def learn(vehicle: Vehicle, recordings: Sequence[Recording]) -> LogLearning:
        from towtank.identification import learn_recordings

        if method is None:
            return learn_recordings(vehicle, recordings, delay=delay)
        return learn_recordings(vehicle, recordings, method=method, delay=delay)

    return learn
