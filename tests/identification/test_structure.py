"""Which coefficients are said to be found: never one that the data does not hold, never one that is not physical."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.identification import Estimate, PaperLearner, learn_paper
from towtank.identification.least_squares.solution import (
    AxisFindings,
    AxisInformation,
    AxisSolution,
    select,
    solve_axis,
)
from towtank.identification.model.terms import AXES, candidates, paper_names
from towtank.recording import Recording
from towtank.simulation import Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import Vehicle, load_vehicle

from .runs import TRUTH, box, fly, follow, unknown, waves

TANK = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05))


def surge(amplitude: float, *, seed: int = 0, seconds: float = 60.0, **drag: float) -> Recording:
    vehicle = box(hydrodynamics={"X_udot": -10.0, **drag})
    push = waves(round(seconds * 100), 0.01, (0, amplitude, 0.5), (0, 0.6 * amplitude, 1.7), square=True)
    return simulate(vehicle, wrench=push, sensors=Mocap(), disturbance=TANK, seed=seed)


def learned(log: Recording) -> Estimate:
    return learn_paper(box(hydrodynamics={}), [log], delay=0.0).estimate


def consistent(estimate: Estimate) -> None:
    """What holds of every estimate whatsoever."""
    for c in estimate.coefficients:
        assert c.identified == (c.reason is None), c
        assert np.isfinite(c.value)
        assert np.isfinite(c.std) == c.identified
        if c.identified and c.name[2:] in ("u", "v", "w", "p", "q", "r", "uu", "vv", "ww", "pp", "qq", "rr"):
            assert c.value < 0.0, c
    assert all(total.value > 0.0 for total in estimate.sums)


@pytest.mark.parametrize("seed", range(3))
def test_quadratic_truth(seed: int) -> None:
    estimate = learned(surge(30.0, seed=seed, X_uu=-30.0))
    consistent(estimate)
    assert estimate["X_uu"].identified
    assert estimate["X_uu"].value == pytest.approx(-30.0, rel=0.05)
    assert not estimate["X_u"].identified
    assert estimate["X_u"].value == 0.0
    assert "cannot be told apart" in str(estimate["X_u"].reason)


@pytest.mark.parametrize("seed", range(3))
def test_linear_truth(seed: int) -> None:
    estimate = learned(surge(30.0, seed=seed, X_u=-25.0))
    consistent(estimate)
    assert estimate["X_u"].identified
    assert estimate["X_u"].value == pytest.approx(-25.0, rel=0.05)
    assert not estimate["X_uu"].identified
    assert estimate["X_uu"].value == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_both_at_high_speed(seed: int) -> None:
    estimate = learned(surge(90.0, seed=seed, seconds=120.0, X_u=-20.0, X_uu=-30.0))
    consistent(estimate)
    assert estimate["X_u"].identified
    assert estimate["X_uu"].identified
    assert abs(estimate["X_u"].value + 20.0) < 4.0 * estimate["X_u"].std
    assert abs(estimate["X_uu"].value + 30.0) < 4.0 * estimate["X_uu"].std


@pytest.mark.parametrize("seed", range(4))
def test_both_at_low_speed_cannot_be_told_apart(seed: int) -> None:
    estimate = learned(surge(4.0, seed=seed, X_u=-20.0, X_uu=-30.0))
    consistent(estimate)
    found = [estimate[name] for name in ("X_u", "X_uu")]
    assert sum(c.identified for c in found) == 1
    reason = next(c.reason for c in found if not c.identified)
    assert reason is not None
    assert "cannot be told apart" in reason
    assert "stands for both" in reason


def test_an_axis_that_rests_under_disturbance_is_not_identified() -> None:
    for sensors in ("perfect", Mocap()):
        vehicle = load_vehicle("vlbv300")
        commands = manoeuvre("surge-square", vehicle, duration=30.0).commands
        log = simulate(vehicle, commands=commands, sensors=sensors)
        estimate = learn_paper(vehicle, [log], delay=0.0).estimate
        consistent(estimate)
        assert estimate["X_udot"].identified
        assert not estimate["Y_vdot"].identified
        assert "sway was not" in str(estimate["Y_vdot"].reason)


@pytest.mark.parametrize("seed", range(4))
def test_axes_that_only_a_disturbance_moves_do_not_drag_the_others_along(seed: int) -> None:
    """Without a command nothing anchors the scale of an axis: it may not be learned, nor used to learn others."""
    log = simulate(
        box(), wrench=waves(6000, 0.01, (0, 25.0, 0.6), square=True), sensors=Mocap(), disturbance=TANK, seed=seed
    )
    estimate = learn_paper(box(), [log], delay=0.0).estimate
    truth = {**TRUTH, "BG_z": 0.02 * 20 * 9.81}
    wrong = {
        c.name: (c.value, c.std)
        for c in estimate.coefficients
        if c.identified and abs(c.value - truth.get(c.name, 0.0)) > 5.0 * c.std
    }
    assert not wrong


def test_without_any_command_nothing_is_found() -> None:
    log = simulate(box(), wrench=np.zeros((4000, 6)), disturbance=TANK, sensors=Mocap())
    learning = learn_paper(box(), [log])
    consistent(learning.estimate)
    assert not any(learning.estimate.identified)
    assert any("nothing could be identified" in text for text in learning.warnings)


def test_speeds_that_are_not_measured() -> None:
    vehicle = box()
    log = simulate(vehicle, wrench=waves(2000, 0.01, (5, 4.0, 1.0), square=True))
    log = log.without(*"xyzuvw", "phi", "theta", "psi")
    estimate = learn_paper(vehicle, [log], delay=0.0).estimate
    consistent(estimate)
    assert estimate["N_rr"].identified
    assert estimate["X_udot"].reason == "surge speed u is not measured in these recordings"
    learner = PaperLearner(vehicle)
    assert learner.estimate["X_udot"].reason == "no motion has been seen yet"
    learner.run(log)
    assert learner.estimate["Y_vv"].reason == "sway speed v is not measured"
    consistent(learner.estimate)


def test_reversed_thrust_is_not_called_rest() -> None:
    run = fly(box(), waves(3000, 0.01, (0, 30.0, 0.8), square=True))
    learner = PaperLearner(box(), free=("X_udot", "X_uu"))
    for k in range(run.t.size):
        learner.update(run.t[k], velocity=run.velocity[k], pose=run.pose[k], wrench=-run.wrench[k])
    found = learner.estimate["X_udot"]
    assert not found.identified
    assert "hardly varied" not in str(found.reason)


# -- free=...


def test_free_takes_exactly_those_names() -> None:
    run = fly(box(), waves(2000, 0.01, (0, 30.0, 0.8), square=True))
    assert set(follow(PaperLearner(box(), free=("X_uu",)), run).estimate.names) == {"X_uu"}
    fitted = follow(PaperLearner(box(), free=["X_udot", "X_u"]), run).estimate
    assert set(fitted.names) == {"X_udot", "X_u"}
    assert fitted["X_u"].value == pytest.approx(0.0, abs=1e-3)  # X_uu is held at its true value


@pytest.mark.parametrize("name", paper_names())
def test_every_name_that_is_asked_for_is_answered(name: str) -> None:
    run = fly(box(), waves(300, 0.01, (0, 30.0, 0.8), (3, 1.0, 1.0), (5, 4.0, 1.0), square=True))
    estimate = follow(PaperLearner(box(), free=(name,)), run).estimate
    assert estimate.names == (name,)
    consistent(estimate)


@pytest.mark.parametrize("name, hint", [("X_uuu", 'did you mean "X_uu"'), ("Y_rdot", "off-diagonal"), ("", "expected")])
def test_unknown_names_are_refused(name: str, hint: str) -> None:
    with pytest.raises(InputError, match="found") as caught:
        PaperLearner(box(), free=(name,))
    assert hint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_damping_terms_of_the_file_decide_what_is_wanted() -> None:
    quadratic, neither = candidates(box())[0], candidates(unknown(box()))[0]
    assert quadratic.to_learn[:2] == (False, True)
    assert neither.to_learn[:2] == (True, True)


# -- the rules by themselves, over data of every kind


def information(rows: Array) -> AxisInformation:
    R = np.linalg.qr(rows, mode="r")
    blocks = np.array([part.T @ part for part in np.array_split(rows, 40)])
    return AxisInformation(R, blocks, 0.25, float(len(rows)), 3.0, 1.0, 1.0)


def cases() -> list[tuple[Vehicle, AxisFindings]]:
    """Outcomes of `select` for physical and impossible truths, rich and poor data, little and much noise."""
    rng = np.random.default_rng(0)
    vehicle = box(hydrodynamics={"X_udot": -10.0, "X_u": -5.0, "X_uu": -30.0, "K_p": -1.0, "K_pp": -1.0, "Z_w": -5.0})
    found = []
    t = np.arange(400) * 0.1
    for _ in range(600):
        free = None if rng.random() < 0.5 else list(rng.choice(paper_names(), 4))
        u = np.sin(t * rng.uniform(0.2, 2)) * 10 ** rng.uniform(-2, 0.5)
        still = rng.random() < 0.5
        tilt = np.full(400, rng.choice([0.0, 1.0])) if still else 0.1 * rng.normal(size=400)
        push = rng.normal(size=400) * 10 ** rng.uniform(-2, 1) + 5 * np.cos(t)
        columns = np.column_stack([u, np.abs(u) * u, tilt, np.ones(400), push])
        if rng.random() < 0.2:
            columns[:, rng.integers(5)] = 0.0
        theta = rng.normal(size=5) * [1, 1, 0.3, 0.3, 0.2]
        y = columns @ theta + rng.normal(size=400) * 10 ** rng.uniform(-6, 0)
        known = information(np.column_stack([columns, y]))

        def solve(flags: tuple[bool, ...], held: Array, known: AxisInformation = known) -> AxisSolution | None:
            return solve_axis(known, flags, held)

        candidate = candidates(vehicle, free)[rng.integers(6)]
        found.append((vehicle, select(candidate, solve, lambda solution: solution.residual_sum)))
    return found


@pytest.fixture(scope="module")
def outcomes() -> list[tuple[Vehicle, AxisFindings]]:
    return cases()


def test_whatever_is_not_identified_has_a_reason(outcomes: list[tuple[Vehicle, AxisFindings]]) -> None:
    silent = [
        (f.axis.name, c)
        for _, f in outcomes
        for c in range(5)
        if f.to_learn[c]
        and not (f.solution and f.solution.free[c])
        and (*f.axis.columns, "mass")[c]
        and not f.reasons[c]
    ]
    assert not silent


def test_no_inertia_is_negative(outcomes: list[tuple[Vehicle, AxisFindings]]) -> None:
    masses = [f.solution.values[4] for _, f in outcomes if f.solution and f.solution.free[4]]
    assert masses
    assert min(masses) > 0.0


def test_no_damping_feeds_energy_in(outcomes: list[tuple[Vehicle, AxisFindings]]) -> None:
    damping = [f.solution.values[c] for _, f in outcomes for c in (0, 1) if f.solution and f.solution.free[c]]
    assert damping
    assert max(damping) < 0.0


def test_what_stands_for_both_is_identified_itself(outcomes: list[tuple[Vehicle, AxisFindings]]) -> None:
    for _, f in outcomes:
        for reason in f.reasons:
            if reason and "stands for both" in reason:
                kept = 0 if f"{f.axis.linear} stands" in reason else 1
                assert f.solution is not None
                assert f.solution.free[kept]


def test_the_axes_cover_all_names_once() -> None:
    assert len(set(paper_names())) == len(paper_names()) == 6 + 12 + 2 + 5
    assert TRUTH.keys() <= set(paper_names())
    assert [axis.index for axis in AXES] == list(range(6))
