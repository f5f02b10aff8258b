"""What a log shows before it is learned: which axes follow the inputs, after which delay, and what it will make known.

For the first no vehicle is needed. For each axis the acceleration is regressed on the inputs
(each and its square with its sign, since thrust is about quadratic in the command) and on everything else that moves a
vehicle: speeds, their squares and products, gravity; all sides through the same first-order filter. Where speeds were
not measured they are derived from the pose, which needs one more filter. The delay is the one that leaves the least
unexplained; the share that the inputs explain says whether the axis was driven at all.

What it will make known is what a learning of its liveliest stretches knows. Deviations fall with the time learned from,
so the whole recording makes known at least as much.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.identification.data.samples import Samples, Sources, held_forces
from towtank.identification.least_squares.batch import DelayCost, scan_delay
from towtank.identification.least_squares.chain import uses_commands
from towtank.identification.posterior.assembly import LogLearning
from towtank.identification.posterior.estimate import Learned
from towtank.identification.posterior.wording import phrase, role, will_be_known
from towtank.recording import Grid
from towtank.recording.frames.pose_rates import velocity_of_pose
from towtank.vehicle import Vehicle, configuration_matrix, index, unit

__all__ = [
    "DRIVEN",
    "MOST_ROWS",
    "PredictedAccuracy",
    "best_excited",
    "driven_axes",
    "driven_by",
    "first_look",
    "predicted_accuracies",
]

DERIVED_CORNER = 12.0  # 1/s, of the low-pass that a derived speed needs
_CUT = 7.0  # times the median deviation from the running mean
DRIVEN = 0.3  # share explained from which an axis counts as driven
_SLOW = 8.0  # 1/s, to tell whether an axis follows the inputs
_QUICK = 40.0  # 1/s, to tell the delay: a slow filter lets what is not modelled pull it to zero
_LEAK = 0.1  # 1/s, of the integral of the speed that stands for the angle
_LONGEST = 0.4  # s
_ROWS_SHOWN = 60_000
_FEW = 100
_BLOCKS = 64  # of time, for the deviation of the delay
_INDEPENDENT = 1e-9
_LENGTH = 0.3  # m that makes a force of a moment
MOST_ROWS = 9_000  # of a recording that are learned from to say what it will make known,
_STRETCHES = 6  # cut into so many where there are more
_MAY_BE_NOTHING = 25.0  # %, above which a term that may as well be 0 is given in its own unit


def lowpass(x: Array, dt: float, a: float) -> Array:
    """Pass x (n,) or its columns (n, k) through a / (s + a), from rest at the first row."""
    from scipy.signal import lfilter  # slow to import, seldom needed

    keep = np.exp(-a * dt)
    if not len(x):
        return x
    smooth, _ = lfilter([1.0 - keep], [1.0, -keep], x, axis=0, zi=keep * x[:1])
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
    if not absent.any() or len(grid) < 3:
        return measured
    derived = velocity_of_pose(grid.pose, np.gradient(grid.pose, grid.dt, axis=0), grid.velocity)
    for i in np.flatnonzero(absent & np.isfinite(derived).any(axis=0)):
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
    nu = speeds(grid)[:_ROWS_SHOWN]
    partly = np.isfinite(nu).any(axis=0) & (np.array(sources.velocity) == "absent")  # by depth or single angles
    look = _looked(grid, np.where(partly, np.nan, nu), sources, 2 if "derived" in sources.velocity else 0)
    if not partly.any():
        return look
    more = _looked(grid, nu, sources, 2)
    shares = tuple(b if part else a for a, b, part in zip(look.explained, more.explained, partly, strict=True))
    return replace(more if look.delay is None else look, explained=shares)


def _looked(grid: Grid, nu: Array, sources: Sources, passes: int) -> FirstLook:
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
        acceleration = self.a * (whole - lowpass(whole, dt, self.a))
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


def driven_axes(samples: Sequence[Samples], share: float = 0.02) -> tuple[bool, ...]:
    """Return whether the inputs drive each axis (6,): by a share of the largest force or moment at least."""
    forces = [each.input_force @ each.B.T for each in samples if len(each)]
    sizes = [np.nanstd(each, axis=0) for each in forces if np.isfinite(each).any()]
    return driven_by(np.max(sizes, axis=0, initial=0.0), share)


def driven_by(sizes: Array, share: float = 0.02) -> tuple[bool, ...]:
    """Return whether forces and moments (6,) of these sizes drive each axis: by a share of the largest at least."""
    forces = sizes / np.array([1.0] * 3 + [_LENGTH] * 3)
    return tuple(bool(force > 0.0 and force >= share * forces.max()) for force in forces)


@dataclass(frozen=True)
class PredictedAccuracy:
    """One coefficient: to how many percent it will be known (inf: not), its deviation in its own unit, a sentence."""

    percent: float
    std: float
    unit: str
    text: str


def predicted_accuracies(learning: LogLearning) -> dict[str, PredictedAccuracy]:
    """Return the accuracies of what was identified; an added inertia counts with the rigid body's."""
    known = [each for each in learning.estimate.coefficients if each.identified]
    return {each.name: _accuracy(learning.vehicle, each, [other.name for other in known]) for each in known}


def _accuracy(vehicle: Vehicle, known: Learned, names: list[str]) -> PredictedAccuracy:
    kind, i, j = index(known.name)
    size = abs(float(vehicle.rigid_body_matrix[i, j]) - known.value if kind == "mass" else known.value)
    percent = 100.0 * known.std / size if size > 0.0 else np.inf
    text = will_be_known(phrase(known.name, names), percent)
    if percent > _MAY_BE_NOTHING and role(known.name).kind in ("restoring", "constant", "coupling"):
        text = f"{phrase(known.name)} will be known to {known.std:.2g} {unit(known.name)}"
    return PredictedAccuracy(percent, known.std, unit(known.name), text)


def best_excited(grid: Grid, vehicle: Vehicle, rows: int = MOST_ROWS) -> tuple[tuple[float, float], ...]:
    """Return the stretches (start, end) [s], of so many rows in all, in which the thrusters do the most on each axis;
    one that spans the grid where it has no more rows than that.
    """
    n = len(grid)
    if n <= rows:
        return ((float(grid.t[0]), float(grid.t[-1])),)
    wrench = grid.wrench
    if uses_commands(vehicle, grid):
        wrench = held_forces(vehicle, grid.commands, None) @ configuration_matrix(vehicle).T
    long = rows // _STRETCHES
    done = np.vstack([np.zeros(6), np.cumsum(np.nan_to_num(wrench) ** 2, axis=0)])
    inside = done[long:] - done[:-long]
    taken: list[int] = []
    for axis in range(6):
        free = np.all([np.abs(np.arange(len(inside)) - first) >= long for first in taken], axis=0)
        score = np.where(free, inside[:, axis], -1.0)[: n - long]
        if score.max() > 0.0:
            taken.append(int(np.argmax(score)))
    return tuple((float(grid.t[first]), float(grid.t[first + long])) for first in sorted(taken or [0]))
