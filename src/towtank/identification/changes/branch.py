"""Branches of the joint filter that runs on a stream: with more coordinates, wider ones, or informed after the event.

Also the rows and inputs of the last seconds, which branches go over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.zero_order_hold import ZeroOrderHold
from towtank.identification.changes.evidence import InformationIncrement, increment_between
from towtank.identification.data.samples import Buffer, NoiseLevels, Samples
from towtank.identification.kalman.filter import joint_events, rows_of, take_all
from towtank.identification.kalman.state import (
    FilterSettings,
    JointState,
    coefficient_block,
    coefficient_std,
    columns_of,
    places_of,
    transition_scratch,
)
from towtank.identification.kalman.update import inject
from towtank.identification.model.measurements import N_SENSORS
from towtank.identification.model.parameters import IN_LATENCY, N_FIXED, FreeParameters, told
from towtank.identification.model.prior import Prior

__all__: list[str] = []

_Record = TypeVar("_Record", JointState, ZeroOrderHold)
_MOVED = 0.5  # deviations of the prior, from the linearisation point
_FIXED_SHARE = 1e-4  # of the step that a coefficient might have made: its deviation where a hypothesis leaves it alone


class Kept(NamedTuple):
    """What was learned from rows that are gone, the prior of what follows.

    mean (n,), covariance (n, n), in the coordinates of a filter linearised about (n,), see `told` of
    `model.parameters`; disagreement, apart (n,): see `Running`.
    """

    names: tuple[str, ...]
    mean: Array
    covariance: Array
    about: Array
    disagreement: Array
    apart: Array


class Running(NamedTuple):
    """The filter that runs on a stream.

    Attributes:
        whole: what is supposed of every plausible coefficient. prior: of those that the filter learns.
        state, held: the filter and its inputs. disagreement: factor (n,) to the deviations, see `JointFit`.
        apart: d (n,) of a likelier picture of the data, see `kalman.rivals.apart_from`, with delay and lag themselves;
            0 for none.
        remarks: sentences about that, and about speeds that were smoothed.
        settings, levels: that it was begun with.
    """

    whole: Prior
    prior: Prior
    state: JointState
    held: ZeroOrderHold
    disagreement: Array
    apart: Array
    settings: FilterSettings
    levels: NoiseLevels
    remarks: tuple[str, ...] = ()

    @property
    def free(self) -> FreeParameters:
        """Its coordinates."""
        return self.prior.free

    @property
    def told(self) -> tuple[Array, Array]:
        """Mean (n,) and covariance (n, n) as wide as windows and pictures of the data disagree; delay and lag [s]."""
        theta, about = self.state.theta, self.state.linearised_at
        theta, _, covariance = told(self.free, about, theta, theta, self.undoubted)
        return theta, covariance + np.outer(self.apart, self.apart)

    @property
    def undoubted(self) -> Array:
        """Covariance (n, n) of its coordinates without what another picture of the data contradicts."""
        return np.asarray(coefficient_block(self.state) * np.outer(self.disagreement, self.disagreement))

    @property
    def std(self) -> Array:
        """Deviations (n,) of its coordinates, as wide as windows and pictures of the data disagree."""
        return np.hypot(coefficient_std(self.state) * self.disagreement, self.apart)

    @property
    def moved(self) -> NDArray[np.bool_]:
        """Which coefficients (n,) are known to be far from where the motion is linearised."""
        away = np.abs(self.state.theta - self.state.linearised_at)
        return np.asarray(away > np.maximum(_MOVED * self.prior.std, 2.0 * self.std))


@dataclass(eq=False)
class Branch:
    """A filter that runs beside the first one since it was split off, free to change at that moment.

    Attributes:
        t: when it was split off [s]. free: its coordinates, those of the first filter and more. steps: deviations (n,)
            by which they were widened. state, held: the filter and its inputs.
        theta0, P0: coordinates (n,) and covariance (n, n) before they were widened.
        parent, parent_held: copies of the filter that it was split off, as it was then.
        until: when it ends [s]. resets: times that its motion had begun anew by then.
        increment: what its samples said when that was last worked out. at_most: log Bayes factor of any change by it.
    """

    t: float
    free: FreeParameters
    steps: Array
    state: JointState
    held: ZeroOrderHold
    theta0: Array
    P0: Array
    parent: JointState
    parent_held: ZeroOrderHold
    until: float
    resets: float
    increment: InformationIncrement | None = None
    at_most: float = 0.0

    def take(self, rows: Samples) -> None:
        """Take rows and inputs that came since."""
        take_all(self.state, self.held, rows)

    @property
    def healthy(self) -> bool:
        """Whether it has tracked the motion without a break, its numbers finite and its variances positive."""
        return bool(
            self.state.clock[0].resets == self.resets
            and np.isfinite(self.state.theta).all()
            and np.isfinite(self.state.P).all()
            and (np.diag(self.state.P)[: N_FIXED + len(self.free)] >= 0.0).all()
        )

    def refresh(self) -> None:
        """Work out what the samples so far say."""
        if self.healthy:
            self.increment = self.increment_now()
            self.at_most = self.increment.most(self.steps)

    def increment_now(self) -> InformationIncrement:
        """Return what the samples since it was split off say by themselves."""
        return increment_between(self.theta0, self.P0, self.steps, self.state.theta, coefficient_block(self.state))


def split_off(
    t: float,
    state: JointState,
    held: ZeroOrderHold,
    free: FreeParameters,
    wide: FreeParameters,
    steps: Array,
    until: float,
) -> Branch:
    """Return a filter that goes on from here with the coordinates `wide`, `free` among them, widened by `steps` (n,).

    It stays linear about the linearisation point of `state`, so that a wide prior cannot lead it off.
    """
    n = len(wide)
    places = {name: k for k, name in enumerate(free.names)}
    split = with_coordinates(state, wide, [places.get(name, -1) for name in wide.names])
    block = slice(N_FIXED, N_FIXED + n)
    theta0, P0 = split.theta.copy(), split.P[block, block].copy()
    split.P[block, block] += np.diag(steps**2)
    split.settings["considered_share"] = 0.0
    split.information_time[:] = 0.0
    resets = float(state.clock[0].resets)
    return Branch(t, wide, steps, split, copied(held), theta0, P0, copied(state), copied(held), until, resets)


def split_later(branch: Branch, free: FreeParameters, rows: Samples, when: Sequence[float]) -> list[Branch]:
    """Return filters that were split off where `branch` was or later: at the times `when` [s], in order.

    Args:
        free: coordinates of the filter that it was split off. rows: what came since; the filters have taken it all.
    """
    state, held = copied(branch.parent), copied(branch.parent_held)
    out = []
    taken = done = 0
    for t in when:
        last = int(np.searchsorted(rows.t, t, side="right"))
        taken = joint_events(state, held, rows_of(rows), done, last, taken)
        done = max(done, last)
        row = float(rows.t[done - 1]) if done else branch.t  # what came after that is still to be taken
        later = split_off(row, state, held, free, branch.free, branch.steps, branch.until)
        later.take(rows.taken(slice(done, None), slice(taken, None)))
        if later.healthy:
            out.append(later)
    return out


def with_coordinates(state: JointState, free: FreeParameters, source: Sequence[int]) -> JointState:
    """Return a copy of the filter with other coordinates.

    Args:
        free: the coordinates (n,). source: index of each in `state`, -1 for one that is new: 0, and known exactly.
    """
    n, old = len(free), state.theta.size
    behind = state.P.shape[0] - N_FIXED - old
    rows = [*range(N_FIXED), *(N_FIXED + k if k >= 0 else -1 for k in source), *range(N_FIXED + old, state.P.shape[0])]
    into = [i for i, k in enumerate(rows) if k >= 0]
    out_of = [k for k in rows if k >= 0]
    size = N_FIXED + n + behind
    P = np.zeros((size, size))
    P[np.ix_(into, into)] = state.P[np.ix_(out_of, out_of)]
    kept = [(i, k) for i, k in enumerate(source) if k >= 0]
    vectors = {name: np.zeros(n) for name in ("theta", "linearised_at", "information_time", "information_rate")}
    vectors["learns"] = np.ones(n)
    for name, vector in vectors.items():
        for i, k in kept:
            vector[i] = getattr(state, name)[k]
    dx = np.zeros(size)
    dx[into] = state.dx[out_of]
    F, A, work, scratch = transition_scratch(n)
    fresh = {
        "P": P,
        "codes": np.ascontiguousarray(free.codes),
        "F": F,
        "A": A,
        "work": work,
        "scratch": scratch,
        "W": np.zeros((12, size)),
        "H": np.zeros((3, size)),
        "G": np.zeros((3, size)),
        "dx": dx,
        "active": np.ones(size),
        "latency": columns_of(free.codes, IN_LATENCY, N_SENSORS),
        "place": places_of(free.codes),
        **vectors,
    }
    return JointState(
        **{name: fresh[name] if name in fresh else np.array(value) for name, value in state._asdict().items()}
    )


def copied(record: _Record) -> _Record:
    """Return a copy that shares nothing."""
    return record._replace(**{name: np.array(value) for name, value in record._asdict().items()})


def definite(covariance: Array) -> Array:
    """Return a covariance (n, n) in which nothing is known exactly."""
    return covariance + np.diag(1e-12 + 1e-6 * np.diag(covariance))


def inform(state: JointState, rows: Array, covariance: Array, residual: Array) -> None:
    """Update by rows (m, n) of the filter's coordinates, measured with a covariance (m, m) and residuals (m,)."""
    n = state.theta.size
    spread = state.P[:, N_FIXED : N_FIXED + n] @ rows.T
    S = rows @ spread[N_FIXED : N_FIXED + n] + covariance
    gain = np.linalg.solve(0.5 * (S + S.T), spread.T).T
    state.dx[:] += gain @ residual
    P = state.P - gain @ spread.T
    state.P[:] = 0.5 * (P + P.T)
    inject(state)


def fused(mean: Array, covariance: Array, other: Array, spread: Array) -> tuple[Array, Array]:
    """Return mean (n,) and covariance (n, n) after a measurement of all by `other` (n,) with covariance (n, n)."""
    S = covariance + spread
    gain = np.linalg.solve(0.5 * (S + S.T), covariance).T
    left = covariance - gain @ covariance
    return mean + gain @ (other - mean), 0.5 * (left + left.T)


def without_change_of(branch: Branch, steps: Array) -> JointState:
    """Return the branch's filter as it would be, had it been widened by `steps` (n,) only: fewer of its own."""
    state = copied(branch.state)
    left = np.flatnonzero(steps < branch.steps)
    if left.size == 0:
        return state
    root = np.zeros((len(branch.free), left.size))
    root[left, np.arange(left.size)] = np.sqrt(branch.steps[left] ** 2 - steps[left] ** 2)
    narrow = branch.P0 + np.diag(
        np.maximum(steps, np.where(branch.steps > 0.0, _FIXED_SHARE * branch.steps, 1e-9)) ** 2
    )
    rows = np.asarray(np.linalg.solve(0.5 * (narrow + narrow.T), root).T, dtype=np.float64)
    covariance = np.eye(left.size)
    covariance += rows @ root
    inform(state, rows, covariance, rows @ (branch.theta0 - state.theta))
    return state


class Recent:
    """Pieces of a stream.

    Args:
        seconds: that are kept.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._pieces: list[Samples] = []

    def add(self, buffer: Buffer) -> Samples:
        """Take what is in a buffer, empty it, and forget what is too old; return what was taken."""
        rows = buffer.whole
        piece = replace(
            rows,
            t=rows.t.copy(),
            values=rows.values.copy(),
            input_t=rows.input_t.copy(),
            input_force=rows.input_force.copy(),
        )
        buffer.clear()
        if len(piece) or piece.input_t.size:
            self._pieces.append(piece)
            newest = piece.t[-1] if len(piece) else piece.input_t[-1]
            while len(self._pieces[0]) and self._pieces[0].t[-1] < newest - self._seconds:
                self._pieces.pop(0)
        return piece

    def since(self, t: float) -> Samples:
        """Return what came after t [s], in one; t is the time of a row."""
        pieces = [each for each in self._pieces if not len(each) or each.t[-1] > t]
        whole = replace(
            pieces[0],
            t=np.concatenate([each.t for each in pieces]),
            values=np.concatenate([each.values for each in pieces]),
            input_t=np.concatenate([each.input_t for each in pieces]),
            input_force=np.concatenate([each.input_force for each in pieces]),
        )
        first = int(np.searchsorted(whole.t, t, side="right"))
        return whole.taken(slice(first, None), slice(int(np.searchsorted(whole.input_t, t, side="right")), None))

    def clear(self) -> None:
        """Forget everything."""
        self._pieces.clear()
