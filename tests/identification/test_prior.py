"""What is supposed before any data: sizes by physics, the vehicle's file, its table [prior], a file beside, what was
learned before."""

from __future__ import annotations

import math

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.identification.model.parameters import DVL_PLACE, IMU_PLACE, LATENCIES, MARKER_PLACE, PLACES
from towtank.identification.model.prior import Prior, prior_of
from towtank.identification.model.terms import Body
from towtank.identification.posterior.result import with_posterior
from towtank.vehicle import COEFFICIENTS, Coefficient, Posterior, Vehicle, index, load_vehicle, parse_vehicle
from towtank.vehicle.posterior import coordinate, with_coordinates

BODIES = {
    # gyradii of 0.1 m and 0.5 m, so that the arm of hull and fins is 0.17 m and 0.85 m
    "13 kg": {"mass": 13.0, "inertia": [0.13, 0.13, 0.13]},
    "640 kg": {"mass": 640.0, "inertia": [160.0, 160.0, 160.0]},
}
SIZES = {
    # name: (mean, deviation) in its own unit, by hand from the table; of inertias the total and that of its logarithm
    "13 kg": {
        "X_udot": (22.1, 0.5),
        "N_rdot": (0.208, 0.5),
        "Y_rdot": (0.0, 0.24 * math.sqrt(22.1 * 0.208)),
        "X_uu": (-55.288, 110.575),
        "Z_w": (-5.5288, 11.0575),
        "K_pp": (-0.27163, 0.54326),
        "K_p": (-0.15978, 0.31956),
        "N_v": (0.0, 0.93988),
        "W_minus_B": (0.0, 1.2753),
        "BG_z": (0.59973, 2.99865),
        "BG_x": (0.0, 0.59973),
        "X_0": (0.0, 0.065),
        "N_0": (0.0, 0.0013),
    },
    "640 kg": {
        "Y_vdot": (1088.0, 0.5),
        "M_qdot": (256.0, 0.5),
        "X_qdot": (0.0, 0.24 * math.sqrt(1088.0 * 256.0)),
        "Y_vv": (-742.65, 1485.31),
        "X_u": (-74.265, 148.531),
        "N_rr": (-456.08, 912.16),
        "M_q": (-53.657, 107.313),
        "M_w": (0.0, 63.126),
        "W_minus_B": (0.0, 62.784),
        "BG_z": (108.21, 541.06),
        "BG_y": (0.0, 108.21),
        "Z_w2": (0.0, 222.796),
        "Y_v2": (0.0, 22.2796),
        "Y_0": (0.0, 3.2),
        "K_0": (0.0, 1.6),
    },
}
EVEN = "uwq"  # velocities that a mirror through the plane y = 0 leaves as they are; v, p, r change sign


def body(which: str = "13 kg", **more: object) -> Vehicle:
    return Vehicle.model_validate({"name": "body", "rigid_body": BODIES[which], **more})


def driven(**more: object) -> Vehicle:
    """A body with four thrusters, whose curves were measured."""
    curve = {"kind": "quadratic", "forward": 40.0, "source": "bench"}
    thrusters = [
        {"name": f"t{k}", "position": [0.0, 0.1 * k, 0.0], "direction": [1.0, 0.0, 0.0], "curve": curve}
        for k in range(4)
    ]
    return body(**{"thrusters": thrusters, **more})


def of(supposed: Prior, name: str) -> tuple[float, float]:
    """Mean and deviation in the coordinate that a vehicle's posterior has of an unknown."""
    k = supposed.names.index(name)
    return float(coordinates(supposed)[k]), float(supposed.std[k])


def coordinates(supposed: Prior) -> np.ndarray:
    """Means; of a coupling of inertia the coefficient, of which theta is the rigid body's element less this."""
    couplings = [name.endswith("dot") and index(name)[1] != index(name)[2] for name in supposed.names]
    return np.where(couplings, supposed.free.rigid - supposed.mean, supposed.mean)


def source(supposed: Prior, name: str) -> str:
    return supposed.sources[supposed.names.index(name)]


# -- physics


@pytest.mark.parametrize("which", list(BODIES))
def test_sizes_are_those_of_the_table(which: str) -> None:
    supposed = prior_of(body(which))
    for name, (mean, std) in SIZES[which].items():
        at, width = of(supposed, name)
        kind, i, j = index(name)
        value = math.exp(at) if kind == "mass" and i == j else at
        assert value == pytest.approx(mean, rel=2e-5), name
        assert width == pytest.approx(std, rel=2e-5), name


def test_inputs_are_those_of_autopilots_and_thrusters() -> None:
    supposed = prior_of(driven(), more=(*LATENCIES, *PLACES))
    assert of(supposed, "delay") == (0.08, 0.06)
    assert of(supposed, "lag") == (0.1, 0.08)
    assert of(supposed, "inflow_loss") == (0.0, 0.15)
    for k in range(4):
        assert of(supposed, f"gain_t{k}") == pytest.approx((0.0, 0.08))
    assert all(of(supposed, name) == (0.05, 0.1) for name in LATENCIES)
    assert all(of(supposed, name) == (0.0, 0.1) for name in IMU_PLACE)
    gyradius = float(np.sqrt(max(driven().rigid_body.inertia) / driven().rigid_body.mass))
    assert all(of(supposed, name) == pytest.approx((0.0, gyradius)) for name in (*DVL_PLACE, *MARKER_PLACE))


def test_a_wrench_has_a_delay_and_no_thrusters() -> None:
    supposed = prior_of(driven(), commands=False)
    assert [name for name in supposed.names if name not in COEFFICIENTS] == ["delay"]
    assert "inflow_loss" not in supposed.names


@pytest.mark.parametrize("s", [2.0, 5.0])
def test_a_body_s_times_as_long_has_forces_that_grow_as_areas_and_volumes_do(s: float) -> None:
    """Geometric similarity: at the same speed drag grows by s^2, its moment at the same rim speed by s^3."""
    small = body()
    large = body(rigid_body={"mass": 13.0 * s**3, "inertia": [0.13 * s**5] * 3})
    one, two = prior_of(small), prior_of(large)
    powers = {"X_uu": 2, "X_u": 2, "K_pp": 5, "K_p": 4, "X_u2": 2, "W_minus_B": 3, "BG_z": 4, "Y_rdot": 4, "N_v": 3}
    for name, power in powers.items():
        assert of(two, name) == pytest.approx([s**power * x for x in of(one, name)]), name
    assert Body(large).gyradii == pytest.approx(s * Body(small).gyradii)
    assert Body(large).length == pytest.approx(s * Body(small).length)


@pytest.mark.parametrize("kind", ["mass", "linear", "quadratic"])
def test_couplings_are_those_of_a_body_that_is_the_same_to_port_and_starboard(kind: str) -> None:
    found = [index(name) for name in prior_of(body()).names if name in COEFFICIENTS]
    pairs = {(i, j) for what, i, j in found if what == kind and i != j}
    symmetric = {
        (i, j) for i in range(6) for j in range(6) if i != j and ("uvwpqr"[i] in EVEN) == ("uvwpqr"[j] in EVEN)
    }
    assert pairs <= symmetric
    if kind == "mass":
        assert {tuple(sorted(pair)) for pair in symmetric} == pairs  # each once


def test_damping_is_a_plain_number_and_inertia_a_logarithm() -> None:
    supposed = prior_of(driven())
    slopes = dict(zip(supposed.names, supposed.free.slopes(supposed.mean), strict=True))
    assert all(slopes[name] == 1.0 for name in ("X_u", "X_uu", "K_pp", "BG_z", "N_v", "delay", "lag"))
    assert slopes["X_udot"] == pytest.approx(-22.1)


# -- the vehicle's file


def test_what_the_file_says_is_the_mean() -> None:
    stated = {
        "X_uu": {"value": -40.0, "std": 4.0},
        "X_u": -3.0,
        "Y_vdot": {"value": -12.0, "std": 5.0},
        "Z_wdot": -12.0,
        "N_vdot": {"value": 0.7, "std": 0.1},
        "Y_uv": {"value": -9.0, "std": 2.0},
    }
    supposed, silent = prior_of(body(hydrodynamics=stated)), prior_of(body())
    assert of(supposed, "X_uu") == (-40.0, 4.0)
    assert of(supposed, "X_u") == (-3.0, 1.5)
    assert of(supposed, "Y_vdot") == pytest.approx((math.log(25.0), 5.0 / 25.0))
    assert of(supposed, "Z_wdot") == pytest.approx((math.log(25.0), 6.0 / 25.0))
    assert of(supposed, "Y_rdot") == (0.7, 0.1)
    assert of(supposed, "Y_uv") == (-9.0, 2.0)
    assert "N_vdot" not in supposed.names
    assert "Y_uv" not in silent.names
    assert of(supposed, "K_p") == of(silent, "K_p")
    assert source(supposed, "X_uu") == "the vehicle's file"
    assert "states no deviation" in source(supposed, "X_u")
    assert "gyration" in source(supposed, "K_p")


def test_a_zero_without_deviation_is_no_unknown_where_no_body_of_this_kind_has_it() -> None:
    supposed = prior_of(body(hydrodynamics={"Y_uv": 0.0, "X_vv": 0.0}))
    assert not {"Y_uv", "X_vv"} & set(supposed.names)
    assert supposed.std.min() > 0.0


@pytest.mark.parametrize(("said", "other"), [("X_uu", "X_u"), ("N_r", "N_rr")])
def test_a_file_with_one_damping_term_says_that_the_other_is_little(said: str, other: str) -> None:
    supposed, silent = prior_of(body(hydrodynamics={said: {"value": -5.0, "std": 1.0}})), prior_of(body())
    assert of(supposed, other) == (0.0, 0.5 * of(silent, other)[1])
    assert said in source(supposed, other)


def test_the_file_s_delay_and_lag_are_means() -> None:
    vehicle = driven(command_delay=0.2)
    slow = [each.model_copy(update={"time_constant": 0.3}) for each in vehicle.thrusters]
    supposed = prior_of(vehicle.model_copy(update={"thrusters": slow}))
    assert of(supposed, "delay") == (0.2, 0.06)
    assert of(supposed, "lag") == pytest.approx((0.3, 0.15))


# -- gains and the scale of force


def gains(vehicle: Vehicle) -> np.ndarray:
    supposed = prior_of(vehicle)
    rows = [k for k, name in enumerate(supposed.names) if name.startswith("gain_")]
    return supposed.covariance[np.ix_(rows, rows)]


@pytest.mark.parametrize("scale", [0.02, 0.3])
def test_the_scale_is_what_all_gains_have_in_common(scale: float) -> None:
    """The mean of the logarithms has the deviation of the scale; what differs among thrusters keeps 8 %."""
    block = gains(driven(scale_std=scale))
    assert math.sqrt(block.mean()) == pytest.approx(scale)
    values, directions = np.linalg.eigh(block)
    common = int(np.argmax(np.abs(directions.sum(axis=0))))
    assert np.abs(directions[:, common]) == pytest.approx(0.5)
    assert values[common] == pytest.approx(4.0 * scale**2)
    assert np.delete(values, common) == pytest.approx(0.08**2)


def test_independent_gains_know_the_scale_by_themselves() -> None:
    assert math.sqrt(gains(driven()).mean()) == pytest.approx(0.08 / 2.0)


def test_curves_of_unit_scale_leave_the_scale_unknown() -> None:
    unit = [{**each.model_dump(), "curve": {"kind": "quadratic", "forward": 1.0}} for each in driven().thrusters]
    values = np.linalg.eigvalsh(gains(driven(thrusters=unit)))
    assert values[:-1] == pytest.approx(0.08**2)
    assert math.sqrt(values[-1] / 4.0) >= 1.0


# -- the table [prior]

TABLE = {
    "X_uu": {"value": -60.0, "std": 20.0, "source": "a tow"},
    "X_udot": {"value": -7.0, "std": 4.0},
    "N_vdot": {"value": 0.2, "std": 0.05},
    "Z_uw": {"value": -3.0, "std": 1.0},
    "delay": {"value": 0.1, "std": 0.02},
    "lag": {"value": 0.2, "std": 0.05},
    "gain_t1": {"value": 0.9, "std": 0.09},
    "latency_velocity": {"value": 0.12, "std": 0.01},
}
EXPECTED = {
    "X_uu": (-60.0, 20.0),
    "X_udot": (math.log(20.0), 0.2),
    "Y_rdot": (0.2, 0.05),
    "Z_uw": (-3.0, 1.0),
    "delay": (0.1, 0.02),
    "lag": (0.2, 0.05),
    "gain_t1": (math.log(0.9), 0.1),
    "latency_velocity": (0.12, 0.01),
}


@pytest.mark.parametrize("where", ["vehicle", "beside"])
def test_lines_of_the_table_take_the_place_of_all_else(where: str) -> None:
    stated = {"X_uu": {"value": -40.0, "std": 4.0}, "X_u": {"value": -3.0, "std": 1.0}}
    vehicle, late = driven(hydrodynamics=stated, command_delay=0.3, scale_std=0.05), ("latency_velocity",)
    if where == "vehicle":
        supposed = prior_of(vehicle.model_copy(update={"prior": TABLE}), more=late)
    else:
        supposed = prior_of(vehicle, more=late, beside=body(prior=TABLE))
    before = prior_of(vehicle, more=late)
    for name, expected in EXPECTED.items():
        assert of(supposed, name) == pytest.approx(expected), name
        assert "[prior]" in source(supposed, name)
    assert source(supposed, "X_uu").endswith("[prior]: a tow")
    for name in set(before.names) - EXPECTED.keys():
        assert of(supposed, name) == of(before, name), name
    k = supposed.names.index("gain_t1")
    assert np.count_nonzero(supposed.covariance[k]) == 1
    np.linalg.cholesky(supposed.covariance)
    assert supposed.reference == pytest.approx(supposed.std)


def test_a_gain_is_stated_as_the_file_of_a_thruster_states_it() -> None:
    """A gain of 0.9 is 0.9 of the curve, whatever the file's own gain is, which unknown gains are multiples of."""
    vehicle = driven(prior={"gain_t0": {"value": 0.9, "std": 0.09}})
    weak = [each.model_copy(update={"gain": 0.6}) for each in vehicle.thrusters]
    assert of(prior_of(vehicle.model_copy(update={"thrusters": weak})), "gain_t0") == pytest.approx(
        (math.log(1.5), 0.1)
    )


def test_inputs_that_are_none_here_are_passed_over() -> None:
    supposed = prior_of(driven(prior=TABLE), commands=False)
    assert not {"lag", "gain_t1", "latency_velocity"} & set(supposed.names)
    assert of(supposed, "delay") == (0.1, 0.02)


@pytest.mark.parametrize(
    ("name", "hint"),
    [("latency_velocty", '"latency_velocity"'), ("gain_t11", '"gain_t1"'), ("gain_other", "no unknown")],
)
def test_a_name_that_is_no_unknown_is_refused(name: str, hint: str) -> None:
    beside = body(prior={name: {"value": 0.9, "std": 0.1}})
    with pytest.raises(InputError, match=hint):
        prior_of(driven(), beside=beside)


def test_an_inertia_that_the_vehicle_cannot_have_is_refused() -> None:
    beside = body("640 kg", prior={"X_udot": {"value": 100.0, "std": 10.0}})
    with pytest.raises(InputError, match=r"prior\.X_udot: found 100, with which body has a total inertia of -87"):
        prior_of(driven(), beside=beside)


# -- a file beside


def test_a_file_beside_counts_where_it_says_something() -> None:
    vehicle = driven(hydrodynamics={"X_u": {"value": -3.0, "std": 1.0}, "N_rr": -0.2})
    beside = body(
        hydrodynamics={"X_uu": {"value": -50.0, "std": 5.0}, "N_rr": {"value": -0.4, "std": 0.1}, "Y_vv": -70.0}
    )
    supposed, alone = prior_of(vehicle, beside=beside), prior_of(vehicle)
    assert of(supposed, "X_uu") == (-50.0, 5.0)
    assert of(supposed, "X_u") == (-3.0, 1.0)  # the vehicle's, of which the other file is silent
    assert of(supposed, "N_rr") == (-0.4, 0.1)
    assert of(supposed, "Y_vv") == (-70.0, 35.0)
    assert of(supposed, "Y_v") == (0.0, 0.5 * of(alone, "Y_v")[1])  # both are silent of it, and one has Y_vv
    assert of(supposed, "K_p") == of(alone, "K_p")
    assert source(supposed, "X_uu") == "the prior's file"
    assert source(supposed, "X_u") == "the vehicle's file"


def test_a_term_that_only_the_file_beside_has_is_an_unknown() -> None:
    assert of(prior_of(driven(), beside=body(hydrodynamics={"Y_uv": {"value": -9.0, "std": 2.0}})), "Y_uv") == (
        -9.0,
        2.0,
    )


# -- what was learned before


def learned(vehicle: Vehicle, names: list[str], gain: float = 1.0) -> Vehicle:
    """The vehicle as it was learned: everything in `names` is known together, and thruster t0 has this gain."""
    supposed, n = prior_of(vehicle, more=("latency_velocity",)).only(names), len(names)
    rng = np.random.default_rng(7)
    mean = coordinates(supposed) + 0.3 * supposed.std * rng.standard_normal(n)
    mean[[name.startswith("gain_") for name in names]] = 0.0
    mix = np.eye(n) + 0.2 * rng.standard_normal((n, n))
    factor = 0.1 * supposed.std[:, None] * mix
    thrusters = [each.model_copy(update={"gain": gain}) if each.name == "t0" else each for each in vehicle.thrusters]
    posterior = Posterior.from_covariance(supposed.names, mean, factor @ factor.T, supposed.std)
    return vehicle.model_copy(update={"thrusters": thrusters, "posterior": posterior})


NAMES = ["X_udot", "Y_rdot", "X_u", "X_uu", "delay", "lag", "gain_t0", "gain_t1", "latency_velocity"]


@pytest.mark.parametrize("where", ["vehicle", "beside"])
def test_a_learned_file_goes_on_exactly_where_it_was(where: str) -> None:
    """Whatever else it states: lines of [prior] and deviations of coefficients were there before the data."""
    known = driven(prior={"X_uu": {"value": -1.0, "std": 0.1}}, scale_std=0.05)
    before = learned(known, [name for name in prior_of(known, more=("latency_velocity",)).names if name in NAMES])
    vehicle, beside = (before, None) if where == "vehicle" else (driven(scale_std=0.05), before)
    supposed = prior_of(vehicle, more=("latency_velocity",), beside=beside)
    there = before.posterior
    assert there is not None
    found = supposed.only(there.names)
    order = [there.names.index(name) for name in found.names]
    assert set(found.names) == set(NAMES)
    signs = [-1.0 if name == "Y_rdot" else 1.0 for name in found.names]
    assert np.array_equal(coordinates(found), np.array(there.mean)[order])
    assert np.array_equal(found.covariance, np.outer(signs, signs) * there.covariance[np.ix_(order, order)])
    assert np.array_equal(found.reference, np.array(there.prior_std)[order])
    assert set(found.sources) == {"learned before"}
    rest = [name for name in supposed.names if name not in there.names]
    rows, columns = ([supposed.names.index(name) for name in names] for names in (rest, found.names))
    assert not supposed.covariance[np.ix_(rows, columns)].any()
    assert of(supposed, "N_rr") == of(prior_of(driven()), "N_rr")


def test_gains_learned_of_one_file_mean_the_same_force_on_another() -> None:
    before = learned(driven(), ["X_u", "gain_t0", "gain_t1"], gain=0.8)
    supposed = prior_of(driven(), beside=before)
    assert of(supposed, "gain_t0")[0] == pytest.approx(math.log(0.8))
    assert of(supposed, "gain_t1")[0] == pytest.approx(0.0)
    assert of(prior_of(before), "gain_t0")[0] == 0.0


def test_what_is_stated_beside_a_learned_vehicle_counts_more() -> None:
    vehicle = learned(driven(), ["X_u", "X_uu", "Y_vv", "delay"])
    beside = body(
        prior={"delay": {"value": 0.1, "std": 0.02}},
        hydrodynamics={"X_uu": {"value": -50.0, "std": 5.0}, "Y_vv": -70.0},
    )
    supposed, alone = prior_of(vehicle, beside=beside), prior_of(vehicle)
    assert of(supposed, "delay") == (0.1, 0.02)
    assert of(supposed, "X_uu") == (-50.0, 5.0)
    for name in ("X_u", "Y_vv"):  # a value without a deviation is worth less than what was learned
        assert of(supposed, name) == of(alone, name)
    k = supposed.names.index("X_uu")
    assert np.count_nonzero(supposed.covariance[k]) == 1
    np.linalg.cholesky(supposed.covariance)


@pytest.mark.parametrize("name", ["rexrov", "bluerov2_heavy"])
@pytest.mark.filterwarnings("ignore::towtank.vehicle.VehicleWarning")
def test_a_posterior_is_of_the_vehicle_s_own_coordinates(name: str) -> None:
    """At theta of a vehicle's coefficients, couplings of inertia among them, the posterior's mean is the vehicle."""
    vehicle = load_vehicle(name).with_coefficients({"Y_rdot": 0.3, "Z_qdot": -0.2})
    supposed = prior_of(vehicle)
    theta = supposed.free.theta(vehicle, delay=0.1, lag=0.2)
    posterior = with_posterior(vehicle, supposed, theta, supposed.covariance).posterior
    assert posterior is not None
    pairs = zip(posterior.names, theta, strict=True)
    expected = [coordinate(vehicle, each) if each in COEFFICIENTS else x for each, x in pairs]
    assert posterior.mean == pytest.approx(expected)
    drawn = with_coordinates(vehicle, posterior.names, posterior.mean)
    assert drawn.mass_matrix == pytest.approx(vehicle.mass_matrix)
    assert drawn.coefficient("Y_rdot") == pytest.approx(0.3)
    again = prior_of(vehicle.model_copy(update={"posterior": posterior}))
    assert again.mean == pytest.approx(theta)
    assert again.covariance == pytest.approx(supposed.covariance, rel=5e-3)


# -- the record


def test_only_keeps_what_is_supposed_of_each() -> None:
    whole = prior_of(driven(scale_std=0.05))
    names = ["gain_t2", "X_uu", "delay", "gain_t0"]
    part = whole.only(names)
    assert set(part.names) == set(names)
    for name in names:
        assert of(part, name) == of(whole, name)
        assert source(part, name) == source(whole, name)
    a, b = (part.names.index(name) for name in ("gain_t0", "gain_t2"))
    c, d = (whole.names.index(name) for name in ("gain_t0", "gain_t2"))
    assert part.covariance[a, b] == whole.covariance[c, d] != 0.0
    assert part.free.values(part.mean) == pytest.approx(part.values)


@pytest.mark.parametrize("name", ["seamor", "bluerov2_heavy", "rexrov", "lauv"])
@pytest.mark.filterwarnings("ignore::towtank.vehicle.VehicleWarning")
def test_values_and_coordinates_are_the_same_thing(name: str) -> None:
    supposed = prior_of(load_vehicle(name), more=(*LATENCIES, *PLACES))
    assert supposed.free.thetas(supposed.values) == pytest.approx(supposed.mean)
    step = 1e-6 * supposed.std
    moved = (supposed.free.values(supposed.mean + step) - supposed.free.values(supposed.mean - step)) / 2e-6
    assert supposed.value_std == pytest.approx(np.abs(moved), rel=1e-5)
    assert np.linalg.eigvalsh(supposed.covariance / np.outer(supposed.std, supposed.std))[0] > 0.0


def test_the_mean_is_a_vehicle_that_dissipates() -> None:
    supposed = prior_of(body("640 kg"))
    assert body("640 kg").with_coefficients(supposed.vehicle_values).warnings == ()


def test_a_file_of_nothing_but_body_and_prior_is_a_vehicle() -> None:
    rigid_body = "[rigid_body]\nmass = 13.0\ninertia = [0.1, 0.1, 0.1]\n"
    vehicle = parse_vehicle(f'name = "lines"\n{rigid_body}[prior]\ndelay = {{ value = 0.1, std = 0.02 }}', "lines.toml")
    assert vehicle.prior["delay"] == Coefficient(value=0.1, std=0.02, unit="s")
    assert of(prior_of(driven(), beside=vehicle), "delay") == (0.1, 0.02)
