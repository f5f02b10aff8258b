"""What an estimate says: deviations that hold, sums that are known, BG_z from two axes, a vehicle with all put in."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.identification import Estimate, PaperLearner, learn_paper
from towtank.identification.least_squares.solution import AxisInformation, merge_information, solve_axis
from towtank.recording import Recording
from towtank.simulation import Mocap, OrnsteinUhlenbeck, simulate

from .runs import TRUTH, box, fly, follow, unknown, waves

TANK = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05))
WATCHED = ("X_udot", "X_uu", "N_rdot", "N_rr")
SEEDS = 60


def white(theta: np.ndarray, noise: float, seed: int, rows: int = 2000) -> AxisInformation:
    """Rows [linear, quadratic, restoring, constant, force, lhs] with white residuals, in 100 blocks of time."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(rows, 5)) * [1.0, 0.7, 0.4, 1.0, 12.0] + [0, 0, 0, 1.0, 0]
    data = np.column_stack([columns, columns @ theta + noise * rng.normal(size=rows)])
    blocks = np.array([part.T @ part for part in np.array_split(data, 100)])
    return AxisInformation(np.linalg.qr(data, mode="r"), blocks, 0.25, float(rows), 3.0, 1.0, 1.0)


PHYSICAL = np.array([-6.0, -30.0, 4.0, 0.5, 25.0])
THETA = np.append(PHYSICAL[:4], 1.0) / PHYSICAL[4]


def test_the_delta_method_beside_repeated_trials() -> None:
    found, claimed = [], []
    for seed in range(400):
        solution = solve_axis(white(THETA, 0.3, seed), (True,) * 5, np.zeros(5))
        assert solution is not None
        found.append(solution.values)
        claimed.append(solution.covariance)
    actual, said = np.cov(np.array(found).T), np.mean(claimed, axis=0)
    assert np.abs(np.mean(found, axis=0) / PHYSICAL - 1.0).max() < 0.02
    assert np.sqrt(np.diag(said) / np.diag(actual)) == pytest.approx(np.ones(5), abs=0.15)
    correlation = [c / np.sqrt(np.outer(np.diag(c), np.diag(c))) for c in (actual, said)]
    assert np.abs(correlation[0] - correlation[1]).max() < 0.15


def test_held_coefficients_have_no_deviation_and_are_put_where_they_belong() -> None:
    information = white(THETA, 1e-9, 1)
    for c in range(5):
        free = tuple(i != c for i in range(5))
        solution = solve_axis(information, free, PHYSICAL)
        assert solution is not None
        assert solution.values == pytest.approx(PHYSICAL, rel=1e-6)
        assert solution.covariance[c].any() == False  # noqa: E712
    assert solve_axis(information, (False,) * 5, PHYSICAL) is None


def test_instruments_equal_least_squares_where_they_are_the_regressors() -> None:
    information = white(THETA, 0.1, 2)
    one, two = (solve_axis(information, (True,) * 5, np.zeros(5), instruments=flag) for flag in (False, True))
    assert one is not None
    assert two is not None
    assert one.values == pytest.approx(two.values, rel=1e-8)
    assert one.covariance == pytest.approx(two.covariance, rel=1e-6)


def test_two_stretches_together_equal_one_long() -> None:
    parts = [white(THETA, 0.3, seed) for seed in (1, 2)]
    merged = merge_information(parts)
    assert merged.rows == 4000
    assert merged.triangle.T @ merged.triangle == pytest.approx(sum(p.triangle.T @ p.triangle for p in parts))
    single, both = (solve_axis(i, (True,) * 5, np.zeros(5)) for i in (parts[0], merged))
    assert single is not None
    assert both is not None
    assert both.std / single.std == pytest.approx(np.full(5, np.sqrt(0.5)), rel=0.25)


def test_deviations_do_not_depend_on_what_a_recording_is_learned_beside() -> None:
    """Blocks of a long recording are longer; a short one beside it keeps its own correlation in time."""
    rng = np.random.default_rng(3)
    push = np.zeros((60_000, 6))
    push[:, 0] = 30 * np.sign(np.sin(0.8 * np.arange(60_000) * 0.01))
    long, short = (
        simulate(box(), wrench=push[:n], disturbance=TANK, seed=int(rng.integers(99))) for n in (60_000, 6000)
    )

    def std(first: object, second: object) -> float:
        learner = learn_paper(box(), [first, second], delay=0.0, instruments=False)  # type: ignore[list-item]
        return learner.estimate["X_uu"].std

    alone = learn_paper(box(), [long], delay=0.0, instruments=False).estimate["X_uu"].std
    assert 0.7 < std(long, short) / alone < 1.2


def test_sums_are_what_is_known_and_shares_need_the_rigid_body() -> None:
    run = fly(box(), waves(3000, 0.01, (5, 4.0, 0.9), square=True))
    light = box(rigid_body={"mass": 20.0, "inertia": (1.0, 1.2, 0.5)}, hydrodynamics={**TRUTH, "N_rdot": -1.8})
    a, b = (follow(PaperLearner(vehicle, free=("N_rdot", "N_rr")), run).estimate for vehicle in (box(), light))
    assert a.sums[0].name == "I_z - N_rdot"
    assert a.sums[0].value == pytest.approx(2.3, rel=1e-6)
    assert b.sums[0].value == pytest.approx(a.sums[0].value, rel=1e-9)
    assert b["N_rdot"].value == pytest.approx(a["N_rdot"].value - 1.0, rel=1e-5)
    assert a["N_rdot"].std == pytest.approx(a.sums[0].std)


def test_the_righting_moment_of_roll_and_pitch_is_their_weighted_mean() -> None:
    push = waves(4000, 0.01, (3, 2.0, 1.3), (4, 3.0, 0.9), square=True)
    log = simulate(box(), wrench=push, disturbance=OrnsteinUhlenbeck(std=(0, 0, 0, 0.1, 0.3, 0)), seed=3)
    names = ("K_pdot", "K_pp", "M_qdot", "M_qq", "BG_z")
    both = learn_paper(box(), [log], free=names, delay=0.0, instruments=False).estimate
    assert both.names.count("BG_z") == 1
    assert both["BG_z"].identified
    assert abs(both["BG_z"].value - 3.924) < 4 * both["BG_z"].std
    i = both.names.index("BG_z")
    assert both.covariance[i, i] == pytest.approx(both["BG_z"].std ** 2)
    for other in ("K_pp", "M_qq"):
        assert both.covariance[i, both.names.index(other)] != 0.0
    assert np.linalg.eigvalsh(both.covariance).min() > -1e-12


def test_the_model_is_the_vehicle_with_what_was_found() -> None:
    run = fly(box(), waves(3000, 0.01, (0, 30.0, 0.8), square=True))
    start = unknown(box(), Y_vv=-7.0)
    learner = follow(PaperLearner(start, delay=0.02), run)
    model = learner.model()
    assert model.coefficient("X_uu") == pytest.approx(learner.estimate["X_uu"].value)
    assert model.hydrodynamics["X_uu"].std == pytest.approx(learner.estimate["X_uu"].std)
    assert model.coefficient("Y_vv") == -7.0
    assert model.command_delay == 0.0  # the delay of a wrench is none of the thrusters'
    assert start.coefficient("X_uu") == 0.0
    with pytest.raises(InputError, match="did you mean"):
        learner.estimate["X_udott"]
    assert "X_uu" in learner.estimate
    assert "Y_rdot" not in learner.estimate


def trial(seed: int, rate: float = 100.0) -> list[Recording]:
    """Surge and yaw in a tank: mocap noise, jumps, a slow disturbance."""
    dt = 1.0 / rate
    pushes = [waves(round(20.0 * rate), dt, row, square=True) for row in ((0, 25.0, 1.25), (5, 3.0, 1.25))]
    return [
        simulate(box(), wrench=push, dt=dt, sensors=Mocap(rate=rate), disturbance=TANK, seed=2 * seed + k)
        for k, push in enumerate(pushes)
    ]


def outcome(estimate: Estimate) -> tuple[list[float], list[float]]:
    return [estimate[name].value for name in WATCHED], [estimate[name].std for name in WATCHED]


@pytest.fixture(scope="module")
def streamed() -> tuple[np.ndarray, np.ndarray]:
    """Values and deviations (seeds, 4) by recursive least squares."""
    found = []
    for seed in range(SEEDS):
        learner = PaperLearner(box(), free=WATCHED)
        for log in trial(seed):
            learner.run(log)
        found.append(outcome(learner.estimate))
    values, stds = zip(*found, strict=True)
    return np.array(values), np.array(stds)


@pytest.fixture(scope="module")
def instrumented() -> tuple[np.ndarray, np.ndarray]:
    """Values and deviations (20, 4) by command-driven instruments."""
    found = [outcome(learn_paper(box(), trial(seed, 50.0), free=WATCHED, delay=0.0).estimate) for seed in range(20)]
    values, stds = zip(*found, strict=True)
    return np.array(values), np.array(stds)


@pytest.mark.parametrize("k", range(4), ids=WATCHED)
def test_intervals_cover_the_truth(streamed: tuple[np.ndarray, np.ndarray], k: int) -> None:
    values, stds = streamed[0][:, k], streamed[1][:, k]
    inside = np.abs(values - TRUTH[WATCHED[k]]) < 1.96 * stds
    assert 0.80 <= inside.mean() <= 1.0
    assert 0.6 < stds.mean() / values.std() < 4.0


def test_intervals_of_instruments_cover_the_truth(instrumented: tuple[np.ndarray, np.ndarray]) -> None:
    values, stds = instrumented
    truth = [TRUTH[name] for name in WATCHED]
    assert 0.80 <= (np.abs(values - truth) < 1.96 * stds).mean() <= 1.0


@pytest.mark.parametrize("method", ["streamed", "instrumented"])
def test_the_bias_is_small(method: str, request: pytest.FixtureRequest) -> None:
    values = request.getfixturevalue(method)[0].mean(axis=0)
    rigid = np.array([20.0, 0.0, 1.5, 0.0])
    truth = np.array([TRUTH[name] for name in WATCHED])
    assert rigid - values == pytest.approx(rigid - truth, rel=0.03)
