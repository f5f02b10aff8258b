"""What was learned that cannot be right, in physical words; and the sentence that says what matters first."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from towtank.identification.data.samples import N_MEASURED, NoiseLevels
from towtank.identification.model.prior import prior_of
from towtank.identification.posterior.assembly import Current, LogLearning, Mode
from towtank.identification.posterior.plausibility import implausible
from towtank.identification.posterior.result import estimate_of, model_of, with_posterior
from towtank.identification.posterior.thrusters import learned_gains
from towtank.recording.consistency import Finding
from towtank.report.verdict import learn_verdict
from towtank.validation import AxisUse, Usability
from towtank.vehicle import Vehicle, load_vehicle
from towtank.vehicle.matrices import GRAVITY

VEHICLE = load_vehicle("bluerov2_heavy").model_copy(update={"hydrodynamics": {}})
WEIGHT = GRAVITY * VEHICLE.rigid_body.mass


def learning(known: float = 0.05, vehicle: Vehicle = VEHICLE, **moved: float) -> LogLearning:
    """A finished learning that left the prior's mean but for some unknowns, in their physical units.

    known: deviations as a share of the prior's.
    """
    prior = prior_of(vehicle, more=("latency_position",))
    values = prior.free.values(prior.mean)
    for name, value in moved.items():
        values[prior.names.index(name)] = value
    theta, covariance = prior.free.thetas(values), known**2 * prior.covariance
    std = np.sqrt(np.diag(covariance))
    estimate, messages = estimate_of(vehicle, prior, theta, covariance, 60.0, 6000)
    gains = learned_gains(vehicle, prior.free, theta, std)
    model = model_of(vehicle, estimate, "test", delay=0.08, lag=0.1, gains=gains)
    return LogLearning(
        vehicle=vehicle,
        estimate=estimate,
        model=with_posterior(model, prior, theta, covariance),
        delay=0.08,
        delay_scan=None,
        grids=(),
        sources=(),
        warnings=messages,
        method="joint",
        gains=gains,
        mode=Mode(prior, theta, NoiseLevels(np.ones(N_MEASURED), np.ones(6))),
    )


@pytest.mark.parametrize(("drag", "identified"), [(-10.0, False), (-60.0, True)])
def test_asymmetric_drag_is_not_learned_from_its_bound(drag: float, identified: bool) -> None:
    """|X_u2| <= -X_uu alone leaves it a deviation of |X_uu| / sqrt(3), however much was supposed of it."""
    found = learning(0.3, X_uu=drag).estimate["X_u2"]
    assert found.std == pytest.approx(5.1, abs=0.1)
    assert found.identified == identified


def test_the_mean_of_the_prior_is_not_doubted() -> None:
    assert implausible(learning()) == ()


MASS = VEHICLE.rigid_body.mass
FIRST = VEHICLE.thrusters[0].name


@pytest.mark.parametrize(
    "name, value, words",
    [
        ("BG_z", 0.63 * WEIGHT, "is a righting arm of 63 cm"),
        ("BG_x", -0.2 * WEIGHT, "puts weight and buoyancy 20 cm apart lengthways"),
        ("W_minus_B", 0.094 * WEIGHT, "is 9.4 % of the weight .. : check mass, ballast"),
        ("X_uu", -5000.0, "is a drag coefficient of 1"),
        ("X_uu", 800.0, "drives the vehicle on .. : check signs"),
        ("Z_wdot", -19.0 * MASS, "is 20 times the body's own mass"),
        ("Y_0", 0.1 * WEIGHT, "the constant sway force of"),
        ("Y_rdot", 60.0, "the inertia coupling Y_rdot is 60"),
        ("inflow_loss", 0.8, "thrusters lose 80.00 ± 0.75 % of their thrust per m/s"),
        ("inflow_loss", -1.3, "thrusters gain 130.00 ± 0.75 % of their thrust per m/s"),
        ("delay", 0.42, "a delay of 420.0 ± 3.0 ms from command to thruster"),
        ("lag", 2.0, "ms of the thrusters, first order"),
        ("latency_position", 0.6, "position arrives 600.0 ± 5.0 ms late"),
        (f"gain_{FIRST}", 0.62, f"thruster {FIRST} gives 62.00 ± 0.25 % of its curve .. : check curve, voltage"),
    ],
)
def test_what_lies_beyond_the_prior_is_told_in_physical_words(name: str, value: float, words: str) -> None:
    [finding] = implausible(learning(**{name: value}))
    assert finding.what == name
    assert all(part in finding.text for part in words.split(" .. "))
    assert " deviations from what " in finding.text or "times the body's own" in finding.text


def test_an_unknown_within_three_deviations_or_hardly_known_is_not_doubted() -> None:
    prior = prior_of(VEHICLE)
    k = prior.names.index("BG_z")
    mean, std = float(prior.mean[k]), float(prior.std[k])
    assert implausible(learning(BG_z=mean + 2.9 * std)) == ()
    assert implausible(learning(known=0.05, BG_z=mean + 3.1 * std)) == ()  # 0.1 beyond, known to 0.05
    assert implausible(learning(known=0.5, BG_z=mean + 4.4 * std)) == ()
    assert [each.what for each in implausible(learning(known=0.05, BG_z=mean + 3.3 * std))] == ["BG_z"]


def test_quick_thrusters_are_no_fault() -> None:
    assert implausible(learning(lag=0.001, delay=0.0)) == ()


def test_what_a_file_states_is_called_that() -> None:
    stated = VEHICLE.with_coefficients({"X_uu": -50.0})
    [finding] = implausible(learning(vehicle=stated, X_uu=-200.0))
    assert "6 deviations from what the file says" in finding.text


def test_total_inertias_below_and_far_above_the_rigid_body() -> None:
    light = implausible(learning(known=0.01, X_udot=0.4 * MASS))
    assert [each.what for each in light] == ["X_udot"]
    assert "is 0.6 times the body's own mass: check mass, units" in light[0].text
    heavy = implausible(learning(known=0.01, K_pdot=-4.3 * VEHICLE.rigid_body_matrix[3, 3]))
    assert "is 5.3 times the body's own moment of inertia" in heavy[0].text
    assert implausible(learning(known=0.6, X_udot=0.4 * MASS)) == ()


def test_a_current_that_no_water_has() -> None:
    still = learning()
    slow, fast = (Current(np.array([speed, 0.0, 0.0]), np.full(3, 0.02)) for speed in (0.8, 1.4))
    assert implausible(replace(still, current=slow)) == ()
    [finding] = implausible(replace(still, current=fast))
    assert "1.400 ± 0.020 m/s" in finding.text


def test_the_farthest_comes_first() -> None:
    found = implausible(learning(BG_z=0.3 * WEIGHT, delay=1.2, W_minus_B=0.2 * WEIGHT))
    assert [each.what for each in found] == ["BG_z", "W_minus_B", "delay"]


DRIVEN = (True, True, True, False, False, True)


def verdict(learned: LogLearning, fit: dict[str, float | None] | None = None, *findings: Finding) -> str:
    return learn_verdict(learned.estimate, fit or {}, "these logs", findings, DRIVEN).text


def test_the_verdict_begins_with_what_cannot_be_right() -> None:
    wrong, late = Finding("p", "p is upside down"), Finding("u", "u arrives late", allowed_for=True)
    assert verdict(learning(), None, wrong, late) == "Not usable as it is. Something cannot be right: p is upside down."
    assert verdict(learning(), None, wrong, wrong, late).endswith("p is upside down (and 1 more below).")
    assert "cannot be right" not in verdict(learning(), None, late)


def test_a_model_that_predicts_is_of_use_though_a_coefficient_is_not_to_be_believed() -> None:
    use = Usability((AxisUse("surge", "u", 30.0, 70.0),), (), (), 90.0)
    odd, wrong = Finding("N_r", "N_r is odd", of_model=True), Finding("p", "p is upside down")
    known = learning()
    told = learn_verdict(known.estimate, {}, "these logs", (odd,), DRIVEN, use)
    assert told.text == (
        "Usable for prediction up to 30 s (surge), judged on these logs. But something cannot be right: N_r is odd."
    )
    assert told.grade == "fair"
    assert learn_verdict(known.estimate, {}, "these logs", (odd, wrong), DRIVEN, use).text.startswith("Not usable as")


def test_the_verdict_says_why_nothing_was_identified() -> None:
    assert verdict(learning(known=0.9)).startswith("Not usable. Nothing could be identified: the data leave 90 %")


def only(learned: LogLearning, letters: str) -> LogLearning:
    """What was learned, with nothing identified but of these rows."""
    estimate = learned.estimate
    identified = tuple(name[0] in letters and name[1:2] == "_" and name != "W_minus_B" for name in estimate.names)
    sums = tuple(total for total, row in zip(estimate.sums, "XYZKMN", strict=True) if row in letters)
    reasons = tuple(None if ok else "too little motion" for ok in identified)
    return replace(learned, estimate=replace(estimate, identified=identified, reasons=reasons, sums=sums))


def test_the_verdict_says_which_axes_are_known_and_how_well() -> None:
    text = verdict(only(learning(known=0.04), "XYZN"), {"u": 91.0, "r": 97.2})
    assert text == (
        "Surge, sway, heave and yaw: inertia to 2 %, drag to 6 %; roll and pitch were not driven; the model predicts "
        "surge speed and yaw rate of these logs with a fit of 91 to 97 %."
    )


def test_an_axis_that_was_driven_in_vain_is_called_unknown() -> None:
    assert "; sway stays unknown" in verdict(only(learning(known=0.04), "XZN"))


def test_drag_is_as_well_known_as_at_the_best_speed() -> None:
    learned = only(learning(known=0.4), "X")
    estimate = learned.estimate
    linear, quadratic = estimate.names.index("X_u"), estimate.names.index("X_uu")
    covariance = estimate.covariance.copy()
    # the sum at 0.5 m/s is known to 1 % of it, either by itself hardly
    g, across = np.array([0.5, 0.25]), np.array([1.0, -2.0])
    drag = abs(g @ estimate.values[[linear, quadratic]])
    at = np.ix_([linear, quadratic], [linear, quadratic])
    covariance[at] = (0.01 * drag) ** 2 * np.outer(g, g) / (g @ g) ** 2 + 100.0 * np.outer(across, across)
    text = learn_verdict(replace(estimate, covariance=covariance), {}, "", (), DRIVEN).text
    share = float(text.split("drag to ")[1].split(" %")[0])
    assert share == pytest.approx(1.0, abs=1.1)
    assert math.isfinite(share)
