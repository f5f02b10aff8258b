"""The posterior of a vehicle file: what is kept of a covariance, how it is written, vehicles drawn from it."""

import copy
import math
import pickle

import numpy as np
import pytest
from scipy.stats import binom, chi2

from towtank.errors import InputError
from towtank.vehicle import (
    COEFFICIENTS,
    Coefficient,
    Posterior,
    Provenance,
    index,
    load_vehicle,
    parse_vehicle,
    save_vehicle,
    vehicle_text,
)
from towtank.vehicle.posterior import coordinate, with_coordinates

VLBV = load_vehicle("vlbv300")
GAIN = f"gain_{VLBV.thrusters[1].name}"
NAMES = ("X_udot", "X_u", "X_uu", "Y_vdot", "Y_rdot", "N_rdot", "N_r", "BG_z", "W_minus_B", "delay", "lag", GAIN)
STEADY = VLBV.with_coefficients({"X_u": -8.0, "N_r": -3.0, "W_minus_B": -2.0})
DRAWS = 4000
RARE = 1e-3  # how rare a correct result would be beyond the limits


def covariance_of(n, condition, seed):
    """A covariance whose correlations have about this condition, of unknowns of very different size."""
    rng = np.random.default_rng(seed)
    turn, _ = np.linalg.qr(rng.normal(size=(n, n)))
    size = 10.0 ** rng.uniform(-3.0, 2.0, n)
    return turn @ np.diag(np.logspace(0.0, -math.log10(condition), n)) @ turn.T * np.outer(size, size)


def ratios(posterior, covariance):
    """Largest and smallest deviation of any direction, as multiples of what the covariance says."""
    scale = np.sqrt(np.diag(covariance))
    factor = scale[:, None] * np.linalg.cholesky(covariance / np.outer(scale, scale))
    return np.linalg.svd(np.linalg.solve(factor, posterior.factor), compute_uv=False)[[0, -1]]


def unknowns(n):
    plain = [name for name in COEFFICIENTS if index(name)[0] != "mass" or index(name)[1] == index(name)[2]]
    return (*plain[: n - 3], "delay", "lag", "latency_velocity")


def learned(names=NAMES, relative=0.04, vehicle=STEADY):
    """A vehicle with a posterior about its own values: correlated, all far from what is not physical."""
    vehicle = with_coordinates(vehicle, ["delay", "lag"], [0.08, 0.15])
    mean = np.array([at(vehicle, name, vehicle) for name in names])
    correlations = covariance_of(len(names), 1e3, 3)
    size = np.sqrt(np.diag(correlations))
    std = relative * np.where(np.abs(mean) > 0.0, np.abs(mean), 1.0)
    covariance = correlations * np.outer(std / size, std / size)
    posterior = Posterior.from_covariance(names, mean, covariance, 10.0 * std)
    return vehicle.model_copy(update={"posterior": posterior}), covariance


def at(vehicle, name, base):
    """The coordinate of an unknown of a vehicle drawn from `base`."""
    if name == "delay":
        return vehicle.command_delay
    if name == "lag":
        return vehicle.thrusters[0].time_constant
    if name == GAIN:
        return math.log(vehicle.thrusters[1].gain / base.thrusters[1].gain)
    return coordinate(vehicle, name)


def single(name, mean, std):
    return Posterior.from_covariance([name], [mean], [[std**2]], [1.0])


@pytest.mark.parametrize("condition", [1e0, 1e2, 1e4, 1e6, 1e8, 1e10, 1e12])
@pytest.mark.parametrize("n", [3, 20, 60])
def test_every_direction_keeps_its_deviation_whatever_the_condition(n, condition):
    covariance = covariance_of(n, condition, seed=n)
    posterior = Posterior.from_covariance(unknowns(n), np.zeros(n), covariance, np.ones(n))
    largest, smallest = ratios(posterior, covariance)
    assert 0.999 <= smallest <= largest <= 1.001
    np.testing.assert_allclose(posterior.std, np.sqrt(np.diag(covariance)), rtol=1e-15)


def test_four_digits_would_not_do():
    covariance = covariance_of(60, 1e8, seed=60)
    posterior = Posterior.from_covariance(unknowns(60), np.zeros(60), covariance, np.ones(60))
    shortened = [np.rint(1e4 * np.array(row) / np.linalg.norm(row)).tolist() for row in posterior.cholesky]
    for i, row in enumerate(shortened):
        row[i] = max(row[i], 1.0)
    coarse = Posterior.model_validate({**posterior.model_dump(), "cholesky": shortened})
    assert ratios(coarse, covariance)[0] > 1.2


def test_correlations_near_one_survive():
    std, r = np.array([3.0, 0.2]), 1.0 - 1e-9
    covariance = np.outer(std, std) * np.array([[1.0, r], [r, 1.0]])
    posterior = Posterior.from_covariance(["X_u", "X_uu"], [-1.0, -2.0], covariance, [5.0, 5.0])
    difference = np.array([1.0 / 3.0, -1.0 / 0.2])
    kept = math.sqrt(difference @ covariance @ difference)
    assert np.linalg.norm(posterior.factor.T @ difference) == pytest.approx(kept, rel=1e-3)


def test_file_keeps_mean_exactly_and_covariance_as_the_record_has_it(tmp_path):
    vehicle, covariance = learned()
    save_vehicle(vehicle, tmp_path / "learned.toml")
    again = load_vehicle(tmp_path / "learned.toml")
    assert again == vehicle
    assert hash(again) == hash(vehicle)
    assert again.posterior.names == NAMES
    assert again.posterior.mean == tuple(at(vehicle, name, vehicle) for name in NAMES)
    assert np.array_equal(again.posterior.covariance, vehicle.posterior.covariance)
    largest, smallest = ratios(again.posterior, covariance)
    assert 0.999 <= smallest <= largest <= 1.001
    assert pickle.loads(pickle.dumps(vehicle)) == vehicle
    assert copy.deepcopy(vehicle) == vehicle
    with pytest.raises(ValueError, match="frozen"):
        vehicle.posterior.mean = ()


@pytest.mark.parametrize(("condition", "most"), [(1e0, 9_000), (1e4, 16_000), (1e8, 19_000)])
def test_file_of_sixty_unknowns_stays_readable(condition, most):
    names = unknowns(60)
    covariance = covariance_of(60, condition, seed=60)
    posterior = Posterior.from_covariance(names, np.linspace(0.1, 3.3, 60), covariance, np.ones(60))
    plain = vehicle_text(VLBV)
    text = vehicle_text(VLBV.model_copy(update={"posterior": posterior}))
    assert text.startswith(plain)
    table = text.removeprefix(plain)
    assert len(table) < most
    lines = table.splitlines()
    assert len(lines) == 60 + 8  # an empty one, the header, four lists, two brackets; a row for each unknown
    assert lines[-2].endswith("], # latency_velocity")


def test_file_without_the_table_has_no_posterior():
    assert VLBV.posterior is None
    assert "posterior" not in vehicle_text(VLBV)


TABLE = """
[posterior]
names = ["X_udot", "X_u", "delay"]
mean = [3.7, -4, 0.1]
std = [0.1, 0.5, 0.01]
prior_std = [0.5, 4, 0.05]
cholesky = [[1], [3, 4], [0.0, -6, 8]]
"""
HEAD = 'name = "mine"\n[rigid_body]\nmass = 20.0\ninertia = [0.4, 0.6, 0.6]\n'


def test_rows_may_have_any_length():
    posterior = parse_vehicle(HEAD + TABLE, "mine.toml").posterior
    np.testing.assert_allclose(posterior.factor, [[0.1, 0, 0], [0.3, 0.4, 0], [0, -0.006, 0.008]], rtol=1e-14)
    np.testing.assert_allclose(posterior.covariance, posterior.factor @ posterior.factor.T, rtol=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"X_u"', '"X_uuu"', 'posterior.names[1]: found the text "X_uuu", expected a coefficient, delay, lag, gain_'),
        ('"delay"', '"dealy"', 'did you mean "delay"?'),
        ('"delay"', '"gain_aft"', 'posterior.names[2]: found "gain_aft", but no thruster is "aft"'),
        ('"delay"', '"X_u"', 'posterior.names[2]: "X_u" stands there already as "X_u"'),
        ('"X_udot", "X_u"', '"Y_rdot", "N_vdot"', 'posterior.names[1]: "N_vdot" stands there already as "Y_rdot"'),
        ('"X_u"', "3", "posterior.names[1]: found 3, expected a coefficient"),
        ('["X_udot", "X_u", "delay"]', "[]", "posterior.names: found an empty list"),
        ('["X_udot", "X_u", "delay"]', '"X_u"', 'posterior.names: found the text "X_u", expected a list of names'),
        ("[3.7, -4, 0.1]", "[3.7, -4]", "posterior.mean: found 2 numbers, expected 3, one for each name"),
        ("-4", "nan", "posterior.mean[1]: found nan, expected a finite number"),
        ("[0.1, 0.5, 0.01]", "[0.1]", "posterior.std: found 1 numbers, expected 3"),
        ("0.01", "0", "posterior.std[2]: found 0, expected a number above 0"),
        ("0.05", "inf", "posterior.prior_std[2]: found inf, expected a finite number"),
        ("[3, 4], ", "", "posterior.cholesky: found 2 rows, expected 3"),
        ("[3, 4]", "[3, 4, 0]", "posterior.cholesky[1]: found 3 numbers, expected 2: row 2 of the lower triangle, X_u"),
        ("[3, 4]", "[3, -4]", "posterior.cholesky[1][1]: found -4, expected a number above 0 on the diagonal"),
        ("[3, 4]", "4", "posterior.cholesky[1]: found 4, expected a list of numbers"),
        ("-6", '"a"', 'posterior.cholesky[2][1]: found the text "a", expected a number'),
        ("mean", "means", 'posterior.means: unknown key; did you mean "mean"?'),
        ("std = [0.1, 0.5, 0.01]", "", "posterior.std: missing"),
    ],
)
def test_wrong_tables_are_told_in_one_line(old, new, expected):
    assert old in TABLE
    with pytest.raises(InputError) as caught:
        parse_vehicle(HEAD + TABLE.replace(old, new, 1), "mine.toml")
    message = str(caught.value)
    assert message.startswith("mine.toml: ")
    assert expected in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("covariance", "expected"),
    [
        (np.eye(3), r"posterior: found a covariance of shape \(3, 3\), expected \(2, 2\)"),
        ([[1.0, 2.0], [2.0, 1.0]], "posterior: the covariance is not positive definite"),
        ([[1.0, 0.0], [0.0, 0.0]], "posterior: the covariance is not finite with variances above 0"),
        ([[1.0, np.nan], [np.nan, 1.0]], "posterior: the covariance is not finite"),
    ],
)
def test_what_is_no_covariance_is_refused(covariance, expected):
    with pytest.raises(InputError, match=expected):
        Posterior.from_covariance(["X_u", "X_uu"], [0.0, 0.0], covariance, [1.0, 1.0])


def test_wrong_arguments_are_told_by_their_place():
    with pytest.raises(InputError, match=r"posterior\.prior_std: found 1 numbers, expected 2"):
        Posterior.from_covariance(["X_u", "X_uu"], [0.0, 0.0], np.eye(2), [1.0])
    with pytest.raises(InputError, match=r"posterior\.names\[0\]: found the text"):
        Posterior.from_covariance(["X"], [0.0], np.eye(1), [1.0])


def test_vehicles_drawn_have_mean_and_covariance_of_the_posterior():
    vehicle, covariance = learned()
    drawn = np.array([[at(each, name, vehicle) for name in NAMES] for each in vehicle.sample(DRAWS, seed=1)])
    n = len(NAMES)
    offset = drawn.mean(axis=0) - vehicle.posterior.mean
    precision = np.linalg.inv(covariance)
    assert chi2.ppf(RARE, n) < DRAWS * offset @ precision @ offset < chi2.ppf(1.0 - RARE, n)
    spread = precision @ ((drawn - vehicle.posterior.mean).T @ (drawn - vehicle.posterior.mean)) / DRAWS
    likelihood_ratio = DRAWS * (np.trace(spread) - np.linalg.slogdet(spread)[1] - n)  # Wilks
    degrees = n * (n + 1) // 2
    assert chi2.ppf(RARE, degrees) < likelihood_ratio < chi2.ppf(1.0 - RARE, degrees)


def test_vehicles_drawn_differ_in_their_unknowns_alone():
    vehicle, _ = learned()
    for each in vehicle.sample(20, seed=2):
        assert each.posterior is None
        fixed = set(VLBV.hydrodynamics) - set(NAMES) - {"N_vdot"}
        assert fixed
        assert all(each.hydrodynamics[name] == vehicle.hydrodynamics[name] for name in fixed)
        assert each.coefficient("N_vdot") == each.coefficient("Y_rdot") != vehicle.coefficient("Y_rdot")
        assert len({thruster.time_constant for thruster in each.thrusters}) == 1
        assert [t.gain for t in each.thrusters if f"gain_{t.name}" != GAIN] == [1.0] * (len(each.thrusters) - 1)


def test_seeds_repeat_and_more_draws_begin_with_the_same():
    vehicle, _ = learned()
    assert vehicle.sample(5, seed=7) == vehicle.sample(5, seed=7) == vehicle.sample(8, seed=7)[:5]
    assert vehicle.sample(5, seed=7) != vehicle.sample(5, seed=8)
    assert len(set(vehicle.sample(5, seed=7))) == 5
    assert vehicle.sample(0, seed=7) == ()


@pytest.mark.parametrize(("name", "mean", "std"), [("X_uu", -1.0, 1.0), ("N_r", -1.0, 1.0), ("delay", 0.05, 0.05)])
def test_what_is_not_physical_is_cut_at_zero(name, mean, std):
    vehicle = VLBV.model_copy(update={"posterior": single(name, mean, std)})
    values = [each.command_delay if name == "delay" else each.coefficient(name) for each in vehicle.sample(1000, 3)]
    cut = values.count(0.0)
    assert binom.ppf(RARE, 1000, 0.158655) < cut < binom.ppf(1.0 - RARE, 1000, 0.158655)
    assert min(values) * math.copysign(1.0, mean) >= 0.0 <= max(values) * math.copysign(1.0, mean)


def test_couplings_of_damping_have_either_sign():
    vehicle = VLBV.model_copy(update={"posterior": single("Y_r", -1.0, 1.0)})
    signs = {np.sign(each.coefficient("Y_r")) for each in vehicle.sample(100, 3)}
    assert signs == {-1.0, 1.0}


def test_latencies_are_the_sensors_and_change_no_vehicle():
    vehicle = VLBV.model_copy(update={"posterior": single("latency_velocity", 0.1, 0.05)})
    assert vehicle.sample(3, 1) == (VLBV,) * 3


def test_a_draw_that_could_not_move_is_drawn_again():
    limit = math.sqrt(VLBV.mass_matrix[1, 1] * VLBV.mass_matrix[5, 5])
    vehicle = VLBV.model_copy(update={"posterior": single("Y_rdot", 0.0, limit)})
    couplings = [each.mass_matrix[1, 5] for each in vehicle.sample(300, 4)]
    assert max(map(abs, couplings)) < limit
    assert max(map(abs, couplings)) > 0.9 * limit  # of a normal distribution a third was drawn again
    never = VLBV.model_copy(update={"posterior": single("Y_rdot", 5.0 * limit, 0.01 * limit)})
    with pytest.raises(InputError, match="vlbv300: 100 draws in a row have a total mass matrix that is not positive"):
        never.sample(1, 4)


def test_deviations_of_a_file_without_posterior_are_drawn_independently():
    std = {"X_udot": 2.0, "X_uu": 3.0, "Y_rdot": 0.05, "BG_z": 0.4}
    values = {name: Coefficient(value=VLBV.coefficient(name), std=s) for name, s in std.items()}
    vehicle = VLBV.with_coefficients(values)
    drawn = np.array([[each.coefficient(name) for name in std] for each in vehicle.sample(DRAWS, seed=5)])
    deviations = (drawn - [VLBV.coefficient(name) for name in std]) / list(std.values())
    total = VLBV.mass_matrix[0, 0]
    deviations[:, 0] = np.log1p(-deviations[:, 0] * 2.0 / total) / (2.0 / total)
    n = len(std)
    offset = deviations.mean(axis=0)
    assert chi2.ppf(RARE, n) < DRAWS * offset @ offset < chi2.ppf(1.0 - RARE, n)
    spread = deviations.T @ deviations / DRAWS
    likelihood_ratio = DRAWS * (np.trace(spread) - np.linalg.slogdet(spread)[1] - n)
    assert chi2.ppf(RARE, 10) < likelihood_ratio < chi2.ppf(1.0 - RARE, 10)


def test_nothing_to_draw_from_is_told():
    with pytest.raises(InputError, match=r"vlbv300: has neither a posterior nor a coefficient with std.*learn"):
        VLBV.sample(3, seed=0)
    with pytest.raises(InputError, match="found n = -1"):
        learned()[0].sample(-1, seed=0)
    heavy = load_vehicle("seamor").with_coefficients({"X_udot": Coefficient(value=40.0, std=1.0)})
    with pytest.raises(InputError, match="the total inertia in row X is not above 0"):
        heavy.sample(1)


def test_posterior_lives_as_long_as_the_values_it_belongs_to():
    vehicle, _ = learned()
    kept = vehicle.posterior
    value = vehicle.coefficient("X_uu")
    assert vehicle.with_coefficients({"X_uu": Coefficient(value=value, std=0.1, source="x")}).posterior == kept
    assert vehicle.with_coefficients({}, provenance=Provenance(source="x")).posterior == kept
    assert vehicle.model_copy(update={"name": "b", "provenance": Provenance()}).posterior == kept
    assert vehicle.with_coefficients({"X_uu": value - 1e-9}).posterior is None
    assert vehicle.with_coefficients({"Z_ww": -1.0}).posterior is None
    assert vehicle.model_copy(update={"command_delay": 0.2}).posterior is None
    assert vehicle.model_copy(update={"thrusters": ()}).posterior is None
    assert vehicle.model_copy(update={"command_delay": 0.2, "posterior": kept}).posterior == kept


def test_posterior_of_other_values_is_doubted():
    vehicle, _ = learned()
    assert vehicle.warnings == VLBV.warnings
    edited = parse_vehicle(vehicle_text(vehicle).replace("X_uu = {value = -41", "X_uu = {value = -81"), "edited")
    assert edited.posterior == vehicle.posterior
    doubt = [text for text in edited.warnings if text not in vehicle.warnings]
    assert doubt == ["posterior: it belongs to other values of X_uu; learn anew, or take the table out"]
