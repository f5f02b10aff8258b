"""The integrator: fourth order as claimed, one run and many runs the same, inputs left alone."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.dynamics import forward_dynamics
from towtank.core.forces import current_in_body
from towtank.core.rk4 import LANES, N_STATES, is_coupled, simulate_run, simulate_runs, step_into

from .independent import Body, body, pose_difference, quaternion, state
from .proof import sized

STILL = np.zeros(3)
ETA0 = np.array([0.3, -0.2, 1.0, 0.2, -0.3, 1.0])
NU0 = np.array([1.0, 0.8, -0.7, 0.5, -0.6, 0.7])
PUSH = np.array([60.0, 50.0, -50.0, 5.0, -6.0, 6.0])


def smooth(t: np.ndarray) -> np.ndarray:
    """A wrench (..., 6) that varies in time and keeps every velocity away from zero, where |nu| nu has a kink."""
    return PUSH * (1.0 + 0.4 * np.sin(3.0 * np.asarray(t)[..., None] + np.arange(6)))


def order(errors: list[float], steps: list[int]) -> float:
    return -float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def errors(b: Body, tau: dict[int, np.ndarray], end: float, reference: np.ndarray) -> list[float]:
    found = []
    for n, wrench in tau.items():
        run = simulate_run(b.p, state(ETA0, NU0), wrench, end / n, STILL)
        assert (np.sign(run[:, 7:]) == np.sign(NU0)).all()
        found.append(pose_difference(run[-1], reference))
    return found


@pytest.mark.parametrize("seed", [11, 12])
def test_order_four_with_a_wrench_that_varies_within_the_step(seed: int) -> None:
    b, end, steps = body(seed), 0.5, [16, 32, 64, 128]
    tau = {}
    for n in steps:
        t = end / n * np.arange(n)
        tau[n] = np.stack([smooth(t), smooth(t + 0.5 * end / n), smooth(t + end / n)], axis=1)
    reference = b.motion(ETA0, NU0, smooth, end)
    assert order(errors(b, tau, end, reference), steps) == pytest.approx(4.0, abs=0.2)


@pytest.mark.parametrize("seed", [11, 12])
def test_order_four_with_a_held_wrench(seed: int) -> None:
    """The wrench of a digital controller, constant over 1/16 s; steps divide the hold."""
    b, end, holds, steps = body(seed), 0.5, 8, [16, 32, 64, 128]
    held = smooth(end / holds * np.arange(holds))
    tau = {n: np.repeat(held, n // holds, axis=0)[:, None] for n in steps}
    reference = np.concatenate([ETA0, NU0])
    for f in held:
        reference = b.motion(reference[:6], reference[6:], lambda t, f=f: f, end / holds)
    assert order(errors(b, tau, end, reference), steps) == pytest.approx(4.0, abs=0.2)


def test_a_wrench_constant_within_the_step_is_a_held_one() -> None:
    tau = smooth(0.01 * np.arange(50))
    held = simulate_run(body(2).p, state(ETA0, NU0), tau[:, None], 0.01, STILL)
    three = simulate_run(body(2).p, state(ETA0, NU0), np.repeat(tau[:, None], 3, axis=1), 0.01, STILL)
    assert np.array_equal(held, three)


def test_shape_start_and_unit_quaternions() -> None:
    n = 40
    start = state(ETA0, NU0)
    run = simulate_run(body(2).p, start, smooth(0.05 * np.arange(n))[:, None], 0.05, np.array([0.1, 0.2, 0.3]))
    assert run.shape == (n + 1, N_STATES)
    assert np.array_equal(run[0], start)
    assert np.abs((run[:, 3:7] ** 2).sum(axis=1) - 1.0).max() < 1e-15 * 4
    assert simulate_run(body(2).p, start, np.zeros((0, 1, 6)), 0.05, STILL).shape == (1, N_STATES)


@pytest.mark.parametrize("current", [np.zeros(3), np.array([0.3, -0.2, 0.1])])
@pytest.mark.parametrize("s", [1, 3])
def test_one_step_is_the_textbook_formula(current: np.ndarray, s: int) -> None:
    """k1..k4 written out, with the derivative taken from the kinematics and `forward_dynamics`."""
    b, dt, rng = body(6), 0.02, np.random.default_rng(1)
    tau = PUSH * rng.uniform(0.5, 1.5, (s, 6))
    start = state(ETA0, NU0)

    def rate(x: np.ndarray, f: np.ndarray) -> np.ndarray:
        w, v = x[3], x[4:7]
        R = np.eye(3) + 2 * w * np.cross(np.eye(3), v) + 2 * np.cross(np.cross(np.eye(3), v), v)
        omega = x[10:]
        turning = 0.5 * np.append(-v @ omega, w * omega + np.cross(v, omega))
        nu_dot = forward_dynamics(b.p[None], x[None, 3:7].copy(), x[None, 7:].copy(), f[None])[0]
        return np.concatenate([R @ x[7:10] + current, turning, nu_dot])

    x = start.copy()
    x[7:] -= current_in_body(x[3:7], current)
    k1 = rate(x, tau[0])
    k2 = rate(x + 0.5 * dt * k1, tau[s // 2])
    k3 = rate(x + 0.5 * dt * k2, tau[s // 2])
    k4 = rate(x + dt * k3, tau[s - 1])
    x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    x[3:7] /= np.linalg.norm(x[3:7])
    x[7:] += current_in_body(x[3:7], current)
    assert np.abs(simulate_run(b.p, start, tau[None], dt, current)[1] - x).max() < 1e-13


@pytest.mark.parametrize("current", [np.zeros(3), np.array([0.3, -0.2, 0.1])])
@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("runs", [1, 2, LANES - 1, LANES, LANES + 1, 2 * LANES + 3])
def test_many_runs_are_so_many_single_runs(runs: int, shared: bool, current: np.ndarray) -> None:
    """Every run its own vehicle, start and (or a shared) wrench, for counts that fill the lanes and that do not."""
    n, dt, rng = sized(200, 6), 0.02, np.random.default_rng(runs)
    bodies = [body(100 + i) for i in range(runs)]
    p = np.array([b.p for b in bodies])
    start = np.array([state(ETA0 + rng.uniform(-0.3, 0.3, 6), rng.normal(size=6)) for _ in bodies])
    tau = PUSH * rng.uniform(-1.0, 1.0, (1 if shared else runs, n, 6))
    inputs = [a.copy() for a in (p, start, tau, current)]
    final = simulate_runs(p, start, tau, dt, current, n)[:, 0]
    half = simulate_runs(p, start, tau, dt, current, n // 2)
    assert final.shape == (runs, N_STATES)
    assert half.shape == (runs, 2, N_STATES)
    assert np.array_equal(half[:, 1], final)
    for i in range(runs):
        single = simulate_run(p[i], start[i], tau[0 if shared else i][:, None], dt, current)[-1]
        assert np.abs(final[i] - single).max() < 1e-12
    assert all(np.array_equal(a, b) for a, b in zip((p, start, tau, current), inputs, strict=True))


def test_each_lane_of_a_step_is_its_own_vehicle() -> None:
    lanes, dt = 3, 0.05
    bodies = [body(50 + i) for i in range(lanes)]
    p = np.ascontiguousarray(np.array([b.p for b in bodies]).T)
    starts = [state(ETA0 + 0.1 * i, NU0 - 0.2 * i) for i in range(lanes)]
    x = np.ascontiguousarray(np.array(starts).T)
    tau = np.ascontiguousarray(np.stack([smooth(np.array([0.0, 0.5, 1.0]) + i) for i in range(lanes)], axis=2))
    step_into(p, x, tau, STILL, dt, np.empty((3, N_STATES, lanes)), True, True)
    for i in range(lanes):
        single = simulate_run(bodies[i].p, starts[i], tau[None, :, :, i].copy(), dt, STILL)[-1]
        assert np.abs(x[:, i] - single).max() < 1e-13


def test_the_short_form_for_diagonal_matrices_is_the_full_one() -> None:
    b = body(60)
    p = b.p.copy()
    for block in (slice(0, 36), slice(72, 108), slice(108, 144)):
        p[block] *= np.eye(6).ravel()
    p[36:72] = np.linalg.inv(p[:36].reshape(6, 6)).ravel()
    columns = np.ascontiguousarray(p[:, None])
    assert not is_coupled(columns)
    assert is_coupled(np.ascontiguousarray(b.p[:, None]))
    tau = np.ascontiguousarray(smooth(np.array([0.0, 0.5, 1.0]))[:, :, None])
    ends = []
    for coupled in (False, True):
        x = np.ascontiguousarray(state(ETA0, NU0)[:, None])
        step_into(columns, x, tau, STILL, 0.05, np.empty((3, N_STATES, 1)), coupled, False)
        ends.append(x)
    assert np.abs(ends[0] - ends[1]).max() < 1e-14


def test_quaternion_of_either_sign_gives_the_same_motion() -> None:
    start = state(ETA0, NU0)
    other = start.copy()
    other[3:7] *= -1.0
    tau = smooth(0.02 * np.arange(50))[:, None]
    a = simulate_run(body(8).p, start, tau, 0.02, STILL)
    b = simulate_run(body(8).p, other, tau, 0.02, STILL)
    b[:, 3:7] *= -1.0
    assert np.abs(a - b).max() < 1e-13


def test_inputs_of_a_single_run_are_left_alone_and_may_be_read_only() -> None:
    arguments = (body(8).p, state(ETA0, NU0), smooth(0.02 * np.arange(5))[:, None], np.array([0.1, 0.0, 0.0]))
    before = [a.copy() for a in arguments]
    simulate_run(*arguments[:3], 0.02, arguments[3])
    assert all(np.array_equal(a, b) for a, b in zip(arguments, before, strict=True))
    arguments[0].setflags(write=False)
    run = simulate_run(*arguments[:3], 0.02, arguments[3])
    assert np.array_equal(quaternion(ETA0[3:]), run[0, 3:7])
