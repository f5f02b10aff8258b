"""One vehicle through one experiment, as its sensors see it.

What drives the vehicle in one simulation: a wrench or commands, held or continuous, checked.
"""

from __future__ import annotations

import bisect
import itertools
import math
import time
from collections.abc import Callable, Sequence
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.core.layout import I_INFLOW
from towtank.errors import InputError, nearest
from towtank.recording.channel import Channel, read_only, standard_channel
from towtank.recording.recording import Recording
from towtank.recording.standard import COMMAND_PREFIX, WRENCH
from towtank.simulation.actuation import Drive, FunctionDrive, HeldDrive, cut_step
from towtank.simulation.inputs import finite_array, initial_states, positive, step_count
from towtank.simulation.integration import (
    lifted,
    relative_to_water,
    simulate_in_waves,
    simulate_pieces,
    simulate_thrusters,
)
from towtank.simulation.motion import GRAVITY, Motion, continuous_eulers
from towtank.simulation.sensors.presets import sensors_named
from towtank.simulation.sensors.sensor import Sensors, channels
from towtank.simulation.water import OrnsteinUhlenbeck, RisingCurrent, WaterMotion, Waves
from towtank.vehicle import AnyVehicle, Vehicle, configuration_matrix, thruster_forces, vehicle_of

__all__ = ["Progress", "simulate"]

Progress = Callable[[int, int], None]
_CHUNK = 2048  # steps between two reports of progress
_PAUSE = 0.05  # s, shortest time between two reports
_EXTRAS = ("wrench", "disturbance")
_ZERO6 = (0.0,) * 6


def drive_of(
    vehicle: Vehicle,
    wrench: ArrayLike | Callable[[Array], Array] | None,
    commands: ArrayLike | None,
    voltage: ArrayLike | None,
    dt: float,
    duration: float | None,
    delay: float | None,
    substeps: int,
    later: Sequence[tuple[int, Vehicle]] = (),
) -> tuple[Drive, int, dict[str, Array]]:
    """Return what drives the vehicle, the number of steps, and the input channels (n,) by name.

    Args:
        later: the vehicle whose thrusters they are from a step on; positions and directions must not change.
    """
    if wrench is not None and commands is not None:
        raise InputError("simulate: give a wrench or commands, not both")
    if voltage is not None and commands is None:
        raise InputError("voltage: it acts through the thrusters; give commands")
    late = (vehicle.command_delay if commands is not None else 0.0) if delay is None else float(delay)
    if not (math.isfinite(late) and late >= 0.0):
        raise InputError(f"delay: found {late} s, expected 0 or more")
    if commands is None and (wrench is None or callable(wrench)):
        if duration is None:
            raise InputError("duration: needed where the input is not held; give it in seconds")
        if late:
            raise InputError("delay: a function of time is not delayed; shift the time inside it")
        n = step_count(duration, dt)
        pieces = cut_step(dt, substeps=substeps)
        if callable(wrench):
            return FunctionDrive(wrench, dt, pieces), n, {}
        return HeldDrive(np.zeros((n, 6)), pieces), n, {}
    if commands is None:
        values = finite_array("wrench", cast(ArrayLike, wrench), ("n", 6))
        n = _steps(values, duration, dt, "wrench")
        pieces = cut_step(dt, delay=late, substeps=substeps)
        return HeldDrive(values[:n], pieces), n, {}
    m = len(vehicle.thrusters)
    if m == 0:
        raise InputError(f"{vehicle.name} has no thrusters; add [[thrusters]] to its file or give a wrench instead")
    orders = finite_array("commands", commands, ("n", m))
    n = _steps(orders, duration, dt, "commands")
    given = {f"{COMMAND_PREFIX}{thruster.name}": orders[:n, k] for k, thruster in enumerate(vehicle.thrusters)}
    supply = None
    if voltage is not None:
        supply = finite_array("voltage", voltage, (), (len(orders),))
        supply = np.full(n, float(supply)) if supply.ndim == 0 else supply[:n]
        given["voltage"] = supply
    lags = np.array([thruster.time_constant for thruster in vehicle.thrusters])
    pieces = cut_step(dt, delay=late, substeps=substeps, lags=lags)
    forces = thruster_forces(vehicle, orders[:n], supply)
    for first, other in later:
        if not np.array_equal(configuration_matrix(other), configuration_matrix(vehicle)):
            raise InputError(
                f"changes: {other.name} has its thrusters elsewhere than {vehicle.name}; keep their places"
            )
        forces[first:] = thruster_forces(other, orders[first:n], None if supply is None else supply[first:])
    return HeldDrive(forces, pieces, configuration_matrix(vehicle), lags), n, given


def _steps(values: Array, duration: float | None, dt: float, name: str) -> int:
    """Return how many steps to take with a held input: all its rows, or those within `duration`."""
    rows = values.shape[0]
    n = rows if duration is None else step_count(duration, dt)
    if n < 1 or n > rows:
        wanted = "at least one row" if n < 1 else f"at least {n} rows for a duration of {duration:g} s"
        raise InputError(f"{name}: found {rows} rows of {dt:g} s, expected {wanted}")
    return n


def simulate(
    vehicle: AnyVehicle,
    *,
    wrench: ArrayLike | Callable[[Array], Array] | None = None,
    commands: ArrayLike | None = None,
    dt: float = 0.01,
    duration: float | None = None,
    eta0: ArrayLike | None = None,
    nu0: ArrayLike | None = None,
    current: ArrayLike = (0.0, 0.0, 0.0),
    voltage: ArrayLike | None = None,
    sensors: str | Sensors | None = None,
    disturbance: OrnsteinUhlenbeck | None = None,
    waves: Waves | RisingCurrent | None = None,
    delay: float | None = None,
    changes: Sequence[tuple[float, AnyVehicle]] = (),
    seed: int = 0,
    substeps: int = 1,
    record: Sequence[str] = (),
    progress: Progress | None = None,
) -> Recording:
    """Simulate a vehicle and return what its sensors measure, with the inputs beside it.

    Fourth-order Runge-Kutta over n steps of dt. Motion is sampled at t = 0, dt, .., n dt; inputs have n samples, each
    held from its time on; what waves add to the weight is held over each substep. The true motion depends on the seed
    through disturbance and waves alone: the same seed gives the same motion under any sensors.

    Args:
        vehicle: or its name in the catalog, or the path of its file.
        wrench: X Y Z K M N [N, N m], body FRD: held (n, 6), or a function of time, (...) [s] -> (..., 6), taken at the
            start, the middle and the end of each step. Neither wrench nor commands: free motion.
        commands: (n, m) held, one column per thruster: curve with dead band, then delay, then first-order lag. Where
            the vehicle has an `inflow_loss`, water that meets the thrusters takes its share; of a wrench it takes none.
        dt: step [s].
        duration: [s]; needed unless the input is held; cuts a held input.
        eta0, nu0: pose and velocity over ground (6,) at the start, default zero.
        current: velocity of the water (3,) [m/s], NED, constant.
        voltage: supply voltage [V], a number or (n,) held; it acts through the thrusters' curves.
        sensors: "perfect" (default), "mocap", "ins", "ins-water", or a record such as `Mocap(noise_mm=5)`; several by
            `Together`.
        disturbance: random wrench on the body, held over each step; not part of the channels X .. N.
        waves: velocity of the water beside the current, alike wherever the vehicle is: `Waves` or a `RisingCurrent`.
        delay: from a held input to its effect [s], any part of a step, exact; before the first effect the thrusters are
            off. Default: `vehicle.command_delay` for commands, none for a wrench.
        changes: (time [s], vehicle): from the step that begins then on, it is this vehicle: a payload taken up, ballast
            lost, a thruster fouled. Pose and velocity go on as they are; thrusters stay where they were.
        seed: of all random numbers.
        substeps: integration steps to each step of dt.
        record: extra channels: "wrench" (X .. N of commands), "disturbance" (X_disturbance ..).
        progress: called as progress(steps done, n) from time to time, and at the end.

    Returns:
        A Recording: what the sensors measure, then cmd_<thruster> for commands, or X .. N for a wrench. X .. N is the
        mean over the step that begins at its time (for a held wrench without delay: the wrench itself), less what
        thrusters lose with inflow.

    Raises:
        InputError: an argument is wrong, or the motion grows beyond all bounds.
    """
    vehicle, dt = vehicle_of(vehicle), positive("dt", dt)
    if isinstance(substeps, bool) or not isinstance(substeps, int | np.integer) or substeps < 1:
        raise InputError(f"substeps: found {substeps!r}, expected a whole number, 1 or more")
    for extra in record:
        if extra not in _EXTRAS:
            raise InputError(f'record: unknown "{extra}"{nearest(extra, _EXTRAS)}; there are {", ".join(_EXTRAS)}')
    watch = sensors_named(sensors)
    later = _steps_of(changes, dt)
    drive, n, given = drive_of(vehicle, wrench, commands, voltage, dt, duration, delay, int(substeps), later)
    still = finite_array("current", current, (3,))
    start_pose = finite_array("eta0", _ZERO6 if eta0 is None else eta0, (6,))
    start_velocity = finite_array("nu0", _ZERO6 if nu0 is None else nu0, (6,))
    push = np.zeros((n, 6)) if disturbance is None else disturbance.sample(n, dt, seed)

    t = read_only(np.arange(n + 1) * dt)
    swell = None if waves is None else waves.motion(t, seed)
    water = still if swell is None else still + swell.velocity
    state0 = relative_to_water(initial_states(start_pose, start_velocity), water[0] if water.ndim > 1 else water)
    bodies = [(first, each, np.array(each.parameters)) for first, each in ((0, vehicle), *later) if first < n]
    states, starts, means = _run(bodies, state0, drive, push, still, swell, n, dt, progress)

    over_ground = relative_to_water(states, water, 1.0)
    q = np.ascontiguousarray(states[:, 3:7])
    position = states[:, :3] if swell is None else states[:, :3] + swell.displacement
    eta = np.hstack([position, continuous_eulers(q, start_pose[3:])])
    nu_r = np.ascontiguousarray(states[:, 7:])
    motion = Motion(
        t,
        dt,
        eta,
        q,
        np.ascontiguousarray(over_ground[:, 7:]),
        nu_r,
        starts,
        bodies[0][2],
        tuple((first, p) for first, _, p in bodies[1:]),
        np.zeros(3) if swell is None else swell.acceleration,
    )

    held = read_only(t[:-1])
    found = watch.observe(motion, seed)
    found += [standard_channel(name, held, values) for name, values in given.items()]
    if commands is None or "wrench" in record:
        found += channels(WRENCH, held, means)
    if "disturbance" in record:
        units = ("N", "N", "N", "N m", "N m", "N m")
        found += [Channel(f"{a}_disturbance", held, push[:, j], units[j], "FRD") for j, a in enumerate(WRENCH)]
    attributes = {"vehicle": vehicle.name, "dt": repr(dt), "seed": str(seed), "sensors": repr(watch)}
    return Recording({c.name: c for c in found}, source=f"simulation of {vehicle.name}", attributes=attributes)


def _steps_of(changes: Sequence[tuple[float, AnyVehicle]], dt: float) -> list[tuple[int, Vehicle]]:
    """Return the first step (n >= 1) of each later vehicle."""
    out: list[tuple[int, Vehicle]] = []
    for when, vehicle in changes:
        first = round(when / dt) if np.isfinite(when) else 0
        if first <= (out[-1][0] if out else 0):
            raise InputError(f"changes: found one at {when} s, expected times after 0 that rise by a step or more")
        out.append((first, vehicle_of(vehicle)))
    return out


def _run(
    bodies: Sequence[tuple[int, Vehicle, Array]],
    state0: Array,
    drive: Drive,
    push: Array,
    current: Array,
    swell: WaterMotion | None,
    n: int,
    dt: float,
    progress: Progress | None,
) -> tuple[Array, Array, Array]:
    """Return states (n + 1, 13), total wrench from each instant on (n + 1, 6), mean wrench of the drive (n, 6)."""
    pieces = drive.pieces.lengths
    m = pieces.size
    states, starts, means = np.empty((n + 1, 13)), np.empty((n + 1, 6)), np.empty((n, 6))
    states[0] = state0
    reported = time.monotonic()
    starts_anew = [first for first, _, _ in bodies]
    edges = sorted({*range(0, n, _CHUNK), *starts_anew, n})
    for first, last in itertools.pairwise(edges):
        _, vehicle, p = bodies[bisect.bisect_right(starts_anew, first) - 1]
        stages, pushed = drive.stages(first, last), np.repeat(push[first:last], m, axis=0)
        means[first:last] = _means(stages.wrench, pieces)
        tau = stages.wrench + pushed[:, None, :]
        starts[first:last], starts[last] = tau[::m, 0], tau[-1, 2]
        part, forces = slice(first, last + 1), stages.forces
        losing = None if forces is None or p[I_INFLOW] == 0.0 else (forces, configuration_matrix(vehicle))
        if swell is not None:
            lift = swell.acceleration[part] / GRAVITY
            middle = ((np.cumsum(pieces) - 0.5 * pieces) / dt)[:, None]
            of_pieces = (lift[:-1, None] + np.diff(lift, axis=0)[:, None] * middle).reshape(-1, 3)
            own = p if losing is not None else np.where(np.arange(p.size) == I_INFLOW, 0.0, p)
            given = (stages.wrench, np.eye(6)) if losing is None else losing
            states[part] = simulate_in_waves(own, states[first], pushed, *given, pieces, current, of_pieces)
            starts[part] += [lifted(p, q, each) for q, each in zip(states[part, 3:7], lift, strict=True)]
        elif losing is not None:
            states[part] = simulate_thrusters(p, states[first], pushed, *losing, pieces, current)
        else:
            states[part] = simulate_pieces(p, states[first], tau, pieces, current)
        if losing is not None:
            forces, B = losing
            nu = states[part, 7:]
            starts[part] += _lost(p[I_INFLOW], B, np.vstack([forces[::m, 0], forces[-1:, 2]]), nu)
            means[first:last] += _lost(p[I_INFLOW], B, _means(forces, pieces), 0.5 * (nu[:-1] + nu[1:]))
        _require_finite(vehicle, states[part], first, dt)
        if progress is not None and (last == n or time.monotonic() - reported >= _PAUSE):
            reported = time.monotonic()
            progress(last, n)
    return states, starts, means


def _lost(loss: float, B: Array, forces: Array, nu: Array) -> Array:
    """Return the wrench (k, 6) that thrusters B (6, m) with forces (k, m) lose at velocities nu (k, 6)."""
    return np.asarray(-loss * (np.abs(forces) * (nu @ B)) @ B.T)


def _means(tau: Array, pieces: Array) -> Array:
    """Return the mean (n, d) over each step by Simpson's rule; exactly the value itself where it is held."""
    m = pieces.size
    start = tau[::m, 0]
    rise = (4.0 * (tau[:, 1] - tau[:, 0]) + (tau[:, 2] - tau[:, 0])) / 6.0 + tau[:, 0] - np.repeat(start, m, axis=0)
    mean: Array = start + np.einsum("nmi,m->ni", rise.reshape(-1, m, tau.shape[2]), pieces / pieces.sum())
    return mean


def _require_finite(vehicle: Vehicle, states: Array, first: int, dt: float) -> None:
    bad = ~np.isfinite(states).all(axis=1)
    if bad.any():
        when = (first + int(np.argmax(bad))) * dt
        hint = "; ".join(vehicle.warnings[:1]) or "the step may be too long for its damping: try a smaller dt"
        raise InputError(f"{vehicle.name}: the motion grows beyond all bounds at t = {when:g} s ({hint})")
