"""The guard: what it predicts is what happens, it passes what is safe bit for bit, and it stops in time."""

from __future__ import annotations

import itertools
import math

import numba
import numpy as np
import pytest

from towtank.core.rk4 import simulate_run
from towtank.errors import InputError
from towtank.planning.braking import PERIOD, brake_into
from towtank.planning.guard import LIMITS, Guard, drawn_around, scaled
from towtank.planning.guarded import guarded_run
from towtank.planning.observer import Observer
from towtank.planning.space import Space
from towtank.simulation import OrnsteinUhlenbeck, simulate
from towtank.vehicle import load_vehicle, thruster_commands, thruster_forces

JIT = not numba.config.DISABLE_JIT
COUNT = 9 if JIT else 1
TANK = Space.from_text("5x5x2.5")
WIDE = Space.from_text("90x90x90")
VEHICLES = ("vlbv300", "bluerov2_heavy")
S2 = OrnsteinUhlenbeck((0.5, 0.5, 0.5, 0.05, 0.05, 0.05), time_constant=2.0)
compiled = pytest.mark.skipif(not JIT, reason="whole runs need the compiler")


def guard_of(name, space=TANK, count=COUNT, **changes):
    vehicle = load_vehicle(name).model_copy(update=changes)
    return Guard.of(vehicle, space, drawn_around(vehicle, count, 0.3))


def test_its_arrays_are_laid_out_as_the_kernels_are_compiled_for():
    """Of another layout each kernel would be compiled once more."""
    guard = guard_of("vlbv300")
    assert all(each.flags.c_contiguous for part in (guard.draws, guard.memory, guard.brake) for each in part)


def state_of(space, velocity=(0.0,) * 6, place=None):
    state = np.zeros(13)
    state[:3] = space.middle if place is None else place
    state[3] = 1.0
    state[7:] = velocity
    return state


def along(guard, axis, size):
    """Forces that push along one axis, by a share of what the thrusters can do."""
    f = guard.brake.inverse[:, axis]
    return size * f * np.min(np.minimum(-guard.brake.low, guard.brake.high)) / np.abs(f).max()


def braked(guard, state, first):
    """States (n + 1, 13) of the nominal vehicle without lag: forces `first` for a period, then its own braking."""
    p, states, n = guard.draws.parameters[:, 0].copy(), [state], len(guard.work.commands)
    out, force = np.empty(first.size), np.empty((first.size, 1))
    forces = first
    for i in range(n):
        if i:
            force[:, 0] = forces
            brake_into(guard.brake, states[-1].reshape(13, 1), force, 0, out)
            forces = out.copy()
        tau = (guard.brake.matrix @ forces)[None, None, :]
        states.append(simulate_run(p, states[-1], tau, PERIOD, np.zeros(3))[-1])
    return np.array(states)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_predicted_stopping_point_is_that_of_the_integrated_model(axis):
    guard = guard_of("vlbv300")
    velocity = np.zeros(6)
    velocity[axis] = 0.6
    state, first = state_of(TANK, velocity), along(guard, axis, 0.2)
    guard.step(state, first)
    assert not guard.shares.any()
    path = braked(guard, state, first)[1:, :3]
    room = np.minimum(path - guard.bounds.lower, guard.bounds.upper - path).min(axis=0)
    np.testing.assert_allclose(guard.work.clear[:3, 0], room, atol=1e-9)
    reached = path[:, axis].max() - state[axis]
    assert 0.02 < reached < 1.2


@pytest.mark.parametrize("name", VEHICLES)
def test_the_energy_falls_while_it_brakes(name):
    prompt = tuple(t.model_copy(update={"time_constant": 0.0}) for t in load_vehicle(name).thrusters)
    guard = guard_of(name, WIDE, count=0, thrusters=prompt)
    state = state_of(WIDE, (0.5, 0.4, -0.3, 0.0, 0.0, 0.3), WIDE.middle)
    guard.brake.home[:] = state[:3]
    states = braked(guard, state, guard.brake.hover)
    mass = guard.vehicle.mass_matrix
    energy = 0.5 * np.einsum("ni,ij,nj->n", states[:, 7:], mass, states[:, 7:])
    assert energy[-1] < 0.1 * energy[0]
    assert energy[10] < 0.5 * energy[0]
    assert np.all(energy <= energy[0])


def test_a_lagged_and_late_force_is_predicted_as_the_simulator_has_it():
    vehicle = load_vehicle("bluerov2_heavy").model_copy(update={"command_delay": 0.1})
    guard = Guard.of(vehicle, WIDE, [])
    pushed = along(guard, 0, 0.3)
    guard.memory.past[0] = pushed  # the last period alone: it acts from 0.06 to 0.10 s from now
    guard.brake.gain[:] = 0.0
    guard.brake.hover[:] = 0.0
    state, n = state_of(WIDE), len(guard.work.commands)
    guard.step(state, np.zeros(pushed.size))
    commands = np.zeros((100 + 4 * n, pushed.size)) + thruster_commands(vehicle, np.zeros(pushed.size))
    commands[96:100] = thruster_commands(vehicle, pushed)
    run = simulate(vehicle, commands=commands, eta0=(*state[:3], 0.0, 0.0, 0.0))
    rest = simulate(vehicle, commands=commands[:100], eta0=(*state[:3], 0.0, 0.0, 0.0))
    moved = run["x"].values[-1] - rest["x"].values[-1]
    assert moved > 0.02
    assert guard.work.state[0, 0] - state[0] == pytest.approx(moved, rel=0.02)


@pytest.mark.parametrize("name", VEHICLES)
def test_far_from_walls_the_command_passes_bit_for_bit(name):
    guard = guard_of(name)
    rng = np.random.default_rng(1)
    for _ in range(4):
        wanted = sum(along(guard, axis, 0.05 * rng.standard_normal()) for axis in (0, 1, 2))
        given = guard.step(state_of(TANK, (0.1, -0.1, 0.05, 0.0, 0.0, 0.1)), wanted)
        assert given.tobytes() == wanted.tobytes()
        assert not guard.shares.any()
        np.testing.assert_array_equal(guard.memory.past[0], wanted)


@pytest.mark.parametrize("axis, wall", [(0, 2.5), (1, -2.5), (2, 2.5)])
def test_near_a_wall_the_push_towards_it_is_taken_back_and_the_thrusters_can_do_it(axis, wall):
    guard = guard_of("bluerov2_heavy")
    place, side = TANK.middle, math.copysign(1.0, wall)
    place[axis] = wall - side * (guard.radius + TANK.margin + 0.02)
    velocity = np.zeros(6)
    velocity[axis] = 0.3 * side
    wanted = along(guard, axis, 0.8 * side)
    given = guard.step(state_of(TANK, velocity, place), wanted)
    force, before = (guard.brake.matrix @ each for each in (given, wanted))
    assert side * force[axis] < 0.3 * side * before[axis]
    assert guard.shares[axis] > 0.0
    assert LIMITS[axis] == "xyz"[axis]
    assert np.all(given >= guard.brake.low)
    assert np.all(given <= guard.brake.high)


def test_along_a_wall_the_vehicle_is_driven_as_wanted():
    guard = guard_of("bluerov2_heavy")
    place = TANK.middle
    place[0] = 2.5 - guard.radius - TANK.margin - 0.05
    wanted = along(guard, 0, 0.6) + along(guard, 1, 0.2)
    given = guard.step(state_of(TANK, (0.4, 0.0, 0.0, 0.0, 0.0, 0.0), place), wanted)
    force, before = guard.brake.matrix @ given, guard.brake.matrix @ wanted
    assert force[0] < 0.5 * before[0]
    assert guard.shares[-1] == 0.0
    assert force[1] == pytest.approx(before[1], rel=0.05)


def test_a_share_falls_off_when_it_is_no_longer_needed_and_then_is_gone():
    guard = guard_of("bluerov2_heavy", count=1)
    guard.memory.shares[0] = 0.2
    wanted, shares = along(guard, 0, 0.05), []
    for _ in range(9):
        given = guard.step(state_of(TANK), wanted)
        shares.append(float(guard.shares[0]))
    assert all(a > b for a, b in itertools.pairwise(shares) if a > 0.0)
    assert shares[-1] == 0.0
    assert given.tobytes() == wanted.tobytes()


def test_a_state_that_nobody_knows_stops_all_thrust():
    guard = guard_of("bluerov2_heavy", count=1)
    state = state_of(TANK)
    state[0] = np.nan
    assert not guard.step(state, along(guard, 0, 0.2)).any()
    assert guard.shares.all()


@compiled
def test_a_bent_command_takes_no_more_memory_than_one_that_passes():
    from numba.core.runtime import _nrt_python, rtsys

    guard, counts = guard_of("bluerov2_heavy"), []
    near = TANK.middle
    near[0] = 2.5 - guard.radius - TANK.margin - 0.02
    guard.step(state_of(TANK), along(guard, 0, 0.2))
    _nrt_python.memsys_enable_stats()
    try:
        for state, size in ((state_of(TANK), 0.05), (state_of(TANK, (0.3, 0.0, 0.0, 0.0, 0.0, 0.0), near), 0.8)):
            before = rtsys.get_allocation_stats().alloc
            guard.step(state, along(guard, 0, size))
            counts.append(rtsys.get_allocation_stats().alloc - before)
    finally:
        _nrt_python.memsys_disable_stats()
    assert guard.shares.any()
    assert counts[0] == counts[1]


def test_what_no_thruster_can_do_is_refused():
    guard = guard_of("vlbv300", count=1)
    for wanted in (2.0 * guard.brake.high, np.full(6, np.nan), np.zeros(5)):
        with pytest.raises(InputError, match=r"^wanted: "):
            guard.step(state_of(TANK), wanted)


def test_a_vehicle_that_cannot_be_guarded_is_refused_in_one_line():
    vehicle = load_vehicle("vlbv300")
    for changed, words in (
        (vehicle.model_copy(update={"thrusters": ()}), "no thrusters"),
        (vehicle.model_copy(update={"command_delay": 1.0}), "delay of 1 s"),
    ):
        with pytest.raises(InputError, match=words):
            Guard.of(changed, TANK, [])
    with pytest.raises(InputError, match="take a tank of"):
        Guard.of(vehicle, Space.from_text("1x1x1"), [])


def test_drawn_vehicles_differ_in_everything_and_are_the_same_for_a_seed():
    vehicle = load_vehicle("bluerov2_heavy")
    first, second = drawn_around(vehicle, 2, 0.3, seed=4), drawn_around(vehicle, 2, 0.3, seed=4)
    assert first == second
    for name in ("X_udot", "N_rdot", "X_u", "Y_vv", "BG_z"):
        assert first[0].coefficient(name) != vehicle.coefficient(name)
    exact = scaled(vehicle, lambda: 1.3, 0.0)
    np.testing.assert_allclose(np.diag(exact.mass_matrix), 1.3 * np.diag(vehicle.mass_matrix))
    assert exact.coefficient("Z_ww") == pytest.approx(1.3 * vehicle.coefficient("Z_ww"))
    assert exact.thrusters == vehicle.thrusters


def test_the_observer_finds_the_velocity_of_a_vehicle_that_is_not_the_one_supposed():
    vehicle = load_vehicle("bluerov2_heavy")
    truth = scaled(vehicle, lambda: 1.3, 0.25)
    n = 150 if JIT else 40
    t = 0.01 * np.arange(n)
    commands = 1500.0 + 120.0 * np.sin(2.0 * t)[:, None] * np.array([-1.0, -1.0, 1.0, 1.0, 0.5, 0.5, 0.5, 0.5])
    run = simulate(truth, commands=commands, eta0=(0.0, 0.0, 2.0, 0.0, 0.0, 0.0))
    eta = np.column_stack([run[name].values for name in ("x", "y", "z", "phi", "theta", "psi")])
    nu = np.column_stack([run[name].values for name in "uvwpqr"])
    observer, forces = Observer.of(vehicle, eta[0]), thruster_forces(vehicle, commands)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(eta.shape)
    errors = []
    for k in range(1, n + 1):
        observer.give(0.01 * (k - 1), forces[k - 1])
        observer.see(0.01 * k, np.full(6, np.nan) if k % 10 == 5 else eta[k] + noise[k])
        errors.append(observer.state[7:] - nu[k])
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(rms[:3] < 0.04)
    assert np.all(rms[3:] < 0.15)


@compiled
@pytest.mark.parametrize("name", VEHICLES)
def test_a_guarded_run_keeps_off_the_walls_and_its_recording_is_the_run(name):
    guard = guard_of(name, count=15)
    n = 200
    rng = np.random.default_rng(3)
    truth = scaled(guard.vehicle, lambda: 1.0 + 0.3 * rng.choice([-1.0, 1.0]), 0.25)
    wanted = np.tile(along(guard, 2, 0.8), (n, 1))
    run = guarded_run(guard, truth, wanted, disturbance=S2, seed=5)
    assert run.touch is None
    assert run.clearance.min() > 0.5 * TANK.margin
    assert run.tilt.max() < TANK.tilt
    assert np.all(run.given >= guard.brake.low)
    assert np.all(run.given <= guard.brake.high)
    again = simulate(
        truth, commands=np.repeat(run.commands, 4, axis=0), eta0=TANK.eta0, disturbance=S2, seed=5, sensors="perfect"
    )
    for k, axis in enumerate("xyz"):
        np.testing.assert_allclose(again[axis].values, run.eta[:, k], atol=1e-9)
        np.testing.assert_allclose(run.recording[axis].values, run.eta[:, k], atol=6e-3)
    untouched = ~(run.shares > 0.0).any(axis=1)
    assert untouched[0]
    np.testing.assert_array_equal(run.given[untouched], wanted[untouched])
    np.testing.assert_array_equal(run.commands[untouched], thruster_commands(guard.vehicle, wanted)[untouched])
    free = guarded_run(guard, truth, wanted, disturbance=S2, seed=5, guarded=False)
    assert free.touch is not None
    at, place = free.touch
    assert 0.0 < at < n * PERIOD
    assert TANK.clearance(np.array(place), guard.radius) <= 0.0
    np.testing.assert_array_equal(free.given, wanted)


@compiled
def test_a_guarded_run_is_the_same_for_a_seed():
    guard = guard_of("bluerov2_heavy")
    wanted = np.tile(along(guard, 0, 0.8), (60, 1))
    first, second = (guarded_run(guard, guard.vehicle, wanted, disturbance=S2, seed=6) for _ in range(2))
    np.testing.assert_array_equal(first.given, second.given)
    np.testing.assert_array_equal(first.eta, second.eta)


@compiled
def test_thrusters_that_stand_elsewhere_are_refused():
    guard = guard_of("vlbv300", count=1)
    with pytest.raises(InputError, match="thrusters elsewhere"):
        guarded_run(guard, load_vehicle("bluerov2_heavy"), np.zeros((3, 6)))
