"""Without noise the chain finds the truth: every axis, coupled axes, any filter constant, irregular times, gaps."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.identification import PaperLearner, learn_paper
from towtank.simulation import simulate
from towtank.vehicle import Vehicle

from .runs import POSE, TRUTH, VELOCITY, Run, box, errors, fly, follow, table, unknown, waves

ONE_BY_ONE = [(0, 40.0, 0.8), (1, 60.0, 0.8), (2, 40.0, 0.8), (3, 3.0, 0.9), (4, 4.0, 1.1), (5, 4.0, 0.8)]


def one_after_the_other(vehicle: Vehicle, **settings: float) -> PaperLearner:
    learner = PaperLearner(unknown(vehicle), free=(*TRUTH, "BG_z"), **settings)  # type: ignore[arg-type]
    for row in ONE_BY_ONE:
        learner.restart()
        follow(learner, fly(vehicle, waves(3000, 0.01, row)))
    return learner


@pytest.mark.parametrize("a", [0.3, 3.0, 10.0])
def test_twelve_coefficients_and_the_righting_moment_of_held_inputs(a: float) -> None:
    learner = one_after_the_other(box(), a=a)
    assert max(errors(learner, TRUTH).values()) < 2e-6
    assert learner.estimate["BG_z"].value == pytest.approx(0.02 * 20 * 9.81, rel=1e-6)


def test_smooth_inputs() -> None:
    vehicle, truth = box(), {name: TRUTH[name] for name in ("X_udot", "X_uu")}

    def push(t: np.ndarray) -> np.ndarray:
        out = np.zeros((*np.shape(t), 6))
        out[..., 0] = 40 * np.sin(0.8 * t)
        return out

    log = simulate(vehicle, wrench=push, dt=0.01, duration=40.0)
    run = Run(log["u"].t, table(log, POSE), table(log, VELOCITY), push(log["u"].t))
    learner = follow(PaperLearner(unknown(vehicle), free=tuple(truth), inputs="smooth"), run)
    assert max(errors(learner, truth).values()) < 1e-6


RICH = {**TRUTH, "X_u": -6.0, "Y_v": -9.0, "Z_w": -8.0, "K_p": -0.8, "M_q": -0.9, "N_r": -1.1,
        "X_0": 0.6, "Y_0": -0.5, "K_0": 0.05, "M_0": -0.04, "N_0": 0.07}  # fmt: skip


def test_both_damping_terms_constants_and_net_weight() -> None:
    vehicle = box(hydrodynamics=RICH, buoyancy={"force": 194.0, "centre": (0.0, 0.0, -0.02)})
    learner = PaperLearner(vehicle.with_coefficients({"X_u": -1.0, "X_uu": -90.0, "Z_w": -80.0, "X_0": 0.0}))
    for row in ONE_BY_ONE:
        learner.restart()
        follow(learner, fly(vehicle, waves(3000, 0.01, row)))
    assert max(errors(learner, {n: v for n, v in RICH.items() if n[0] in "XZ"}).values()) < 1e-3
    assert learner.estimate["W_minus_B"].value == pytest.approx(20 * 9.81 - 194.0, abs=1e-3)
    assert learner.estimate["BG_z"].value == pytest.approx(0.02 * 194.0, rel=1e-3)


ALL_AT_ONCE = [(k, amplitude, 0.4 + 0.17 * k) for k, amplitude in enumerate((40.0, 60.0, 50.0, 3.0, 4.0, 5.0))]


@pytest.mark.parametrize("truth", [TRUTH, RICH], ids=["quadratic", "rich"])
def test_all_axes_at_once_from_a_recording(truth: dict[str, float]) -> None:
    """Perfect sensors, nothing known of the hydrodynamics: every axis' coupling has to be learned beside it."""
    vehicle = box(hydrodynamics=truth)
    log = simulate(vehicle, wrench=waves(6000, 0.01, *ALL_AT_ONCE))
    estimate = learn_paper(unknown(vehicle), [log], delay=0.0).estimate
    for axis, rigid in zip(("X_udot", "Y_vdot", "Z_wdot", "N_rdot"), (20.0, 20.0, 20.0, 1.5), strict=True):
        assert estimate[axis].identified
        assert rigid - estimate[axis].value == pytest.approx(rigid - truth[axis], rel=0.03)


def test_the_model_of_the_couplings_never_runs_away() -> None:
    vehicle = box()
    learner = PaperLearner(unknown(vehicle))
    run = fly(vehicle, waves(3000, 0.01, *ALL_AT_ONCE))
    true = np.diag(vehicle.mass_matrix)
    for k in range(run.t.size):
        learner.update(run.t[k], pose=run.pose[k], velocity=run.velocity[k], wrench=run.wrench[k])
        chain = learner._chain
        assert chain is not None
        assert (chain.state.p[0:36:7] < 10.0 * true).all()


def test_known_couplings_are_honoured() -> None:
    """Off-diagonal inertia and damping that the vehicle's file holds are not taken for something else."""
    coupling = {"Y_rdot": 0.8, "Y_r": 0.5, "N_v": 0.4, "X_vv": -0.5}
    vehicle = box(hydrodynamics={**TRUTH, **coupling})
    run = fly(vehicle, waves(6000, 0.01, (0, 40.0, 0.5), (1, 60.0, 0.7), (5, 4.0, 0.9)))
    truth = {name: TRUTH[name] for name in ("X_uu", "Y_vdot", "Y_vv", "N_rr")}
    knowing = follow(PaperLearner(vehicle, free=tuple(truth)), run)
    assert max(errors(knowing, truth).values()) < 1e-5
    ignorant = follow(PaperLearner(box(), free=tuple(truth)), run)
    assert max(errors(ignorant, truth).values()) > 0.02


def thinned(run: Run, keep: np.ndarray, learner: PaperLearner, *, velocity: bool = True) -> PaperLearner:
    """Commands at every time, motion only where `keep` (n,) says so."""
    for k in range(run.t.size):
        learner.update(
            run.t[k],
            pose=run.pose[k] if keep[k] else None,
            velocity=run.velocity[k] if keep[k] and velocity else None,
            wrench=run.wrench[k],
        )
    return learner


SHORT = {name: TRUTH[name] for name in ("X_udot", "X_uu", "N_rdot", "N_rr")}
PUSHES = [waves(4000, 0.01, row, square=True) for row in ((0, 30.0, 0.8), (5, 4.0, 1.1))]


def holes(kind: str) -> np.ndarray:
    rng = np.random.default_rng(6)
    keep = np.ones(4001, dtype=bool)
    if kind == "irregular":
        keep = np.isin(np.arange(4001), np.cumsum(rng.integers(1, 6, 4001)))
    elif kind == "gaps":
        for start in rng.integers(100, 3800, 12):
            keep[start : start + rng.integers(60, 200)] = False
    elif kind == "dropouts":
        for start in range(100, 4000, 100):
            keep[start : start + 30] = False
    keep[0] = True
    return keep


def both_runs(kind: str, *, velocity: bool) -> dict[str, float]:
    """Relative errors of the total inertias and drags of surge and yaw."""
    learner = PaperLearner(unknown(box()), free=tuple(SHORT))
    for push in PUSHES:
        learner.restart()
        thinned(fly(box(), push), holes(kind), learner, velocity=velocity)
    rigid = {"X_udot": 20.0, "N_rdot": 1.5}
    estimate = learner.estimate
    assert all(estimate.identified)
    found = {name: rigid.get(name, 0.0) - estimate[name].value for name in SHORT}
    return {name: abs(found[name] / (rigid.get(name, 0.0) - SHORT[name]) - 1.0) for name in SHORT}


@pytest.mark.parametrize("kind", ["irregular", "gaps", "dropouts"])
def test_irregular_times_and_gaps_do_not_bias_measured_velocity(kind: str) -> None:
    assert 0.2 < holes(kind).mean() < 0.85
    assert max(both_runs(kind, velocity=True).values()) < (1e-2 if kind == "dropouts" else 1e-3)


@pytest.mark.parametrize("kind", ["regular", "irregular", "gaps"])
def test_irregular_times_and_gaps_hardly_bias_derived_velocity(kind: str) -> None:
    assert max(both_runs(kind, velocity=False).values()) < 0.02


def test_dropouts_shorter_than_a_gap_hardly_bias_derived_velocity() -> None:
    assert max(both_runs("dropouts", velocity=False).values()) < 0.08


def test_a_recording_gives_the_same_truth() -> None:
    learner = PaperLearner(unknown(box()), free=tuple(SHORT))
    assert [learner.run(simulate(box(), wrench=push, dt=0.01)) for push in PUSHES] == [4000, 4000]
    assert max(errors(learner, SHORT).values()) < 1e-6


def test_a_vehicle_with_a_delay_is_learned_from_its_wrenches() -> None:
    """`simulate` applies a vehicle's command delay to commands, never to a wrench; so does the learner."""
    vehicle = box(command_delay=0.15)
    learner = PaperLearner(vehicle, free=tuple(SHORT))
    for push in PUSHES:
        learner.run(simulate(vehicle, wrench=push, dt=0.01))
    assert max(errors(learner, SHORT).values()) < 1e-6
