"""Which way round commanded forces act: thrusters on the wrong side, a recorded wrench with the wrong sign."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.identification import learn_recordings
from towtank.identification.data.samples import samples_of
from towtank.identification.offline import wiring
from towtank.identification.offline.wiring import wiring_of
from towtank.recording import Recording
from towtank.simulation import Mocap, OrnsteinUhlenbeck, simulate
from towtank.vehicle import Thruster, Vehicle, configuration_matrix
from towtank.vehicle.thrusters.wiring import Wiring, rewired

from .runs import TRUTH, box, unknown, waves

SURGE, SWAY = 0, 1


def craft() -> Vehicle:
    """Two thrusters astern, left and right of the middle."""
    curve = {"kind": "polynomial", "coefficients": (40.0,), "limits": (-1.0, 1.0)}
    thrusters = tuple(
        Thruster(name=name, position=(-0.4, y, 0.0), direction=(1.0, 0.0, 0.0), curve=curve)
        for name, y in (("left", -0.3), ("right", 0.3))
    )
    return box().model_copy(update={"thrusters": thrusters})


def spins(seconds: float, seed: int = 0) -> Recording:
    """A run of `craft` with square waves of different periods on both thrusters."""
    t = np.arange(round(100 * seconds)) * 0.01
    commands = 0.5 * np.column_stack([np.sign(np.sin(1.1 * t)), np.sign(np.sin(0.7 * t + 1.0))])
    force = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05))
    return simulate(craft(), commands=commands, dt=0.01, sensors=Mocap(), disturbance=force, seed=seed)


def inertia(vehicle: Vehicle) -> np.ndarray:
    return np.diag(vehicle.mass_matrix)


@pytest.mark.parametrize("change", [Wiring((0,)), Wiring((1,)), Wiring((0, 1)), Wiring((), (0, 1))], ids=str)
def test_what_is_turned_or_swapped_is_found_as_it_is(change: Wiring) -> None:
    vehicle, run = craft(), spins(40.0)
    assert not wiring_of([samples_of(run, vehicle)], inertia(vehicle))
    supposed = rewired(vehicle, change)
    found = wiring_of([samples_of(run, supposed)], 1.3 * inertia(vehicle))
    assert found.matrix(configuration_matrix(supposed)) == pytest.approx(configuration_matrix(vehicle), abs=1e-9)
    assert [t.name for t in supposed.thrusters] == [t.name for t in vehicle.thrusters]


def test_it_is_told_by_number_and_name() -> None:
    assert Wiring((0,)).said(craft()) == "thruster 1 (left) pushes the other way than the file says"
    said = Wiring((0, 1), (0, 1)).said(craft())
    assert said == (
        "the outputs of thrusters 1 (left) and 2 (right) are swapped, and thrusters 1 (left) and 2 (right) push the "
        "other way than the file says"
    )


def test_learning_goes_on_with_the_thrusters_where_they_are() -> None:
    vehicle, run = craft(), spins(40.0)
    swapped = rewired(vehicle, Wiring((), (0, 1)))
    learning = learn_recordings(swapped, [run], free=("N_rdot", "N_rr", "X_uu"), delay=0.0)
    [finding] = learning.findings
    assert finding.what == "thrusters"
    assert finding.text.startswith("the outputs of thrusters 1 (left) and 2 (right) are swapped")
    assert configuration_matrix(learning.model) == pytest.approx(configuration_matrix(vehicle), abs=1e-9)
    assert 1.5 - learning.estimate["N_rdot"].value == pytest.approx(2.3, rel=0.05)


def test_nothing_is_said_where_all_is_right() -> None:
    learning = learn_recordings(craft(), [spins(20.0, 1)], free=("N_rdot", "N_rr"), delay=0.0)
    assert learning.findings == ()
    assert learning.driven == (True, False, False, False, False, True)


@pytest.mark.parametrize("axis", range(6))
def test_every_axis_of_a_recorded_wrench(axis: int) -> None:
    amplitude = 25.0 if axis < 3 else 1.0
    # at one frequency alone a righting moment and a reversed sign look alike
    wrench = waves(4000, 0.01, (axis, amplitude, 0.7), (axis, 0.8 * amplitude, 3.1), (axis, amplitude, 1.7))
    samples = samples_of(simulate(box(), wrench=wrench, sensors=Mocap()), box())
    assert not wiring_of([samples], inertia(box()))
    samples.input_force[:, axis] *= -1.0
    assert wiring_of([samples], inertia(box())) == Wiring((axis,))


def test_depth_tells_of_surge_where_the_vehicle_pitches() -> None:
    body = box(buoyancy={"centre": (0.0, 0.0, -0.05)})
    wrench = waves(9000, 0.01, (SURGE, 9.0, 0.7), (SURGE, 8.0, 2.1), (SURGE, 6.0, 0.3), square=True)
    wrench += waves(9000, 0.01, (2, 6.0, 1.3), (4, 3.0, 0.1))
    run = simulate(body, wrench=wrench, sensors=Mocap())
    assert 0.5 < np.abs(run["theta"].values).max() < 1.0
    samples = samples_of(Recording({name: run[name] for name in ("z", "phi", "theta", *"XYZKMN")}), body)
    assert not wiring_of([samples], inertia(body), [2])
    samples.input_force[:, [SURGE, 2]] *= -1.0
    assert wiring_of([samples], inertia(body), [2]) == Wiring((SURGE, 2))


@pytest.mark.parametrize("axis", range(3))
def test_specific_force_is_what_a_turning_frame_makes_of_the_speeds(axis: int) -> None:
    t = wiring.STEP * np.arange(201)
    s, rate = np.sin(0.2 * t), 0.2 * np.cos(0.2 * (t[1:] + t[:-1]) / 2.0)
    middle, gains, omega = 0.5 * (s[1:] + s[:-1]), np.array([0.7, -1.1, 0.4]), np.array([0.3, -0.2, 0.9])
    turn = np.cross(omega, np.eye(3)).T[axis]  # omega x v is this matrix times v
    seen = wiring._seen(s[None, :, None], np.broadcast_to(turn, (1, 200, 3)), axis, wiring._FORCE)[0] @ gains
    expected = gains[axis] * rate + np.cross(omega, gains)[axis] * middle
    assert seen == pytest.approx(expected, abs=1e-5)


def test_a_wrench_of_the_wrong_sign_is_reported_with_what_to_do() -> None:
    run = simulate(box(), wrench=waves(3000, 0.01, (SWAY, 25.0, 0.9), square=True), sensors=Mocap())
    turned = type(run["Y"])("Y", run["Y"].t, -run["Y"].values, run["Y"].unit, run["Y"].frame)
    learning = learn_recordings(unknown(box(), **TRUTH), [run.replace([turned])], method="paper", delay=0.0)
    assert "sway force acts with the opposite sign" in learning.findings[0].text
    assert "mapping" in learning.findings[0].text


def test_short_and_empty_recordings_say_nothing() -> None:
    assert not wiring_of([samples_of(spins(0.5), craft())], inertia(craft()))
    assert not wiring_of([], inertia(craft()))
    still = simulate(box(), wrench=np.zeros((500, 6)), sensors=Mocap())
    assert not wiring_of([samples_of(still, box())], inertia(box()))
