"""Pooling: what has a formula of its own, what may not matter, and what a fleet says of one like it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from towtank import InputError, load_vehicle
from towtank.campaigns import Fleet, Run, pool
from towtank.campaigns.pooling import per_thrust, thrust_undone
from towtank.campaigns.random_effects import Evidence, Variances, restricted_maximum, solved
from towtank.core.arrays import Array
from towtank.identification.model.prior import Prior, prior_of
from towtank.identification.posterior.result import with_posterior
from towtank.vehicle import Vehicle
from towtank.vehicle.posterior import Posterior, with_coordinates

# -- random effects alone


def known_exactly(values: Array, member: Array, std: float) -> Evidence:
    """Runs (n, p) whose coefficients are each measured with this deviation."""
    n, p = values.shape
    information = np.tile(np.eye(p) / std**2, (n, 1, 1))
    return Evidence(information, values / std**2, member)


def maximum(evidence: Evidence) -> Variances:
    p = evidence.score.shape[1]
    return restricted_maximum(evidence, np.eye(2 * p), Variances(np.full(p, 0.01), np.full(p, 0.01)))


def correlated(n: int = 12, p: int = 3, seed: int = 1) -> Evidence:
    """Runs with full covariances, some of which say nothing of a direction."""
    chance = np.random.default_rng(seed)
    factors = chance.standard_normal((n, p, p)) * 8.0
    factors[::3, 0] = 0.0  # singular
    information = factors.transpose(0, 2, 1) @ factors
    member = np.arange(n) % 4
    x = 0.3 * chance.standard_normal((4, p))[member] + 0.1 * chance.standard_normal((n, p))
    noise = np.einsum("nij,ni->nj", factors, chance.standard_normal((n, p)))
    return Evidence(information, np.einsum("nij,nj->ni", information, x) + noise, member)


def test_balanced_runs_have_the_variances_of_the_analysis_of_variance() -> None:
    """Restricted maximum likelihood of a balanced one-way layout is (MSB - MSW) / n and MSW."""
    chance, members, each, std = np.random.default_rng(3), 5, 8, 0.02
    member = np.repeat(np.arange(members), each)
    values = 0.3 * chance.standard_normal((members, 2))[member] + 0.1 * chance.standard_normal((members * each, 2))
    found = maximum(known_exactly(values, member, std))
    means = values.reshape(members, each, 2).mean(axis=1)
    within = ((values - means[member]) ** 2).sum(axis=0) / (members * (each - 1))
    between = each * ((means - means.mean(axis=0)) ** 2).sum(axis=0) / (members - 1)
    np.testing.assert_allclose(found.within, within - std**2, rtol=1e-3)
    np.testing.assert_allclose(found.between, (between - within) / each, rtol=1e-3)


def test_the_interval_of_a_balanced_layout_is_students_with_members_less_one() -> None:
    chance, member = np.random.default_rng(4), np.repeat(np.arange(5), 8)
    values = 0.3 * chance.standard_normal((5, 1))[member] + 0.03 * chance.standard_normal((40, 1))
    evidence = known_exactly(values, member, 0.001)
    variance, degrees = solved(evidence, maximum(evidence)).deviations(np.eye(1))
    means = values.reshape(5, 8).mean(axis=1)
    assert variance[0] == pytest.approx(means.var(ddof=1) / 5, rel=1e-3)
    assert degrees[0] == pytest.approx(4.0, rel=0.02)


def test_variances_below_zero_are_zero() -> None:
    """Members whose means lie closer together than their runs allow by chance."""
    member = np.repeat(np.arange(4), 4)
    values = np.tile([[-0.3], [-0.1], [0.1], [0.3]], (4, 1))
    found = maximum(known_exactly(values, member, 0.01))
    assert found.between[0] == 0.0
    assert found.within[0] == pytest.approx(values.var() * 16 / 15 - 1e-4, rel=1e-3)


def test_without_spread_the_mean_is_that_of_the_likelihoods_by_their_information() -> None:
    evidence = correlated()
    found = solved(evidence, Variances(np.zeros(3), np.zeros(3)))
    total = evidence.information.sum(axis=0)
    np.testing.assert_allclose(found.mean, np.linalg.solve(total, evidence.score.sum(axis=0)), rtol=1e-6)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(total), rtol=1e-6)


def test_the_likelihood_is_that_of_all_runs_as_one_gaussian() -> None:
    """Of runs with an inverse: y ~ N(mu, noise + within + between), written out whole."""
    chance, n, p = np.random.default_rng(5), 6, 2
    member = np.array([0, 0, 1, 1, 1, 2])
    factors = chance.standard_normal((n, p, p)) + 2.0 * np.eye(p)
    information = factors.transpose(0, 2, 1) @ factors
    y = chance.standard_normal((n, p))
    evidence = Evidence(information, np.einsum("nij,nj->ni", information, y), member)
    prior = np.eye(p)

    def whole(variances: Variances) -> float:
        covariance = np.zeros((n * p, n * p))
        for r in range(n):
            for s in range(n):
                block = np.eye(p) + (member[r] == member[s]) * np.diag(variances.between)  # np.eye: the prior of mu
                if r == s:
                    block = block + np.diag(variances.within) + np.linalg.inv(information[r])
                covariance[r * p : r * p + p, s * p : s * p + p] = block
        x = y.reshape(-1)
        return float(-0.5 * np.linalg.slogdet(covariance)[1] - 0.5 * x @ np.linalg.solve(covariance, x))

    one, other = Variances(np.array([0.3, 0.1]), np.array([0.2, 0.5])), Variances(np.array([1.0, 0.0]), np.zeros(2))
    difference = solved(evidence, one, prior).likelihood - solved(evidence, other, prior).likelihood
    assert difference == pytest.approx(whole(one) - whole(other), rel=1e-9)


def test_the_gradient_is_that_of_the_likelihood() -> None:
    evidence, at = correlated(), np.array([0.05, 0.1, 0.02, 0.01, 0.03, 0.02])
    found, small = solved(evidence, Variances(at[:3], at[3:])), 1e-6
    for k, slope in enumerate(np.concatenate(found.gradient)):
        ends = []
        for sign in (1.0, -1.0):
            moved = at.copy()
            moved[k] += sign * small
            ends.append(solved(evidence, Variances(moved[:3], moved[3:])).likelihood)
        assert (ends[0] - ends[1]) / (2.0 * small) == pytest.approx(slope, rel=1e-3, abs=1e-4)


def test_the_information_of_variances_is_fishers() -> None:
    """1/2 tr(P Z_i Z_i^T P Z_j Z_j^T) written out; pairs of runs of different members are left out of it, by design."""
    chance, n, p = np.random.default_rng(6), 48, 2
    member, variances = np.repeat(np.arange(16), 3), Variances(np.array([0.3, 0.1]), np.array([0.2, 0.5]))
    factors = chance.standard_normal((n, p, p)) + 2.0 * np.eye(p)
    information = factors.transpose(0, 2, 1) @ factors
    found = solved(Evidence(information, np.zeros((n, p)), member), variances).information
    noise = np.linalg.inv(information)
    Z_r, Z_v, X = np.eye(n * p), np.zeros((n * p, 16 * p)), np.tile(np.eye(p), (n, 1))
    V = Z_r @ np.diag(np.tile(variances.within, n)) @ Z_r.T
    for r in range(n):
        V[r * p : r * p + p, r * p : r * p + p] += noise[r]
        Z_v[r * p : r * p + p, member[r] * p : member[r] * p + p] = np.eye(p)
    V += Z_v @ np.diag(np.tile(variances.between, 16)) @ Z_v.T
    W = np.linalg.inv(V)
    P = W - W @ X @ np.linalg.solve(X.T @ W @ X, X.T @ W)
    parts = [Z_v[:, k::p] @ Z_v[:, k::p].T for k in range(p)] + [Z_r[:, k::p] @ Z_r[:, k::p].T for k in range(p)]
    whole = np.array([[0.5 * np.trace(P @ one @ P @ other) for other in parts] for one in parts])
    np.testing.assert_allclose(found[:p, :p], whole[:p, :p], rtol=1e-4)
    np.testing.assert_allclose(np.diag(found), np.diag(whole), rtol=0.02)
    np.testing.assert_allclose(found, whole, atol=0.02 * np.abs(whole).max())


def test_the_order_of_runs_does_not_matter() -> None:
    evidence = correlated()
    order = np.random.default_rng(7).permutation(12)
    turned = Evidence(evidence.information[order], evidence.score[order], evidence.member[order])
    one, other = maximum(evidence), maximum(turned)
    np.testing.assert_allclose(one.between, other.between, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(solved(evidence, one).mean, solved(turned, other).mean, rtol=1e-6)


def test_a_run_that_knows_nothing_changes_nothing() -> None:
    evidence = correlated()
    more = Evidence(
        np.concatenate([evidence.information, np.zeros((1, 3, 3))]),
        np.concatenate([evidence.score, np.zeros((1, 3))]),
        np.append(evidence.member, 2),
    )
    one, other = maximum(evidence), maximum(more)
    np.testing.assert_allclose(one.within, other.within, rtol=1e-9)
    np.testing.assert_allclose(solved(evidence, one).covariance, solved(more, other).covariance, rtol=1e-9)


# -- learned models


def bare(name: str = "bluerov2_heavy") -> Vehicle:
    file = load_vehicle(name)
    thrusters = tuple(each.model_copy(update={"time_constant": 0.0}) for each in file.thrusters)
    return Vehicle(name=name, rigid_body=file.rigid_body, buoyancy=file.buoyancy, thrusters=thrusters)


BEFORE = bare()
SUPPOSED = prior_of(BEFORE)


def place(name: str) -> int:
    return SUPPOSED.names.index(name)


def run(vehicle: str, label: str, theta: Array, std: dict[str, float], before: Vehicle = BEFORE) -> Run:
    """A run whose data lie at theta (n,), learned from what is supposed of the vehicle.

    std: of what the data tell of multiples of the thrust, as shares of what is supposed.
    """
    prior, mean = prior_of(before), theta
    q, turn = per_thrust(prior.free, theta)
    rows = np.array([np.eye(len(theta))[place(name)] / (each * prior.std[place(name)]) for name, each in std.items()])
    information = rows.T @ rows
    for _ in range(5):
        there, turn = per_thrust(prior.free, mean)
        near, covariance = prior.seen_from(mean)
        before_, data = np.linalg.inv(covariance), turn.T @ information @ turn
        after = np.linalg.inv(before_ + data)
        mean = after @ (before_ @ near + data @ mean + turn.T @ information @ (q - there))
    return Run(vehicle, before.name, label, modelled(before, prior, mean, 0.5 * (after + after.T)), before)


def modelled(before: Vehicle, prior: Prior, mean: Array, covariance: Array) -> Vehicle:
    signs = prior.free.signs
    at = np.where(signs < 0.0, prior.free.rigid - mean, mean)
    return with_posterior(with_coordinates(before, prior.names, at), prior, mean, covariance)


TOLD = {"X_udot": 0.02, "X_u": 0.03, "X_uu": 0.01, "N_rdot": 0.03, "N_rr": 0.02}


def at(**moved: float) -> Array:
    """theta (n,) of physics, with some coordinates moved by so many of what is supposed of them."""
    theta = SUPPOSED.mean.copy()
    for name, deviations in moved.items():
        theta[place(name)] += deviations * SUPPOSED.std[place(name)]
    return theta


def fleet_runs(vehicles: int = 4, each: int = 3, seed: int = 1, told: dict[str, float] = TOLD) -> list[Run]:
    chance, runs = np.random.default_rng(seed), []
    for v in range(vehicles):
        own = 0.2 * chance.standard_normal(len(TOLD))
        for r in range(each):
            away = own + 0.05 * chance.standard_normal(len(TOLD))
            runs.append(run(f"v{v}", f"{v}-{r}", at(**dict(zip(TOLD, away, strict=True))), told))
    return runs


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    return fleet_runs()


@pytest.fixture(scope="module")
def fleet(runs: list[Run]) -> Fleet:
    return pool(runs)


def test_forces_as_multiples_of_the_thrust_come_back() -> None:
    theta = at(gain_hor_aft_port=2.0, X_uu=-0.3, K_rdot=1.0)
    q, turn = per_thrust(SUPPOSED.free, theta)
    back, inverse = thrust_undone(SUPPOSED.free, q)
    np.testing.assert_allclose(back, theta, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(inverse @ turn, np.eye(len(theta)), atol=1e-9)
    small = np.random.default_rng(1).standard_normal(theta.size) * 1e-7
    np.testing.assert_allclose(per_thrust(SUPPOSED.free, theta + small)[0] - q, turn @ small, atol=1e-10)


def test_one_run_alone_is_what_it_was_learned_to_be() -> None:
    """Its prior is taken out and put back once."""
    alone = run("v", "1", at(X_udot=0.8, X_uu=-0.2), TOLD)
    found = pool([alone])["bluerov2_heavy"]
    for name in TOLD:
        total = name.endswith("dot")
        here, there = (each.coefficient(name) for each in (alone.model, found.vehicle))
        assert there == pytest.approx(here, rel=2e-3)
        k = (alone.model.posterior or fail()).names.index(name)
        std = (alone.model.posterior or fail()).std[k]
        size = found[name].size if total else 1.0
        assert found[name].std == pytest.approx(std * size, rel=0.01)


def test_the_prior_of_many_runs_counts_once() -> None:
    """Nine runs that know X_uu to half of what is supposed: averaged as they are, they would stay near physics."""
    supposed = SUPPOSED.std[place("X_uu")]
    half = {**TOLD, "X_uu": 1.0 / 1.9}
    same = [run("v", f"{k}", at(X_uu=-0.25), half) for k in range(9)]
    truth = at(X_uu=-0.25)[place("X_uu")]
    shrunk = float(np.mean([each.model.coefficient("X_uu") for each in same]))
    found = pool(same)["bluerov2_heavy"]["X_uu"]
    assert abs(found.value - truth) < 0.15 * abs(shrunk - truth)
    assert found.within == pytest.approx(0.0, abs=0.02 * supposed)


def test_the_scale_of_thrust_is_no_surer_for_many_vehicles(fleet: Fleet) -> None:
    """All masses and drags of a fleet have the scale in common, which no motion tells: 8 % of eight thrusters."""
    scale = 0.08 / np.sqrt(8)
    found = pool(fleet_runs(vehicles=2, each=20, told=dict.fromkeys(TOLD, 0.002)))
    for each in (fleet, found):
        posterior = each.classes[0].vehicle.posterior or fail()
        gains = [k for k, name in enumerate(posterior.names) if name.startswith("gain_")]
        share = np.zeros(len(posterior.names))
        share[gains] = 1.0 / len(gains)
        assert np.sqrt(share @ posterior.covariance @ share) == pytest.approx(scale, rel=0.05)
        mass = each.classes[0]["X_udot"]
        assert mass.std > scale * mass.size


def test_a_run_that_went_farther_than_it_states_is_not_taken_beyond_its_word() -> None:
    """Widened afterwards to 95 % of the prior, 2.5 deviations away: by information alone its data would lie at 26."""
    k = place("X_uu")
    mean, covariance = SUPPOSED.mean.copy(), SUPPOSED.covariance.copy()
    mean[k] += 2.5 * SUPPOSED.std[k]
    covariance[k, k] *= 0.95**2
    found = pool([Run("v", BEFORE.name, "1", modelled(BEFORE, SUPPOSED, mean, covariance), BEFORE)]).classes[0]
    data, told = 2.5 / (2.5 / 3.0) ** 2, 1.0 / 0.95**2 - 1.0
    away = (found["X_uu"].value - SUPPOSED.mean[k]) / SUPPOSED.std[k]
    assert away == pytest.approx(told / (1.0 + told) * data, rel=0.05)
    assert away < told / (1.0 + told) * 26.0 / 5.0


def test_vehicles_and_runs_in_another_order_are_the_same_fleet(runs: list[Run], fleet: Fleet) -> None:
    turned = pool(runs[::-1])
    for one in fleet.classes[0].coefficients:
        other = turned.classes[0][one.name]
        assert other.value == pytest.approx(one.value, rel=1e-4, abs=1e-4 * one.prior_std)
        assert other.std == pytest.approx(one.std, rel=1e-3)


def test_a_run_that_learned_nothing_changes_nothing(runs: list[Run], fleet: Fleet) -> None:
    nothing = Run("v0", BEFORE.name, "nothing", modelled(BEFORE, SUPPOSED, SUPPOSED.mean, SUPPOSED.covariance), BEFORE)
    found = pool([*runs, nothing])
    for one in fleet.classes[0].coefficients:
        other = found.classes[0][one.name]
        assert other.value == pytest.approx(one.value, rel=1e-6, abs=1e-6 * one.prior_std)
        for spread, before in ((other.between, one.between), (other.within, one.within)):
            assert (spread is None) == (before is None)
            assert (spread or 0.0) == pytest.approx(before or 0.0, rel=1e-3, abs=1e-6)


def test_a_vehicle_a_thousand_times_as_heavy_has_the_same_shares() -> None:
    """Units of everything change: lengths by 10, masses by 1,000, forces by 1,000; logarithms and shares do not."""
    small, large = bare("seamor"), scaled(bare("seamor"))
    told = {"X_udot": 0.02, "X_uu": 0.05, "N_rr": 0.05}
    found = []
    for before in (small, large):
        chance, runs, prior = np.random.default_rng(2), [], prior_of(before)
        for v in range(3):
            for r in range(3):
                theta = prior.mean + 0.2 * prior.std * np.where([n in told for n in prior.names], 1.0, 0.0) * (
                    chance.standard_normal() + 0.2 * chance.standard_normal()
                )
                rows = np.array(
                    [
                        np.eye(len(prior.mean))[prior.names.index(n)] / (s * prior.std[prior.names.index(n)])
                        for n, s in told.items()
                    ]
                )
                after = np.linalg.inv(np.linalg.inv(prior.covariance) + rows.T @ rows)
                mean = after @ (np.linalg.solve(prior.covariance, prior.mean) + rows.T @ rows @ theta)
                runs.append(
                    Run(f"{v}", "seamor", f"{v}-{r}", modelled(before, prior, mean, 0.5 * (after + after.T)), before)
                )
        found.append(pool(runs).classes[0])
    for name in told:
        one, other = found[0][name], found[1][name]
        for pair in ((one.between, other.between), (one.within, other.within), (one.std, other.std)):
            assert (pair[1] or 0.0) / other.prior_std == pytest.approx(
                (pair[0] or 0.0) / one.prior_std, rel=1e-3, abs=1e-6
            )


def scaled(vehicle: Vehicle) -> Vehicle:
    """The same vehicle ten times as long, with as much thrust per volume."""
    body = vehicle.rigid_body.model_copy(
        update={
            "mass": 1e3 * vehicle.rigid_body.mass,
            "inertia": tuple(1e5 * each for each in vehicle.rigid_body.inertia),
        }
    )
    return vehicle.model_copy(update={"rigid_body": body, "buoyancy": type(vehicle.buoyancy)()})


def test_what_vehicles_and_runs_differ_by_is_found(fleet: Fleet) -> None:
    """0.2 and 0.05 of what is supposed; with four vehicles and eight degrees of freedom within a factor of two."""
    found = pool(fleet_runs(vehicles=12, each=4, seed=5)).classes[0]
    for name in TOLD:
        each = found[name]
        assert (each.between or 0.0) / each.prior_std == pytest.approx(0.2, rel=0.5)
        assert (each.within or 0.0) / each.prior_std == pytest.approx(0.05, rel=0.5)


def test_a_run_that_is_out_of_line_is_named_with_its_coefficient(runs: list[Run], fleet: Fleet) -> None:
    assert fleet.classes[0].outliers == ()
    away = dict.fromkeys(TOLD, 0.0)
    others = fleet_runs(vehicles=4, each=8, seed=8)
    found = pool([*others, run("v2", "tether", at(**{**away, "N_rr": 2.0}), TOLD)]).classes[0]
    assert [(each.vehicle, each.run, each.name) for each in found.outliers] == [("v2", "tether", "N_rr")]
    assert found.outliers[0].deviations > 6.0
    assert found.outliers[0].text.startswith("tether (v2): N_rr +")


def test_one_vehicle_says_how_its_runs_differ_and_nothing_of_others() -> None:
    found = pool(fleet_runs(vehicles=1, each=8)).classes[0]
    each = found["X_uu"]
    assert each.between is None
    assert each.within is not None
    assert each.next_std >= 0.95 * each.prior_std
    assert "no deviation is below that before any data" in found.vehicle.provenance.source


def test_the_file_is_a_prior_that_knows_what_the_fleet_knows(fleet: Fleet, tmp_path: Path) -> None:
    path = f"{tmp_path}/fleet.toml"
    fleet.write(path)
    before, after = prior_of(BEFORE), prior_of(BEFORE, beside=load_vehicle(path))
    for name in TOLD:
        k = after.names.index(name)
        each = fleet.classes[0][name]
        slope = abs(after.free.slopes(after.mean)[k])
        assert slope * after.std[k] == pytest.approx(each.next_std, rel=1e-2)
        assert after.std[k] < 0.6 * before.std[k]
        assert after.reference[k] == pytest.approx(before.std[k])
    untold = after.names.index("Y_vv")
    assert after.std[untold] == pytest.approx(before.std[untold], rel=0.02)
    delay = after.names.index("delay")
    assert after.std[delay] == before.std[delay]


def test_the_deviations_of_a_single_run_are_widened_by_what_runs_differ_by(runs: list[Run], fleet: Fleet) -> None:
    model, found = runs[0].model, fleet.classes[0]
    wider = found.widened(model)
    before, after = model.posterior or fail(), wider.posterior or fail()
    assert after.mean == before.mean
    for name in TOLD:
        k, each = before.names.index(name), found[name]
        unit = float(model.mass_matrix[3, 3]) if name == "K_pdot" else 1.0
        size = {"X_udot": model.mass_matrix[0, 0], "N_rdot": model.mass_matrix[5, 5]}.get(name, unit)
        grown = size * np.sqrt(after.std[k] ** 2 - before.std[k] ** 2)
        assert grown == pytest.approx(each.within, rel=0.1)
    assert after.std[before.names.index("delay")] == pytest.approx(before.std[before.names.index("delay")], rel=1e-6)


def test_the_document_has_every_number_and_the_table_what_is_known(fleet: Fleet) -> None:
    document = fleet.document()["classes"]["bluerov2_heavy"]
    assert document["coefficients"]["X_uu"]["identified"] is True
    assert document["coefficients"]["Y_vv"]["between"] is None
    rows = fleet.classes[0].rows()
    assert {row[0] for row in rows} == set(TOLD)
    assert all(len(row) == len(Fleet.HEADS) for row in rows)


def test_a_run_without_the_vehicle_that_it_was_learned_from_is_of_a_bare_one(runs: list[Run], fleet: Fleet) -> None:
    found = pool([Run(each.vehicle, each.klass, each.label, each.model) for each in runs])
    assert found.classes[0]["X_uu"].value == pytest.approx(fleet.classes[0]["X_uu"].value, rel=1e-9)


def test_what_cannot_be_pooled_is_refused_in_a_line(runs: list[Run], fleet: Fleet, tmp_path: Path) -> None:
    def refused(given: list[Run], text: str) -> None:
        with pytest.raises(InputError, match=text):
            pool(given)

    one = runs[0]
    refused([], "no run given")
    refused([one, one], "0-0: stands there twice for v0")
    refused([Run("v", "c", "typed.toml", BEFORE)], r"typed.toml: its model has no \[posterior\]")
    refused([Run("v", "c", "0", one.model, load_vehicle("bluerov2_heavy"))], "was learned from a prior deviation of")
    other = bare("bluerov2")
    prior = prior_of(other)
    six = Run("w", one.klass, "six", modelled(other, prior, prior.mean, prior.covariance), other)
    refused([one, six], "six: w has the thrusters .* but 0-0 of the same class bluerov2_heavy has")
    with pytest.raises(InputError, match=r"expected one of bluerov2_heavy"):
        fleet["bluerov2_havy"]
    with pytest.raises(InputError, match=r'"X_uw" was not pooled'):
        fleet.classes[0]["X_uw"]


def test_a_fleet_of_several_classes_writes_one_that_is_named(runs: list[Run], tmp_path: Path) -> None:
    second = [Run(each.vehicle, "with gripper", each.label, each.model, each.before) for each in runs]
    both = pool([*runs, *second])
    assert [each.name for each in both.classes] == ["bluerov2_heavy", "with gripper"]
    with pytest.raises(InputError, match=r"found 2 classes .*, expected one; name it"):
        both.write(f"{tmp_path}/fleet.toml")
    both.write(f"{tmp_path}/fleet.toml", "with gripper")
    assert load_vehicle(f"{tmp_path}/fleet.toml").name == "with gripper"


def fail() -> Posterior:
    raise AssertionError("there is no posterior")
