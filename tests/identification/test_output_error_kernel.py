"""One free run: its motion against the simulator, its sensitivities against differences of itself.

Also run as plain Python, where the runs are short.
"""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.core.attitude import quaternion_product, quaternions_from_eulers
from towtank.core.zero_order_hold import new_zero_order_hold
from towtank.identification.data.samples import N_MEASURED, Samples, samples_of
from towtank.identification.model.parameters import FreeParameters, free_parameters
from towtank.identification.simulation_error.residuals import GATE, GONE, HUBER, robust_cost, weight_of
from towtank.identification.simulation_error.segments import FreeRun, free_run_of
from towtank.identification.simulation_error.trajectory import (
    NormalEquations,
    Unknowns,
    free_run_into,
    new_equations,
    new_workspace,
)
from towtank.simulation import simulate
from towtank.vehicle import Vehicle, configuration_matrix, load_vehicle

INTERPRETED = bool(numba.config.DISABLE_JIT)
COEFFICIENTS = (
    *("X_udot", "Y_vdot", "N_rdot", "K_pdot", "Y_rdot", "X_qdot"),
    *("X_u", "Y_vv", "N_rr", "N_v", "M_ww", "W_minus_B", "BG_x", "BG_y", "BG_z", "X_0", "N_0"),
)
INPUTS = ("delay", "lag", "gain_AftPort", "gain_AftStarboard")
DELAY, LAG = 0.0437, 0.12  # s
COLUMNS = {
    "position": (0, 3),
    "attitude": (3, 6),
    "velocity": (6, 12),
    "specific force": (12, 15),
    "through water": (15, 18),
}
SMALL = 1e-4


def _vehicle() -> Vehicle:
    start = load_vehicle("vlbv300")
    couplings = {"Y_rdot": 0.7, "X_qdot": -0.4, "N_v": -1.3, "X_u": -4.0, "BG_x": 0.3, "BG_y": -0.2, "M_ww": 0.6}
    return start.with_coefficients(couplings)


class Case:
    """A run of random held forces, as a function of the coefficients and of the errors of its initial states."""

    def __init__(
        self, names: tuple[str, ...], *, delay: float = 0.0, lag: float = 0.0, dt: float = 0.01, segments: int = 2
    ) -> None:
        generator = np.random.default_rng(5)
        self.vehicle = _vehicle()
        thrusters = [f"gain_{thruster.name}" for thruster in self.vehicle.thrusters]
        names = tuple(thrusters[("gain_AftPort", "gain_AftStarboard").index(n)] if "gain" in n else n for n in names)
        self.free = free_parameters(self.vehicle, names)
        self.theta = self.free.theta(self.vehicle, delay=delay, lag=lag)
        self.gains = any(name.startswith("gain") for name in names)
        self.delay = delay
        n = 8 if INTERPRETED else 120
        t = dt * np.arange(n, dtype=np.float64)
        t[n // 3 : n // 2] += 0.3 * dt  # not regular
        shape = configuration_matrix(self.vehicle)
        m = shape.shape[1]
        stamps = np.sort(np.concatenate([[-0.2], generator.uniform(-0.1, t[-1], max(n // 6, 2))]))
        force = generator.uniform(-6.0, 6.0, (stamps.size, m))
        samples = Samples(t, np.zeros((n, N_MEASURED)), stamps, force, shape, np.full(m, lag), True)
        run = free_run_of(samples, np.ones(N_MEASURED), t[-1] / segments, 0.5, self.gains)
        self.run = run._replace(block=np.arange(n, dtype=np.int64))
        start = np.concatenate([[1.0, 2.0, 3.0], [0.9, 0.2, -0.3, 0.1], [0.4, -0.2, 0.15, 0.3, -0.4, 0.5]])
        start[3:7] /= np.linalg.norm(start[3:7])
        self.states = np.array([start, np.append(start[:7], -start[7:])])[:segments]
        assert self.run.first.size == segments

    def measure(self, first: int, last: int, generator: np.random.Generator) -> None:
        """Measure these columns, a little off the run; the attitude as a whole."""
        angles = self._made(self.run._replace(q=np.full((self.run.t.size, 4), np.nan)), np.zeros(len(self)))
        values = -angles.residuals + SMALL * generator.standard_normal((self.run.t.size, N_MEASURED))
        q = quaternions_from_eulers(np.ascontiguousarray(values[:, 3:6]))
        values[:, :first] = values[:, last:] = np.nan
        self.run = self.run._replace(values=values, q=q if first <= 3 < last else np.full_like(q, np.nan))

    def __len__(self) -> int:
        return 12 * len(self.states) + len(self.free)

    def _made(self, run: FreeRun, move: Array) -> NormalEquations:
        s = len(self.states)
        states = np.array([_moved(x, e) for x, e in zip(self.states, move[: 12 * s].reshape(s, 12), strict=True)])
        n, m = len(self.free), run.B.shape[1]
        out = new_equations(s, run.t.size, run.t.size, 12 + n)
        hold = new_zero_order_hold(m, run.lag, self.delay)
        everything = np.arange(12)
        theta, scale, space = self.theta + move[12 * s :], np.full(N_MEASURED, 1e6), new_workspace(12 + n, n, m)
        unknowns = Unknowns(self.free.codes, theta, states, everything, everything)
        assert free_run_into(run, self.vehicle.parameters.copy(), unknowns, hold, scale, False, out, space)
        return out

    def __call__(self, move: Array) -> NormalEquations:
        return self._made(self.run, move)


def _moved(x: Array, e: Array) -> Array:
    out = x.copy()
    out[:3] += e[:3]
    angle = float(np.linalg.norm(e[3:6]))
    turn = np.concatenate([[np.cos(0.5 * angle)], 0.5 * np.sinc(0.5 * angle / np.pi) * e[3:6]])
    out[3:7] = quaternion_product(x[3:7], turn)
    out[7:] += e[6:]
    return out


def _scores(case: Case) -> tuple[Array, Array]:
    """Return the scores (n, c) of every row, the kernel's and those of differences; each relative to its column."""
    at = case(np.zeros(len(case)))
    s, n = len(case.states), len(case.free)
    step = 1e-6
    derivative = np.empty((*at.residuals.shape, len(case)))
    for c in range(len(case)):
        move = np.zeros(len(case))
        move[c] = step
        derivative[:, :, c] = (case(-move).residuals - case(move).residuals) / (2.0 * step)
    product = np.einsum("rj,rjc->rc", np.nan_to_num(at.residuals), np.nan_to_num(derivative))
    segment = np.repeat(np.arange(s), case.run.last - case.run.first)
    own = np.array([product[r, 12 * k : 12 * k + 12] for r, k in enumerate(segment)])
    expected = np.hstack([own, product[:, 12 * s :]])
    found = at.scores[:, : 12 + n] * 1e12
    size = np.abs(np.nan_to_num(derivative)).max(axis=(0, 1))
    size = np.concatenate([size[: 12 * s].reshape(s, 12).max(axis=0), size[12 * s :]]) * SMALL
    size[size < 1e-3 * SMALL] = SMALL
    return found / size, expected / size


@pytest.mark.parametrize("name", COLUMNS)
def test_sensitivities_to_states_and_coefficients(name: str) -> None:
    case = Case(COEFFICIENTS[::2] if INTERPRETED else COEFFICIENTS)
    case.measure(*COLUMNS[name], np.random.default_rng(1))
    found, expected = _scores(case)
    np.testing.assert_allclose(found, expected, atol=0.02)


@pytest.mark.parametrize("name", COLUMNS)
def test_sensitivities_to_delay_lag_and_gains(name: str) -> None:
    case = Case(INPUTS, delay=DELAY, lag=LAG)
    case.measure(*COLUMNS[name], np.random.default_rng(2))
    found, expected = _scores(case)
    np.testing.assert_allclose(found, expected, atol=0.02)


@pytest.mark.parametrize("angle", [3, 4, 5])
def test_sensitivities_of_single_angles(angle: int) -> None:
    case = Case(("K_pdot", "BG_z"))
    case.measure(angle, angle + 1, np.random.default_rng(3))
    case.run = case.run._replace(q=np.full_like(case.run.q, np.nan))
    found, expected = _scores(case)
    np.testing.assert_allclose(found, expected, atol=0.02)


@pytest.mark.skipif(INTERPRETED, reason="runs of plain Python are too short to tell")
def test_sensitivities_are_of_second_order_in_the_step() -> None:
    worst = []
    for dt in (0.01, 0.005):
        case = Case(("Y_vdot", "N_rr", "BG_z"), dt=dt, segments=1)
        case.measure(0, 12, np.random.default_rng(4))
        found, expected = _scores(case)
        worst.append(np.abs(found - expected).max())
    assert worst[1] < 0.5 * worst[0]


@pytest.mark.parametrize("delay, lag", [(0.0, 0.0), (0.15, 0.0), (0.03, 0.1)])
def test_the_motion_is_the_simulators(delay: float, lag: float) -> None:
    vehicle = _vehicle()
    slow = tuple(thruster.model_copy(update={"time_constant": lag}) for thruster in vehicle.thrusters)
    vehicle = vehicle.model_copy(update={"thrusters": slow, "command_delay": delay})
    n = 50 if INTERPRETED else 500
    commands = np.repeat(np.random.default_rng(0).uniform(-40.0, 40.0, (n // 10, len(slow))), 10, axis=0)
    commands[:10] = 0.0
    samples = samples_of(simulate(vehicle, commands=commands, dt=0.01), vehicle)
    free = free_parameters(vehicle, ("X_udot",))
    run = free_run_of(samples, np.ones(N_MEASURED), None, 0.5, False)
    out, space = new_equations(1, int(run.block.max()) + 1, n + 1, 13), new_workspace(13, 1, run.B.shape[1])
    start = np.zeros((1, 13))
    start[0, 3] = 1.0
    hold, theta = new_zero_order_hold(run.lag.size, run.lag, delay), free.theta(vehicle, delay=0.0, lag=0.0)
    unknowns = Unknowns(free.codes, theta, start, np.arange(12), np.arange(12))
    assert free_run_into(run, vehicle.parameters.copy(), unknowns, hold, np.ones(N_MEASURED), True, out, space)
    assert np.nanmax(np.abs(out.residuals[:, :12])) < (1e-5 if lag == 0.0 and delay == 0.0 else 3e-4)
    assert np.isfinite(out.residuals[:, :12]).all()


def test_an_impossible_mass_and_a_diverging_motion_are_said() -> None:
    case = Case(("Y_rdot",))
    with pytest.raises(AssertionError):
        case(np.append(np.zeros(24), 1e3))
    case = Case(("Z_w",))
    case.free = FreeParameters(("Z_w",), np.array([[1, 2, 2, 0]]), np.zeros(1))  # as it is: it may push
    case.theta = np.array([1e5])
    with pytest.raises(AssertionError):
        case(np.zeros(25))


def test_weights_are_the_slope_of_the_cost() -> None:
    for gated in (False, True):
        for x in (0.0, 1.0, HUBER + 0.1, GATE - 0.1, GATE + 0.1, GONE - 0.1, GONE + 1.0):
            step = 1e-6
            ends = [robust_cost(np.full((1, 1), x + e), np.ones(1), gated) for e in (-step, step)]
            assert weight_of(x, gated) * x == pytest.approx((ends[1] - ends[0]) / (2.0 * step), abs=1e-6)
    assert weight_of(100.0, True) == 0.0 < weight_of(100.0, False)


def test_inputs_alike_are_taken_together_unless_gains_are_free() -> None:
    case = Case(("X_uu",))
    assert case.run.B.shape == (6, 6)
    assert Case(INPUTS, lag=LAG).run.B.shape[1] == len(case.vehicle.thrusters)
    samples = Samples(
        case.run.t, np.zeros((case.run.t.size, N_MEASURED)), case.run.input_t, case.run.input_force, case.run.B,
        case.run.lag, True,
    )  # fmt: skip
    still = replace(samples, input_force=0.0 * samples.input_force)
    assert free_run_of(still, np.ones(N_MEASURED), None, 0.5, False).B.shape == (6, 0)
