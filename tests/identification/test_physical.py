"""The likeliest physical model: nothing moves where all is physical, and what does moves as it must."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from towtank.errors import InputError
from towtank.identification.posterior.physical import Consistency, consistent, families
from towtank.identification.posterior.statistics import conditional_covariance, nearest_point, square_root
from towtank.vehicle import Vehicle, VehicleWarning, load_vehicle

from .runs import box

UPPER = tuple(f"{row}_{col}dot" for i, row in enumerate("XYZKMN") for j, col in enumerate("uvwpqr") if j >= i)


def sound(vehicle: Vehicle, names: tuple[str, ...], found: Consistency) -> bool:
    """Whether the vehicle with these values has no fault in mass or damping."""
    learned = vehicle.with_coefficients(dict(zip(names, map(float, found.values), strict=True)))
    words = ("mass", "energy", "damping")
    return not any(word in line for line in learned.warnings for word in words)


def test_what_is_physical_stays_as_it_is() -> None:
    vehicle = load_vehicle("vlbv300")
    names = ("X_udot", "X_uu", "N_rdot", "Y_rdot", "W_minus_B", "delay", "gain_aft_port")
    values = np.array([-19.5, -41.3, -0.9, -0.3, 1.5, 0.04, 1.0])
    S = np.random.default_rng(0).normal(size=(7, 7))
    found = consistent(vehicle, names, values, S @ S.T)
    assert np.array_equal(found.values, values)
    np.testing.assert_allclose(found.covariance, S @ S.T, rtol=1e-12)
    assert (found.held, found.violations, found.messages, found.distance) == ((), (), (), 0.0)


def test_a_negative_added_mass_is_held_at_zero_and_drag_follows() -> None:
    C = np.array([[0.25, 0.3], [0.3, 4.0]])
    names = ("X_udot", "X_uu")
    found = consistent(load_vehicle("vlbv300"), names, np.array([3.1, -41.0]), C)
    # conditional Gaussian at X_udot = 0
    assert found.values == pytest.approx([0.0, -41.0 - 0.3 / 0.25 * 3.1])
    assert found.values[0] == 0.0
    np.testing.assert_allclose(found.covariance, [[0.0, 0.0], [0.0, 4.0 - 0.3**2 / 0.25]], atol=1e-12)
    assert found.held == ("X_udot",)
    assert found.distance == pytest.approx(6.2)
    (violation,) = found.violations
    assert violation.names == ("X_udot",)
    assert violation.deviations == pytest.approx(6.2)
    assert violation.text == (
        "the data pull X_udot to +3.1 +- 0.5 kg, an added mass below zero by 6.2 deviations"
        ": check the mass in the file, the thrusters' force scale or the delay; moved to 0"
    )


def test_drag_that_feeds_energy_in() -> None:
    names = ("N_r", "N_rr")
    found = consistent(load_vehicle("vlbv300"), names, np.array([0.9, -0.8]), np.diag([0.04, 0.01]))
    assert found.values.tolist() == [0.0, -0.8]
    assert (
        "drag that feeds energy in by 4.5 deviations: check the direction of the commanded yaw moment"
        in (found.messages[0])
    )
    small = consistent(load_vehicle("vlbv300"), names, np.array([0.1, -0.8]), np.diag([0.04, 0.01]))
    assert small.messages == (
        "N_r came out as +0.1 +- 0.2 N m s/rad, 0.5 deviations beyond what is physical; moved to 0",
    )


def test_one_bound_can_push_another_coefficient_to_its_own() -> None:
    C = np.array([[1.0, 0.9], [0.9, 1.0]])
    found = consistent(load_vehicle("vlbv300"), ("N_r", "N_rr"), np.array([-0.5, 2.0]), C)
    assert found.values == pytest.approx([-2.3, 0.0])
    found = consistent(load_vehicle("vlbv300"), ("N_r", "N_rr"), np.array([-0.5, 2.0]), C * [[1, -1], [-1, 1]])
    assert found.values.tolist() == [0.0, 0.0]
    assert found.held == ("N_r", "N_rr")
    assert found.messages[-1] == "N_r, -0.5 +- 1 N m s/rad by itself, comes to 0 once the others are physical"


@pytest.mark.parametrize(
    ("names", "values"),
    [
        (("Y_vdot", "Y_rdot", "N_rdot"), (-16.0, -6.0, -0.9)),
        (("Y_v", "Y_r", "N_r", "N_v"), (-10.0, 6.0, -2.0, 6.0)),
        (("Y_vv", "Y_rr", "N_rr", "N_vv"), (-70.0, 16.0, -0.3, 9.0)),
        (("Y_rdot",), (-6.0,)),
        (("X_udot", "Z_udot", "Z_wdot", "X_uu"), (2.0, 3.0, 1.0, -40.0)),
    ],
)
def test_couplings_too_large_for_their_diagonal(names: tuple[str, ...], values: tuple[float, ...]) -> None:
    vehicle = load_vehicle("vlbv300")
    C = np.diag(np.linspace(0.2, 1.0, len(names)))
    assert not sound(vehicle, names, Consistency(np.array(values), C, (), 0.0, ())) or "Y_rr" in names
    found = consistent(vehicle, names, np.array(values), C)
    assert sound(vehicle, names, found)
    assert found.distance > 0.0
    assert found.violations
    assert np.linalg.eigvalsh(found.covariance)[0] > -1e-12
    assert np.all(np.diag(found.covariance) <= np.diag(C) + 1e-12)
    again = consistent(vehicle, names, found.values, C)  # a projection: twice is once
    np.testing.assert_allclose(again.values, found.values, rtol=1e-6, atol=1e-8)


def test_the_message_on_couplings_names_them_and_where_they_went() -> None:
    names = ("Y_vdot", "Y_rdot", "N_rdot")
    found = consistent(load_vehicle("vlbv300"), names, np.array([-16.0, -6.0, -0.9]), np.diag([1.0, 0.5, 0.01]))
    assert found.messages == (
        "the added-mass matrix is not positive semidefinite in a combination of Y_vdot, Y_rdot, N_rdot, by 3 deviations"
        ": check lever arms, the place of the body origin and signs"
        "; moved to the nearest physical values (Y_vdot -16 -> -16.5, Y_rdot -6 -> -4.02, N_rdot -0.9 -> -0.981)",
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_nearest_of_all_added_mass_matrices(seed: int) -> None:
    rng = np.random.default_rng(seed)
    vehicle = box(hydrodynamics={})
    A = rng.normal(size=(6, 6))
    x0 = -(A + A.T)[np.triu_indices(6)]
    S = rng.normal(size=(21, 21)) + 2.0 * np.eye(21)
    C = S @ S.T
    found = consistent(vehicle, UPPER, x0, C)
    assert sound(vehicle, UPPER, found)
    # no physical matrix is nearer: the derivative of the distance is not negative towards any of them
    slope = np.linalg.solve(C, found.values - x0)
    assert found.distance == pytest.approx(float(np.sqrt((found.values - x0) @ slope)), rel=1e-6)
    for _ in range(200):
        B = rng.normal(size=(6, rng.integers(1, 7)))
        other = -(B @ B.T)[np.triu_indices(6)]
        assert slope @ (other - found.values) > -1e-4 * (1.0 + abs(slope @ other))
    assert slope @ found.values == pytest.approx(0.0, abs=1e-3 * found.distance**2)


@pytest.mark.parametrize("seed", range(5))
def test_the_projection_meets_the_conditions_of_karush_kuhn_and_tucker(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = 6, 9
    S, G = rng.normal(size=(n, n)), rng.normal(size=(m, n))
    C = S @ S.T
    x0, h = rng.normal(size=n), G @ rng.normal(size=n) - rng.uniform(0.0, 0.5, m)
    found = nearest_point(x0, square_root(C), G, h)
    assert found.reachable
    assert np.all(G @ found.x >= h - 1e-9)
    assert np.all(found.multipliers >= 0.0)
    np.testing.assert_allclose(found.x - x0, C @ G.T @ found.multipliers, atol=1e-9)
    np.testing.assert_allclose(found.multipliers * (G @ found.x - h), 0.0, atol=1e-8)
    W = np.linalg.inv(C)
    other = minimize(
        lambda x: (x - x0) @ W @ (x - x0),
        x0,
        jac=lambda x: 2.0 * W @ (x - x0),
        constraints={"type": "ineq", "fun": lambda x: G @ x - h, "jac": lambda x: G},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    cost = (found.x - x0) @ W @ (found.x - x0)
    assert cost <= other.fun * (1.0 + 1e-6)


def test_a_singular_covariance_moves_only_what_may_move() -> None:
    vehicle = load_vehicle("vlbv300")
    names = ("X_udot", "X_uu", "N_rr")
    direction = np.array([0.5, 2.0, 0.0])  # known but for one direction
    found = consistent(vehicle, names, np.array([3.0, -41.0, -0.3]), np.outer(direction, direction))
    assert found.values == pytest.approx([0.0, -41.0 - 12.0, -0.3])
    assert np.abs(found.covariance).max() < 1e-9
    unknown = np.diag([0.25, np.nan, 0.01])
    found = consistent(vehicle, names, np.array([3.0, -41.0, -0.3]), unknown)
    assert found.values == pytest.approx([0.0, -41.0, -0.3])
    assert np.isnan(found.covariance[1]).all()
    assert found.covariance[2, 2] == pytest.approx(0.01)


def test_what_nothing_free_can_mend_is_said() -> None:
    vehicle = load_vehicle("vlbv300")
    found = consistent(vehicle, ("X_udot", "N_r"), np.array([3.0, 0.4]), np.diag([0.0, 0.01]))
    assert found.values.tolist() == [3.0, 0.0]
    assert any("cannot mend it" in line for line in found.messages)
    couplings = consistent(vehicle, ("Y_rdot",), np.array([-9.0]), np.zeros((1, 1)))
    assert couplings.values.tolist() == [-9.0]
    assert "cannot mend it" in couplings.messages[0]


def test_what_the_file_has_wrong_is_left_alone() -> None:
    with pytest.warns(VehicleWarning, match="Y_vdot"):
        published = load_vehicle("vlbv300_as_published")
    assert published.coefficient("Y_vdot") > 0.0
    names = ("X_udot", "Y_rdot")
    found = consistent(published, names, np.array([-20.0, -0.1]), np.eye(2))
    assert found.values.tolist() == [-20.0, -0.1]


def test_total_inertia_stays_positive_where_no_added_mass_is_known() -> None:
    vehicle = box(hydrodynamics={})
    found = consistent(vehicle, ("Y_rdot",), np.array([-9.0]), np.array([[4.0]]))
    total = vehicle.with_coefficients({"Y_rdot": float(found.values[0])}).mass_matrix
    assert np.linalg.eigvalsh(total)[0] > 0.0
    assert "total mass matrix is not positive definite" in found.messages[0]


def test_matrices_of_the_bounds() -> None:
    vehicle = load_vehicle("vlbv300")
    by_kind = {family.kind: family for family in families(vehicle, ("Y_rdot", "N_r", "X_uu", "delay", "BG_z"))}
    assert set(by_kind) == {"added", "inertia", "linear", "quadratic", "ahead", "astern"}
    x = np.array([-0.5, -2.0, -40.0, 0.1, 4.0])
    changed = vehicle.with_coefficients({"Y_rdot": -0.5, "N_r": -2.0, "X_uu": -40.0})
    np.testing.assert_allclose(by_kind["added"].at(x), changed.added_mass_matrix)
    assert by_kind["linear"].rows == (5,)
    assert by_kind["linear"].at(x).tolist() == [[2.0]]
    assert by_kind["quadratic"].at(x)[0, 0] == 40.0
    assert not by_kind["quadratic"].coupled
    assert by_kind["added"].coupled


def test_square_root_and_conditional_covariance() -> None:
    S = np.random.default_rng(1).normal(size=(5, 3)) * [[1e-6], [1.0], [1e6], [1.0], [0.0]]
    C = S @ S.T
    root = square_root(C)
    np.testing.assert_allclose(root @ root.T, C, rtol=1e-9, atol=1e-18)
    full = np.diag([1.0, 4.0, 9.0]) + 0.5
    left = conditional_covariance(full, np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0]]))  # the same bound twice
    assert np.array([1.0, 1.0, 0.0]) @ left @ np.array([1.0, 1.0, 0.0]) == pytest.approx(0.0, abs=1e-9)
    assert np.array_equal(conditional_covariance(full, np.empty((0, 3))), full)


def test_what_does_not_fit_together_is_refused() -> None:
    vehicle = box()
    with pytest.raises(InputError, match="2 names"):
        consistent(vehicle, ("X_udot", "X_uu"), np.zeros(1), np.eye(2))
    with pytest.raises(InputError, match="X_uu is not a finite number"):
        consistent(vehicle, ("X_udot", "X_uu"), np.array([0.0, np.nan]), np.eye(2))
