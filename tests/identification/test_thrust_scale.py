"""The scale of force: what an error in it does, what its deviation adds, and where nothing fixes it."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.identification import LogLearning, learn_paper
from towtank.identification.posterior.thrusters import scale_remarks, with_scale, with_thrust_scale
from towtank.recording import Recording
from towtank.simulation import manoeuvre, simulate
from towtank.vehicle import Vehicle, load_vehicle

VEHICLE = load_vehicle("vlbv300")
NAMES = ("N_rdot", "N_rr", "Z_wdot", "Z_ww", "W_minus_B")


def scaled(vehicle: Vehicle, factor: float, **more: object) -> Vehicle:
    """The vehicle with thrusters that are believed to push so many times as hard."""
    thrusters = []
    for thruster in vehicle.thrusters:
        coefficients = tuple(factor * c for c in thruster.curve.coefficients)  # type: ignore[union-attr]
        curve = thruster.curve.model_copy(update={"coefficients": coefficients})
        thrusters.append(thruster.model_copy(update={"curve": curve}))
    return vehicle.model_copy(update={"thrusters": tuple(thrusters), **more})


@pytest.fixture(scope="module")
def run() -> Recording:
    drive = manoeuvre("yaw-square", VEHICLE, duration=12.0, dt=0.02)
    heave = manoeuvre("heave-square", VEHICLE, duration=12.0, dt=0.02)
    return simulate(VEHICLE, commands=np.vstack([drive.commands, heave.commands]), dt=0.02, sensors="perfect")


def learn(run: Recording, vehicle: Vehicle) -> LogLearning:
    return learn_paper(vehicle, [run], free=NAMES, delay=0.0, instruments=False)


def test_a_wrong_scale_goes_one_to_one_into_every_coefficient(run: Recording) -> None:
    right, wrong = learn(run, VEHICLE).estimate, learn(run, scaled(VEHICLE, 1.1)).estimate
    unsure = with_thrust_scale(right, VEHICLE.model_copy(update={"scale_std": 0.1}))
    moved = 0
    for k, name in enumerate(right.names):
        if right.identified[k]:
            moved += 1
            assert wrong[name].value - right[name].value == pytest.approx(
                0.1 * growth(right[name].value, name), rel=2e-3, abs=2e-3
            )
            assert unsure.std[k] ** 2 - right.std[k] ** 2 == pytest.approx(
                (wrong[name].value - right[name].value) ** 2, rel=5e-3, abs=1e-4
            )
    assert moved >= 4
    for total in unsure.sums:
        assert total.std == pytest.approx(0.1 * total.value, rel=1e-2)


def growth(value: float, name: str) -> float:
    rigid = {"N_rdot": VEHICLE.rigid_body_matrix[5, 5], "Z_wdot": VEHICLE.rigid_body_matrix[2, 2]}
    return value - float(rigid.get(name, 0.0))


def test_the_covariance_knows_that_all_err_together(run: Recording) -> None:
    estimate = with_thrust_scale(learn(run, VEHICLE).estimate, VEHICLE.model_copy(update={"scale_std": 0.2}))
    at = [k for k, name in enumerate(estimate.names) if name in ("N_rdot", "N_rr", "Z_ww")]
    block = estimate.covariance[np.ix_(at, at)]
    size = np.sqrt(np.diag(block))
    assert np.abs(block / np.outer(size, size)).min() > 0.99
    assert estimate.std[at] == pytest.approx(size)


def test_nothing_changes_where_the_file_gives_none_or_the_wrench_was_recorded(run: Recording) -> None:
    found = learn(run, VEHICLE)
    assert with_thrust_scale(found.estimate, VEHICLE) is found.estimate
    assert with_thrust_scale(found.estimate, VEHICLE.model_copy(update={"scale_std": 0.0})) is found.estimate
    unsure = VEHICLE.model_copy(update={"scale_std": 0.1})
    wrench = manoeuvre("yaw-square", VEHICLE, duration=10.0, dt=0.02).wrench
    recorded = simulate(VEHICLE, wrench=wrench, dt=0.02, sensors="perfect")
    by_wrench = learn(recorded, unsure)
    assert with_scale(by_wrench) is by_wrench


def test_the_model_bears_the_deviation(run: Recording) -> None:
    unsure = VEHICLE.model_copy(update={"scale_std": 0.1})
    found = with_scale(learn(run, unsure))
    for name in ("N_rr", "Z_wdot"):
        assert found.model.deviation(name) == pytest.approx(found.estimate[name].std)
    assert found.model.deviation("N_rr") == pytest.approx(-0.1 * found.model.coefficient("N_rr"), rel=0.02)
    assert found.model.scale_std == 0.1
    assert found.warnings == learn(run, unsure).warnings


def with_curve(**curve: object) -> Vehicle:
    thrusters = tuple(
        {"name": t.name, "position": t.position, "direction": t.direction, "curve": curve} for t in VEHICLE.thrusters
    )
    return VEHICLE.model_copy(update={"thrusters": thrusters})


@pytest.mark.parametrize(
    "curve",
    [
        {"kind": "quadratic", "forward": 1.0},
        {"kind": "polynomial", "coefficients": (0.0, 1.0)},
        {"kind": "polynomial", "coefficients": (0.0, 0.0, 1.0), "scale": 400.0, "neutral": 1500.0},
        {"kind": "table", "command": (1100.0, 1500.0, 1900.0), "force": (-0.8, 0.0, 1.0)},
    ],
    ids=["quadratic", "linear", "scaled", "table"],
)
def test_curves_of_unit_scale_leave_ratios_only(curve: dict[str, object]) -> None:
    [remark] = scale_remarks(with_curve(**curve))
    assert "only ratios of the coefficients are known" in remark
    assert "bollard pull" in remark
    assert scale_remarks(with_curve(**curve, source="bench test of May")) == ()
    assert scale_remarks(with_curve(**curve).model_copy(update={"scale_std": 0.05})) == ()


def test_measured_curves_leave_nothing_to_remark() -> None:
    assert scale_remarks(VEHICLE) == ()
    assert scale_remarks(VEHICLE.model_copy(update={"thrusters": ()})) == ()
    assert scale_remarks(with_curve(kind="quadratic", forward=0.0002)) == ()


def test_gains_of_all_thrusters_leave_ratios_only() -> None:
    gains = [f"gain_{thruster.name}" for thruster in VEHICLE.thrusters]
    assert scale_remarks(VEHICLE, gains[1:]) == ()
    [remark] = scale_remarks(VEHICLE, ["X_udot", *gains])
    assert "the gain of every thruster is free" in remark
