"""Which way round commanded forces act: thrusters on the wrong side, a recorded wrench with the wrong sign."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from wiring_study import case

from towtank.identification import learn_recordings
from towtank.identification.data.samples import Samples, samples_of
from towtank.identification.kalman.problem import JointFit, JointProblem
from towtank.identification.offline import wiring
from towtank.identification.offline.axis_responses import axis_responses
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.identification.offline.wiring import wiring_of
from towtank.recording import Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, simulate
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
    t = np.arange(round(50 * seconds)) * 0.02
    commands = 0.5 * np.column_stack([np.sign(np.sin(1.1 * t)), np.sign(np.sin(0.7 * t + 1.0))])
    force = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05))
    return simulate(craft(), commands=commands, dt=0.02, sensors=Mocap(rate=50.0), disturbance=force, seed=seed)


def found_in(run: Recording, supposed: Vehicle) -> Wiring:
    return of_samples(run, samples_of(run, supposed), supposed)


def of_samples(run: Recording, samples: Samples, supposed: Vehicle) -> Wiring:
    return wiring_of(joint_problem(LearningRequest(supposed, [run], [samples])))


@pytest.mark.parametrize("change", [Wiring((0,)), Wiring((1,)), Wiring((0, 1)), Wiring((), (0, 1))], ids=str)
def test_what_is_turned_or_swapped_is_found_as_it_is(change: Wiring) -> None:
    vehicle, run = craft(), spins(40.0)
    assert not found_in(run, unknown(vehicle))
    supposed = unknown(rewired(vehicle, change))
    found = found_in(run, supposed)
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
    wrench = waves(2000, 0.02, (axis, amplitude, 0.7), (axis, 0.8 * amplitude, 3.1), (axis, amplitude, 1.7))
    run = simulate(box(), wrench=wrench, dt=0.02, sensors=Mocap(rate=50.0))
    samples = samples_of(run, box())
    assert not of_samples(run, samples, unknown(box()))
    samples.input_force[:, axis] *= -1.0
    assert of_samples(run, samples, unknown(box())) == Wiring((axis,))


def test_depth_tells_of_surge_where_the_vehicle_pitches() -> None:
    body = box(buoyancy={"centre": (0.0, 0.0, -0.05)})
    wrench = waves(12000, 0.01, (SURGE, 9.0, 0.7), (SURGE, 8.0, 2.1), (SURGE, 6.0, 0.3), square=True)
    wrench += waves(12000, 0.01, (2, 6.0, 1.3), (4, 1.5, 0.1), (4, 3.0, 2.6))
    run = simulate(body, wrench=wrench, sensors=Ins())
    assert 0.5 < np.abs(run["theta"].values).max() < 1.0
    samples = samples_of(Recording({name: run[name] for name in ("z", "phi", "theta", "p", "q", "r", *"XYZKMN")}), body)
    assert not of_samples(run, samples, unknown(body))
    samples.input_force[:, [SURGE, 2]] *= -1.0
    assert of_samples(run, samples, unknown(body)) == Wiring((SURGE, 2))


def test_occlusions_leave_windows_between_them() -> None:
    vehicle, run = craft(), spins(60.0)
    whole = samples_of(run, vehicle)
    hidden = np.any([np.abs(whole.t - t) < 0.4 for t in (9.0, 21.0, 33.0, 48.0)], axis=0)
    whole.values[hidden] = np.nan
    assert {0, 5} <= {each.axis for each in axis_responses([whole])}
    assert not of_samples(run, whole, unknown(vehicle))


@pytest.mark.parametrize("late", [0.0, 0.2])
def test_the_gains_of_a_linear_axis_are_found(late: float) -> None:
    """v' = -v / T + g F(t - d), solved exactly from one change of the held force to the next."""
    rng = np.random.default_rng(3)
    time, gain, dt = 1.6, np.array([0.05, -0.03]), 0.1
    force = np.repeat(rng.uniform(-20.0, 20.0, (60, 2)), 10, axis=0)
    delayed = np.roll(force, round(late / dt), axis=0)
    delayed[: round(late / dt)] = 0.0
    speed = np.zeros(601)
    for k in range(600):
        speed[k + 1] = np.exp(-dt / time) * speed[k] + (1.0 - np.exp(-dt / time)) * time * gain @ delayed[k]
    t = dt * np.arange(601)
    values = np.full((601, 18), np.nan)
    values[:, 6] = speed
    B = np.zeros((6, 2))
    B[0] = 1.0
    samples = Samples(t, values, t[:-1], force, B, np.zeros(2), commands=True)
    [found] = axis_responses([samples])
    assert found.axis == SURGE
    assert found.gains[0] == pytest.approx(gain, rel=1e-6)


def test_a_wrench_of_the_wrong_sign_is_reported_with_what_to_do() -> None:
    run = simulate(box(), wrench=waves(3000, 0.01, (SWAY, 25.0, 0.9), square=True), sensors=Mocap())
    turned = type(run["Y"])("Y", run["Y"].t, -run["Y"].values, run["Y"].unit, run["Y"].frame)
    learning = learn_recordings(unknown(box(), **TRUTH), [run.replace([turned])], method="paper", delay=0.0)
    assert "sway force acts with the opposite sign" in learning.findings[0].text
    assert "mapping" in learning.findings[0].text


def test_short_and_empty_recordings_say_nothing() -> None:
    assert not found_in(spins(0.5), craft())
    still = simulate(box(), wrench=np.zeros((500, 6)), sensors=Mocap())
    assert not found_in(still, box())


@pytest.mark.parametrize("turned", [False, True])
def test_what_the_judges_find_stays_only_where_what_is_learned_is_likelier_with_it(
    turned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A flat vehicle of 7 kg, 7 times as heavy in heave, was taken for one of which two thrusters push the other way:
    about what is supposed, the filter followed best what did not push at all."""
    vehicle, run = craft(), spins(20.0)

    def fooled(ways: list[Wiring], *others: object) -> np.ndarray:
        return np.array([1000.0 * (way == Wiring((0,))) for way in ways])

    monkeypatch.setattr(wiring, "likelihood_of", fooled)
    supposed = unknown(rewired(vehicle, Wiring((0,)))) if turned else unknown(vehicle)
    assert bool(found_in(run, supposed)) == turned


@pytest.fixture
def wrong(monkeypatch: pytest.MonkeyPatch) -> Wiring:
    """A way of wiring for which both judges speak by less than it costs."""
    way = Wiring((0,))

    def unsure(ways: list[Wiring], *others: object) -> np.ndarray:
        return np.array([{Wiring(): 0.0, way: 2.0}.get(each, -1000.0) for each in ways])

    monkeypatch.setattr(wiring, "likelihood_of", unsure)
    monkeypatch.setattr(wiring._Look, "_told", lambda look, ways, k: np.zeros(len(ways)))
    return way


def test_what_the_judges_leave_open_is_decided_by_what_is_learned(wrong: Wiring) -> None:
    """Data speak for another wiring by less than it costs: what it does to a vehicle that is not known may be small."""
    vehicle, run = craft(), spins(20.0)
    assert found_in(run, unknown(rewired(vehicle, wrong)))
    assert not found_in(run, unknown(vehicle))


def test_where_both_judges_find_another_surely_likelier_they_decide(monkeypatch: pytest.MonkeyPatch) -> None:
    """At sea other optima of the same fit are further apart than wirings: what is learned is not asked then."""
    vehicle, run, wrong = craft(), spins(40.0), Wiring((0,))
    asked: list[Wiring] = []
    monkeypatch.setattr(wiring._Look, "choice", lambda look, cost, judged: asked.append(judged) or judged)
    assert found_in(run, unknown(rewired(vehicle, wrong))) == wrong
    assert not asked


@pytest.mark.parametrize("looked_at", [1, 40])
def test_that_another_is_likelier_counts_only_beyond_what_it_costs(
    looked_at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Keeping station, commands answer what pushes: of all ways to swap two outputs and turn some thrusters one fits
    that by chance, and was so far ahead of the file, for as large a cost, that the filter was not asked; nor must it
    be left out where many are ahead of it."""
    dear, asked = Wiring((0,), (0, 1)), list[Wiring]()
    monkeypatch.setattr(wiring, "_LOOKED_AT", looked_at)
    monkeypatch.setattr(wiring, "_SWAP", 30.0)
    monkeypatch.setattr(wiring, "likelihood_of", lambda ways, *others: np.array([60.0 * (w == dear) for w in ways]))
    monkeypatch.setattr(wiring._Look, "_told", lambda look, ways, k: np.array([-5.0 * bool(w) for w in ways]))
    monkeypatch.setattr(wiring._Look, "choice", lambda look, cost, judged: asked.append(judged) or Wiring())
    assert not found_in(spins(20.0), unknown(craft()))
    assert asked == [Wiring()]


@pytest.mark.parametrize("linear", [Wiring((0,)), Wiring((1,))], ids=str)
def test_of_two_ways_that_the_judges_find_likeliest_the_one_is_taken_that_is_likelier_learned_with(
    linear: Wiring, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At sea the filter, about where the wrong wiring had come to, took two turned thrusters for swapped ones."""
    right, other = Wiring((0,)), Wiring((1,))
    at_once = {right: other, other: right}[linear]  # what the filter finds likeliest

    def by_responses(ways: list[Wiring], *others: object) -> np.ndarray:
        return np.array([{linear: 30.0, at_once: 25.0, Wiring(): 0.0}.get(each, -1000.0) for each in ways])

    def by_filter(look: object, ways: list[Wiring], k: int) -> np.ndarray:
        return np.array([{linear: -20.0, at_once: 0.0}.get(each, -1000.0) for each in ways])

    monkeypatch.setattr(wiring, "likelihood_of", by_responses)
    monkeypatch.setattr(wiring._Look, "_told", by_filter)
    monkeypatch.setattr(wiring._Look, "choice", None)  # the file's wiring is far behind: it is not asked
    assert found_in(spins(20.0), unknown(rewired(craft(), right))) == right


def farther_without(run: Recording, passes: Callable[..., JointFit]) -> Callable[..., JointFit]:
    """Passes that are far likelier with any other wiring than that of the file which is looked at."""

    def come(problem: JointProblem, *others: object, **settings: object) -> JointFit:
        own = samples_of(run, problem.vehicle).B
        fit = passes(problem, *others, **settings)
        return replace(fit, likelihood=fit.likelihood + 1e6 * (not np.allclose(problem.samples[0].B, own)))

    return come


def test_what_is_likelier_by_chance_takes_no_place(wrong: Wiring, monkeypatch: pytest.MonkeyPatch) -> None:
    """Passes come farther with one way than with another, as at sea: learned as a log is, the file's is likelier."""
    vehicle, run = craft(), spins(20.0)
    for name in ("first_passes", "settled"):
        monkeypatch.setattr(wiring, name, farther_without(run, getattr(wiring, name)))
    assert not found_in(run, unknown(vehicle))
    assert found_in(run, unknown(rewired(vehicle, wrong)))


def test_the_filter_looks_where_passes_have_come_to() -> None:
    """About the prior's mean this log tells too little of its swap to be learned with it."""
    found = case("VECTORED_6DOF", Wiring((), (5, 7)), 2035)
    assert found.said
    assert found.right


def test_wirings_that_make_the_same_of_all_inputs_are_looked_at_once() -> None:
    """Ahead alone, two thrusters beside each other may be swapped, or not; turning one of them is seen as it is."""
    B = np.array([[1.0, 1.0], [0.3, -0.3]])
    ways = [Wiring(), Wiring((), (0, 1)), Wiring((0,)), Wiring((1,)), Wiring((0, 1)), Wiring((0, 1), (0, 1))]
    pushes = np.sin(np.arange(50.0))
    ahead = np.column_stack([pushes, pushes])
    assert wiring._different(ways, range(6), B, ahead) == [0, 2, 3, 4]
    turning = np.column_stack([pushes, np.cos(np.arange(50.0))])
    assert wiring._different(ways, range(6), B, turning) == [0, 1, 2, 3, 4, 5]
    assert wiring._different(ways, [1, 0], B, ahead) == [1]  # the first of them as they come, the cheapest
