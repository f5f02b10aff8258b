"""What a log shows before anything is learned: which axes follow the inputs, after which delay, and with which sign.

Which axes, and the delay, need no vehicle (`first_look`). For each axis the acceleration is regressed on the inputs
(each and its square with its sign, since thrust is about quadratic in the command) and on everything else that moves a
vehicle: speeds, their squares and products, gravity; all sides through the same first-order filter. Where speeds were
not measured they are derived from the pose, which needs one more filter. The delay is the one that leaves the least
unexplained; the share that the inputs explain says whether the axis was driven at all.

The sign needs the vehicle's thrusters (`reversals`): one may be wired or placed on the wrong side, or a frame be
mirrored. One axis at a time, a speed is what inertia, damping and, in roll and pitch, a righting moment make of the
force,

    v' = -v / T - w^2 x + g F(t - d),   x' = v,

over windows with a start and a mean of their own, for a bank of time constants T, frequencies w and delays d. The share
of the speed's square that this explains is compared for g > 0 and for g < 0. Nothing else turns a force round: an axis
is called reversed where g < 0 explains much and g > 0 next to nothing, in the first half of the data and in the second.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from towtank.core.arrays import Array
from towtank.core.attitude import euler_rates_matrix, rotation_from_euler
from towtank.identification.data.samples import Samples, Sources
from towtank.identification.least_squares.batch import DelayCost, scan_delay
from towtank.identification.posterior.wording import reversed_force
from towtank.recording import Grid
from towtank.recording.frames.rotations import conjugate, rotate
from towtank.vehicle import Vehicle, configuration_matrix

__all__ = ["DRIVEN", "driven_axes", "first_look", "mirrored", "reversals"]

DERIVED_CORNER = 12.0  # 1/s, of the low-pass that a derived speed needs
_CUT = 7.0  # times the median deviation from the running mean
DRIVEN = 0.3  # share explained from which an axis counts as driven
_SLOW = 8.0  # 1/s, to tell whether an axis follows the inputs
_QUICK = 40.0  # 1/s, to tell the delay: a slow filter lets what is not modelled pull it to zero
_LEAK = 0.1  # 1/s, of the integral of the speed that stands for the angle
_LONGEST = 0.4  # s
_MOST_ROWS = 60_000
_FEW = 100
_BLOCKS = 64  # of time, for the deviation of the delay
_INDEPENDENT = 1e-9
_STEP = 0.1  # s
_WINDOW, _SHORTEST, _MOST = 20.0, 5.0, 60  # s, s; windows used, spread evenly
_TIMES = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8)  # s
_SWINGS, _DAMPED = (0.5, 1.0, 2.0, 4.0, 8.0), (0.2, 0.8, 3.2)  # rad/s, and s, of what is righted
_DELAYS = (0, 1, 2, 4)  # steps
_MUCH, _NOTHING = 0.3, 0.3  # share that g < 0 must explain; of that, what g > 0 may explain
_CLOSE = 0.5  # s over which a speed is interpolated
_COMMANDED = 0.2  # of the largest force or moment: below it the motion may come from another axis
_LEVEL = 0.05  # cosine of pitch above which Euler angles give rates
_LENGTH = 0.3  # m that makes a force of a moment


def lowpass(x: Array, dt: float, a: float) -> Array:
    """Pass x (n,) or its columns (n, k) through a / (s + a), from rest at the first row."""
    from scipy.signal import lfilter  # slow to import, seldom needed

    keep = np.exp(-a * dt)
    start = keep * x[:1] if x.ndim == 2 else keep * x[0]
    smooth, _ = lfilter([1.0 - keep], [1.0, -keep], x, axis=0, zi=np.atleast_1d(start))
    return np.asarray(smooth)


def filled(x: Array) -> Array:
    """Return x (n,) with its NaN interpolated; zeros where it has no value."""
    finite = np.isfinite(x)
    rows = np.arange(x.size)
    return np.interp(rows, rows[finite], x[finite]) if finite.any() else np.zeros(x.size)


def speeds(grid: Grid) -> Array:
    """Return u v w p q r (n, 6), measured, or else derived from the pose by central differences; NaN if unknown."""
    measured = np.array(grid.velocity)
    absent = ~np.isfinite(measured).any(axis=0)
    if not absent.any() or not grid.attitude_known.any() or len(grid) < 3:
        return measured
    phi, theta = grid.pose[:, 3], grid.pose[:, 4]
    rates = np.gradient(grid.pose, grid.dt, axis=0)
    p, q, r = rates[:, 3], rates[:, 4], rates[:, 5]
    turning = np.column_stack(
        [
            p - r * np.sin(theta),
            q * np.cos(phi) + r * np.cos(theta) * np.sin(phi),
            r * np.cos(theta) * np.cos(phi) - q * np.sin(phi),
        ]
    )
    derived = np.hstack([rotate(conjugate(grid.quaternion), rates[:, :3]), turning])
    for i in np.flatnonzero(absent):
        measured[:, i] = _without_jumps(derived[:, i], grid.dt)
    return measured


def _without_jumps(speed: Array, dt: float) -> Array:
    """Return a derived speed (n,) with the spikes that a jump of the pose makes cut to its running mean."""
    whole = filled(speed)
    limit = _CUT * float(np.median(np.abs(whole - lowpass(whole, dt, DERIVED_CORNER))))
    for _ in range(2):
        mean = lowpass(whole, dt, DERIVED_CORNER)
        whole = np.clip(whole, mean - limit, mean + limit)
    return np.where(np.isfinite(speed), whole, np.nan)


@dataclass(frozen=True)
class FirstLook:
    """What a log shows of its inputs.

    Attributes:
        delay, delay_std: [s]; None without a driven axis, the deviation NaN where it cannot be told.
        explained: per axis the share 0 .. 1 of its acceleration that inputs explain, NaN where its speed is unknown.
    """

    delay: float | None
    delay_std: float | None
    explained: tuple[float, ...]
    sources: Sources


def first_look(grid: Grid) -> FirstLook:
    """Return what a grid with inputs (commands, else a wrench) shows."""
    sources = Sources.of(grid.pose, grid.velocity, grid.acceleration)
    nu = speeds(grid)[:_MOST_ROWS]
    passes = 2 if "derived" in sources.velocity else 0
    slow = _Motion(grid, nu, _SLOW, passes)
    at_once = slow.explained(0.0)
    driven = {i for i in range(6) if at_once[i] > DRIVEN}
    if not driven:
        return FirstLook(None, None, tuple(at_once), sources)
    quick = _Motion(grid, nu, _QUICK, passes)
    scan = scan_delay(lambda delay: quick.misfit(delay, driven), _LONGEST)
    return FirstLook(float(scan.delay), float(scan.std), tuple(slow.explained(scan.delay)), sources)


class _Motion:
    """The motion of a grid through one filter, with one set of columns for all axes."""

    def __init__(self, grid: Grid, nu: Array, a: float, passes: int) -> None:
        self.grid, self.nu, self.a, self.passes = grid, nu, a, passes
        self.rows = nu.shape[0]

    def _filtered(self, x: Array) -> Array:
        for _ in range(self.passes):
            x = lowpass(x, self.grid.dt, DERIVED_CORNER)
        return lowpass(x, self.grid.dt, self.a)

    def inputs(self, delay: float) -> Array:
        """Return what the inputs may do over each step (n-1, k), `delay` [s] after their stamps."""
        grid = self.grid
        means = (grid.command_means(delay) if grid.command_t.size else grid.wrench_means(delay))[: self.rows - 1]
        means = means[:, np.isfinite(means).any(axis=0)]
        away = np.nan_to_num(means - np.nanmedian(means, axis=0)) if means.size else means
        size = np.abs(away).max(axis=0, initial=0.0)
        away = away[:, size > 0.0] / size[size > 0.0]
        return self._filtered(np.hstack([away, away * np.abs(away)]))

    def explained(self, delay: float) -> list[float]:
        """Return per axis the share 0 .. 1 of what motion leaves open that the inputs explain; NaN where unknown."""
        inputs = self.inputs(delay)
        shares = [float("nan")] * 6
        for group in self.groups:
            for i, left, total in zip(group.axes, group.left(inputs), (group.open**2).sum(axis=0), strict=True):
                shares[i] = 1.0 - float(left / total) if total > 0.0 else 0.0
        return shares

    def misfit(self, delay: float, axes: Collection[int]) -> DelayCost:
        """Return -2 ln L of these axes for a delay [s], and its parts over blocks of time."""
        inputs = self.inputs(delay)
        total = 0.0
        blocks: list[Array] = []
        for group in self.groups:
            chosen = [axis in axes for axis in group.axes]
            if any(chosen):
                squares = group.residual(inputs)[:, chosen] ** 2
                n, left = squares.shape[0], np.maximum(squares.sum(axis=0), 1e-300)
                total += n * float(np.log(left).sum())
                edges = np.linspace(0, n, _BLOCKS + 1).astype(np.intp)[:-1]
                blocks += list((n / left * np.add.reduceat(squares, edges, axis=0)).T)
        return DelayCost(total, blocks)

    @cached_property
    def groups(self) -> list[_Group]:
        """The known axes of u v w p q r, those with the same rows together."""
        dt = self.grid.dt
        whole = np.column_stack([filled(self.nu[:, i]) for i in range(6)])
        for _ in range(self.passes):
            whole = lowpass(whole, dt, DERIVED_CORNER)
        smooth = lowpass(whole, dt, self.a)
        acceleration = self.a * (whole - smooth)
        pairs = [whole[:, i] * whole[:, j] for i in range(6) for j in range(i)]
        columns = [whole, whole * np.abs(whole), np.column_stack(pairs), lowpass(whole, dt, _LEAK)]
        if self.grid.tilt_known.any():
            phi, theta = (filled(self.grid.pose[: self.rows, j]) for j in (3, 4))
            columns.append(np.column_stack([np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)]))
        beside = np.hstack([lowpass(np.hstack(columns), dt, self.a), np.ones((self.rows, 1))])
        settled = np.arange(self.rows) * dt > 3.0 / min(self.a, DERIVED_CORNER)
        finite = np.isfinite(self.nu)
        known = finite[:-1] & finite[1:] & settled[:-1, None]
        alike: dict[bytes, list[int]] = {}
        for i in range(6):
            if known[:, i].sum() > max(_FEW, 2 * beside.shape[1]):
                alike.setdefault(known[:, i].tobytes(), []).append(i)
        return [
            _Group.of(tuple(axes), acceleration[1:, axes], beside[:-1], known[:, axes[0]]) for axes in alike.values()
        ]


@dataclass(frozen=True)
class _Group:
    """Axes with the same rows: which, the rows that count (n-1,), what the motion alone leaves of their accelerations
    (m, axes), and an orthonormal basis (m, k) of what the motion explains."""

    axes: tuple[int, ...]
    known: NDArray[np.bool_]
    open: Array
    basis: Array

    @classmethod
    def of(cls, axes: tuple[int, ...], acceleration: Array, beside: Array, known: NDArray[np.bool_]) -> _Group:
        y, columns = acceleration[known], beside[known]
        size = np.linalg.norm(columns, axis=0)
        u, s, _ = np.linalg.svd(columns[:, size > 0.0] / size[size > 0.0], full_matrices=False)
        basis = u[:, s > _INDEPENDENT * s[0]]
        return cls(axes, known, y - basis @ (basis.T @ y), basis)

    def left(self, inputs: Array) -> Array:
        """Return the sum of squares (axes,) that inputs (n-1, k) and motion together leave."""
        return np.asarray((self.residual(inputs) ** 2).sum(axis=0))

    def residual(self, inputs: Array) -> Array:
        """Return what inputs (n-1, k) and motion together leave (m, axes)."""
        columns = inputs[self.known]
        columns = columns - self.basis @ (self.basis.T @ columns)
        theta = np.linalg.lstsq(columns.T @ columns, columns.T @ self.open, rcond=_INDEPENDENT)[0]
        return np.asarray(self.open - columns @ theta)


class _Explained(NamedTuple):
    """Share of the speed's square that one sign explains, and the products of both in either half of the data."""

    share: float = 0.0
    early: float = 0.0
    late: float = 0.0


@dataclass(frozen=True)
class Reversal:
    """An axis (0 .. 5) whose commanded force acts with the opposite sign.

    Attributes:
        reversed_share, share: of the square of the speed, explained with the sign reversed and as it is.
    """

    axis: int
    reversed_share: float
    share: float

    @property
    def text(self) -> str:
        """It in plain words."""
        return reversed_force(self.axis, self.reversed_share, self.share)


def driven_axes(samples: Sequence[Samples], share: float = 0.02) -> tuple[bool, ...]:
    """Return whether the inputs drive each axis (6,): by a share of the largest force or moment at least."""
    forces = np.array([_force_size(samples, i) for i in range(6)]) / np.array([1.0] * 3 + [_LENGTH] * 3)
    return tuple(bool(force > 0.0 and force >= share * forces.max()) for force in forces)


def reversals(samples: Sequence[Samples]) -> tuple[Reversal, ...]:
    """Return the axes on which the recordings speak for the opposite sign."""
    commanded = np.flatnonzero(driven_axes(samples, _COMMANDED))
    return tuple(each for each in (_reversal(samples, int(i)) for i in commanded) if each is not None)


def mirrored(vehicle: Vehicle, axes: Sequence[int]) -> Vehicle | None:
    """Return the vehicle with its thrusters moved so that their wrench is reversed on these axes.

    None where no place of a thruster does that (the moment of a force is perpendicular to it).
    """
    B = configuration_matrix(vehicle)
    B[list(axes)] *= -1.0
    thrusters = []
    for k, thruster in enumerate(vehicle.thrusters):
        before = np.array(thruster.direction)
        force, moment = B[:3, k], B[3:, k]
        along = float(np.dot(before, thruster.position))
        place = np.cross(force, moment) + along * force
        where = {"position": tuple(float(x) for x in place + 0.0), "direction": tuple(float(x) for x in force + 0.0)}
        thrusters.append(thruster.model_copy(update=where))
    out = vehicle.model_copy(update={"thrusters": tuple(thrusters)})
    return out if np.allclose(configuration_matrix(out), B, atol=1e-9) else None


def _force_size(samples: Sequence[Samples], axis: int) -> float:
    return max((float(np.nanstd(each.input_force @ each.B[axis])) for each in samples if len(each)), default=0.0)


def _reversal(samples: Sequence[Samples], axis: int) -> Reversal | None:
    """Return what speaks for the opposite sign on an axis; None where nothing does, or it cannot be told."""
    speeds, forces = _windows(samples, axis)
    if len(speeds) < 2:
        return None
    best = {1: _Explained(), -1: _Explained()}
    bank = [(time, 0.0) for time in _TIMES]
    if axis in (3, 4):
        bank += [(time, swing) for time in _DAMPED for swing in _SWINGS]
    for time, swing in bank:
        for delay in _DELAYS:
            cross, power, square = _sums(speeds, forces, time, swing, delay)
            total = float(square.sum())
            if not total > 0.0 or not power.sum() > 0.0:
                continue
            middle = len(cross) // 2
            share = float(cross.sum() ** 2 / (power.sum() * total))
            sign = 1 if cross.sum() > 0.0 else -1
            if share > best[sign].share:
                best[sign] = _Explained(share, float(cross[:middle].sum()), float(cross[middle:].sum()))
    against, along = best[-1], best[1]
    wrong = against.share >= _MUCH and along.share <= _NOTHING * against.share
    if wrong and against.early < 0.0 and against.late < 0.0:
        return Reversal(axis, against.share, along.share)
    return None


def _windows(samples: Sequence[Samples], axis: int) -> tuple[list[Array], list[Array]]:
    """Return speeds (m,) and forces (m,) of windows in which both are known, spread evenly."""
    speeds: list[Array] = []
    forces: list[Array] = []
    for each in samples:
        v, f = _series(each, axis)
        span = round(min(_WINDOW, max(_SHORTEST, 0.25 * each.duration)) / _STEP)
        for first in range(0, v.size - span + 1, span):
            part = slice(first, first + span)
            if np.isfinite(v[part]).all() and np.isfinite(f[part]).all():
                speeds.append(v[part])
                forces.append(f[part])
    if len(speeds) < 2:
        return speeds, forces
    some = np.unique(np.linspace(0, len(speeds) - 1, _MOST).astype(np.int64))
    return [speeds[k] for k in some], [forces[k] for k in some]


def _sums(
    speeds: Sequence[Array], forces: Sequence[Array], time: float, swing: float, delay: int
) -> tuple[Array, Array, Array]:
    """Return y v, y^2 and v^2 of each window (w,), y the speed that the force makes; start and mean taken out."""
    out = np.zeros((3, len(speeds)))
    whole = expm(_STEP * np.array([[-1.0 / time, -(swing**2), 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    A, b = whole[:2, :2], whole[:2, 2]
    n = max(v.size for v in speeds)
    alone = np.zeros((n + 1, 2))  # speed after k steps of a start with speed 1, and of one with x = 1: A^k, first row
    alone[0, 0] = 1.0
    for k in range(n):
        alone[k + 1] = alone[k] @ A
    stepped = np.concatenate([[0.0], alone[:n] @ b])  # and after a step of force
    for k, (v, f) in enumerate(zip(speeds, forces, strict=True)):
        late = np.concatenate([np.full(delay, f[0]), f[: f.size - delay]])
        y = np.convolve(late, stepped[: v.size])[: v.size]
        free = np.linalg.qr(np.column_stack([np.ones(v.size), alone[: v.size, : 2 if swing else 1]]))[0]
        y, v = y - free @ (free.T @ y), v - free @ (free.T @ v)
        out[:, k] = y @ v, y @ y, v @ v
    return out[0], out[1], out[2]


def _series(samples: Samples, axis: int) -> tuple[Array, Array]:
    """Return the speed (m,) at regular instants, NaN where unknown, and the mean force (m,) from each to the next."""
    if len(samples) < 2:
        return np.zeros(0), np.zeros(0)
    grid = samples.t[0] + _STEP * np.arange(int(samples.duration / _STEP))
    t, speed = _speed(samples, axis)
    if t.size < 2 or grid.size < 2:
        return np.zeros(0), np.zeros(0)
    v = np.interp(grid, t, speed, left=np.nan, right=np.nan)
    after = np.clip(np.searchsorted(t, grid), 1, t.size - 1)
    v[t[after] - t[after - 1] > _CLOSE] = np.nan
    force = samples.input_force @ samples.B[axis]
    edges = np.append(grid, grid[-1] + _STEP)
    change = np.concatenate([[0.0], np.cumsum(np.diff(samples.input_t) * force[:-1])])
    last = np.clip(np.searchsorted(samples.input_t, edges, "right") - 1, 0, force.size - 1)
    integral = change[last] + force[last] * (edges - samples.input_t[last])
    f = np.diff(integral) / _STEP
    f[grid < samples.input_t[0]] = np.nan
    return v, f


def _speed(samples: Samples, axis: int) -> tuple[Array, Array]:
    """Return times and speeds, measured or from the pose."""
    values = samples.values
    known = np.isfinite(values[:, 6 + axis])
    if known.any():
        return samples.t[known], values[known, 6 + axis]
    needed = slice(0, 6) if axis < 3 else slice(3, 6)
    posed = np.flatnonzero(np.isfinite(values[:, needed]).all(axis=1))
    t = samples.t[posed]
    if t.size < 2:
        return np.zeros(0), np.zeros(0)
    apart = max(1, round(_STEP / max(float(np.median(np.diff(t))), 1e-6)))
    t, pose = t[::apart], values[posed[::apart], :6]
    if t.size < 3:
        return np.zeros(0), np.zeros(0)
    pose = np.column_stack([pose[:, :3], np.unwrap(pose[:, 3:], axis=0)])
    rate = (pose[2:] - pose[:-2]) / (t[2:] - t[:-2])[:, None]
    out = np.empty(len(rate))
    for k, (angles, rates) in enumerate(zip(pose[1:-1, 3:], rate, strict=True)):
        if axis < 3:
            known = np.isfinite(rates[:3]).all()
            out[k] = float((rotation_from_euler(*angles).T @ rates[:3])[axis]) if known else np.nan
        elif abs(np.cos(angles[1])) > _LEVEL:
            out[k] = float(np.linalg.solve(euler_rates_matrix(angles[0], angles[1]), rates[3:])[axis - 3])
        else:
            out[k] = np.nan
    fine = np.isfinite(out)
    return t[1:-1][fine], out[fine]
