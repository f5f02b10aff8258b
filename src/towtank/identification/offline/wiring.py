"""Which way each thruster pushes, and which output drives which, as recordings show it.

Outputs may be swapped, propellers turn the other way. Every axis tells of all thrusters at once: its speed is what
inertia, damping and, in roll and pitch, a righting moment make of their forces (body frame, FRD),

    v' = -v / T - w^2 x + g sum_k B_ik F_k(t - d),   x' = v,

over windows with a start and a mean of their own, for a bank of time constants T, frequencies w and delays d. Looked at
is the speed; where it is not measured, specific force or depth. These show the speeds of all three axes, as rates and
attitude turn them: a_i = v_i' + (omega x v)_i, and z' the third row of R(phi, theta) times v.
Fitted without any knowledge of the vehicle, gains b_k of each thruster come out, with an information matrix A by the
independent samples of what is left. A vehicle whose thrusters are wired B' = B P S (signs S, outputs swapped by P) has

    b_k = g B'_ik (1 + e_k) + g max_k |B_ik| f_k,

g one over the inertia within what is supposed of it, e of 0.2 and f of 0.1 what models do not know of a thruster and of
other axes; of the motion itself a linear response leaves 0.3 of what it explains. The likelihood of a wiring is that of
all axes together; an axis that no wiring explains (an autopilot's feedback can turn any motion round) is held against
none for more than 40 nats (12 in roll and pitch), and one that forces hardly explain is left out.

Everything is made white by an autoregression of what is left, so that a slow disturbance, and an autopilot that answers
it, count for no more than they tell. Wiring is called wrong where another one is far likelier, the more so the more are
tried. Thrusters are turned or their outputs swapped; none is moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from towtank.core.arrays import Array
from towtank.identification.data.samples import Samples
from towtank.recording.frames.pose_rates import velocity_of_pose
from towtank.vehicle.matrices import GRAVITY
from towtank.vehicle.thrusters.wiring import Wiring

__all__ = ["wiring_of"]

STEP = 0.1  # s
_WINDOW, _SHORTEST, _MOST = 20.0, 5.0, 60  # s, s; windows used, spread evenly
_TIMES = (0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8)  # s
_SWINGS, _DAMPED = (0.5, 1.0, 2.0, 4.0, 8.0), (0.2, 0.8, 3.2)  # rad/s, and s, of what is righted
_DELAYS = ((0, 0.0), (1, 0.0), (2, 0.0), (4, 0.0), (0, 0.1), (0, 0.2), (1, 0.1), (1, 0.3))  # steps, and lags [s]
_LATEST = 4  # steps
_GAIN = 0.5  # deviation of the logarithm of g
_GAINS = np.linspace(-1.25, 1.25, 7)
_ALONE = 1e-6  # of the largest eigenvalue: below it inputs cannot be told apart
_KEPT = 24  # time constants, frequencies and delays that are looked at closely
_MEMORY = 4  # steps that an autoregression looks back
_ROUGH = 0.3  # of what forces make, that a linear response leaves
_LAGS = 20  # steps over which what is left may still be alike
_GAIN_ERROR, _COUPLING = 0.2, 0.1  # of a thruster's own force, and of the largest one's on the axis
_NONSENSE, _HELD = 40.0, 12.0  # nats that it costs an axis to follow no wiring; roll and pitch, that autopilots hold
# nats that a turned thruster costs, a swap, and the logarithm of how many swaps there are
_TURN, _SWAP, _CHOICE = 0.5, 4.0, 4.0
_SURE = 10.0  # nats, besides the logarithm of how many are tried, by which a wiring must be likelier than the file's
_MOST_TOLD = 1e8  # of information to what is supposed
_CLOSE = 0.5  # s over which a speed is interpolated
_MANY = 12  # thrusters, above which not every set of signs is tried
_SPEED, _PLACE, _FORCE = range(3)  # what is looked at of an axis: v, x, v'


def wiring_of(samples: Sequence[Samples], inertia: Array, axes: Sequence[int] = range(6)) -> Wiring:
    """Return how recordings have the inputs wired; nothing turned or swapped where they do not speak for it.

    Args:
        samples: body frame, FRD, SI; those with other inputs than the first are left out.
        inertia: what is supposed of the total inertia (6,) of each axis [kg, kg m^2]. axes: those to look at (0 .. 5).
    """
    if not samples or not (np.isfinite(inertia) & (inertia > 0.0)).all():
        return Wiring()
    B = samples[0].B
    samples = [each for each in samples if each.commands == samples[0].commands and np.array_equal(each.B, B)]
    evidence = [found for axis in axes for found in _evidence(samples, axis)]
    if not evidence:
        return Wiring()
    tried = _signs(B.shape[1])
    likelihood = _likelihood(evidence, tried, B, inertia)
    if samples[0].commands:
        swaps = _swaps(tried[int(np.argmax(likelihood - _price(tried, B.shape[1])))], B)
        tried, likelihood = tried + swaps, np.append(likelihood, _likelihood(evidence, swaps, B, inertia))
    judged = likelihood - _price(tried, B.shape[1])
    best = int(np.argmax(judged))
    return tried[best] if judged[best] > judged[0] + _SURE + np.log(len(tried)) else Wiring()


def _signs(n: int) -> list[Wiring]:
    """Return the ways to turn n thrusters, none turned first."""
    sizes = range(n + 1) if n <= _MANY else (0, 1, 2, n)
    return [Wiring(turned) for size in sizes for turned in combinations(range(n), size)]


def _swaps(first: Wiring, B: Array) -> list[Wiring]:
    """Return two outputs swapped, with none, some or the likeliest thrusters turned."""
    n = B.shape[1]
    few = [turned for size in range(3) for turned in combinations(range(n), size)]
    near = {tuple(sorted(set(first.turned) ^ set(turned))) for turned in few}
    return [
        Wiring(turned, pair)
        for pair in combinations(range(n), 2)
        for turned in sorted({*few, *near})
        if not np.allclose(B[:, pair[0]], B[:, pair[1]])
    ]


def _price(tried: Sequence[Wiring], n: int) -> Array:
    """Return what each way (h,) of wiring n inputs costs before any data [nats]; a swap more where many are."""
    swap = _SWAP + _CHOICE * np.log(max(n * (n - 1) / 2.0, 1.0))
    return np.array([_TURN * len(each.turned) + swap * bool(each.swapped) for each in tried])


class _Evidence(NamedTuple):
    """Of an axis, for the likeliest time constants, frequencies and delays (k): what any inputs whatever make of it.

    gains: (k, n) of each input. information: (k, n, n) of them. misfit: (k,), half the square of what they leave, in
    deviations. worth: nats by which they explain the motion.
    """

    axes: tuple[int, ...]
    gains: Array
    information: Array
    misfit: Array
    worth: float
    nonsense: float = _NONSENSE


def _likelihood(evidence: Sequence[_Evidence], tried: Sequence[Wiring], B: Array, inertia: Array) -> Array:
    """Return the log likelihood of each way (h,)."""
    out = np.zeros(len(tried))
    signs = np.ones((len(tried), B.shape[1]))
    groups: dict[tuple[int, ...], list[int]] = {}
    for h, each in enumerate(tried):
        groups.setdefault(each.swapped, []).append(h)
        signs[h, list(each.turned)] = -1.0
    for found in evidence:
        for swapped, which in groups.items():
            axes = list(found.axes)
            out[which] += _of_axes(found, Wiring((), swapped).matrix(B)[axes] / inertia[axes, None], signs[which])
    return out


def _of_axes(found: _Evidence, beta: Array, signs: Array) -> Array:
    """Return the log likelihood (h,) of what axes say whose inputs should do beta (R, n), but for signs (h, n)."""
    size = np.abs(beta).max(axis=1, keepdims=True)
    if not size.max() > 0.0:
        return np.zeros(len(signs))
    gains, A, misfit = found.gains, found.information, found.misfit
    signs = np.tile(signs, len(beta))
    several = []
    for gain in _GAINS:
        g = np.exp(gain)
        spread = ((g * _GAIN_ERROR * beta) ** 2 + (g * _COUPLING * size) ** 2).ravel()
        does = g * beta.ravel()
        weight, constant = _weight(A, spread)
        own = np.einsum("ki,kij,kj->k", gains, weight, gains)
        cross = (weight @ gains[:, :, None])[:, :, 0] * does
        square = weight * does[:, None] * does
        apart = own[:, None] - 2.0 * cross @ signs.T + ((signs @ square) * signs).sum(axis=2)
        several.append((constant - misfit)[:, None] - 0.5 * apart - 0.5 * (gain / _GAIN) ** 2)
    follows = np.max(several, axis=(0, 1))
    weight, constant = _weight(A, np.broadcast_to((2.0 * size) ** 2, beta.shape).ravel())
    own = np.einsum("ki,kij,kj->k", gains, weight, gains)
    nonsense = float(np.max(constant - misfit - 0.5 * own)) - found.nonsense
    return np.asarray(np.logaddexp(follows, nonsense))


def _weight(A: Array, spread: Array) -> tuple[Array, Array]:
    """Return (A^-1 + P)^-1 (k, n, n) and -ln |I + A P| / 2 (k,) for P = diag(spread); A (k, n, n) may be singular."""
    told = np.einsum("kii->ki", A * spread).max(axis=1)
    A = A * np.minimum(1.0, _MOST_TOLD / np.maximum(told, 1.0))[:, None, None]  # numbers end where sensors do not
    with_it = np.eye(spread.size) + A * spread
    return np.asarray(np.linalg.solve(with_it, A)), np.asarray(-0.5 * np.linalg.slogdet(with_it)[1])


def _evidence(samples: Sequence[Samples], axis: int) -> list[_Evidence]:
    """Return what tells most of an axis: its speed, else specific force or depth; or nothing."""
    for kinds in ((_SPEED,), (_FORCE, _PLACE)):
        found = [each for kind in kinds if (each := _of_kind(samples, axis, kind)) is not None]
        found = [each for each in found if each.worth > each.gains.shape[1]]  # more than numbers of any kind explain
        if found:
            held = axis in (3, 4) and samples[0].commands
            return [max(found, key=lambda each: each.worth)._replace(nonsense=_HELD if held else _NONSENSE)]
    return []


def _of_kind(samples: Sequence[Samples], axis: int, kind: int) -> _Evidence | None:
    windows: list[_Series] = []
    duration = sum(each.duration for each in samples)
    span = round(min(_WINDOW, max(_SHORTEST, 0.25 * duration)) / STEP)
    for each in samples:
        whole = _series(each, axis, kind)
        for first in range(_LATEST, whole.motion.size - span + 1, span):
            rows = slice(first, first + span)
            part = _Series(whole.motion[rows], whole.force[first - _LATEST : first + span], whole.turn[rows])
            if all(np.isfinite(values).all() for values in part):
                windows.append(part)
    if len(windows) < 2:
        return None
    some = np.unique(np.linspace(0, len(windows) - 1, _MOST).astype(np.int64))
    return _fitted(_Series(*(np.array(each)[some] for each in zip(*windows, strict=True))), axis, kind)


def _fitted(series: _Series, axis: int, kind: int) -> _Evidence:
    """Return what motion (w, m) tells of the gains of each force (w, d + m, n), start and mean taken out.

    What is left of a first fit is an autoregression, by which everything is made white before the second.
    """
    motion, force, turn = series
    m = motion.shape[1]
    bank = [(time, 0.0) for time in _TIMES]
    if axis in (3, 4):
        bank += [(time, swing) for time in _DAMPED for swing in _SWINGS]
    late = {delay: force[:, _LATEST - delay : _LATEST - delay + m] for delay, _ in _DELAYS}
    spectra = {delay: np.fft.rfft(each, 2 * m + 2, axis=1) for delay, each in late.items()}
    made, free = [], []
    for time, swing in bank:
        pushed, starts = _response(time, swing, m)
        basis = _seen(np.broadcast_to(starts, (motion.shape[0], *starts.shape)), turn, axis, kind)
        basis = np.concatenate([basis, np.ones((*motion.shape, 1))], axis=2)
        if kind == _PLACE:
            basis = np.concatenate([basis, np.broadcast_to(np.arange(m)[None, :, None], (*motion.shape, 1))], axis=2)
        for delay, lag in _DELAYS:
            lagged = np.fft.rfft(_lagged(pushed, lag), 2 * m + 2)[None, :, None]
            speeds = np.fft.irfft(spectra[delay] * lagged, 2 * m + 2, axis=1)[:, : m + 1]
            made.append(_seen(speeds, turn, axis, kind))
            free.append(basis)
    fits = [_least_squares(motion, y, basis, np.zeros(0)) for y, basis in zip(made, free, strict=True)]
    best = min(range(len(fits)), key=lambda k: fits[k].share)
    memory = _autoregression(_without(motion - made[best] @ fits[best].gains, np.linalg.qr(free[best])[0]))
    fits = [_least_squares(motion, y, basis, memory) for y, basis in zip(made, free, strict=True)]
    kept = sorted(fits, key=lambda fit: fit.share)[:_KEPT]
    used = (made[0].shape[2] + motion.shape[0] * free[0].shape[2]) / motion.size
    samples = motion.shape[0] * _independent(kept[0].left) * max(1.0 - used, 0.1)
    explained = float(kept[0].gains @ kept[0].products @ kept[0].gains)
    noise = max(kept[0].square + _ROUGH**2 * explained, 1e-300) / samples
    return _Evidence(
        (0, 1, 2) if turn.size else (axis,),
        gains=np.array([fit.gains for fit in kept]),
        information=np.array([fit.products for fit in kept]) / noise,
        misfit=0.5 * np.array([fit.square for fit in kept]) / noise,
        worth=-0.5 * samples * float(np.log(max(kept[0].share, 1e-9))),
    )


def _seen(speeds: Array, turn: Array, axis: int, kind: int) -> Array:
    """Return what is seen (w, m, R n) of body speeds (w, m + 1, n) along each axis.

    Specific force along an axis is v' + (omega x v), and depth the integral of the speed down, of all three axes.
    """
    if kind == _SPEED:
        return speeds[:, :-1]
    middle = 0.5 * (speeds[:, 1:] + speeds[:, :-1])
    rows = [turn[..., j, None] * middle for j in range(3)]
    if kind == _FORCE:
        rows[axis] = np.broadcast_to(np.diff(speeds, axis=1) / STEP, rows[axis].shape)
        return np.concatenate(rows, axis=2)
    gone = STEP * np.concatenate(rows, axis=2)
    return np.asarray(np.cumsum(gone, axis=1) - gone)


def _lagged(kernel: Array, lag: float) -> Array:
    """Return what a step of force leaves (m,) where it comes through a first-order lag [s]."""
    if not lag:
        return kernel
    share = (1.0 - np.exp(-STEP / lag)) * np.exp(-STEP / lag * np.arange(kernel.size))
    return np.asarray(np.convolve(kernel, share)[: kernel.size])


class _Fit(NamedTuple):
    """Gains (n,) that make a motion of what each force makes, the products (n, n), what is left (w, m) and its square.

    share: of the motion's square that is left.
    """

    gains: Array
    products: Array
    left: Array
    square: float
    share: float


def _least_squares(motion: Array, y: Array, free: Array, memory: Array) -> _Fit:
    """Return what makes motion (w, m) of y (w, m, n) and of what a start and a mean do (w, m, k)."""
    basis = np.linalg.qr(_white(free, memory))[0]
    v, white = _without(_white(motion, memory), basis), _white(y, memory)
    white = white - basis @ (basis.transpose(0, 2, 1) @ white)
    S = np.einsum("wmi,wmj->ij", white, white)
    gains = np.linalg.lstsq(S, np.einsum("wmi,wm->i", white, v), rcond=_ALONE)[0]
    left = v - white @ gains
    square = float((left**2).sum())
    return _Fit(gains, S, left, square, square / max(float((v**2).sum()), 1e-300))


def _without(x: Array, basis: Array) -> Array:
    """Return x (w, m) less what an orthonormal basis (w, m, k) can make of it."""
    return np.asarray(x - np.einsum("wmk,wk->wm", basis, np.einsum("wmk,wm->wk", basis, x)))


def _white(x: Array, memory: Array) -> Array:
    """Return x (w, m, ...) less what its past lets expect of it (w, m - p, ...)."""
    p, m = memory.size, x.shape[1]
    out = x[:, p:].copy()
    for k, share in enumerate(memory, 1):
        out -= share * x[:, p - k : m - k]
    return out


def _autoregression(left: Array) -> Array:
    """Return the coefficients (p,) of an autoregression of what is left (w, m)."""
    m = left.shape[1]
    alike = np.array([float((left[:, k:] * left[:, : m - k]).sum()) for k in range(_MEMORY + 1)])
    if not alike[0] > 0.0:
        return np.zeros(0)
    table = alike[np.abs(np.subtract.outer(np.arange(_MEMORY), np.arange(_MEMORY)))]
    return np.asarray(np.linalg.solve(table + 1e-3 * alike[0] * np.eye(_MEMORY), alike[1:]))


def _independent(left: Array) -> float:
    """Return how many independent samples there are in a window of what is left (w, m)."""
    m = left.shape[1]
    power = float((left**2).sum())
    alike = [float((left[:, lag:] * left[:, :-lag]).sum()) / max(power, 1e-300) for lag in range(1, min(_LAGS, m - 1))]
    upto = next((k for k, rho in enumerate(alike) if rho < 0.05), len(alike))
    return float(m / (1.0 + 2.0 * sum(alike[:upto])))


def _response(time: float, swing: float, m: int) -> tuple[Array, Array]:
    """Return the speed at m + 1 instants after a step of force (m + 1,), and after a start (m + 1, k)."""
    whole = expm(STEP * np.array([[-1.0 / time, -(swing**2), 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    A, b = whole[:2, :2], whole[:2, 2]
    powers = np.empty((m + 1, 2, 2))
    powers[0] = np.eye(2)
    for k in range(m):
        powers[k + 1] = A @ powers[k]
    pushed = np.concatenate([np.zeros((1, 2)), powers[:m] @ b])
    return pushed[:, 0], powers[:, 0, : 2 if swing else 1]  # a start of speed 1, and of place 1 where it is righted


class _Series(NamedTuple):
    """At regular instants: motion (m,), NaN where unknown, mean forces (m, n) from each to the next, and turn (m, 3).

    turn: what of the speed along each axis is seen, by the attitude or its rates; (m, 0) where only one axis is.
    """

    motion: Array
    force: Array
    turn: Array


def _series(samples: Samples, axis: int, kind: int) -> _Series:
    nothing = _Series(np.zeros(0), np.zeros((0, samples.B.shape[1])), np.zeros((0, 3)))
    if len(samples) < 2 or samples.input_t.size == 0:
        return nothing
    t, motion = _measured(samples, axis, kind)
    grid = samples.t[0] + STEP * np.arange(int(samples.duration / STEP))
    if t.size < 2 or grid.size < 2:
        return nothing
    at_once = kind != _FORCE
    v = np.interp(grid, t, motion, left=np.nan, right=np.nan) if at_once else _means(grid, t, motion)
    after = np.clip(np.searchsorted(t, grid), 1, t.size - 1)
    v[t[after] - t[after - 1] > _CLOSE] = np.nan
    return _Series(v, _held(grid, samples.input_t, samples.input_force), _turn(samples, grid + 0.5 * STEP, axis, kind))


def _turn(samples: Samples, t: Array, axis: int, kind: int) -> Array:
    """Return what (m, 3) of the speed along each axis is seen; as if level and not turning where that is unknown."""
    if kind == _SPEED:
        return np.zeros((t.size, 0))
    if kind == _PLACE:
        return _down(samples, t)
    p, q, r = (_between(samples, t, j) for j in (9, 10, 11))
    zero = np.zeros(t.size)
    return np.column_stack([(zero, -r, q), (r, zero, -p), (-q, p, zero)][axis])


def _down(samples: Samples, t: Array) -> Array:
    """Return the direction of gravity (m, 3) in the body; as if level where the attitude is unknown."""
    phi, theta = (_between(samples, t, j) for j in (3, 4))
    return np.column_stack([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])


def _between(samples: Samples, t: Array, column: int) -> Array:
    known = np.isfinite(samples.values[:, column])
    return np.interp(t, samples.t[known], samples.values[known, column]) if known.any() else np.zeros(t.size)


def _means(grid: Array, t: Array, values: Array) -> Array:
    """Return the means (m,) of values between samples, from each instant to the next."""
    edges = np.append(grid, grid[-1] + STEP)
    whole = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (values[1:] + values[:-1]))])
    return np.asarray(np.diff(np.interp(edges, t, whole, left=np.nan, right=np.nan)) / STEP)


def _held(grid: Array, t: Array, force: Array) -> Array:
    """Return the means (m, n) of forces (k, n), each held until the next, from each instant to the next."""
    edges = np.append(grid, grid[-1] + STEP)
    done = np.concatenate([np.zeros((1, force.shape[1])), np.cumsum(np.diff(t)[:, None] * force[:-1], axis=0)])
    last = np.clip(np.searchsorted(t, edges, "right") - 1, 0, t.size - 1)
    integral = done[last] + force[last] * (edges - t[last])[:, None]
    out = np.diff(integral, axis=0) / STEP
    out[grid < t[0]] = np.nan
    return np.asarray(out)


def _measured(samples: Samples, axis: int, kind: int) -> tuple[Array, Array]:
    """Return times and what is measured of an axis: its speed, by a sensor or the pose, its place or its v'."""
    if kind == _SPEED:
        return _speed(samples, axis)
    values = samples.values
    if kind == _PLACE and axis == 2:
        known = np.isfinite(values[:, 2])
        return samples.t[known], values[known, 2]
    if kind == _FORCE and axis < 3:
        return _acceleration(samples, axis)
    return np.zeros(0), np.zeros(0)


def _acceleration(samples: Samples, axis: int) -> tuple[Array, Array]:
    """Return times and specific force along an axis less that of gravity [m/s^2]."""
    known = np.isfinite(samples.values[:, 12 + axis])
    t = samples.t[known]
    return t, samples.values[known, 12 + axis] + GRAVITY * _down(samples, t)[:, axis]


def _speed(samples: Samples, axis: int) -> tuple[Array, Array]:
    """Return times and speeds, measured or from the pose."""
    values = samples.values
    known = np.isfinite(values[:, 6 + axis])
    if known.any():
        return samples.t[known], values[known, 6 + axis]
    needed = slice(0, 6) if axis < 3 else slice(3, 6)
    posed = np.flatnonzero(np.isfinite(values[:, needed]).all(axis=1))
    t = samples.t[posed]
    apart = max(1, round(STEP / max(float(np.median(np.diff(t))), 1e-6))) if t.size > 1 else 1
    t, pose = t[::apart], values[posed[::apart], :6]
    if t.size < 3:
        return np.zeros(0), np.zeros(0)
    pose = np.column_stack([pose[:, :3], np.unwrap(pose[:, 3:], axis=0)])
    rate = (pose[2:] - pose[:-2]) / (t[2:] - t[:-2])[:, None]
    speed = velocity_of_pose(pose[1:-1], rate, np.full((len(rate), 6), np.nan))[:, axis]
    fine = np.isfinite(speed)
    return t[1:-1][fine], speed[fine]
