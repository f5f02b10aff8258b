"""What each input does on each axis, without any knowledge of the vehicle: by linear responses of the speed to forces.

A speed is what inertia, damping and, in roll and pitch, a righting moment make of forces (body frame, FRD),

    v' = -v / T - w^2 x + g sum_k B_ik F_k(t - d),   x' = v,

over windows with a start and a mean of their own, for a bank of time constants T, frequencies w and delays d. Gains b_k
of each input come out, with an information matrix A by the independent samples of what is left; of the motion itself a
linear response leaves 0.3 of what it explains. Everything is made white by an autoregression of what is left, so that a
slow disturbance, and an autopilot that answers it, count for no more than they tell.

A vehicle whose inputs are wired B' = B P S (signs S, outputs swapped by P) has

    b_k = g B'_ik (1 + e_k) + g max_k |B_ik| f_k,

g one over the inertia within what is supposed of it, e of 0.2 and f of 0.1 what models do not know of a thruster and of
other axes. An axis that no wiring explains (an autopilot's feedback can turn any motion round) is held against none for
more than 40 nats (12 in roll and pitch), and one that forces hardly explain is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from towtank.core.arrays import Array
from towtank.identification.data.samples import Samples
from towtank.recording.frames.pose_rates import velocity_of_pose
from towtank.vehicle.thrusters.wiring import Wiring

__all__ = ["AxisResponse", "axis_responses", "likelihood_of"]

_STEP = 0.1  # s
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
_MOST_TOLD = 1e8  # of information to what is supposed
_CLOSE = 0.5  # s over which a speed is interpolated


class AxisResponse(NamedTuple):
    """Of an axis, for the likeliest time constants, frequencies and delays (k): what any inputs whatever make of it.

    axis: 0 .. 5 of u v w p q r, body FRD. gains: (k, n) of each input, m/s^2 or rad/s^2 per unit of it (N, N m).
    information: (k, n, n) of them, one over their units squared. misfit: (k,), half the square of what they leave, in
    deviations. worth: nats by which they explain the motion. nonsense: nats that it costs to follow no wiring.
    """

    axis: int
    gains: Array
    information: Array
    misfit: Array
    worth: float
    nonsense: float


def axis_responses(samples: Sequence[Samples]) -> list[AxisResponse]:
    """Return what recordings with the same inputs tell of the axes whose speed they show."""
    found = [each for axis in range(6) if (each := _of_axis(samples, axis)) is not None]
    return [each for each in found if each.worth > each.gains.shape[1]]  # more than numbers of any kind explain


def likelihood_of(ways: Sequence[Wiring], found: Sequence[AxisResponse], B: Array, inertia: Array) -> Array:
    """Return the log likelihood of each way of wiring (h,).

    Args:
        B: wrench (6, n) of each input as the file has it. inertia: what is supposed of the total inertia (6,) of each
            axis [kg, kg m^2].
    """
    out = np.zeros(len(ways))
    signs = np.ones((len(ways), B.shape[1]))
    groups: dict[tuple[int, ...], list[int]] = {}
    for h, each in enumerate(ways):
        groups.setdefault(each.swapped, []).append(h)
        signs[h, list(each.turned)] = -1.0
    for response in found:
        i = response.axis
        for swapped, which in groups.items():
            out[which] += _of_wirings(response, Wiring((), swapped).matrix(B)[i] / inertia[i], signs[which])
    return out


def _of_wirings(found: AxisResponse, beta: Array, signs: Array) -> Array:
    """Return the log likelihood (h,) of what an axis says whose inputs should do beta (n,), but for signs (h, n)."""
    size = np.abs(beta).max()
    if not size > 0.0:
        return np.zeros(len(signs))
    gains, A, misfit = found.gains, found.information, found.misfit
    several = []
    for gain in _GAINS:
        g = np.exp(gain)
        does = g * beta
        weight, constant = _weight(A, (_GAIN_ERROR * does) ** 2 + (_COUPLING * g * size) ** 2)
        own = np.einsum("ki,kij,kj->k", gains, weight, gains)
        cross = (weight @ gains[:, :, None])[:, :, 0] * does
        square = weight * does[:, None] * does
        apart = own[:, None] - 2.0 * cross @ signs.T + ((signs @ square) * signs).sum(axis=2)
        several.append((constant - misfit)[:, None] - 0.5 * apart - 0.5 * (gain / _GAIN) ** 2)
    follows = np.max(several, axis=(0, 1))
    weight, constant = _weight(A, np.full(beta.shape, (2.0 * size) ** 2))
    own = np.einsum("ki,kij,kj->k", gains, weight, gains)
    nonsense = float(np.max(constant - misfit - 0.5 * own)) - found.nonsense
    return np.asarray(np.logaddexp(follows, nonsense))


def _weight(A: Array, spread: Array) -> tuple[Array, Array]:
    """Return (A^-1 + P)^-1 (k, n, n) and -ln |I + A P| / 2 (k,) for P = diag(spread); A (k, n, n) may be singular."""
    told = np.einsum("kii->ki", A * spread).max(axis=1)
    A = A * np.minimum(1.0, _MOST_TOLD / np.maximum(told, 1.0))[:, None, None]  # numbers end where sensors do not
    with_it = np.eye(spread.size) + A * spread
    return np.asarray(np.linalg.solve(with_it, A)), np.asarray(-0.5 * np.linalg.slogdet(with_it)[1])


def _of_axis(samples: Sequence[Samples], axis: int) -> AxisResponse | None:
    """Return what the speed along an axis tells; None where it is not shown over two windows at least.

    Windows are as long as there are enough of them without a gap.
    """
    whole = [_series(each, axis) for each in samples]
    span = min(_WINDOW, max(_SHORTEST, 0.25 * sum(each.duration for each in samples)))
    windows: list[_Series] = []
    while len(windows) < 2 and span >= _SHORTEST:
        windows = [part for series in whole for part in _windows(series, round(span / _STEP))]
        span *= 0.5
    if len(windows) < 2:
        return None
    some = np.unique(np.linspace(0, len(windows) - 1, _MOST).astype(np.int64))
    held = axis in (3, 4) and samples[0].commands
    return _fitted(_Series(*(np.array(each)[some] for each in zip(*windows, strict=True))), axis, held=held)


def _windows(series: _Series, span: int) -> list[_Series]:
    """Return windows of so many steps without a gap, one after the other, each with the forces before it."""
    out, first = [], _LATEST
    while first + span <= series.motion.size:
        part = _Series(series.motion[first : first + span], series.force[first - _LATEST : first + span])
        lacking = np.flatnonzero(~np.isfinite(part.motion))
        if lacking.size:
            first += int(lacking[-1]) + 1
        else:
            if np.isfinite(part.force).all():
                out.append(part)
            first += span
    return out


def _fitted(series: _Series, axis: int, *, held: bool) -> AxisResponse:
    """Return what motion (w, m) tells of the gains of each force (w, d + m, n), start and mean taken out.

    What is left of a first fit is an autoregression, by which everything is made white before the second.
    """
    motion, force = series
    m = motion.shape[1]
    bank = [(time, 0.0) for time in _TIMES]
    if axis in (3, 4):
        bank += [(time, swing) for time in _DAMPED for swing in _SWINGS]
    spectra = np.fft.rfft([force[:, _LATEST - delay :][:, :m] for delay, _ in _DELAYS], 2 * m + 2, axis=2)

    def made(time: float, swing: float) -> tuple[Array, Array]:  # for all delays at once, and what moves freely
        pushed, starts = _response(time, swing, m)
        lagged = np.fft.rfft([_lagged(pushed, lag) for _, lag in _DELAYS], 2 * m + 2)[:, None, :, None]
        free = np.concatenate([starts[:m], np.ones((m, 1))], axis=1)
        return np.fft.irfft(spectra * lagged, 2 * m + 2, axis=2)[:, :, :m], free

    fits = [_least_squares(motion, *made(*each), np.zeros(0)) for each in bank]
    i, j = min(np.ndindex(len(fits), len(_DELAYS)), key=lambda at: fits[at[0]][at[1]].share)
    y, free = made(*bank[i])
    memory = _autoregression(_without(motion - y[j] @ fits[i][j].gains, np.linalg.qr(free)[0]))
    fits = [_least_squares(motion, *made(*each), memory) for each in bank]
    kept = sorted((fit for each in fits for fit in each), key=lambda fit: fit.share)[:_KEPT]
    used = (force.shape[2] + motion.shape[0] * free.shape[1]) / motion.size
    samples = motion.shape[0] * _independent(kept[0].left) * max(1.0 - used, 0.1)
    explained = float(kept[0].gains @ kept[0].products @ kept[0].gains)
    noise = max(kept[0].square + _ROUGH**2 * explained, 1e-300) / samples
    return AxisResponse(
        axis,
        gains=np.array([fit.gains for fit in kept]),
        information=np.array([fit.products for fit in kept]) / noise,
        misfit=0.5 * np.array([fit.square for fit in kept]) / noise,
        worth=-0.5 * samples * float(np.log(max(kept[0].share, 1e-9))),
        nonsense=_HELD if held else _NONSENSE,
    )


def _lagged(kernel: Array, lag: float) -> Array:
    """Return what a step of force leaves (m,) where it comes through a first-order lag [s]."""
    if not lag:
        return kernel
    share = (1.0 - np.exp(-_STEP / lag)) * np.exp(-_STEP / lag * np.arange(kernel.size))
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


def _least_squares(motion: Array, y: Array, free: Array, memory: Array) -> list[_Fit]:
    """Return what makes motion (w, m) of each of y (d, w, m, n) and of what a start and a mean do (m, k)."""
    d, w, m, n = y.shape
    basis = np.linalg.qr(_white(free[None], memory)[0])[0]
    v, white = _without(_white(motion, memory), basis), _white(y.reshape(d * w, m, n), memory)
    white = (white - basis @ (basis.T @ white)).reshape(d, v.size, n)
    turned = white.transpose(0, 2, 1)
    S = turned @ white
    gains = (np.linalg.pinv(S, rcond=_ALONE, hermitian=True) @ (turned @ v.ravel())[:, :, None])[:, :, 0]
    left = v - (white @ gains[:, :, None]).reshape(d, *v.shape)
    squares, whole = (left**2).sum(axis=(1, 2)), max(float((v**2).sum()), 1e-300)
    found = zip(gains, S, left, squares.tolist(), (squares / whole).tolist(), strict=True)
    return [_Fit(*each) for each in found]


def _without(x: Array, basis: Array) -> Array:
    """Return x (w, m) less what an orthonormal basis (m, k) can make of it."""
    return np.asarray(x - x @ basis @ basis.T)


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


@lru_cache(64)
def _response(time: float, swing: float, m: int) -> tuple[Array, Array]:
    """Return the speed at m + 1 instants after a step of force (m + 1,), and after a start (m + 1, k)."""
    whole = expm(_STEP * np.array([[-1.0 / time, -(swing**2), 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    A, b = whole[:2, :2], whole[:2, 2]
    powers = np.empty((m + 1, 2, 2))
    powers[0] = np.eye(2)
    for k in range(m):
        powers[k + 1] = A @ powers[k]
    pushed = np.concatenate([np.zeros((1, 2)), powers[:m] @ b])
    return pushed[:, 0], powers[:, 0, : 2 if swing else 1]  # a start of speed 1, and of place 1 where it is righted


class _Series(NamedTuple):
    """At regular instants: speed (m,), NaN where unknown, and mean forces (m, n) from each to the next."""

    motion: Array
    force: Array


def _series(samples: Samples, axis: int) -> _Series:
    nothing = _Series(np.zeros(0), np.zeros((0, samples.B.shape[1])))
    if len(samples) < 2 or samples.input_t.size == 0:
        return nothing
    t, speed = _speed(samples, axis)
    grid = samples.t[0] + _STEP * np.arange(int(samples.duration / _STEP))
    if t.size < 2 or grid.size < 2:
        return nothing
    v = np.interp(grid, t, speed, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(t, grid), 1, t.size - 1)
    v[t[after] - t[after - 1] > _CLOSE] = np.nan
    return _Series(v, _held(grid, samples.input_t, samples.input_force))


def _held(grid: Array, t: Array, force: Array) -> Array:
    """Return the means (m, n) of forces (k, n), each held until the next, from each instant to the next."""
    edges = np.append(grid, grid[-1] + _STEP)
    done = np.concatenate([np.zeros((1, force.shape[1])), np.cumsum(np.diff(t)[:, None] * force[:-1], axis=0)])
    last = np.clip(np.searchsorted(t, edges, "right") - 1, 0, t.size - 1)
    integral = done[last] + force[last] * (edges - t[last])[:, None]
    out = np.diff(integral, axis=0) / _STEP
    out[grid < t[0]] = np.nan
    return np.asarray(out)


def _speed(samples: Samples, axis: int) -> tuple[Array, Array]:
    """Return times and speeds, measured or from the pose."""
    values = samples.values
    known = np.isfinite(values[:, 6 + axis])
    if known.any():
        return samples.t[known], values[known, 6 + axis]
    needed = slice(0, 6) if axis < 3 else slice(3, 6)
    posed = np.flatnonzero(np.isfinite(values[:, needed]).all(axis=1))
    t = samples.t[posed]
    apart = max(1, round(_STEP / max(float(np.median(np.diff(t))), 1e-6))) if t.size > 1 else 1
    t, pose = t[::apart], values[posed[::apart], :6]
    if t.size < 3:
        return np.zeros(0), np.zeros(0)
    pose = np.column_stack([pose[:, :3], np.unwrap(pose[:, 3:], axis=0)])
    rate = (pose[2:] - pose[:-2]) / (t[2:] - t[:-2])[:, None]
    speed = velocity_of_pose(pose[1:-1], rate, np.full((len(rate), 6), np.nan))[:, axis]
    fine = np.isfinite(speed)
    return t[1:-1][fine], speed[fine]
