"""A recording as the nonlinear estimators take it: rows of measurements at their own times, and held inputs.

No common grid: a row is an instant at which something was measured, NaN stands for what was not. Sensors of several
rates, irregular times and gaps need nothing else. A long recording is cut into pieces, of which a few stand for the
whole; a streaming learner keeps what it has seen in a buffer for as long as it may go over it again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from towtank.core.arrays import Array
from towtank.core.attitude import eulers_from_quaternions
from towtank.errors import InputError
from towtank.recording import Recording, bind_thrusters, standard_channel, with_body_velocity
from towtank.recording.frames.conversion import wrap_angle
from towtank.recording.grids.grid import stack_held
from towtank.recording.grids.stretches import input_rows
from towtank.recording.grids.timing import check_span, quaternion_samples
from towtank.recording.standard import MEASURED, QUATERNION, WRENCH, is_command
from towtank.vehicle import Vehicle, configuration_matrix, thruster_forces

__all__ = [
    "N_MEASURED",
    "Buffer",
    "NoiseLevels",
    "Samples",
    "Sources",
    "held_forces",
    "prepared",
    "samples_of",
    "with_absent_zero",
]

N_MEASURED = len(MEASURED)
_TOGETHER, _COARSEST = 1e-6, 10.0  # s: stamps closer than this are one instant; Hz of the coarsest grid on the way
_CURRENT_WALK = 1e-3  # m/s per sqrt(s), to begin with
_JUMPS = 5.0  # times what nine in ten steps from sample to sample stay below: beyond, it is a jump
_LOOKS = 0.04, 0.6  # s between two looks at outputs, from which on it matters what they did meanwhile, and up to which
_AT_ONCE = 0.02  # s: about so long an input is held that goes on from one look to the next
_FIRST_ROWS = 1024  # room of an empty buffer


@dataclass(frozen=True, eq=False)
class Samples:
    """Measurements and inputs of one recording.

    Attributes:
        t: times (n,) [s], increasing.
        values: (n, 18) x y z phi theta psi u v w p q r ax ay az u_w v_w w_w, NaN where not
            measured; psi and phi as recorded.
        input_t: stamps (k,) [s] of the inputs. input_force: steady force that each asks for (k, m): of the thrusters,
            or the wrench itself.
        B: wrench (6, m) of each unit of input. lag: time constants (m,) [s].
        commands: whether the inputs are thruster commands. source: for messages.
    """

    t: Array
    values: Array
    input_t: Array
    input_force: Array
    B: Array
    lag: Array
    commands: bool
    source: str = ""

    def __len__(self) -> int:
        return int(self.t.size)

    def taken(self, rows: slice, inputs: slice) -> Samples:
        """Return views of these rows and inputs."""
        return replace(
            self,
            t=self.t[rows],
            values=self.values[rows],
            input_t=self.input_t[inputs],
            input_force=self.input_force[inputs],
        )

    def stretch(self, first: int, last: int) -> Samples:
        """Return views of the rows [first, last) with the inputs that matter to them, one at least."""
        inputs = input_rows(self.input_t, float(self.t[first]), float(self.t[last - 1]))
        return self.taken(slice(first, last), slice(inputs.start, max(inputs.stop, inputs.start + 1)))

    @property
    def _new_inputs(self) -> NDArray[np.bool_]:
        """Which inputs (k,) are not what the one before was."""
        return np.append(True, np.any(self.input_force[1:] != self.input_force[:-1], axis=1))[: self.input_t.size]

    @property
    def input_period(self) -> float:
        """Usual time [s] between two inputs that differ, 0 where there are none: a table may repeat what was seen."""
        t = self.input_t[self._new_inputs]
        return float(np.median(np.diff(t))) if t.size > 1 else 0.0

    def between_looks(self) -> Samples:
        """Return the same with inputs that went on between two looks at them; itself where that is soon, or long.

        A logger that looks at outputs ten times in a second tells nothing of the time between, in which a pilot's hand,
        or an autopilot, moved on: by the smooth curve through what was seen that does not go beyond it (Fritsch and
        Carlson's cubic, 1980). Where nothing new was seen for longer, what was seen last was held until the last look.
        In units of what was given; of each 0.02 s or so it is the curve's exact mean that is held.
        """
        t, force, new, period = self.input_t, self.input_force, self._new_inputs, self.input_period
        if not _LOOKS[0] <= period <= _LOOKS[1]:
            return self
        since = (t - t[np.maximum.accumulate(np.where(new, np.arange(t.size), 0))]) / period
        looks = new | np.append(False, np.diff(np.floor(since + 0.1)) > 0.0)
        t, force = t[looks], force[looks]
        long = np.flatnonzero(np.diff(t) > 1.5 * period)
        t, force = np.insert(t, long + 1, t[long + 1] - period), np.insert(force, long + 1, force[long], axis=0)
        n = round(period / _AT_ONCE)
        edges = np.append((t[:-1, None] + np.diff(t)[:, None] * np.arange(n) / n).ravel(), t[-1])
        passed = PchipInterpolator(t, force).antiderivative()(edges)
        means = np.diff(passed, axis=0) / np.diff(edges)[:, None]
        return replace(self, input_t=edges, input_force=np.concatenate([means, force[-1:]]))

    def shifted(self, latency: Array) -> Samples:
        """Return the rows with each sensor's numbers at the times that they speak of: latency (6,) [s] before."""
        late = [s for s in range(latency.size) if latency[s] != 0.0 and np.any(self.measured[3 * s : 3 * s + 3])]
        if not late:
            return self
        rest = self.values.copy()
        parts = []
        for s in late:
            columns = slice(3 * s, 3 * s + 3)
            own = np.flatnonzero(np.isfinite(self.values[:, columns]).any(axis=1))
            parts.append((self.t[own] - latency[s], columns, self.values[own, columns]))
            rest[:, columns] = np.nan
        left = np.isfinite(rest).any(axis=1)
        parts.append((self.t[left], slice(0, N_MEASURED), rest[left]))
        return self._joined(parts)

    def _joined(self, parts: Sequence[tuple[Array, slice, Array]]) -> Samples:
        """Return rows of parts, times (n,), columns and numbers (n, k) of each, with those of one instant in one."""
        t, rows_of_parts = _instants([part[0] for part in parts])
        values = np.full((t.size, N_MEASURED), np.nan)
        for (_, columns, numbers), rows in zip(parts, rows_of_parts, strict=True):
            known = np.isfinite(numbers)
            place, column = np.nonzero(known)
            values[:, columns][rows[place], column] = numbers[known]
        return replace(self, t=t, values=values)

    def averaged(self, apart: float) -> Samples:
        """Return the rows with the mean of what each sensor shows in every `apart` seconds, at the mean of its times.

        Where it jumps by far more than mostly, samples stay single, for the filter to judge each. Angles wrap.
        """
        parts = []
        for k in range(0, N_MEASURED, 3):
            known = np.isfinite(self.values[:, k : k + 3])
            rows = np.flatnonzero(known.any(axis=1))
            if not rows.size:
                continue
            t, numbers, wrapped = self.t[rows], self.values[rows, k : k + 3], wrap_angle if k == 3 else np.asarray
            jumps = np.abs(np.nan_to_num(wrapped(np.diff(numbers, axis=0))))
            together = np.diff(np.floor((t - self.t[0]) / apart + 1e-6)) == 0.0
            together &= (known[rows[1:]] == known[rows[:-1]]).all(axis=1)
            if together.any():
                together &= (jumps <= _JUMPS * np.quantile(jumps[together], 0.9, axis=0)).all(axis=1)
            first = np.flatnonzero(np.concatenate([[True], ~together]))
            count = np.diff(np.append(first, rows.size))
            away = wrapped(numbers - np.repeat(numbers[first], count, axis=0))
            mean = numbers[first] + np.add.reduceat(away, first) / count[:, None]
            parts.append((np.add.reduceat(t, first) / count, slice(k, k + 3), mean))
        return self._joined(parts) if parts else self

    def thinned(self, apart: float) -> Samples:
        """Return the rows with no more of each sensor than one in every `apart` seconds."""
        values = self.values.copy()
        for k in range(0, N_MEASURED, 3):
            rows = np.flatnonzero(np.isfinite(values[:, k : k + 3]).any(axis=1))
            slots = np.floor((self.t[rows] - self.t[0]) / apart + 1e-6)
            values[rows[1:][np.diff(slots) == 0.0], k : k + 3] = np.nan
        kept = np.isfinite(values).any(axis=1)
        return replace(self, t=self.t[kept], values=values[kept])

    @property
    def recorded(self) -> Recording:
        """What is measured, as a recording: a channel for each column."""
        channels = {}
        for name, values in zip(MEASURED, self.values.T, strict=True):
            known = np.isfinite(values)
            if known.any():
                channels[name] = standard_channel(name, self.t[known], values[known])
        return Recording(channels, self.source)

    def only(self, rows: NDArray[np.intp], columns: Sequence[int]) -> Samples:
        """Return these rows (k,), with nothing in other columns than these, and all inputs."""
        values = np.full((rows.size, self.values.shape[1]), np.nan)
        for j in columns:
            values[:, j] = self.values[rows, j]
        return replace(self, t=self.t[rows], values=values)

    @property
    def duration(self) -> float:
        """From the first to the last row [s]."""
        return float(self.t[-1] - self.t[0]) if self.t.size else 0.0

    @property
    def measured(self) -> Array:
        """Which of the 18 columns are measured anywhere (18,), bool."""
        return np.asarray(np.isfinite(self.values).any(axis=0))


@dataclass(frozen=True, eq=False)
class NoiseLevels:
    """What passes carry from one to the next of all that is random, and of the water.

    noise: of the measured columns (18,). disturbance: levels (6,) [m/s^2, rad/s^2]; in what is learned [N, N m].
    velocity_walk: random walk (6,) of each speed [m/s^2 sqrt(s), rad/s^2 sqrt(s)] that no force of the model accounts
        for, NaN where nothing is known of it.
    waves: deviations (3,) [m/s] of the water's velocity in waves, north, east and down.
    currents: of r pieces (r, 6): number of the recording, when it begins and ends [s], and the current [m/s] NED that
        surely flows in it, as the last pass has found. current_walk: of the current [m/s per sqrt(s)].
    heading_bias: deviation [rad] of the bias of a heading that wanders beside a gyro, where it is larger than supposed.
    """

    noise: Array
    disturbance: Array
    velocity_walk: Array = field(default_factory=lambda: np.zeros(6))
    waves: Array = field(default_factory=lambda: np.zeros(3))
    currents: Array = field(default_factory=lambda: np.zeros((0, 6)))
    current_walk: float = _CURRENT_WALK
    heading_bias: float = 0.0

    @property
    def random(self) -> tuple[Array, Array, Array, Array]:
        """All that passes estimate: noise, disturbance, velocity walk, waves."""
        return self.noise, self.disturbance, self.velocity_walk, self.waves

    def with_random(self, noise: Array, disturbance: Array, velocity_walk: Array, waves: Array) -> NoiseLevels:
        """Return these levels with others of what is `random`."""
        return replace(self, noise=noise, disturbance=disturbance, velocity_walk=velocity_walk, waves=waves)

    def midway_to(self, other: NoiseLevels) -> NoiseLevels:
        """Return the geometric mean of both levels, in the other's currents."""
        return other.with_random(*(np.sqrt(a * b) for a, b in zip(self.random, other.random, strict=True)))

    def turning(self, last: NoiseLevels, before: NoiseLevels) -> NoiseLevels:
        """Return these levels, half way back to the `last` ones where they turn back from what these have come to."""

        def half(now: Array, then: Array, first: Array) -> Array:
            return np.where((now - then) * (then - first) < 0.0, np.sqrt(now * then), now)

        return self.with_random(*map(half, self.random, last.random, before.random))

    @property
    def heading_said(self) -> list[str]:
        """A sentence where the heading wanders, more than an attitude is supposed to."""
        wanders = math.degrees(self.heading_bias)
        return [f"the heading wanders by some {wanders:.2g}° beside the gyro, within half a minute"] if wanders else []

    def current_at(self, t: float, k: int, of: int) -> Array | None:
        """Return the current (3,) [m/s] NED at t [s] in recording k of so many, as far as one is known then.

        Recordings may each begin at 0: then it is that of the same number, if there are as many.
        """
        there = np.flatnonzero((self.currents[:, 1] <= t) & (t <= self.currents[:, 2]))
        if np.unique(self.currents[there, 0]).size > 1:
            there = there[(self.currents[there, 0] == k) & (np.unique(self.currents[:, 0]).size == of)]
        return np.array(self.currents[there[0], 3:]) if there.size else None


def with_absent_zero(wrench: Array) -> Array:
    """Return a wrench (n, 6) with the components that are nowhere recorded set to zero; all NaN stays as it is."""
    absent = ~np.isfinite(wrench).any(axis=tuple(range(wrench.ndim - 1)))
    return wrench if absent.all() else np.where(absent, 0.0, wrench)


def prepared(recording: Recording, vehicle: Vehicle) -> Recording:
    """Return a recording with its commands bound to the vehicle's thrusters and its velocity turned into the body.

    Raises:
        InputError: thrusters that the vehicle lacks.
    """
    return with_body_velocity(bind_thrusters(recording, [thruster.name for thruster in vehicle.thrusters]))


def samples_of(bound: Recording, vehicle: Vehicle) -> Samples:
    """Return the rows and inputs of a recording that is `prepared`.

    Raises:
        InputError: no motion in it, or no commands and no wrench.
    """
    prefix = f"{bound.source}: " if bound.source else ""
    columns: list[tuple[int, Array, Array]] = []
    whole = all(name in bound for name in QUATERNION)
    if whole:
        t, q = quaternion_samples(bound)
        angles = eulers_from_quaternions(q)
        columns += [(3 + j, t, angles[:, j]) for j in range(3)]
    for j, name in enumerate(MEASURED):
        if name in bound and not (whole and 3 <= j < 6):
            channel = bound[name].measured
            columns.append((j, channel.t, channel.values))
    columns = [column for column in columns if column[1].size]
    if not columns:
        raise InputError(f"{prefix}no motion in it, expected pose, velocity, rates or specific force")
    check_span([column[1] for column in columns], _COARSEST, prefix)
    t, rows = _instants([column[1] for column in columns])
    values = np.full((t.size, N_MEASURED), np.nan)
    for (j, _, measured), row in zip(columns, rows, strict=True):
        values[row, j] = measured
    del columns, rows, measured, row  # room for the inputs
    input_t, force, B, lag, commands = _inputs(bound, vehicle, prefix)
    return Samples(t, values, input_t, force, B, lag, commands, bound.source)


def held_forces(vehicle: Vehicle, commands: Array, voltage: Array | float | None) -> Array:
    """Return the steady thruster forces (..., m) of commands (..., m); NaN commands stay NaN."""
    return np.ascontiguousarray(thruster_forces(vehicle, commands, voltage))


def _instants(stamps: list[Array]) -> tuple[Array, list[Array]]:
    """Return the union (n,) of all stamps, those within a microsecond being one, and each one's rows."""
    distinct = {id(t): t for t in stamps}
    union = np.unique(np.concatenate(list(distinct.values()))) if len(distinct) > 1 else stamps[0]
    if union.size > 1:
        first = np.concatenate([[True], np.diff(union) > _TOGETHER])
        union = union[first]
    rows = {key: np.maximum(np.searchsorted(union, t + 0.5 * _TOGETHER, "right") - 1, 0) for key, t in distinct.items()}
    return np.ascontiguousarray(union), [rows[id(t)] for t in stamps]


def _inputs(recording: Recording, vehicle: Vehicle, prefix: str) -> tuple[Array, Array, Array, Array, bool]:
    names = [name for name in recording.names if is_command(name)]
    if vehicle.thrusters and names:
        ordered = [recording[f"cmd_{thruster.name}"] for thruster in vehicle.thrusters]
        t, values = stack_held(ordered)
        if t.size:
            voltage = None
            if "voltage" in recording and len(known := recording["voltage"].measured):
                voltage = np.interp(t, known.t, known.values)
            lag = np.array([thruster.time_constant for thruster in vehicle.thrusters])
            return t, held_forces(vehicle, values, voltage), configuration_matrix(vehicle), lag, True
    present = [name for name in WRENCH if name in recording and len(recording[name].measured)]
    t, known_values = stack_held([recording[name] for name in present])
    if not t.size:
        raise InputError(
            f"{prefix}neither thruster commands nor a wrench is recorded, so there is nothing to learn from; "
            "map the thrusters' columns (--map) or record X Y Z K M N"
        )
    wrench = np.zeros((t.size, 6))
    wrench[:, [WRENCH.index(name) for name in present]] = known_values
    return t, wrench, np.eye(6), np.zeros(6), False


class Buffer:
    """Rows and inputs in growing arrays, in stretches that owe nothing to each other.

    Args:
        B: wrench (6, m) of each input. lag: time constants (m,) [s]. commands: whether inputs are commands.
    """

    def __init__(self, B: Array, lag: Array, *, commands: bool) -> None:
        self.B, self.lag, self.commands = B, lag, commands
        self.t, self.values = np.empty(_FIRST_ROWS), np.empty((_FIRST_ROWS, N_MEASURED))
        self.input_t, self.input_force = np.empty(_FIRST_ROWS), np.empty((_FIRST_ROWS, B.shape[1]))
        self.rows = self.inputs = 0
        self._starts: list[tuple[int, int]] = [(0, 0)]

    def add_row(self, t: float, z: Array) -> None:
        """Add a row z (18,) of time t [s]."""
        if self.rows == self.t.size:
            self.t, self.values = _doubled(self.t), _doubled(self.values)
        self.t[self.rows], self.values[self.rows] = t, z
        self.rows += 1

    def add_input(self, t: float, force: Array) -> None:
        """Add the forces (m,) asked for from t [s] on."""
        if self.inputs == self.input_t.size:
            self.input_t, self.input_force = _doubled(self.input_t), _doubled(self.input_force)
        self.input_t[self.inputs], self.input_force[self.inputs] = t, force
        self.inputs += 1

    def fresh(self) -> Buffer:
        """Return an empty one of the same inputs."""
        return Buffer(self.B, self.lag, commands=self.commands)

    def clear(self) -> None:
        """Forget everything."""
        self.rows = self.inputs = 0
        self._starts = [(0, 0)]

    def without(self, rows: int) -> Buffer:
        """Return a copy without the first `rows`, and without the inputs that mattered to them alone."""
        kept, starts = [], []
        done = [0, 0]
        ends = [*self._starts[1:], (self.rows, self.inputs)]
        for (a, c), (b, d) in zip(self._starts, ends, strict=True):
            first, put = max(a, rows), c
            if first >= b and b < self.rows:
                continue
            if a < first < b:
                put += input_rows(self.input_t[c:d], float(self.t[first]), np.inf).start
            kept.append(self._part(min(first, b), b, put, d))
            starts.append((done[0], done[1]))
            done = [done[0] + len(kept[-1]), done[1] + kept[-1].input_t.size]
        out = self.fresh()
        out.restore(
            np.concatenate([each.t for each in kept]),
            np.concatenate([each.values for each in kept]),
            np.concatenate([each.input_t for each in kept]),
            np.concatenate([each.input_force for each in kept]),
            starts,
        )
        return out

    def break_off(self) -> None:
        """Begin a new stretch."""
        if (self.rows, self.inputs) != self._starts[-1]:
            self._starts.append((self.rows, self.inputs))

    def until(self, rows: int, inputs: int, since: tuple[int, int] = (0, 0)) -> list[tuple[bool, Samples]]:
        """Return what came from so many rows and inputs on until so many: whether it begins a new stretch, and views.

        Another thread may add to the buffer meanwhile.
        """
        out = []
        starts = [(a, c) for a, c in self._starts if a <= rows and c <= inputs]
        ends = [*starts[1:], (rows, inputs)]
        for (a, c), (b, d) in zip(starts, ends, strict=True):
            first, put = max(a, since[0]), max(c, since[1])
            if b > first or d > put:
                out.append((a >= since[0] and (a, c) != (0, 0), self._part(first, b, put, d)))
        return out

    def _part(self, a: int, b: int, c: int, d: int) -> Samples:
        room = Samples(self.t, self.values, self.input_t, self.input_force, self.B, self.lag, self.commands)
        return room.taken(slice(a, b), slice(c, d))

    @property
    def starts(self) -> list[tuple[int, int]]:
        """First row and first input of each stretch."""
        return list(self._starts)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Which of the 18 columns are measured anywhere (18,)."""
        return np.asarray(np.isfinite(self.values[: self.rows]).any(axis=0))

    @property
    def whole(self) -> Samples:
        """Everything in one, whatever its stretches."""
        return self._part(0, self.rows, 0, self.inputs)

    def restore(
        self, t: Array, values: Array, input_t: Array, input_force: Array, starts: Sequence[Sequence[int]]
    ) -> None:
        """Put in what `whole` and `starts` of another buffer gave."""
        self.t, self.values, self.input_t, self.input_force = (
            _roomy(each) for each in (t, values, input_t, input_force)
        )
        self.rows, self.inputs = t.shape[0], input_t.shape[0]
        self._starts = [(int(a), int(b)) for a, b in starts]

    @property
    def stretches(self) -> list[Samples]:
        """All stretches with rows in them; views, not copies."""
        ends = [*self._starts[1:], (self.rows, self.inputs)]
        return [self._part(a, b, c, d) for (a, c), (b, d) in zip(self._starts, ends, strict=True) if b > a]


def _roomy(array: Array) -> Array:
    out = np.empty((max(_FIRST_ROWS, 2 * array.shape[0]), *array.shape[1:]))
    out[: array.shape[0]] = array
    return out


def _doubled(array: Array) -> Array:
    out = np.empty((2 * array.shape[0], *array.shape[1:]))
    out[: array.shape[0]] = array
    return out


@dataclass(frozen=True)
class Sources:
    """Where velocity (six of "measured", "derived", "absent") and attitude ("measured", "accelerometer", "gyro")
    come from."""

    velocity: tuple[str, ...]
    attitude: str

    @classmethod
    def of(cls, pose: Array, velocity: Array, acceleration: Array) -> Sources:
        """Decide from what is finite anywhere in pose (n, 6), velocity (n, 6) and specific force (n, 3)."""
        have_pose = [bool(column.any()) for column in np.isfinite(pose).T]
        have_velocity = [bool(column.any()) for column in np.isfinite(velocity).T]
        tilt = have_pose[3] and have_pose[4]
        attitude = tilt and have_pose[5]
        kinds = []
        for i in range(6):
            if have_velocity[i]:
                kinds.append("measured")
            elif (i < 3 and attitude and all(have_pose[:3])) or (i >= 3 and attitude):
                kinds.append("derived")
            else:
                kinds.append("absent")
        if tilt:
            return cls(tuple(kinds), "measured")
        if np.isfinite(acceleration).all(axis=1).any() and kinds[3:] == ["measured"] * 3:
            return cls(tuple(kinds), "accelerometer")
        return cls(tuple(kinds), "gyro")
