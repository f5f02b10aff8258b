"""The guard: bends what the thrusters are asked for where the vehicle could no longer stop in time.

At every period of control it asks of K vehicles drawn from what is known: if the wanted forces act for one more period,
and the vehicle then brakes as hard as its thrusters can, does it stay within the limits? Limits are the walls along
x, y and z less the margin, speed, tilt and rate of turn; of each the worst twentieth of the draws counts. Where all
hold, the wanted forces pass, bit for bit. Where one does not, the smallest share of braking is found with which it
does, and only that part of the forces is bent on which the limit depends: across the wall, along the velocity, the
moments that tilt or turn. So a vehicle slides along a wall while its other axes are driven as wanted.

This is the supervision by a backup controller of Gurriet et al. (2018), "An online approach to active set invariance",
IEEE CDC, with the shares of Wabersich and Zeilinger (2021), "A predictive safety filter for learning-based control",
Automatica 129. Each drawn vehicle is braked by its own predicted state (`towtank.planning.braking`). Where all shares
together do not help, the command is led towards braking as a whole, which is what keeps walls and tilt in any case.
A share that is no longer needed falls off by a quarter a period, so that the thrusters do not switch to and fro.

A draw differs in its coefficients, the gains and lags of its thrusters, the delay of its commands, and a constant force
nobody knows. Thrust lost to inflow is left out. NED, FRD, SI. The kernels allocate nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array, kernel
from towtank.core.attitude import row_of_rotation
from towtank.core.layout import I_CONSTANT
from towtank.core.rk4 import N_STATES, has_extra_terms, is_coupled, step_into
from towtank.errors import InputError
from towtank.planning.braking import PERIOD, Bounds, Brake, brake_into, brake_of
from towtank.planning.space import Space
from towtank.vehicle import AnyVehicle, Vehicle, vehicle_of

__all__ = ["LIMITS", "Guard", "drawn_around", "guard_into", "predict_into", "scaled"]

LIMITS = ("x", "y", "z", "speed", "tilt", "turn", "all")
_N_LIMITS = 6
_PAST = 14  # commands kept: a delay of half a second
_NO_LAG = 1e-9  # s
_ROUNDING = 1e-6  # N
_WORST = 0.05  # of the draws
_HALVINGS = 5  # of the share of braking: it is found to 1/32
_RELEASE, _GONE = 0.75, 0.03  # of a share from period to period, where it is no longer needed; below this it is none
_HORIZON = 2.0  # s
_TILT_RESERVE = 0.12  # rad, kept off the limit: light vehicles tilt faster than poses and draws tell

_ADDED = ("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot")
_DAMPING = tuple(f"{a}_{v * n}" for n in (1, 2) for a, v in zip("XYZKMN", "uvwpqr", strict=True))


class Draws(NamedTuple):
    """K vehicles, the first the nominal one.

    Attributes:
        parameters: of the kernels (170, K). gains: of the thrusters (m, K), multiples of the nominal ones.
        gone: share (m, K) of the way to what is asked for that a lagged force goes in a PERIOD; mean: that it lacks on
            average meanwhile. delays: of the commands (K,) [s].
    """

    parameters: Array
    gains: Array
    gone: Array
    mean: Array
    delays: Array


class Memory(NamedTuple):
    """What changes: past commands (14, m) [N], the last first; forces of the draws (m, K) [N]; shares (7,)."""

    past: Array
    force: Array
    shares: Array


class Work(NamedTuple):
    """Scratch: states (13, K), steps (3, 13, K), wrenches (3, 6, K), forces (m, K), commands (n, m, K), and others."""

    state: Array
    step: Array
    wrench: Array
    force: Array
    commands: Array
    clear: Array
    worst: Array
    command: Array
    braking: Array
    blend: Array
    low: Array
    high: Array
    ordered: Array
    still: Array


@kernel
def _advance_into(draws: Draws, brake: Brake, memory: Memory, work: Work, i: int, force: Array) -> None:
    """Write the mean wrench of step `i` of the prediction into `work.wrench`; `force` (m, K) goes on to its end."""
    m, lanes = force.shape
    for k in range(lanes):
        whole = int(draws.delays[k] / PERIOD)
        part = draws.delays[k] / PERIOD - whole
        for a in range(6):
            work.wrench[0, a, k] = 0.0
        for j in range(m):
            now, before = i - whole, i - whole - 1
            late = work.commands[now, j, k] if now >= 0 else memory.past[-now - 1, j]
            later = work.commands[before, j, k] if before >= 0 else memory.past[-before - 1, j]
            target = draws.gains[j, k] * ((1.0 - part) * late + part * later)
            lacks = force[j, k] - target
            mean = target + draws.mean[j, k] * lacks
            force[j, k] -= draws.gone[j, k] * lacks
            for a in range(6):
                work.wrench[0, a, k] += brake.matrix[a, j] * mean
    for s in range(1, 3):
        for a in range(6):
            for k in range(lanes):
                work.wrench[s, a, k] = work.wrench[0, a, k]


@kernel
def predict_into(
    draws: Draws, bounds: Bounds, brake: Brake, memory: Memory, x: Array, first: Array, work: Work
) -> None:
    """Write into `work.clear` (6, K) how far each draw stays within each limit: forces `first`, then braking.

    Args:
        x: state (13,). first: forces asked for during the first period (m,) [N].
    """
    m, lanes = memory.force.shape
    coupled, extra = is_coupled(draws.parameters), has_extra_terms(draws.parameters)
    for k in range(lanes):
        for a in range(N_STATES):
            work.state[a, k] = x[a]
        for j in range(m):
            work.force[j, k] = memory.force[j, k]
        for c in range(_N_LIMITS):
            work.clear[c, k] = 1e9
    for i in range(work.commands.shape[0]):
        for k in range(lanes):
            if i > 0:
                brake_into(brake, work.state, work.force, k, work.command)
            for j in range(m):
                work.commands[i, j, k] = first[j] if i == 0 else work.command[j]
        _advance_into(draws, brake, memory, work, i, work.force)
        step_into(draws.parameters, work.state, work.wrench, work.still, PERIOD, work.step, coupled, extra)
        for k in range(lanes):
            first_effect = i <= int(draws.delays[k] / PERIOD) + 1
            _clearances_into(bounds, work.state, k, first_effect, work.clear)


@kernel
def _clearances_into(bounds: Bounds, x: Array, k: int, first_effect: bool, clear: Array) -> None:
    """Lower the clearances (6, K) of lane `k` to those of its state; of speed and turn at the first effect only.

    Braking lowers speed and turn, and what it does to them on the way is nobody's wish.
    """
    for a in range(3):
        clear[a, k] = min(clear[a, k], x[a, k] - bounds.lower[a], bounds.upper[a] - x[a, k])
    lean = 2.0 * math.asin(min(math.sqrt(x[4, k] ** 2 + x[5, k] ** 2), 1.0))
    clear[4, k] = min(clear[4, k], bounds.motion[1] - lean)
    if first_effect:
        speed = math.sqrt(x[7, k] ** 2 + x[8, k] ** 2 + x[9, k] ** 2)
        turn = math.sqrt(x[10, k] ** 2 + x[11, k] ** 2 + x[12, k] ** 2)
        clear[3, k] = min(clear[3, k], bounds.motion[0] - speed)
        clear[5, k] = min(clear[5, k], bounds.motion[2] - turn)


@kernel
def _worst_into(clear: Array, ordered: Array, out: Array) -> None:
    """Write of each limit the clearance that all but the worst twentieth of the draws (6, K) have into `out` (6,)."""
    lanes = clear.shape[1]
    rank = max(math.ceil(_WORST * lanes - 1e-9) - 1, 0)
    for c in range(_N_LIMITS):
        for k in range(lanes):
            j = k
            while j > 0 and ordered[j - 1] > clear[c, k]:
                ordered[j] = ordered[j - 1]
                j -= 1
            ordered[j] = clear[c, k]
        out[c] = ordered[rank]


@kernel
def _bent_into(brake: Brake, x: Array, wanted: Array, braking: Array, shares: Array, out: Array) -> None:
    """Write the wanted forces (m,), led towards those of braking by the share of each limit, into `out`."""
    m = out.shape[0]
    for j in range(m):
        out[j] = wanted[j]
    for c in range(_N_LIMITS):
        share = shares[c]
        if share == 0.0:
            continue
        if c == 4:
            for a in range(2):
                d = 0.0
                for j in range(m):
                    d += brake.matrix[3 + a, j] * (braking[j] - wanted[j])
                # as far as the shares before have not bent it already
                before = 0.0
                for j in range(m):
                    before += brake.matrix[3 + a, j] * (out[j] - wanted[j])
                left = d - before
                for j in range(m):
                    out[j] += share * brake.tilting[j, a] * left
            continue
        if c < 3:
            nx, ny, nz = row_of_rotation(x[3:7], c)
        else:
            base = 7 if c == 3 else 10
            nx, ny, nz = x[base], x[base + 1], x[base + 2]
            size = math.sqrt(nx * nx + ny * ny + nz * nz)
            if size < 1e-9:
                continue
            nx, ny, nz = nx / size, ny / size, nz / size
        row = 3 if c == 5 else 0
        d = 0.0
        for j in range(m):
            along = nx * brake.matrix[row, j] + ny * brake.matrix[row + 1, j] + nz * brake.matrix[row + 2, j]
            d += along * (braking[j] - out[j])
        for j in range(m):
            along = nx * brake.inverse[j, row] + ny * brake.inverse[j, row + 1] + nz * brake.inverse[j, row + 2]
            out[j] += share * along * d
    for j in range(m):
        out[j] = min(max(out[j], brake.low[j]), brake.high[j])


@kernel
def _led_into(brake: Brake, x: Array, wanted: Array, braking: Array, shares: Array, out: Array) -> None:
    """Write the wanted forces (m,), bent for each limit and then led towards braking as a whole, into `out`."""
    _bent_into(brake, x, wanted, braking, shares, out)
    for j in range(out.shape[0]):
        out[j] += shares[_N_LIMITS] * (braking[j] - out[j])


@kernel
def _find_shares_into(
    draws: Draws, bounds: Bounds, brake: Brake, memory: Memory, x: Array, wanted: Array, work: Work
) -> None:
    """Raise the shares (7,) in `memory.shares` as little as makes all limits hold; to 1 where none does.

    Bisection of the shares of all limits at once; a limit that held at first takes part from when it does not. What is
    bent for one limit may harm another, as where surge tilts. So last comes the share of braking as a whole, which is
    what keeps walls and tilt in any case.
    """
    shares = memory.shares
    for c in range(_N_LIMITS):
        work.low[c], work.high[c] = shares[c], 1.0 if work.worst[c] < 0.0 else shares[c]
    for _ in range(_HALVINGS):
        for c in range(_N_LIMITS):
            shares[c] = 0.5 * (work.low[c] + work.high[c])
        _led_into(brake, x, wanted, work.braking, shares, work.blend)
        predict_into(draws, bounds, brake, memory, x, work.blend, work)
        _worst_into(work.clear, work.ordered, work.worst)
        for c in range(_N_LIMITS):
            if work.worst[c] < 0.0:
                work.low[c] = shares[c]
                if work.high[c] == shares[c]:
                    work.high[c] = 1.0
            else:
                work.high[c] = shares[c]
    for c in range(_N_LIMITS):
        shares[c] = work.high[c]
    low, high = shares[_N_LIMITS], 1.0
    for n in range(_HALVINGS + 1):
        _led_into(brake, x, wanted, work.braking, shares, work.blend)
        predict_into(draws, bounds, brake, memory, x, work.blend, work)
        _worst_into(work.clear, work.ordered, work.worst)
        if min(min(work.worst[0], work.worst[1]), min(work.worst[2], work.worst[4])) >= 0.0:
            high = shares[_N_LIMITS]
            if n == 0:
                break
        else:
            low = shares[_N_LIMITS]
        shares[_N_LIMITS] = 0.5 * (low + high)
    shares[_N_LIMITS] = high


@kernel
def _decide_into(
    draws: Draws, bounds: Bounds, brake: Brake, memory: Memory, x: Array, wanted: Array, work: Work, out: Array
) -> None:
    """Write the forces (m,) to be given into `out` and the shares of braking into `memory.shares`."""
    m, shares, rests = out.shape[0], memory.shares, True
    for c in range(_N_LIMITS + 1):
        shares[c] = _RELEASE * shares[c] if shares[c] > _GONE else 0.0
        rests = rests and shares[c] == 0.0
    for a in range(N_STATES):
        work.state[a, 0] = x[a]
    brake_into(brake, work.state, memory.force, 0, work.braking)
    _led_into(brake, x, wanted, work.braking, shares, out)
    predict_into(draws, bounds, brake, memory, x, out, work)
    _worst_into(work.clear, work.ordered, work.worst)
    holds = True
    for c in range(_N_LIMITS):
        holds = holds and work.worst[c] >= 0.0
    if not holds:
        _find_shares_into(draws, bounds, brake, memory, x, wanted, work)
        _led_into(brake, x, wanted, work.braking, shares, out)
    elif rests:
        for j in range(m):
            out[j] = wanted[j]


@kernel
def guard_into(
    draws: Draws, bounds: Bounds, brake: Brake, memory: Memory, x: Array, wanted: Array, work: Work, out: Array
) -> None:
    """Write the forces (m,) [N] to be given for the next period into `out`, and remember that they were given.

    Args:
        x: state (13,): place, attitude, velocity. wanted: forces (m,) [N], within what the thrusters can do.

    `memory.shares` (7,) then says how much of the braking was needed for each of LIMITS; all 0: `out` is `wanted`. A
    state that is not finite stops all thrust: shares are 1.
    """
    m, lanes = memory.force.shape
    shares = memory.shares
    known = True
    for a in range(N_STATES):
        known = known and math.isfinite(x[a])
    if known:
        _decide_into(draws, bounds, brake, memory, x, wanted, work, out)
    else:
        for c in range(_N_LIMITS + 1):
            shares[c] = 1.0
        for j in range(m):
            out[j] = 0.0
    # What was given goes into memory, and the forces of the draws go on by one period.
    for k in range(lanes):
        for j in range(m):
            work.commands[0, j, k] = out[j]
    _advance_into(draws, brake, memory, work, 0, memory.force)
    for i in range(memory.past.shape[0] - 1, 0, -1):
        for j in range(m):
            memory.past[i, j] = memory.past[i - 1, j]
    for j in range(m):
        memory.past[0, j] = out[j]


@dataclass(frozen=True, eq=False)
class Guard:
    """The guard of one vehicle in one space, as the kernels take it. Made by `Guard.of`; `step` is called every PERIOD.

    Attributes:
        vehicle: the nominal one. space: its limits. radius: of the vehicle [m].
        draws, bounds, brake, memory, work: as of the kernels; `memory` changes from step to step.
    """

    vehicle: Vehicle
    space: Space
    radius: float
    draws: Draws
    bounds: Bounds
    brake: Brake
    memory: Memory
    work: Work

    @classmethod
    def of(
        cls,
        vehicle: AnyVehicle,
        space: Space,
        drawn: Sequence[Vehicle],
        *,
        force_std: ArrayLike = (0.5, 0.5, 0.5, 0.05, 0.05, 0.05),
        seed: int = 0,
    ) -> Guard:
        """Return the guard of a vehicle.

        Args:
            vehicle: as it is supposed to be.
            drawn: vehicles that it may be instead, `Vehicle.sample` or `drawn_around`; about twenty.
            force_std: deviations (6,) [N, N m] of a constant force on the body that nobody knows.
            seed: of these forces.

        Raises:
            InputError: no thrusters, or one without limits; a delay of half a second or more; no room in the space.
        """
        vehicle = vehicle_of(vehicle)
        if not vehicle.thrusters:
            raise InputError(f"{vehicle.name} has no thrusters; add [[thrusters]] to its file, a guard brakes by them")
        radius = space.require_room(vehicle)
        fleet = [vehicle, *drawn]
        std = np.asarray(force_std, dtype=np.float64)
        forces = std[:, None] * np.random.default_rng(seed).standard_normal((6, len(fleet)))
        parameters = np.array([each.parameters for each in fleet]).T.copy()
        parameters[I_CONSTANT : I_CONSTANT + 6, 1:] += forces[:, 1:]
        nominal = np.array([thruster.gain for thruster in vehicle.thrusters])
        gains, lags = np.empty((2, len(nominal), len(fleet)))  # in C order, as the kernel is compiled for
        for k, each in enumerate(fleet):
            gains[:, k] = [thruster.gain for thruster in each.thrusters]
            lags[:, k] = [max(thruster.time_constant, _NO_LAG) for thruster in each.thrusters]
        draws = Draws(
            parameters,
            gains / nominal[:, None],
            -np.expm1(-PERIOD / lags),
            -lags / PERIOD * np.expm1(-PERIOD / lags),
            np.array([each.command_delay for each in fleet]),
        )
        longest = float(draws.delays.max())
        if longest > (_PAST - 2) * PERIOD:
            raise InputError(f"{vehicle.name}: found a delay of {longest:.2g} s, too long to be guarded")
        room = radius + space.margin
        bounds = Bounds(
            space.lower + room,
            space.upper - room,
            np.array([space.speed, max(space.tilt - _TILT_RESERVE, 0.5 * space.tilt), space.turn]),
        )
        m, lanes = draws.gains.shape
        n = round(_HORIZON / PERIOD)
        return cls(
            vehicle,
            space,
            radius,
            draws,
            bounds,
            brake_of(vehicle, space.middle, bounds),
            Memory(np.zeros((_PAST, m)), np.zeros((m, lanes)), np.zeros(_N_LIMITS + 1)),
            Work(
                state=np.zeros((N_STATES, lanes)),
                step=np.zeros((3, N_STATES, lanes)),
                wrench=np.zeros((3, 6, lanes)),
                force=np.zeros((m, lanes)),
                commands=np.zeros((n, m, lanes)),
                clear=np.zeros((_N_LIMITS, lanes)),
                worst=np.zeros(_N_LIMITS),
                command=np.zeros(m),
                braking=np.zeros(m),
                blend=np.zeros(m),
                low=np.zeros(_N_LIMITS),
                high=np.zeros(_N_LIMITS),
                ordered=np.zeros(lanes),
                still=np.zeros(3),
            ),
        )

    def step(self, state: Array, wanted: Array) -> Array:
        """Return the forces (m,) [N] to give for the next PERIOD in place of the wanted ones.

        Args:
            state: (13,) as of `towtank.core.rk4`, velocity over ground. wanted: forces (m,) [N].

        Raises:
            InputError: the wanted forces have a wrong shape, or are not within what the thrusters can do.
        """
        low, high = self.brake.low, self.brake.high
        if wanted.shape != low.shape or not bool(np.all((wanted >= low - _ROUNDING) & (wanted <= high + _ROUNDING))):
            raise InputError(f"wanted: found {wanted} N, expected {low.size} forces from {low} to {high} N")
        out = np.empty_like(wanted)
        guard_into(self.draws, self.bounds, self.brake, self.memory, state, wanted, self.work, out)
        return out

    def reset(self) -> None:
        """Forget what was given: thrusters at rest."""
        for each in self.memory:
            each[:] = 0.0

    @property
    def shares(self) -> Array:
        """How much of the braking the last step needed for each of LIMITS (7,), 0 .. 1."""
        return self.memory.shares.copy()


def drawn_around(vehicle: AnyVehicle, count: int, spread: float, seed: int = 0) -> tuple[Vehicle, ...]:
    """Return vehicles whose total inertias, damping, righting moment and gains all differ from those of a vehicle.

    By independent factors exp(spread n), n normal; of the gains, which a bench test tells, a quarter of that.
    """
    vehicle = vehicle_of(vehicle)
    rng = np.random.default_rng(seed)
    return tuple(scaled(vehicle, lambda: math.exp(spread * rng.standard_normal()), 0.25) for _ in range(count))


def scaled(vehicle: Vehicle, factor: Callable[[], float], of_gains: float) -> Vehicle:
    """Return a vehicle with every diagonal inertia, damping and righting moment times factors of their own.

    Args:
        factor: called for each number. of_gains: power of the factor that a thruster's gain takes.
    """
    total, rigid = np.diag(vehicle.mass_matrix), np.diag(vehicle.rigid_body_matrix)
    values = {name: float(rigid[i] - factor() * total[i]) for i, name in enumerate(_ADDED)}
    for name in _DAMPING:
        values[name] = vehicle.coefficient(name) * factor()
    values["BG_z"] = vehicle.restoring_moment[2] * factor()
    thrusters = tuple(t.model_copy(update={"gain": t.gain * factor() ** of_gains}) for t in vehicle.thrusters)
    return vehicle.with_coefficients(values).model_copy(update={"thrusters": thrusters, "posterior": None})
