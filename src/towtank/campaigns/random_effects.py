"""Random effects: a mean, members that differ from it, and runs of a member that differ from the member.

    run r of member v       l_r(x_r) = e_r^T x_r - 1/2 x_r^T L_r x_r, what its data say of p coefficients
    run within its member   x_r = x_v + w_r,  w_r ~ N(0, diag(within))
    member                  x_v = mu + b_v,   b_v ~ N(0, diag(between))

The information L_r (p, p) may be singular: a run says nothing of some directions, and nothing here inverts it. A random
effect of covariance D that stands between the data and what they are asked for leaves of them

    L' = L (I + D L)^-1,   e' = (I + L D)^-1 e

which is (L^-1 + D)^-1 where L has an inverse. Applied to the runs with D = diag(within), summed over the runs of each
member, and applied once more with diag(between), this is the likelihood of mu. It is reckoned as equations |F x - s|^2,
L = F^T F, summed by QR: information differs by ten orders between directions, likelihoods compared by one unit.

Variances maximise the restricted likelihood, with mu integrated out (Patterson and Thompson, Biometrika 58, 1971), by
Fisher scoring within variance >= 0. A flat mu makes it that of contrasts alone; where runs say next to nothing of many
directions, a flat mu would explain what members differ by with a mean far from all that is plausible, so that it has
its prior. With P of that likelihood and Z what a random effect acts on, u = Z^T P y is what the data pull at the effect
and Q = Z^T P Z its covariance: the score of a variance is half the sum of u^2 - Q over its effects, and u / sqrt(Q)
tells how many deviations an effect is out of line.

Intervals are those of Student's t, with the degrees of freedom of Satterthwaite (Biometrics Bulletin 2, 1946): the
variance v of a combination is a function of the variances estimated; g its gradient and A their covariance, v is known
as well as a chi-square of 2 v^2 / (g^T A g) degrees. In a balanced design it is members less one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array

__all__ = ["Evidence", "Solution", "Variances", "restricted_maximum", "solved"]

_FLAT = 1e-6  # information of the mean while variances are asked for, where coordinates are in units of what is known
_ROUNDS, _HALVINGS = 200, 20
_NOTHING = 1e-13  # of a run's largest information
_STILL = 1e-6  # gain of the log likelihood that is none
_LEAST_DEGREES, _MANY_DEGREES = 1.0, 1e6


@dataclass(frozen=True, eq=False)
class Evidence:
    """What n runs of m members say of p coefficients.

    Attributes:
        information: (n, p, p) of each run, positive semidefinite. score: (n, p) information times what it says.
        member: (n,) of each run, 0 .. m - 1.
    """

    information: Array
    score: Array
    member: NDArray[np.int64]

    @property
    def members(self) -> int:
        """Their number m."""
        return int(self.member.max()) + 1

    @cached_property
    def equations(self) -> Array:
        """[F, s] (n, p, p + 1) of each run, F^T F its information, F^T s its score: what it says is |F x - s|^2."""
        size, axes = np.linalg.eigh(0.5 * (self.information + self.information.transpose(0, 2, 1)))
        told = size > _NOTHING * np.maximum(size[:, -1:], 1.0)
        root = np.sqrt(np.where(told, size, 1.0))
        F = np.where(told, root, 0.0)[:, :, None] * axes.transpose(0, 2, 1)
        s = np.where(told, np.einsum("nji,nj->ni", axes, self.score) / root, 0.0)
        return np.concatenate([F, s[:, :, None]], axis=2)

    def without(self, runs: NDArray[np.bool_]) -> Evidence:
        """Return it with these runs (n,) saying nothing."""
        kept = ~runs
        return replace(self, information=self.information * kept[:, None, None], score=self.score * kept[:, None])


@dataclass(frozen=True, eq=False)
class Variances:
    """Of the effects of members and of runs, (p,) each.

    Attributes:
        estimated: (k, 2 p) which of them, between first, one of k parameters makes, and in what proportion; k = 0 where
            all are taken as known.
    """

    between: Array
    within: Array
    estimated: Array | None = None


@dataclass(frozen=True, eq=False)
class Solution:
    """The mean and the effects at given variances.

    Attributes:
        mean, covariance: of mu, (p,) and (p, p). likelihood: log of the restricted one, but for a constant.
        run_information: L' of each run (n, p, p); member_information: of each member (m, p, p).
        member_mean, member_covariance: of x_v, (m, p) and (m, p, p), the uncertainty of mu in it.
        pull, pull_covariance: u (m, p) and Q (m, p, p) of the members' effects; run_pull, run_pull_covariance: (n, p)
            and (n, p, p) of the runs'.
    """

    evidence: Evidence
    variances: Variances
    mean: Array
    covariance: Array
    likelihood: float
    run_information: Array
    member_information: Array
    member_mean: Array
    member_covariance: Array
    pull: Array
    pull_covariance: Array
    run_pull: Array
    run_pull_covariance: Array

    @property
    def gradient(self) -> tuple[Array, Array]:
        """Derivatives (p,) of the likelihood by the variances between and within."""
        return (
            0.5 * np.sum(self.pull**2 - _diagonals(self.pull_covariance), axis=0),
            0.5 * np.sum(self.run_pull**2 - _diagonals(self.run_pull_covariance), axis=0),
        )

    @cached_property
    def information(self) -> Array:
        """Fisher's (2 p, 2 p) of the variances, between first: 1/2 tr(P Z_i Z_i^T P Z_j Z_j^T).

        Within, pairs of runs of different members are left out, which have the mean alone in common.
        """
        p, member = self.mean.size, self.evidence.member
        between = _squares(self.member_information, self.covariance)
        within = np.zeros((p, p))
        for v in range(self.evidence.members):
            within += _squares(self.run_information[member == v], self.member_covariance[v])
        both = np.zeros((p, p))
        whole = _sums(self.run_information, member)
        for v in range(self.evidence.members):
            left = np.eye(p) - whole[v] @ self.member_covariance[v]
            both += np.sum((left @ self.run_information[member == v]) ** 2, axis=0)
        return 0.5 * np.block([[between, both], [both.T, within]])

    def deviations(self, rows: Array, effects: Array | None = None) -> tuple[Array, Array]:
        """Return variance (k,) and degrees of freedom (k,) of combinations of mu, and of new effects upon them.

        Args:
            rows: (k, p). effects: (2, p) 1 where a new member's and a new run's effect counts, too; default: none.
        """
        added = np.zeros((2, rows.shape[1])) if effects is None else effects
        spread = added[0] * self.variances.between + added[1] * self.variances.within
        variance = np.einsum("ki,ij,kj->k", rows, self.covariance, rows) + rows**2 @ spread
        seen = rows @ self.covariance
        by_member = np.sum((seen @ self.member_information) ** 2, axis=0)
        left = np.eye(self.mean.size) - self.variances.between[:, None] * self.member_information
        by_run = np.sum((seen @ (left.transpose(0, 2, 1)[self.evidence.member] @ self.run_information)) ** 2, axis=0)
        slope = np.hstack([by_member + rows**2 * added[0], by_run + rows**2 * added[1]])
        uncertain = np.einsum("ki,ij,kj->k", slope, self.uncertainty, slope)
        degrees = 2.0 * variance**2 / np.maximum(uncertain, 2.0 * variance**2 / _MANY_DEGREES)
        return variance, np.maximum(degrees, _LEAST_DEGREES)

    @cached_property
    def uncertainty(self) -> Array:
        """Covariance (2 p, 2 p) of the variances; none is supposed to lie above 1, that of the coefficient itself."""
        if self.variances.estimated is None:
            return np.zeros((2 * self.mean.size, 2 * self.mean.size))
        made = self.variances.estimated
        return np.asarray(made.T @ np.linalg.inv(made @ self.information @ made.T + np.eye(len(made))) @ made)


def solved(evidence: Evidence, variances: Variances, prior: Array | None = None) -> Solution:
    """Return mean and effects at these variances.

    Args:
        prior: information (p, p) of mu, whose mean is then 0; default: next to none.
    """
    p, member, between = evidence.score.shape[1], evidence.member, variances.between
    runs, run_size = _left(evidence.equations, variances.within)
    whole, run_misfit = _together([runs[member == v].reshape(-1, p + 1) for v in range(evidence.members)])
    members, member_size = _left(whole, between)
    before = math.sqrt(_FLAT) * np.eye(p) if prior is None else np.linalg.cholesky(prior).T
    last, member_misfit = _together([np.vstack([members.reshape(-1, p + 1), np.hstack([before, np.zeros((p, 1))])])])
    root = np.linalg.inv(last[0, :, :p])
    mean, covariance = root @ last[0, :, p], root @ root.T
    size = run_size + member_size - 2.0 * float(np.log(np.abs(np.diag(root))).sum())
    by_run, by_member = (each[:, :, :p].transpose(0, 2, 1) @ each[:, :, :p] for each in (runs, members))
    left = np.eye(p) - between[:, None] * by_member  # (I + D L)^-1
    member_covariance = np.diag(between) - between[:, None] * by_member * between
    member_covariance = member_covariance + left @ covariance @ left.transpose(0, 2, 1)
    pull = _pull(members, np.broadcast_to(mean, (len(members), p)))
    member_mean = mean + between * pull
    return Solution(
        evidence=evidence,
        variances=variances,
        mean=mean,
        covariance=covariance,
        likelihood=-0.5 * (size + run_misfit + member_misfit),
        run_information=by_run,
        member_information=by_member,
        member_mean=member_mean,
        member_covariance=member_covariance,
        pull=pull,
        pull_covariance=by_member - by_member @ covariance @ by_member,
        run_pull=_pull(runs, member_mean[member]),
        run_pull_covariance=by_run - by_run @ member_covariance[member] @ by_run,
    )


def _pull(equations: Array, x: Array) -> Array:
    """Return F^T (s - F x) (n, p) of equations (n, p, p + 1) at x (n, p)."""
    F, s = equations[:, :, :-1], equations[:, :, -1]
    return np.asarray(np.einsum("nki,nk->ni", F, s - np.einsum("nkj,nj->nk", F, x)))


def _together(blocks: Sequence[Array]) -> tuple[Array, float]:
    """Return the equations (m, p, p + 1) that stand for each block of them, and what the blocks themselves misfit."""
    p = blocks[0].shape[1] - 1
    out, misfit = np.zeros((len(blocks), p, p + 1)), 0.0
    for k, block in enumerate(blocks):
        R = np.asarray(np.linalg.qr(block, mode="r"), dtype=np.float64)
        out[k, : min(p, len(R))] = R[:p]
        misfit += float(R[p, p] ** 2) if len(R) > p else 0.0
    return out, misfit


def _left(equations: Array, variance: Array) -> tuple[Array, float]:
    """Return what an effect of this variance (p,) leaves of equations (n, p, p + 1), and its size.

    F x - s gets the covariance I + F D F^T; divided by its root it is of unit covariance again. The size is the sum of
    log det (I + F D F^T).
    """
    F = equations[:, :, :-1]
    root: Array = np.asarray(np.linalg.cholesky(np.eye(F.shape[1]) + (F * variance) @ F.transpose(0, 2, 1)))
    size = 2.0 * float(np.log(_diagonals(root)).sum())
    return np.asarray(np.linalg.solve(root, equations), dtype=np.float64), size


def restricted_maximum(evidence: Evidence, estimated: Array, start: Variances, prior: Array | None = None) -> Variances:
    """Return the variances of the highest restricted likelihood.

    Args:
        estimated: (k, 2 p) as `Variances` has it; what no parameter makes stays. start: where the search begins.
        prior: as for `solved`.
    """
    at = solved(evidence, replace(start, estimated=estimated), prior)
    count = np.maximum(estimated.astype(np.bool_).sum(axis=1), 1)
    share = np.divide(1.0, estimated, out=np.zeros_like(estimated), where=estimated > 0.0)
    z = share @ np.concatenate([start.between, start.within]) / count
    for _ in range(_ROUNDS):
        slope, information = estimated @ np.concatenate(at.gradient), estimated @ at.information @ estimated.T
        step = _step(information, slope, z)
        if float(slope @ step) < _STILL:  # the bounds at 0 have bent it
            step = _step(np.diag(np.diag(information)), slope, z)
        if float(slope @ step) < _STILL:
            break
        bent = _step(np.diag(np.diag(information)), slope, z)
        found = _uphill(at, z, step, prior) or _uphill(at, z, bent, prior)
        if found is None:
            break
        at, z = found
    return at.variances


def _step(information: Array, slope: Array, z: Array) -> Array:
    """Return the scoring step (k,) from variances z that ends at 0 or above; what it would take below stays at 0."""
    step = np.zeros(z.size)
    free = (z > 0.0) | (slope > 0.0)
    while free.any():
        rows = np.flatnonzero(free)
        scale = np.sqrt(np.maximum(np.diag(information)[rows], 1e-300))
        unit = information[np.ix_(rows, rows)] / np.outer(scale, scale) + 1e-6 * np.eye(rows.size)
        rest = slope[rows] - information[np.ix_(rows, np.flatnonzero(~free))] @ step[~free]
        step[rows] = np.linalg.solve(unit, rest / scale) / scale
        below = free & (z + step < 0.0)
        if not below.any():
            break
        step[below] = -z[below]
        free &= ~below
    return step


def _uphill(at: Solution, z: Array, step: Array, prior: Array | None) -> tuple[Solution, Array] | None:
    """Return solution and parameters along a step, of the first of its halves that is likelier; None where none is."""
    variances = at.variances
    made = np.zeros((0, 2 * at.mean.size)) if variances.estimated is None else variances.estimated
    x, p = np.concatenate([variances.between, variances.within]), at.mean.size
    others = np.where(made.any(axis=0), 0.0, x)
    for _ in range(_HALVINGS):
        tried = np.maximum(z + step, 0.0)
        x = others + tried @ made
        found = solved(at.evidence, replace(variances, between=x[:p], within=x[p:]), prior)
        if found.likelihood > at.likelihood:
            return found, tried
        step = 0.5 * step
    return None


def _sums(each: Array, member: NDArray[np.int64]) -> Array:
    """Return the sums over the runs of each member."""
    whose = (member == np.arange(int(member.max()) + 1)[:, None]).astype(np.float64)
    return np.asarray(np.tensordot(whose, each, axes=1))


def _squares(information: Array, common: Array) -> Array:
    """Return (p, p) the sum over all pairs (r, s) of the squares of [r = s] L_r - L_r C L_s, element by element."""
    p = common.shape[0]
    outer = np.einsum("rik,rjk->kij", information, information, optimize=True)
    seen = common @ outer
    pairs = seen.reshape(p, p * p) @ seen.transpose(0, 2, 1).reshape(p, p * p).T
    own = information @ common @ information
    return np.asarray(np.sum(information**2 - 2.0 * information * own, axis=0) + pairs)


def _diagonals(matrices: Array) -> Array:
    return np.asarray(np.einsum("nii->ni", matrices))
