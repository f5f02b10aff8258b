"""One free run of the vehicle with its sensitivities, the normal equations of its residuals, and their solution.

From an initial state the vehicle is left to its inputs, the held commands of the recording given in time; nothing
measured corrects it on the way. With S the derivative of the error state (`towtank.identification.model.linearisation`)
by the initial errors and the free coefficients,

    S' = A S + [0 B],   S(0) = [I 0],   S_{k+1} = S_k + h D + h^2/2 A D,   D = A S_k + [0 B]

A and B at the middle of the step, or of two short ones under the same wrench. Each measured number adds w J J^T to the
normal equations of its segment and w J r to the score of its block of time, w = weight(r / scale) / (noise scale)^2.
Nothing is kept per sample but the residual.

The normal equations have the shape of an arrowhead, H = [X C; C^T T], X block diagonal: initial states of many
segments, coefficients shared by all. The states are eliminated segment by segment (Schur's complement): T - C^T X^-1 C
is the information on the coefficients, and no matrix is larger than one segment's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from towtank.core.arrays import Array, inlined_kernel, kernel
from towtank.core.forces import add_inflow_damping_into
from towtank.core.layout import I_INFLOW, I_LINEAR, N_PARAMETERS
from towtank.core.rk4 import N_STATES, has_extra_terms, is_coupled, stage_of_one_into, step_of_one_into
from towtank.core.zero_order_hold import ZeroOrderHold, hold_force, mean_forces_into
from towtank.identification.data.samples import N_MEASURED
from towtank.identification.model.linearisation import linearise_into
from towtank.identification.model.parameters import IN_DELAY, IN_GAIN, IN_LAG, N_FIXED, N_MOVING, Codes, put_parameters
from towtank.identification.simulation_error.residuals import (
    RowSpace,
    RowSums,
    Weighing,
    absorb_row_into,
    absorb_specific_force_into,
)

if TYPE_CHECKING:
    from towtank.identification.simulation_error.segments import FreeRun, Indices

__all__: list[str] = []

_WIDTH = 8  # columns are padded to whole vectors
STEP = 0.02  # s, longest step of the integration
_FASTEST = 1e3  # m/s, rad/s: beyond this a run has diverged
_LOOSE = np.repeat([10.0, 1.0, 1.0, 1.0], 3)  # m, rad, m/s, rad/s: a state that is known no better than this
_TURN = 1.0  # rad, of a step
_RIDGE = 1e-13  # of a unit diagonal
_SMALLEST = 1e-12  # share of an information's largest eigenvalue, each row scaled, that is not rounding


@kernel
def _give_into(input_t: Array, input_force: Array, hold: ZeroOrderHold, given: int, end: float) -> int:
    """Give the hold the inputs that act before `end` [s]; return how many it has by now."""
    early = min(hold.delay[0], 0.0)
    while given < input_t.shape[0] and input_t[given] + early <= end:
        hold_force(hold, input_t[given], input_force[given])
        given += 1
    return given


@kernel
def _forward_into(input_t: Array, input_force: Array, hold: ZeroOrderHold, given: int, end: float, force: Array) -> int:
    """Take the inputs forward to `end`, one at a time so that their ring never overflows."""
    early = min(hold.delay[0], 0.0)
    while given < input_t.shape[0] and input_t[given] + early <= end:
        hold_force(hold, input_t[given], input_force[given])
        mean_forces_into(hold, min(input_t[given] + hold.delay[0], end), force)
        given += 1
    mean_forces_into(hold, end, force)
    force[1:] = 0.0
    return given


@kernel
def _next_change(input_t: Array, hold: ZeroOrderHold, given: int) -> float:
    """Return when the next input begins to act [s]; infinite after the last."""
    ring, following = hold.times.shape[0], int(hold.counters[0].in_force) + 1
    if following < int(hold.counters[0].received):
        return float(hold.times[following % ring])
    return float(input_t[given] + hold.delay[0]) if given < input_t.shape[0] else math.inf


@kernel
def _wrench_into(B: Array, force: Array, gain: Array, wrench: Array) -> bool:
    """Write the wrench of forces (3, m) three times into `wrench` (3, 6); whether it is the one that was there.

    Their derivatives, in the other rows of `force`, are made those of the thrusts; a gain's own is by the input.
    """
    for i in range(6):
        wrench[0, i] = 0.0
    for a in range(gain.shape[0]):
        force[1, a] *= gain[a]
        force[2, a] *= gain[a]
        thrust = gain[a] * force[0, a]
        if thrust != 0.0:
            for i in range(6):
                wrench[0, i] += B[i, a] * thrust
    same = True
    for i in range(6):
        same = same and wrench[0, i] == wrench[1, i]
        wrench[1, i] = wrench[0, i]
        wrench[2, i] = wrench[0, i]
    return same


@kernel
def _force_now_into(hold: ZeroOrderHold, t: float, force: Array) -> None:
    """Write the force just after t: a thruster without lag has answered already; derivatives are not needed twice."""
    ring = hold.times.shape[0]
    active, given = int(hold.counters[0].in_force), int(hold.counters[0].received)
    while active + 1 < given and hold.times[(active + 1) % ring] <= t:
        active += 1
    for a in range(hold.force.shape[0]):
        if hold.lag[a] > 0.0:
            target = hold.values[active % ring, a]
            force[0, a] = hold.force[a]
            force[1, a] = (hold.force[a] - target) / hold.lag[a]
            force[2, a] = hold.lag[a] * hold.slope[a]
        else:
            force[0, a] = hold.values[active % ring, a]
            force[1, a] = 0.0
            force[2, a] = 0.0


class Unknowns(NamedTuple):
    """What a run is made from, and what its sensitivities are by."""

    codes: Codes  # (n, 4) the free coefficients
    theta: Array  # (n,) their values
    states: Array  # (s, 13) initial state of each segment
    estimated: Indices  # which of the 12 initial errors are estimated; they are the first columns
    moving: Indices  # which of the 12 error states answer to any column


class NormalEquations(NamedTuple):
    """What a run adds up: columns are the initial states that are estimated, then the coefficients, then padding."""

    normal: Array  # (s, c, c) sum of w J J^T of each segment
    scores: Array  # (b, c) sum of w J r of each block of time
    residuals: Array  # (n, 18) in standard deviations of the noise, NaN where nothing was measured
    reach: Array  # (12, c) sum over the segments of the sizes of the sensitivities at their ends


class Workspace(NamedTuple):
    """Scratch of a run."""

    S: Array  # (12, c) sensitivities
    D: Array  # (12, c) their rate
    E: Array  # (12, c)
    A: Array  # (12, 21 + n)
    J: Array  # (3, c)
    p: Array  # (170,)
    x: Array  # (13,) state
    middle: Array  # (13,) state at the middle of a step
    rate: Array  # (13,) derivative of the state
    wrench: Array  # (3, 6)
    force: Array  # (3, m) mean force of each input, and its derivatives by delay and lag
    gain: Array  # (m,)
    work: Array  # (3, 13)
    scratch: Array  # (6, 6)
    current: Array  # (3,)
    bias: Array  # (9,)
    h: Array  # (21 + n,) zero
    linear: Array  # (36,) linear damping without losses by inflow


def new_equations(segments: int, blocks: int, rows: int, columns: int) -> NormalEquations:
    """Return the empty sums of a run with `columns` estimated initial states and coefficients."""
    c = _padded(columns)
    return NormalEquations(
        normal=np.zeros((segments, c, c)),
        scores=np.zeros((blocks, c)),
        residuals=np.full((rows, N_MEASURED), np.nan),
        reach=np.zeros((N_MOVING, c)),
    )


def new_workspace(columns: int, n: int, m: int) -> Workspace:
    """Return scratch for `columns` sensitivities, n of them of coefficients, and m inputs."""
    c = _padded(columns)
    return Workspace(
        S=np.zeros((N_MOVING, c)),
        D=np.zeros((N_MOVING, c)),
        E=np.zeros((N_MOVING, c)),
        A=np.zeros((N_MOVING, N_FIXED + n)),
        J=np.zeros((3, c)),
        p=np.zeros(N_PARAMETERS),
        x=np.zeros(N_STATES),
        middle=np.zeros(N_STATES),
        rate=np.zeros(N_STATES),
        wrench=np.zeros((3, 6)),
        force=np.zeros((3, m)),
        gain=np.ones(m),
        work=np.zeros((3, N_STATES)),
        scratch=np.zeros((6, 6)),
        current=np.zeros(3),
        bias=np.zeros(9),
        h=np.zeros(N_FIXED + n),
        linear=np.zeros(36),
    )


def _padded(columns: int) -> int:
    return -(-columns // _WIDTH) * _WIDTH


@kernel
def free_run_into(
    run: FreeRun,
    parameters: Array,
    unknowns: Unknowns,
    hold: ZeroOrderHold,
    scale: Array,
    gated: bool,
    out: NormalEquations,
    space: Workspace,
) -> bool:
    """Run all segments and add up their normal equations; False where the coefficients or the motion are impossible.

    Args:
        parameters: of the vehicle's kernels (170,); theta is put into a copy.
        hold: an empty one with the nominal lags and delay; changed.
        scale: of the residuals of each column (18,), in standard deviations of the noise.
        gated: whether far residuals are left out altogether.
    """
    out.normal[:] = 0.0
    out.scores[:] = 0.0
    out.reach[:] = 0.0
    S, D, E, A, J = space.S, space.D, space.E, space.A, space.J
    p, x, middle, rate, wrench = space.p, space.x, space.middle, space.rate, space.wrench
    lane = p.reshape(N_PARAMETERS, 1)
    force, gain, work, scratch, current = space.force, space.gain, space.work, space.scratch, space.current
    t, values, q, B, block = run.t, run.values, run.q, run.B, run.block
    codes, theta, states = unknowns.codes, unknowns.theta, unknowns.states
    estimated, moving = unknowns.estimated, unknowns.moving
    input_t, input_force = run.input_t, run.input_force
    p[:] = parameters
    if not put_parameters(p, codes, theta, scratch):
        return False
    gain[:] = 1.0
    steered = False  # whether coefficients of the inputs are free
    for c in range(theta.shape[0]):
        steered = steered or codes[c, 0] == IN_DELAY or codes[c, 0] == IN_LAG or codes[c, 0] == IN_GAIN
        if codes[c, 0] == IN_DELAY:
            hold.delay[0] = theta[c]
        elif codes[c, 0] == IN_LAG:
            hold.lag[:] = max(theta[c], 0.0)
        elif codes[c, 0] == IN_GAIN:
            gain[codes[c, 1]] = math.exp(theta[c])
    extra, loss = has_extra_terms(lane), p[I_INFLOW] != 0.0
    space.linear[:] = p[I_LINEAR : I_LINEAR + 36]
    coupled, lagless, clock = loss or is_coupled(lane), not (hold.lag > 0.0).any(), hold.clock
    k, n = estimated.shape[0], theta.shape[0]
    weighing, room = Weighing(run.noise, scale, gated), RowSpace(current, space.bias, space.h)
    force[:] = 0.0
    given = 0
    if input_t.shape[0] > 0:
        hold_force(hold, input_t[0], input_force[0])
        given = 1
    for s in range(run.first.shape[0]):
        for j in range(N_STATES):
            x[j] = states[s, j]
        S[:] = 0.0
        for c in range(k):
            S[estimated[c], c] = 1.0
        H = out.normal[s]
        for row in range(run.first[s], run.last[s]):
            if row == run.first[s]:
                given = _forward_into(input_t, input_force, hold, given, t[row], force)
                steps, h, half_way, resting, change = 0, 0.0, False, False, -math.inf
            else:
                span = t[row] - t[row - 1]
                steps = max(1, math.ceil(span / STEP - 1e-6))
                h = span / steps
            for step in range(steps):
                end = t[row] if step == steps - 1 else t[row - 1] + h * (step + 1)
                if resting and end <= change:
                    clock[0] = end
                    steady = not steered
                else:
                    resting = lagless and end <= change
                    given = _give_into(input_t, input_force, hold, given, end)
                    mean_forces_into(hold, end, force)
                    change = _next_change(input_t, hold, given)
                    steady = _wrench_into(B, force, gain, wrench) and not steered
                    if loss:
                        _lose_by_inflow(B, force[0], space.linear, p)
                for j in range(N_STATES):
                    middle[j] = x[j]
                step_of_one_into(p, x, wrench, current, h, work, coupled, extra)
                if half_way and steady:
                    half_way = False  # the second step of a pair
                    _advance_into(S, D, E, h, 1.5 * h * h, moving)
                else:
                    half_way = steady and 2.0 * h < 1.01 * STEP
                    share = 0.0 if half_way else 0.5
                    for j in range(N_STATES):
                        middle[j] = share * middle[j] + (1.0 - share) * x[j]
                    stage_of_one_into(p, middle, wrench[0], current, rate, coupled)
                    linearise_into(p, middle, rate, codes, theta, B, force, A, scratch)
                    _rates_into(A, S, k, n, moving, D, E)
                    _advance_into(S, D, E, h, 0.5 * h * h, moving)
            for j in range(7, N_STATES):
                if not math.fabs(x[j]) < _FASTEST:
                    return False
            z, sums = values[row], RowSums(H, out.scores[block[row]], out.residuals[row], J, k + n)
            absorb_row_into(z, q[row], x, room, S, weighing, sums)
            if math.isfinite(z[12]) or math.isfinite(z[13]) or math.isfinite(z[14]):
                half_way = resting = False
                given = _give_into(input_t, input_force, hold, given, t[row])
                _force_now_into(hold, t[row], force)
                _wrench_into(B, force, gain, wrench)
                if loss:
                    _lose_by_inflow(B, force[0], space.linear, p)
                stage_of_one_into(p, x, wrench[0], current, rate, coupled)
                linearise_into(p, x, rate, codes, theta, B, force, A, scratch)
                absorb_specific_force_into(z, x, rate, A, S, room, weighing, sums)
        for i in range(N_MOVING):
            for j in range(S.shape[1]):
                out.reach[i, j] += math.fabs(S[i, j])
    return True


@kernel
def _lose_by_inflow(B: Array, force: Array, linear: Array, p: Array) -> None:
    """Put into `p` the linear damping (36,) with what thrusters of these forces (m,) lose by the water through them."""
    for i in range(36):
        p[I_LINEAR + i] = linear[i]
    add_inflow_damping_into(B, force, p[I_INFLOW], p)


@inlined_kernel
def _rates_into(A: Array, S: Array, states: int, n: int, moving: Indices, D: Array, E: Array) -> None:
    """Write the first and the second derivative of the sensitivities S (12, c) into D and E."""
    _times_into(A, S, moving, D)
    for i in moving:
        for c in range(n):
            D[i, states + c] += A[i, N_FIXED + c]
    _times_into(A, D, moving, E)


@inlined_kernel
def _advance_into(S: Array, D: Array, E: Array, h: float, half: float, moving: Indices) -> None:
    """Add h D + half E to the sensitivities S (12, c)."""
    for i in moving:
        for j in range(S.shape[1]):
            S[i, j] += h * D[i, j] + half * E[i, j]


@inlined_kernel
def _times_into(A: Array, S: Array, moving: Indices, out: Array) -> None:
    """Write A S (12, c) into `out`, in the rows that move."""
    for i in moving:
        for j in range(S.shape[1]):
            out[i, j] = 0.0
        for k in moving:
            f = A[i, k]
            if f != 0.0:
                for j in range(S.shape[1]):
                    out[i, j] += f * S[k, j]


@dataclass(frozen=True, eq=False)
class Step:
    """A step in the coefficients (n,) and the initial errors (s, 12), and by how much it should lower the cost."""

    theta: Array
    states: Array
    decrease: float


Within = Callable[[Array, Array], Array]


@dataclass(frozen=True, eq=False)
class Arrowhead:
    """Normal equations of all segments.

    Attributes:
        X: (s, k, k) initial states. C: (s, k, n) between them and the coefficients. T: (n, n) coefficients, the prior
            included.
        gx: (s, k), g: (n,) right-hand sides.
        estimated: (k,) which of the 12 initial errors.
    """

    X: Array
    C: Array
    T: Array
    gx: Array
    g: Array
    estimated: Indices

    def _eliminated(self, damping: float) -> tuple[Array, Array]:
        """Return X^-1 C (s, k, n) and X^-1 gx (s, k)."""
        k = self.X.shape[1]
        X = self.X.copy()
        places = np.arange(k)
        X[:, places, places] = X[:, places, places] * (1.0 + damping) + _LOOSE[self.estimated] ** -2.0
        scale = 1.0 / np.sqrt(X[:, places, places])
        X *= scale[:, :, None] * scale[:, None, :]
        X[:, places, places] += _RIDGE  # a segment that diverges may leave nothing but rounding errors
        known = np.concatenate([self.C, self.gx[:, :, None]], axis=2)
        solved = scale[:, :, None] * np.linalg.solve(X, scale[:, :, None] * known)
        return solved[:, :, :-1], solved[:, :, -1]

    def step(self, damping: float, least: Array, most: Array, within: Within | None = None) -> Step:
        """Return the damped step within bounds: what would leave them stays on them, the others make the best of it.

        Args:
            damping: Levenberg's and Marquardt's, relative to the diagonal.
            least, most: bounds of the step of each coefficient (n,).
            within: returns the likeliest step that is allowed, of a step (n,) with its covariance (n, n).
        """
        C, x = self._eliminated(damping)
        T = self.T - np.einsum("ski,skj->ij", self.C, C)
        g = self.g - np.einsum("ski,sk->i", self.C, x)
        informed = np.diag(T) > _SMALLEST * np.diag(self.T)
        scale = _scale(T)
        theta, moving = np.zeros(len(g)), informed.copy()
        while moving.any():
            fixed = np.where(moving, 0.0, theta)
            scaled = T * np.outer(scale, scale)
            scaled[~moving, :] = scaled[:, ~moving] = 0.0
            scaled[np.diag_indices_from(scaled)] += damping + _SMALLEST
            free = scale * np.linalg.lstsq(scaled, np.where(moving, scale * (g - T @ fixed), 0.0), rcond=None)[0]
            theta = np.where(moving, np.clip(free, least, most), theta)
            beyond = moving & (theta != free)
            if not beyond.any():
                break
            moving &= ~beyond
        if within is not None:
            damped = T + np.diag((damping + _SMALLEST) / scale**2)
            theta = np.where(informed, np.clip(within(theta, inverse_information(damped)), least, most), 0.0)
        x = x - C @ theta
        states = np.zeros((len(self.X), 12))
        states[:, self.estimated] = x
        shorter = 1.0 / max(np.abs(states[:, 3:6]).max(initial=0.0) / _TURN, 1.0)
        slope = float(self.g @ theta + np.sum(self.gx * x))
        bend = theta @ self.T @ theta + np.einsum("sk,skl,sl->", x, self.X, x)
        bend += 2.0 * np.einsum("sk,skn,n->", x, self.C, theta)
        return Step(shorter * theta, shorter * states, slope - 0.5 * float(bend))

    def information(self) -> tuple[Array, Array]:
        """Return the information (n, n) on the coefficients, the states being unknown, and X^-1 C (s, k, n)."""
        C, _ = self._eliminated(0.0)
        T = self.T - np.einsum("ski,skj->ij", self.C, C)
        return 0.5 * (T + T.T), C


def _scale(T: Array) -> Array:
    """Return what scales T (n, n) to a unit diagonal; 1 where there is nothing."""
    diagonal = np.diag(T)
    return np.asarray(1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0)))


def inverse_information(information: Array) -> Array:
    """Return the inverse (n, n): very large, not infinite, in directions of which the run says nothing at all."""
    scale = _scale(information)
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale))
    values = np.maximum(values, _SMALLEST * max(float(values[-1]), 1.0))
    inverse: Array = (vectors / values) @ vectors.T * np.outer(scale, scale)
    return inverse
