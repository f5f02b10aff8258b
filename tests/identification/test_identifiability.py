"""What a run can tell is read from its information, in words, and never depends on the units of the coordinates."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.identification.posterior.identifiability import Criteria, excitation, excitation_words, identifiability
from towtank.identification.posterior.statistics import alone, along, correlations, deviations, pair, relative
from towtank.identification.posterior.wording import needed_factor

SURGE = ("X_udot", "X_u", "X_uu")
M, L, Q = 40.0, 20.0, 40.0
THETA = np.log([M, L, Q, 1.0])


def surge(force: np.ndarray, dt: float = 0.01) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Speed, acceleration and force (n,) of M u_dot = X - L u - Q |u| u."""
    u, a = np.zeros(force.size), np.zeros(force.size)
    for k in range(force.size):
        a[k] = (force[k] - L * u[k] - Q * abs(u[k]) * u[k]) / M
        if k + 1 < force.size:
            u[k + 1] = u[k] + dt * a[k]
    return u, a, force


def information(run: tuple[np.ndarray, np.ndarray, np.ndarray], std: float, *, gain: bool = False) -> np.ndarray:
    """Of ln M, ln L, ln Q (and ln gain), where the balance of forces is known to `std` newtons in every sample."""
    u, a, force = run
    columns = np.column_stack([M * a, L * u, Q * np.abs(u) * u, -force])[:, : 4 if gain else 3]
    return np.asarray(columns.T @ columns / std**2)


def speeds_of(run: tuple[np.ndarray, np.ndarray, np.ndarray]) -> np.ndarray:
    out = np.zeros((6, 2))
    out[0] = np.sqrt(np.mean(run[0] ** 2)), np.abs(run[0]).max()
    return out


SQUARE = surge(40.0 * np.where(np.arange(3000) // 250 % 2 == 0, 1.0, -1.0))
ALL_LOG = (True,) * 4


def test_a_good_run_determines_all() -> None:
    J = information(SQUARE, 3.0)
    found = identifiability(SURGE, THETA[:3], J, logarithmic=(True,) * 3)
    assert found.determined == found.free == SURGE
    assert not found.held
    assert not found.reasons
    assert not found.combinations
    expected = np.sqrt(np.diag(np.linalg.inv(J)))
    for finding, std, single in zip(found.findings, expected, 1.0 / np.sqrt(np.diag(J)), strict=True):
        assert finding.std == finding.given == pytest.approx(std, rel=1e-9)
        assert finding.conditional == pytest.approx(single)
    assert found["X_udot"].reason == "m - X_udot is known to 0.18 %"


def test_two_damping_terms_that_only_appear_together() -> None:
    found = identifiability(
        SURGE, THETA[:3], information(SQUARE, 60.0), logarithmic=(True,) * 3, criteria=Criteria(speeds_of(SQUARE))
    )
    assert found.determined == ("X_udot",)
    assert found.held == {"X_u": "zero"}
    assert found["X_u"].reason == (
        "X_u and X_uu are correlated 0.98 in this run; only their sum at about 0.65 m/s is known (to 4.3 %)"
        ": speeds above 1.2 m/s would separate them; X_u held at 0"
    )
    assert found["X_uu"].reason.endswith("X_uu stands for both")
    assert found["X_uu"].state == found["X_u"].state == "merged"
    assert found["X_uu"].partner == "X_u"
    (combination,) = found.combinations
    assert combination.names == ("X_uu", "X_u")
    assert sum(combination.weights) == pytest.approx(1.0)
    # the drag at that speed, from the covariance itself
    C = np.linalg.inv(information(SQUARE, 60.0))
    w = np.array([0.0, combination.weights[1], combination.weights[0]])
    assert combination.std == pytest.approx(float(np.sqrt(w @ C @ w)), rel=1e-6)
    assert found["X_uu"].given == pytest.approx(combination.std, rel=0.05)


def test_the_speeds_that_are_asked_for_do_separate_them() -> None:
    J = information(SQUARE, 60.0)
    I2 = pair(relative(J, np.ones(3)), 1, 2)
    k = needed_factor(I2, 0)
    grow = np.diag([k, k**2])
    both = np.linalg.inv(I2 + grow @ I2 @ grow)
    assert np.sqrt(np.diag(both)).max() == pytest.approx(0.2, rel=1e-6)
    assert needed_factor(I2[::-1, ::-1], 1) == pytest.approx(k)
    assert needed_factor(1e6 * I2, 0) == 1.0
    assert needed_factor(1e-12 * I2, 0) == np.inf


def test_a_run_at_one_speed_tells_their_sum_and_no_mass() -> None:
    u = np.full(1000, 0.5)
    steady = information((u, np.zeros(1000), L * u + Q * u**2), 3.0)
    found = identifiability(SURGE, THETA[:3], steady, logarithmic=(True,) * 3)
    assert found["X_udot"].state == "undetermined"
    assert found["X_udot"].reason == (
        "the run says nothing of m - X_udot: too little acceleration in surge; held at the vehicle's value"
    )
    assert found.free == ("X_u",) or found.free == ("X_uu",)
    assert "only their sum at about 0.5 m/s is known" in found["X_u"].reason
    assert "times as high would separate them" in found["X_u"].reason
    assert found["X_u"].std == np.inf


def test_a_free_gain_leaves_only_ratios() -> None:
    names = (*SURGE, "gain_aft")
    exact = information(SQUARE, 1.0, gain=True)
    # the balance of forces is zero whatever its scale
    assert along(exact, np.ones(4)) > 1e3
    found = identifiability(names, THETA, exact, logarithmic=ALL_LOG)
    assert found.held == {"gain_aft": "value"}
    assert found.free == SURGE
    assert found["gain_aft"].reason == (
        "only ratios are known, nothing fixes the scale of the forces; gain_aft held at the vehicle's value"
        ": bench data or a bollard pull of one thruster would fix it"
    )
    assert found["X_uu"].reason.endswith(
        "nothing fixes the scale of the forces: X_uu stands in proportion to gain_aft, which is held"
    )
    assert {each.names for each in found.combinations} == {(name, "gain_aft") for name in SURGE}
    assert max(each.std for each in found.combinations) < 0.05


def test_a_decay_without_force_tells_ratios_of_its_axis_alone() -> None:
    names = ("X_udot", "X_uu", "K_pdot", "K_p", "BG_z")
    theta = np.array([np.log(M), np.log(Q), 0.3, -0.2, 4.1])
    J = np.zeros((5, 5))
    J[:2, :2] = [[4e4, 1e3], [1e3, 2e4]]
    for row in ([1.0, -1.0, 0.0], [1.0, 0.0, -1.0 / 4.1]):  # only differences of logarithms
        J[2:, 2:] += 1e4 * np.outer(row, row)
    found = identifiability(names, theta, J, logarithmic=(True, True, True, True, False))
    assert found.determined == ("X_udot", "X_uu")
    assert found.held == {"K_pdot": "value"}
    assert "only ratios are known in roll" in found["BG_z"].reason
    assert "commanded moments in roll" in found["K_pdot"].reason
    assert found["BG_z"].given == pytest.approx(0.01, rel=1e-6)


def test_inertia_and_drag_known_in_one_combination() -> None:
    known, other = np.array([1.0, -0.5]) / np.sqrt(1.25), np.array([0.5, 1.0]) / np.sqrt(1.25)
    J = 1e4 * np.outer(known, known) + 2.5 * np.outer(other, other)
    found = identifiability(("N_rdot", "N_rr"), np.zeros(2), J, logarithmic=(True, True))
    assert found.held == {"N_rr": "value"}
    assert found["N_rr"].reason == (
        "N_rr and I_z - N_rdot are correlated 0.999 in this run; only one combination of them is known (to 1.1 %)"
        ": reversals as well as steady yaw would tell them apart; N_rr held at the vehicle's value"
    )
    assert found["N_rdot"].reason.endswith("learned with N_rr held")
    (combination,) = found.combinations
    assert combination.weights == pytest.approx((1.0, -0.5), rel=1e-3)


def test_what_a_run_says_nothing_of() -> None:
    names = ("Y_vv", "BG_z", "W_minus_B", "N_v", "gain_a", "delay", "X_0", "N_rdot", "Z_w")
    J = np.zeros((9, 9))
    J[8, 8] = 1.0
    speeds = np.full((6, 2), 0.02)
    log = [name in ("Y_vv", "gain_a", "N_rdot", "Z_w") for name in names]
    found = identifiability(names, np.zeros(9), J, logarithmic=log, size=np.ones(9), criteria=Criteria(speeds))
    assert not found.determined
    assert set(found.held.values()) == {"value"}
    reasons = found.reasons
    assert reasons["Y_vv"] == ("the run says nothing of Y_vv: sway reached 0.02 m/s only; held at the vehicle's value")
    assert "the vehicle hardly tilted" in reasons["BG_z"]
    assert "heave" in reasons["W_minus_B"]
    assert "sway reached 0.02 m/s only" in reasons["N_v"]
    assert "this thruster was hardly used" in reasons["gain_a"]
    assert "the commands hardly changed" in reasons["delay"]
    assert "too little acceleration in yaw" in reasons["N_rdot"]
    assert reasons["Z_w"].startswith("Z_w would be known to 100 % at best, with all else known")


def test_three_that_are_entangled() -> None:
    w = np.array([1.0, -1.0, 1.0]) / np.sqrt(3.0)
    J = 200.0 * (np.eye(3) - np.outer(w, w)) + 4.0 * np.outer(w, w)
    found = identifiability(("K_pdot", "N_v", "Y_r"), np.array([0.0, 1.0, 1.0]), J, logarithmic=(True, False, False))
    assert len(found.held) == 1
    (name,) = found.held
    assert name in ("N_v", "Y_r")
    assert "it cannot be told from" in found[name].reason
    assert found["K_pdot"].state == "merged"
    assert "only with what is held taken as right" in found["K_pdot"].reason


def test_a_prior_enters_as_information_and_is_named() -> None:
    J = information(SQUARE, 60.0)
    prior = np.diag([0.0, 100.0, 0.0])
    found = identifiability(SURGE, THETA[:3], J, logarithmic=(True,) * 3, prior=prior)
    assert found.determined == SURGE
    assert "with the prior; this run alone would give 53 %" in found["X_u"].reason
    assert found["X_udot"].reason == "m - X_udot is known to 3.6 %"
    nothing = identifiability(SURGE, THETA[:3], np.zeros((3, 3)), logarithmic=(True,) * 3, prior=np.eye(3) * 1e3)
    assert "this run alone would not tell it" in nothing["X_u"].reason


@pytest.mark.parametrize("std", [3.0, 60.0, 400.0])
def test_units_of_the_coordinates_do_not_matter(std: float) -> None:
    names = (*SURGE, "N_v", "delay")
    rng = np.random.default_rng(3)
    extra = rng.normal(size=(200, 5)) * [1.0, 1.0, 1.0, 5.0, 300.0]
    J = extra.T @ extra / std**2
    J[:3, :3] += information(SQUARE, std)
    theta = np.array([*THETA[:3], -3.0, 0.08])
    size = np.array([1.0, 1.0, 1.0, 3.0, 0.1])
    log = (True, True, True, False, False)
    base = identifiability(names, theta, J, logarithmic=log, size=size)
    change = np.array([1.0, 1.0, 1.0, 1e4, 1e-5])  # numbers in other units
    other = identifiability(
        names, np.where(log, theta, theta * change), J / np.outer(change, change), logarithmic=log, size=size * change
    )
    assert [f.state for f in base.findings] == [f.state for f in other.findings]
    assert base.reasons == other.reasons
    np.testing.assert_allclose([f.std for f in base.findings], [f.std for f in other.findings], rtol=1e-8)
    assert repr(identifiability(names, theta, J, logarithmic=log, size=size)) == repr(base)


def test_the_order_of_the_names_does_not_matter() -> None:
    J = information(SQUARE, 60.0)
    order = [2, 0, 1]
    base = identifiability(SURGE, THETA[:3], J, logarithmic=(True,) * 3)
    turned = identifiability([SURGE[k] for k in order], THETA[order], J[np.ix_(order, order)], logarithmic=(True,) * 3)
    for name in SURGE:
        assert turned[name].state == base[name].state
        assert turned[name].hold == base[name].hold
        assert turned[name].reason == base[name].reason


def test_broken_information_is_none() -> None:
    for J in (np.zeros((3, 3)), np.full((3, 3), np.nan), -np.eye(3)):
        found = identifiability(SURGE, THETA[:3], J, logarithmic=(True,) * 3)
        assert not found.determined
        assert all(np.isinf(each.std) for each in found.findings)
    J = information(SQUARE, 3.0)
    J[1, :] = J[:, 1] = np.nan
    found = identifiability(SURGE, THETA[:3], J, logarithmic=(True,) * 3)
    assert found["X_u"].state == "undetermined"
    assert found["X_udot"].state == found["X_uu"].state == "determined"
    infinite = identifiability(SURGE, np.array([np.inf, np.nan, 900.0]), np.eye(3) * 1e4, logarithmic=(True,) * 3)
    assert infinite.determined == SURGE


@pytest.mark.parametrize("rank", range(7))
def test_any_rank_gets_a_verdict(rank: int) -> None:
    names = ("X_udot", "X_u", "X_uu", "N_rdot", "N_r", "N_rr", "gain_a", "delay", "Y_0")
    log = [name not in ("delay", "Y_0") for name in names]
    rng = np.random.default_rng(rank)
    for scale in (1e-6, 1.0, 1e6):
        columns = rng.normal(size=(rank, 9)) * scale * 10.0 ** rng.uniform(-3, 3, 9)
        found = identifiability(names, rng.normal(size=9), columns.T @ columns, logarithmic=log)
        assert len(found.findings) == 9
        assert all(each.reason for each in found.findings)
        kept = [each.given for each in found.findings if not each.hold]
        assert all(std < 0.25 for std in kept)
        assert len(kept) <= rank


def test_deviations_of_singular_information() -> None:
    A = np.array([[4.0, -4.0, 0.0], [-4.0, 4.0, 0.0], [0.0, 0.0, 25.0]])
    assert deviations(A).tolist() == [np.inf, np.inf, pytest.approx(0.2)]
    assert alone(np.diag([4.0, 0.0])).tolist() == [0.5, np.inf]
    assert along(A, np.array([1.0, 1.0, 0.0])) == np.inf
    assert along(A, np.array([1.0, -1.0, 0.0])) == pytest.approx(0.25)
    assert np.array_equal(pair(A, 0, 1), A[:2, :2])
    rng = np.random.default_rng(0)
    S = rng.normal(size=(6, 6))
    full = S @ S.T
    C = np.linalg.inv(full)
    np.testing.assert_allclose(correlations(full), C / np.sqrt(np.outer(np.diag(C), np.diag(C))), rtol=1e-8)
    assert correlations(A)[0, 1] == pytest.approx(1.0)
    np.testing.assert_allclose(deviations(full), np.sqrt(np.diag(C)), rtol=1e-9)
    np.testing.assert_allclose(pair(full, 4, 1), np.linalg.inv(C[np.ix_([4, 1], [4, 1])]), rtol=1e-8)


def test_what_inspect_says() -> None:
    known = excitation(("X_udot", "X_u", "X_uu", "N_rr", "BG_z"), np.diag([1e-4, 2.5e-3, np.nan, 1.6e-3, -1.0]))
    assert known == pytest.approx({"X_udot": 1.0, "X_u": 5.0, "X_uu": np.inf, "N_rr": 4.0, "BG_z": np.inf})
    assert excitation_words(known) == (
        "surge mass will be known to 1 %",
        "linear surge drag will be known to 5 %",
        "quadratic surge drag will not be known",
        "yaw drag will be known to 4 %",
        "the righting moment will not be known",
    )


def test_what_does_not_fit_together_is_refused() -> None:
    with pytest.raises(InputError, match="3 names"):
        identifiability(SURGE, THETA[:2], np.eye(3), logarithmic=(True,) * 3)
    found = identifiability(SURGE, THETA[:3], 1e4 * np.eye(3), logarithmic=(True,) * 3)
    with pytest.raises(InputError, match="not free"):
        found["X_vv"]
