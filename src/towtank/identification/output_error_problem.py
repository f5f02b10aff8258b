"""Several recordings and what is estimated from them: runs from a point, normal equations, where a step leads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.attitude import quaternion_product
from towtank.identification.held_input import new_held_input
from towtank.identification.output_error_jumps import jumps
from towtank.identification.output_error_kernel import free_run
from towtank.identification.output_error_rows import robust_cost
from towtank.identification.output_error_solution import Arrowhead, Step
from towtank.identification.output_error_space import (
    FreeRun,
    Indices,
    NormalEquations,
    Workspace,
    new_equations,
    new_workspace,
)
from towtank.identification.parameters import IN_LAG, PLAIN, FreeParameters, put_parameters
from towtank.identification.samples import N_MEASURED

__all__ = ["Point", "Problem", "residual_scale"]

_LOG_STEP = 1.0  # that the logarithm of a coefficient may go in one step
_LAG_STEP, _SHORTEST = -0.5, 0.002  # share that a lag may lose in one step; s, below which it no longer matters
_SEEN = 2000  # residuals that a scale is taken from
_MEDIAN = 0.6744897501960817  # of |x| for a standard normal x
_NOTHING = 1e-12  # information on an initial state, and size of a sensitivity, that is rounding


@dataclass(eq=False)
class Point:
    """The runs of all recordings from one set of coefficients and initial states."""

    theta: Array
    states: list[Array]
    sums: list[NormalEquations]


class Problem:
    """The recordings, and what is estimated from them.

    Attributes:
        estimated: which of the 12 initial errors are. moving: which of the 12 error states answer to anything.
        left_out: measured numbers that belong to jumps.
    """

    def __init__(
        self,
        runs: list[FreeRun],
        p: Array,
        free: FreeParameters,
        prior: tuple[Array, Array],
        delay: float,
    ) -> None:
        self.runs, self.p, self.free, self.prior, self.delay = runs, p, free, prior, delay
        self.lags: NDArray[np.bool_] = free.codes[:, 0] == IN_LAG
        self.logarithmic: NDArray[np.bool_] = free.codes[:, 3] != PLAIN
        self.left_out = 0
        self.estimated: Indices = np.arange(12)
        self.moving: Indices = np.arange(12)
        self.space: list[Workspace] = []
        self.spare: list[NormalEquations] = []
        self._allocate()

    def _allocate(self) -> None:
        n = len(self.free)
        columns = self.estimated.size + n
        self.space = [new_workspace(columns, n, run.shape.shape[1]) for run in self.runs]
        self.spare = self._new_sums()

    def _new_sums(self) -> list[NormalEquations]:
        columns = self.estimated.size + len(self.free)
        return [new_equations(run.first.size, int(run.block.max()) + 1, run.t.size, columns) for run in self.runs]

    def evaluate(self, theta: Array, states: list[Array], scale: Array, gated: bool) -> Point | None:
        """Return the runs from here; None where they are impossible or diverge."""
        sums = self.spare
        for run, start, out, space in zip(self.runs, states, sums, self.space, strict=True):
            held = new_held_input(run.lag.size, run.lag, self.delay)
            if not free_run(
                run, self.p, self.free.codes, theta, held, start, self.estimated, self.moving, scale, gated, out, space
            ):
                return None
            if not (np.isfinite(out.normal).all() and np.isfinite(out.scores).all()):
                return None
        self.spare = self._new_sums()
        return Point(theta, states, sums)

    def narrow(self, point: Point) -> None:
        """From here on estimate only the initial states that the data tell of, and move only what answers."""
        told = np.sum([np.einsum("scc->c", each.normal) for each in point.sums], axis=0)
        k = self.estimated.size
        keep = np.flatnonzero(told[:k] > _NOTHING)
        columns = np.concatenate([keep, k + np.arange(len(self.free))])
        reach = np.sum([each.reach for each in point.sums], axis=0)
        self.moving = np.flatnonzero((reach[:, columns] > _NOTHING).any(axis=1)).astype(np.int64)
        self.estimated = self.estimated[keep]
        old = point.sums
        self._allocate()
        point.sums, self.spare = self.spare, self._new_sums()
        c = columns.size
        for before, after in zip(old, point.sums, strict=True):
            after.normal[:, :c, :c] = before.normal[:, columns[:, None], columns]
            after.scores[:, :c] = before.scores[:, columns]
            after.residuals[:] = before.residuals

    def leave_out_jumps(self, point: Point, scale: Array) -> None:
        """From here on leave out the samples that are off together."""
        for i, (run, each) in enumerate(zip(self.runs, point.sums, strict=True)):
            off = jumps(each.residuals, scale)
            if off.any():
                each.residuals[off] = np.nan
                q = run.q.copy()
                q[off[:, 3:6].any(axis=1)] = np.nan
                self.left_out += int(off.sum())
                self.runs[i] = run._replace(values=np.where(off, np.nan, run.values), q=q)

    def arrowhead(self, point: Point) -> Arrowhead:
        """Return the normal equations at a point, the prior included."""
        k, n = self.estimated.size, len(self.free)
        normal = np.concatenate([each.normal for each in point.sums])
        gx = np.concatenate(
            [
                np.add.reduceat(each.scores[:, :k], run.block[run.first], axis=0)
                for run, each in zip(self.runs, point.sums, strict=True)
            ]
        )
        g = sum((each.scores[:, k : k + n].sum(axis=0) for each in point.sums), np.zeros(n))
        mean, information = self.prior
        return Arrowhead(
            X=normal[:, :k, :k],
            C=normal[:, :k, k : k + n],
            T=normal[:, k : k + n, k : k + n].sum(axis=0) + information,
            gx=gx,
            g=g + information @ (mean - point.theta),
            estimated=self.estimated,
        )

    def bounds(self, theta: Array, *, lag: bool = True) -> tuple[Array, Array]:
        """Return the least and the most (n,) that a step from theta may be; the lag only moves where `lag`."""
        most = np.where(self.logarithmic, _LOG_STEP, np.inf)
        least = -most
        with np.errstate(over="ignore"):
            shortest = np.maximum(_LAG_STEP, np.minimum(_SHORTEST * np.exp(-theta) - 1.0, 0.0))
        least[self.lags] = shortest[self.lags] if lag else 0.0
        most[self.lags] = _LOG_STEP if lag else 0.0
        return least, most

    def cost(self, point: Point, scale: Array, gated: bool) -> float:
        """Return the robust cost of a point, the prior included."""
        away = point.theta - self.prior[0]
        data = sum(robust_cost(each.residuals, scale, gated) for each in point.sums)
        return float(data + 0.5 * away @ self.prior[1] @ away)

    def moved(self, point: Point, step: Step) -> tuple[Array, list[Array]]:
        """Return coefficients and initial states after a step.

        The lag goes by a share of itself, not by a factor: what can be told best is its sum with the delay.
        """
        states = []
        begin = 0
        for start in point.states:
            states.append(_moved(start, step.states[begin : begin + len(start)]))
            begin += len(start)
        theta = np.where(self.lags, np.log1p(np.where(self.lags, step.theta, 0.0)), step.theta)
        return point.theta + theta, states

    def possible(self, theta: Array) -> bool:
        """Whether the mass matrix is positive definite."""
        return bool(put_parameters(self.p.copy(), self.free.codes, theta, np.empty((6, 6))))


def residual_scale(point: Point) -> Array:
    """Return the robust size of each column's residuals (15,), never below that of the noise."""
    residuals = np.concatenate([each.residuals for each in point.sums])
    out = np.ones(N_MEASURED)
    for j in range(N_MEASURED):
        x = residuals[:, j]
        x = x[:: max(1, x.size // _SEEN)]
        x = x[~np.isnan(x)]
        if x.size:
            out[j] = max(1.0, float(np.median(np.abs(x))) / _MEDIAN)
    return out


def _moved(states: Array, errors: Array) -> Array:
    """Return states (s, 13) moved by errors (s, 12)."""
    out = states.copy()
    out[:, :3] += errors[:, :3]
    out[:, 7:] += errors[:, 6:]
    for state, e in zip(out, errors[:, 3:6], strict=True):
        half = 0.5 * float(np.sqrt(e @ e))
        turn = np.concatenate([[np.cos(half)], 0.5 * np.sinc(half / np.pi) * e])
        state[3:7] = quaternion_product(np.ascontiguousarray(state[3:7]), turn)
    return out
