"""What drives the vehicle, as the wrench at the start, the middle and the end of every piece of every step.

A held input with a delay switches inside the steps, and Runge-Kutta is of fourth order only where the wrench is smooth.
So each step is cut at the switching instant, and further into pieces no longer than a quarter of the shortest lag of
the thrusters (at most `MOST_PIECES` to a step): what Simpson's rule, which is Runge-Kutta's on a given wrench, then
loses of the impulse of a lag is below (1/4)^4 / 2880 = 1.4e-6. The lag is first order in the force of each thruster,
T f' = F(command) - f, exact over every piece: f(s) = F + (f0 - F) exp(-s / T). Before the first command arrives all
thrusters are off.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array, kernel
from towtank.errors import InputError

__all__ = ["MOST_PIECES", "Drive", "FunctionDrive", "HeldDrive", "Pieces", "cut_step"]

MOST_PIECES = 64
_LAG_SHARE = 0.25
_TOLERANCE = 1e-9  # of a step: a delay this close to a whole number of steps is one


@dataclass(frozen=True)
class Pieces:
    """How every step is cut.

    Attributes:
        lengths: (m,) [s], their sum is the step.
        late: (m,) how many steps earlier than the current one the command in force was given.
    """

    lengths: Array
    late: NDArray[np.intp]


def cut_step(dt: float, *, delay: float = 0.0, substeps: int = 1, lags: Array | None = None) -> Pieces:
    """Cut a step of dt [s] at the instant where a held input delayed by `delay` [s] switches, and to the lags [s]."""
    whole = math.floor(delay / dt + _TOLERANCE)
    split = delay - whole * dt
    parts = [(dt, whole)] if split <= _TOLERANCE * dt else [(split, whole + 1), (dt - split, whole)]
    longest = dt / substeps
    if lags is not None and (lags > 0.0).any():
        longest = min(longest, _LAG_SHARE * float(lags[lags > 0.0].min()))
    lengths: list[float] = []
    late: list[int] = []
    for length, steps in parts:
        count = min(max(math.ceil(length / longest * (1.0 - _TOLERANCE)), 1), max(MOST_PIECES, substeps))
        lengths += [length / count] * count
        late += [steps] * count
    return Pieces(np.array(lengths), np.array(late, dtype=np.intp))


class Stages(NamedTuple):
    """What acts at the start, the middle and the end of k pieces of steps.

    Attributes:
        wrench: (k, 3, 6) [N, N m]. forces: of the thrusters (k, 3, d) [N]; None where it is a wrench that was given.
    """

    wrench: Array
    forces: Array | None


class Drive(Protocol):
    """A source of wrenches, asked for consecutive runs of steps."""

    @property
    def pieces(self) -> Pieces:
        """How every step is cut."""

    def stages(self, first: int, last: int) -> Stages:
        """Return what acts in the (last - first) m pieces of the steps first .. last - 1."""


class HeldDrive:
    """A held input of d values per step (a wrench, or the forces of d thrusters), delayed and lagged."""

    def __init__(self, values: Array, pieces: Pieces, matrix: Array | None = None, lags: Array | None = None) -> None:
        """Take over the held `values` (n, d); where they are forces, the thrusters' `matrix` (6, d) and `lags` [s]."""
        self.pieces = pieces
        self._values, self._matrix = values, matrix
        self._lags = np.zeros(values.shape[1]) if lags is None else lags
        self._now = np.zeros(values.shape[1])

    def stages(self, first: int, last: int) -> Stages:
        """Return what acts; calls must follow one another."""
        given = (np.arange(first, last)[:, None] - self.pieces.late).ravel()
        targets = np.where(given[:, None] >= 0, self._values[np.maximum(given, 0)], 0.0)
        if self._lags.any():
            forces, self._now = _lagged(targets, self.pieces.lengths, self._lags, self._now)
        else:
            forces = np.repeat(targets[:, None, :], 3, axis=1)
        if self._matrix is None:
            return Stages(forces, None)
        return Stages(forces @ self._matrix.T, forces)


class FunctionDrive:
    """A continuous wrench, a function of time."""

    def __init__(self, function: Callable[[Array], Array], dt: float, pieces: Pieces) -> None:
        """Take over a function from times (...) [s] to wrenches (..., 6)."""
        self.pieces = pieces
        self._function, self._dt = function, dt
        starts = np.concatenate([[0.0], np.cumsum(pieces.lengths)[:-1]])
        self._nodes = starts[:, None] + pieces.lengths[:, None] * np.array([0.0, 0.5, 1.0])

    def stages(self, first: int, last: int) -> Stages:
        """Return what acts."""
        t = (np.arange(first, last)[:, None, None] * self._dt + self._nodes).reshape(-1, 3)
        wrench = np.asarray(self._function(t), dtype=np.float64)
        if wrench.shape != (*t.shape, 6):
            raise InputError(
                f"wrench: for times of shape {t.shape} the function gave shape {wrench.shape}, expected {(*t.shape, 6)}"
            )
        if not np.isfinite(wrench).all():
            raise InputError("wrench: the function gave a number that is not finite")
        return Stages(wrench, None)


@kernel
def _lagged(targets: Array, pieces: Array, lags: Array, start: Array) -> tuple[Array, Array]:
    """Return first-order responses (s, 3, d) to held targets (s, d) at start, middle, end of each piece, and the last.

    Args:
        pieces: lengths (m,) [s], repeated from piece to piece.
        lags: time constants (d,) [s]; 0 follows at once.
        start: value before the first piece (d,).
    """
    s, d, m = targets.shape[0], targets.shape[1], pieces.shape[0]
    out = np.empty((s, 3, d))
    now = start.copy()
    half = np.zeros((m, d))
    for k in range(m):
        for j in range(d):
            if lags[j] > 0.0:
                half[k, j] = math.exp(-0.5 * pieces[k] / lags[j])
    for i in range(s):
        for j in range(d):
            target, a = targets[i, j], half[i % m, j]
            away = now[j] - target
            out[i, 0, j] = target if lags[j] == 0.0 else now[j]
            out[i, 1, j] = target + away * a
            now[j] = target + away * a * a
            out[i, 2, j] = now[j]
    return out, now
