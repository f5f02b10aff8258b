"""Every pass stays where a vehicle is physical, and learns nothing of motion that no sensor shows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from towtank.core.arrays import Array
from towtank.core.layout import N_KINDS
from towtank.identification import learn_recordings
from towtank.identification.data.samples import N_MEASURED, samples_of
from towtank.identification.model.measurements import shown_axes
from towtank.identification.model.parameters import free_parameters
from towtank.identification.model.prior import prior_of
from towtank.identification.offline.free_runs import contradiction, worth_less
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.identification.posterior.physical import _INSIDE, Region
from towtank.identification.posterior.statistics import Reading, widened
from towtank.recording import Recording
from towtank.recording.standard import MEASURED
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import Vehicle, load_vehicle
from towtank.vehicle.matrices import added_mass_matrix, damping_matrices

NOTHING = load_vehicle("vlbv300").model_copy(update={"hydrodynamics": {}})


def test_the_mode_on_a_bound_is_the_gaussian_s_conditional_mean() -> None:
    free = free_parameters(load_vehicle("vlbv300"), ("X_u", "X_uu", "X_wdot", "delay"))
    covariance = np.array([[4.0, -2.0, 0.3, 0.0], [-2.0, 9.0, 1.0, 0.1], [0.3, 1.0, 2.0, 0.05], [0.0, 0.1, 0.05, 0.01]])
    region = Region(load_vehicle("vlbv300"), free)
    feeding = np.array([3.0, -20.0, 1.0, 0.1])  # X_u would put energy in
    expected = feeding - covariance[:, 0] / covariance[0, 0] * feeding[0]
    np.testing.assert_allclose(region.nearest(feeding, covariance), expected, atol=1e-9)
    early = np.array([-3.0, -20.0, 1.0, -0.05])
    expected = early - covariance[:, 3] / covariance[3, 3] * early[3]
    np.testing.assert_allclose(region.nearest(early, covariance), expected, atol=1e-9)
    inside = np.array([-3.0, -20.0, 1.0, 0.1])
    np.testing.assert_array_equal(region.nearest(inside, covariance), inside)


def test_only_added_inertia_moves_the_scale_of_force() -> None:
    """A drag of the wrong sign is so at any scale; a total inertia below the rigid body's says that the scale is."""
    prior = prior_of(NOTHING)
    free, gains = prior.free, np.array([name.startswith("gain_") for name in prior.names])
    share = gains / gains.sum()
    region = Region(NOTHING.with_coefficients(prior.vehicle_values), free)
    feeding = prior.mean.copy()
    feeding[prior.names.index("K_p")] = 0.5
    forces = np.where(free.codes[:, 0] < N_KINDS, feeding, 0.0)
    along = np.where(gains, 1.0, forces)  # what a larger scale does
    common = prior.covariance * 0.01 + 0.03**2 * np.outer(along, along)
    found = region.nearest(feeding, common)
    assert found[prior.names.index("K_p")] == pytest.approx(0.0, abs=1e-9)
    assert share @ found == pytest.approx(share @ feeding, abs=1e-9)
    light = prior.mean.copy()
    k = prior.names.index("X_udot")
    light[k] = np.log(0.95 * NOTHING.rigid_body.mass)
    along = np.where(gains, 1.0, np.eye(len(free))[k])
    found = region.nearest(light, np.diag(np.full(len(free), 1e-6)) + 0.03**2 * np.outer(along, along))
    assert found[k] >= np.log(NOTHING.rigid_body.mass) - 1e-9
    assert share @ found == pytest.approx(-np.log(0.95), rel=0.1)


@pytest.mark.parametrize("names", [None, ("X_udot", "Y_vdot", "X_vdot", "N_rdot", "Y_rdot", "X_u", "Y_v", "X_v")])
def test_cuts_are_the_negative_eigenvalues_of_each_matrix_at_unit_diagonal(names: tuple[str, ...] | None) -> None:
    """v^T A(x) v = lambda for an eigenvector v: of matrices with fewer rows in the same stack, too."""
    prior = prior_of(NOTHING)
    free = prior.free if names is None else free_parameters(NOTHING, names)
    region = Region(NOTHING, free)
    x = np.random.default_rng(2).normal(0.0, 30.0, len(free))
    owners, G, h = region.coupled.worst_bounds(x)
    assert {len(family.rows) for family in region.coupled.families} == ({6} if names is None else {2, 3, 6})
    for family in region.coupled.families:
        A = family.at(x)
        size = np.sqrt(np.maximum(np.abs(np.diag(A)), np.abs(np.diag(family.base))))
        values = np.linalg.eigvalsh(0.5 * (A + A.T) / np.outer(size, size))
        own = [k for k, owner in enumerate(owners) if owner is family]
        np.testing.assert_allclose(np.sort(G[own] @ x - h[own]) + _INSIDE, values[values < 0.0], atol=1e-9)
    assert len(owners) >= len(region.coupled.families) - 1


@pytest.mark.parametrize("seed", range(10))
def test_a_point_of_the_region_is_physical_whatever_a_pass_has_found(seed: int) -> None:
    """Added mass and linear damping that a pass could not be linearised about: far beyond what the axes allow."""
    prior = prior_of(NOTHING)
    free, rng = prior.free, np.random.default_rng(seed)
    root = np.linalg.cholesky(prior.covariance)
    theta = prior.mean + 2.0 * root @ rng.standard_normal(len(free))
    region = Region(NOTHING.with_coefficients(prior.vehicle_values), free)
    values = dict(zip(free.names, free.values(region.nearest(theta, prior.covariance)), strict=True))
    coefficients = {name: values[name] for name in values if name in prior.vehicle_values and name != "inflow_loss"}
    hydrodynamic = {name: value for name, value in coefficients.items() if "_" in name and name[0] in "XYZKMN"}
    added = added_mass_matrix(hydrodynamic)
    linear, quadratic = damping_matrices(hydrodynamic)
    size = np.sqrt(np.diag(NOTHING.rigid_body_matrix))
    assert np.linalg.eigvalsh(added / np.outer(size, size)).min() > -1e-6
    assert np.linalg.eigvalsh(-(linear + linear.T) / np.outer(size, size)).min() > -1e-6
    assert np.diag(quadratic).max() <= 0.0
    assert values["delay"] >= 0.0
    assert values["lag"] >= 0.001


def test_the_likeliest_physical_point_is_what_a_general_optimiser_finds() -> None:
    names = ("X_udot", "Z_wdot", "X_wdot")
    vehicle = load_vehicle("vlbv300")
    free = free_parameters(vehicle, names)
    rigid = vehicle.rigid_body.mass
    start = np.log(rigid + np.array([6.0, 4.0]))
    theta = np.array([*start, 9.0])  # of a coupling no larger than sqrt(24)
    covariance = np.diag([0.1, 0.2, 3.0]) ** 2
    found = Region(vehicle, free).nearest(theta, covariance)
    x0 = free.values(theta)
    slopes = np.abs(free.slopes(theta))
    C = covariance * np.outer(slopes, slopes)

    def away(x: np.ndarray) -> float:
        return float((x - x0) @ np.linalg.solve(C, x - x0))

    bound = {"type": "ineq", "fun": lambda x: x[0] * x[1] - x[2] ** 2}
    best = minimize(away, [-6.0, -4.0, -3.0], constraints=[bound], bounds=[(None, 0), (None, 0), (None, None)])
    assert best.success
    assert away(free.values(found)) == pytest.approx(best.fun, rel=2e-3)


# -- what no sensor shows


def measured(*names: str) -> np.ndarray:
    return np.array([name in names for name in MEASURED])


def test_an_axis_is_shown_by_a_pose_a_speed_or_an_accelerometer() -> None:
    assert shown_axes(measured("x", "y", "psi", "u", "v", "r")).tolist() == [True, True, False, False, False, True]
    assert shown_axes(measured("p", "q", "r")).tolist() == [False] * 3 + [True] * 3
    assert shown_axes(measured("p", "q", "r", "ax", "ay", "az")).all()
    assert shown_axes(measured("z", "u_w")).tolist() == [True, False, True, False, False, False]


def test_what_acts_on_or_by_a_hidden_axis_is_not_learned() -> None:
    names = ("X_udot", "N_rdot", "Y_rdot", "X_wdot", "N_v", "N_r", "M_u", "Z_ww", "K_p2", "N_ur")
    rest = ("W_minus_B", "BG_z", "N_0", "K_0", "inflow_loss", "delay", "lag")
    free = free_parameters(load_vehicle("vlbv300"), (*names, *rest))
    boat = dict(zip(free.names, free.felt(np.array([True, True, False, False, False, True])), strict=True))
    hidden = {"X_wdot", "M_u", "Z_ww", "K_p2", "W_minus_B", "BG_z", "K_0"}
    assert {name for name, shown in boat.items() if not shown} == hidden
    gyros = dict(zip(free.names, free.felt(np.array([False] * 3 + [True] * 3)), strict=True))
    hidden = {"X_udot", "Y_rdot", "X_wdot", "N_v", "M_u", "Z_ww", "N_ur", "W_minus_B", "inflow_loss"}
    assert {name for name, shown in gyros.items() if not shown} == hidden
    assert free.felt(np.ones(6, dtype=np.bool_)).all()


def slow(vehicle: Vehicle) -> Vehicle:
    """Thrusters of 30 ms of lag."""
    thrusters = tuple(each.model_copy(update={"time_constant": 0.03}) for each in vehicle.thrusters)
    return vehicle.model_copy(update={"thrusters": thrusters})


def run(kind: str, seed: int, sensors: object, vehicle: Vehicle) -> Recording:
    """Half a minute of a vehicle, in water that pushes it a little."""
    commands = manoeuvre(kind, vehicle, duration=30.0, dt=0.01, seed=seed).commands
    push = OrnsteinUhlenbeck(std=(0.3, 0.3, 0.3, 0.03, 0.03, 0.1))
    return simulate(vehicle, commands=commands, dt=0.01, sensors=sensors, disturbance=push, seed=seed)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(2))
def test_a_boat_s_log_says_nothing_of_roll_pitch_and_heave(seed: int) -> None:
    boat = slow(load_vehicle("blueboat"))
    told = boat.model_copy(update={"hydrodynamics": {}})
    log = run("surge-square", seed, Mocap(), boat).without("z", "phi", "theta")
    learning, prior = learn_recordings(told, [log]), prior_of(told)
    for name in ("K_pdot", "M_qdot", "Z_wdot", "K_p", "Z_ww", "X_wdot", "K_rdot", "Y_pdot", "M_u", "BG_z", "W_minus_B"):
        found = learning.estimate[name]
        k = prior.names.index(name)
        assert not found.identified
        assert found.value == pytest.approx(prior.values[k], rel=0.1)  # but for the scale that two thrusters have
        assert learning.narrowed[name] == pytest.approx(1.0, abs=0.1)
        assert found.reason is not None
        assert "nothing measures or drives" in found.reason
    assert learning.estimate["X_udot"].identified


def test_axes_that_are_driven_are_learned_though_no_sensor_shows_them() -> None:
    """Surge and sway of a vehicle with gyros and a depth sensor: thrust moves them, and yaw and pitch feel that."""
    truth = slow(load_vehicle("vlbv300"))
    log = run("all-telegraph", 3, Ins(), truth)
    seen = log.without(*(name for name in MEASURED if name in log and name not in ("p", "q", "r", "z")))
    samples = samples_of(seen, truth)
    problem = joint_problem(LearningRequest(NOTHING, [seen], (samples,)))
    assert problem.moving.all()
    assert problem.learned.all()
    learning = learn_recordings(NOTHING, [seen])
    for name, axis in (("X_udot", 0), ("Z_wdot", 2), ("N_rdot", 5)):
        total = float(learning.model.mass_matrix[axis, axis])
        assert total == pytest.approx(float(truth.mass_matrix[axis, axis]), rel=0.15)
        assert learning.estimate[name].identified


# -- what recordings contradict each other


def test_one_window_cannot_clear_itself_where_the_others_contradict_each_other() -> None:
    """What a single window tells alone is believed as little as what all tell together."""
    rng = np.random.default_rng(0)
    alone = []
    for _ in range(100):
        P: Array = np.eye(4)
        x: Array = np.zeros(4)
        truth = rng.standard_normal(4)
        run = [Reading(0.0, x.copy(), P.copy())]
        for k in range(16):
            a = rng.standard_normal((30, 4))
            a[:, 3] *= k == 8
            shift = 3.0 * np.linalg.cholesky(a.T @ a + 1e-9 * np.eye(4)) @ rng.standard_normal(4)
            view = np.linalg.solve(P, x) + a.T @ a @ truth + shift
            P = np.asarray(np.linalg.inv(np.linalg.inv(P) + a.T @ a))
            x = P @ view
            run.append(Reading(0.0, x.copy(), P.copy()))
        covariance, _ = widened(run)
        alone.append(np.sqrt(covariance[3, 3] / P[3, 3]))
    assert np.median(alone) == pytest.approx(3.0, rel=0.15)


@pytest.mark.parametrize("apart", [1.0, 3.0])
def test_parts_that_come_to_other_ends_are_worth_as_much_less(apart: float) -> None:
    """A posterior of five unknowns from 8 parts; the fifth is known beforehand alone."""
    rng, parts = np.random.default_rng(1), 8
    prior, factors = np.diag([4.0, 1.0, 9.0, 1.0, 2.0]), []
    for _ in range(200):
        L, score = np.zeros((parts, 5, 5)), np.zeros((parts, 5))
        for g in range(parts):
            a = rng.standard_normal((40, 5)) * [1.0, 1.0, 1.0, 1.0, 0.0]
            L[g] = a.T @ a
            score[g] = apart * a.T @ rng.standard_normal(40)
        whole = np.linalg.inv(prior) + L.sum(axis=0)
        covariance = np.linalg.inv(whole)
        mode = covariance @ score.sum(axis=0)
        without = [np.linalg.solve(whole - L[g], score.sum(axis=0) - score[g]) - mode for g in range(parts)]
        factors.append(contradiction(without, covariance * parts / (parts - 1) ** 2, covariance, prior))
    assert np.sqrt(np.mean(np.square(factors))) == pytest.approx(apart, rel=0.05)
    wide = worth_less(covariance, prior, apart)
    assert wide[4, 4] == pytest.approx(2.0, rel=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(wide) / np.diag(covariance))[:4], apart, rtol=0.02)


def test_two_likelihoods_of_the_same_unknowns_agree_by_what_both_state() -> None:
    rng, prior = np.random.default_rng(2), np.diag([1.0, 4.0, 9.0])
    one, other = np.diag([0.01, 0.04, 9.0]), np.diag([0.02, 0.01, 9.0])  # neither tells the third
    away = [np.append(rng.standard_normal(2) * np.sqrt(np.diag(one + other)[:2]), 0.0) for _ in range(500)]
    factors = [contradiction([each], one + other, one, prior) for each in away]
    assert np.sqrt(np.mean(np.square(factors))) == pytest.approx(1.0, rel=0.05)
    assert contradiction([3.0 * away[0]], one + other, one, prior) == pytest.approx(3.0 * factors[0])


def test_parts_that_agree_leave_a_posterior_as_it_is() -> None:
    covariance, prior = np.diag([0.1, 0.2]), np.eye(2)
    factor = contradiction([np.zeros(2)] * 4, covariance, covariance, prior)
    assert factor == 0.0
    np.testing.assert_allclose(worth_less(covariance, prior, factor), covariance, rtol=1e-9)
    assert contradiction([], covariance, covariance, prior) == 1.0


def test_nothing_measured_is_nothing_shown() -> None:
    assert not shown_axes(np.zeros(N_MEASURED, dtype=np.bool_)).any()
