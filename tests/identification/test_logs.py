"""Learning from recordings as wholes: several, of different lengths, parts of them; and input that is odd."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.identification import PaperLearner, learn_paper
from towtank.identification.data.samples import samples_of
from towtank.identification.offline.first_look import driven_axes
from towtank.recording import Recording
from towtank.simulation import Ins, Mocap, OrnsteinUhlenbeck, simulate

from .runs import TRUTH, VELOCITY, box, errors, fly, follow, unknown, waves

TANK = OrnsteinUhlenbeck(std=(0.5, 0.5, 0.5, 0.05, 0.05, 0.05))


def run(row: tuple[int, float, float], seconds: float, seed: int = 0, **more: object) -> Recording:
    fields = {"sensors": Mocap(), "disturbance": TANK, "seed": seed, **more}
    return simulate(box(), wrench=waves(round(100 * seconds), 0.01, row, square=True), **fields)  # type: ignore[arg-type]


def test_several_recordings_of_different_lengths() -> None:
    logs = [run((0, 25.0, 1.2), 40.0), run((5, 3.0, 1.2), 15.0, 1), run((2, 30.0, 1.0), 25.0, 2)]
    learning = learn_paper(unknown(box(), **TRUTH), logs, delay=0.0)
    estimate = learning.estimate
    for name in ("X_udot", "X_uu", "Z_wdot", "Z_ww", "N_rdot", "N_rr"):
        assert estimate[name].identified
        assert abs(estimate[name].value - TRUTH[name]) < 4.0 * estimate[name].std
    assert estimate.duration == pytest.approx(80.0, abs=1.5)
    assert [len(grid) for grid in learning.grids] == [4001, 1501, 2501]
    assert estimate["X_udot"].std < 0.05 * 30.0


def test_one_recording_cut_in_two_says_about_the_same() -> None:
    log = run((0, 25.0, 1.2), 60.0)
    parts = [log], [log.window(0.0, 30.0), log.window(30.0, 60.0)]
    whole, halves = (learn_paper(box(), logs, free=("X_udot", "X_uu"), delay=0.0).estimate["X_udot"] for logs in parts)
    assert halves.value == pytest.approx(whole.value, abs=2.0 * whole.std)
    assert halves.std == pytest.approx(whole.std, rel=0.5)


def test_a_window_learns_from_that_part_alone() -> None:
    heavy = simulate(
        box(hydrodynamics={**TRUTH, "X_udot": -25.0}), wrench=waves(3000, 0.01, (0, 25.0, 1.2), square=True)
    )
    found = learn_paper(box(), [heavy.window(10.0, 20.0)], delay=0.0)
    assert found.estimate["X_udot"].value == pytest.approx(-25.0, rel=1e-4)
    assert found.estimate.duration == pytest.approx(10.0, abs=0.1)


def test_instruments_take_the_bias_of_a_slow_disturbance_away() -> None:
    strong = OrnsteinUhlenbeck(std=(2.0, 0, 0, 0, 0, 0))
    found = {True: [], False: []}  # type: ignore[var-annotated]
    for seed in range(5):
        log = run((0, 12.0, 0.6), 60.0, seed, disturbance=strong)
        for flag, values in found.items():
            values.append(learn_paper(box(), [log], delay=0.0, instruments=flag).estimate["X_udot"].value)
    assert abs(np.mean(found[True]) + 10.0) < 1.5
    assert abs(np.mean(found[True]) + 10.0) < abs(np.mean(found[False]) + 10.0) + 0.3


def test_progress_is_told_and_does_not_go_back() -> None:
    told: list[float] = []
    learn_paper(box(), [run((0, 25.0, 1.2), 10.0)], progress=lambda text, share: told.append(share))
    assert told[0] == 0.0
    assert told[-1] == 1.0
    assert told == sorted(told)


def test_recordings_and_vehicle_stay_as_they_are() -> None:
    log, vehicle = run((0, 25.0, 1.2), 10.0), box()
    kept = {name: channel.values.copy() for name, channel in log.channels.items()}
    learn_paper(vehicle, [log])
    assert vehicle == box()
    assert all(np.array_equal(log[name].values, values, equal_nan=True) for name, values in kept.items())


# -- sensors of several kinds


def test_gyros_alone_learn_yaw() -> None:
    log = run((5, 3.0, 1.2), 40.0, sensors="perfect").without(*"xyzuvw", "phi", "theta", "psi")
    assert {"p", "q", "r"} <= set(log.names)
    estimate = learn_paper(box(), [log], delay=0.0).estimate
    assert abs(estimate["N_rdot"].value + 0.8) < 4.0 * estimate["N_rdot"].std
    assert not any(c.identified for c in estimate.coefficients if c.name[0] in "XYZ")


def test_inertial_sensors_with_dvl_and_depth_learn_surge() -> None:
    log = run((0, 25.0, 0.6), 60.0, sensors=Ins())
    estimate = learn_paper(box(), [log], free=("X_udot", "X_uu"), delay=0.0).estimate
    assert estimate["X_uu"].identified
    assert estimate["X_uu"].value == pytest.approx(-30.0, rel=0.06)
    assert 20.0 - estimate["X_udot"].value == pytest.approx(30.0, rel=0.12)  # the dvl is slow


def test_a_wrench_of_fewer_components_is_taken_with_zeros_for_the_rest() -> None:
    log = run((0, 25.0, 1.2), 20.0, sensors="perfect", disturbance=None).without("Y", "Z", "K", "M", "N")
    assert learn_paper(box(), [log], delay=0.0).estimate["X_udot"].value == pytest.approx(-10.0, rel=1e-5)
    assert learn_paper(box(), [log], delay=0.0).estimate["X_udot"].identified


# -- input that is odd


def test_nothing_to_learn_from_is_refused() -> None:
    log = run((0, 25.0, 1.2), 5.0)
    with pytest.raises(InputError, match="at least one"):
        learn_paper(box(), [])
    with pytest.raises(InputError, match="nothing to learn from"):
        learn_paper(box(), [log.without(*"XYZKMN")])
    with pytest.raises(InputError, match="no motion"):
        learn_paper(box(), [log.without("x", "y", "z", "phi", "theta", "psi")])
    with pytest.raises(InputError, match="samples"):
        learn_paper(box(), [log.window(0.0, 0.02)])


@pytest.mark.parametrize(
    "settings",
    [
        {"delay": -0.1},
        {"delay": np.nan},
        {"longest_delay": -1.0},
        {"longest_delay": np.nan},
        {"a": 0.0},
        {"lowpass": -1.0},
    ],
    ids=str,
)
def test_settings_out_of_range_are_refused(settings: dict[str, float]) -> None:
    with pytest.raises(InputError, match="found"):
        learn_paper(box(), [run((0, 25.0, 1.2), 5.0)], **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "settings",
    [
        {"method": "magic"}, {"scheme": "best"}, {"inputs": "jerky"}, {"a": 0.0}, {"a": np.inf}, {"lowpass": np.nan},
        {"gap": -1.0}, {"forgetting": 0.0}, {"forgetting": 1.5}, {"delay": -0.1}, {"delay": np.nan}, {"delay": np.inf},
    ],
    ids=str,
)  # fmt: skip
def test_settings_of_a_learner_out_of_range_are_refused(settings: dict[str, object]) -> None:
    with pytest.raises(InputError, match="found"):
        PaperLearner(box(), **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize("push", [0.0, 10.0], ids=["no command", "one constant command"])
@pytest.mark.parametrize("sensors", ["perfect", Mocap()], ids=["perfect", "mocap"])
def test_commands_that_never_change(push: float, sensors: str | Mocap) -> None:
    wrench = np.zeros((1000, 6))
    wrench[:, 0] = push
    learning = learn_paper(box(), [simulate(box(), wrench=wrench, sensors=sensors)])
    for c in learning.estimate.coefficients:
        assert c.identified == (c.reason is None)
        assert np.isfinite(c.value)


SURGE = fly(box(), waves(2000, 0.01, (0, 30.0, 0.8), square=True))
TRUE = {"X_udot": -10.0, "X_uu": -30.0}


def disturbed(at: int, t: float, **sample: object) -> PaperLearner:
    """A learner of surge that meets one odd sample, after sample `at`."""
    learner = PaperLearner(unknown(box()), free=tuple(TRUE))
    for k in range(2001):
        learner.update(SURGE.t[k], pose=SURGE.pose[k], velocity=SURGE.velocity[k], wrench=SURGE.wrench[k])
        if k == at:
            learner.update(t, **sample)  # type: ignore[arg-type]
    return learner


NAN6, INF6 = np.full(6, np.nan), np.full(6, np.inf)
ODD = {
    "late": (SURGE.t[1000] - 0.3, {"pose": SURGE.pose[0], "velocity": SURGE.velocity[0], "wrench": SURGE.wrench[0]}),
    "again": (SURGE.t[1000], {"pose": SURGE.pose[0], "velocity": SURGE.velocity[0], "wrench": SURGE.wrench[1000]}),
    "no time": (np.nan, {"pose": SURGE.pose[0], "velocity": SURGE.velocity[0], "wrench": SURGE.wrench[0]}),
    "no end of time": (np.inf, {"pose": SURGE.pose[0], "velocity": SURGE.velocity[0], "wrench": SURGE.wrench[0]}),
    "nothing": (SURGE.t[1000] + 0.004, {}),
    "not measured": (SURGE.t[1000] + 0.004, {"pose": NAN6, "velocity": NAN6, "wrench": NAN6}),
    "infinite": (SURGE.t[1000] + 0.004, {"pose": INF6, "velocity": INF6, "wrench": INF6}),
}


@pytest.mark.parametrize("t, sample", ODD.values(), ids=ODD.keys())
def test_one_odd_sample_does_no_harm(t: float, sample: dict[str, object]) -> None:
    learner = disturbed(1000, t, **sample)
    assert max(errors(learner, TRUE).values()) < 1e-4
    assert learner.estimate.samples > 1990


@pytest.mark.parametrize("time", [np.nan, np.inf])
def test_a_first_sample_without_a_time_does_no_harm(time: float) -> None:
    learner = PaperLearner(unknown(box()), free=tuple(TRUE))
    learner.update(time, pose=SURGE.pose[0], velocity=SURGE.velocity[0], wrench=SURGE.wrench[700])
    assert max(errors(follow(learner, SURGE), TRUE).values()) < 1e-4


def test_a_smooth_input_that_is_missing_once_does_not_poison_the_rest() -> None:
    learner = PaperLearner(unknown(box()), free=tuple(TRUE), inputs="smooth")
    for k in range(2001):
        push = None if k == 1000 else SURGE.wrench[k]
        learner.update(SURGE.t[k], pose=SURGE.pose[k], velocity=SURGE.velocity[k], wrench=push)
    assert np.isfinite(learner.estimate["X_uu"].std)


def test_a_recording_of_smooth_inputs_whose_last_sample_has_none() -> None:
    log = simulate(
        box(), wrench=lambda t: np.stack([30 * np.sin(1.3 * t), *[0 * t] * 5], axis=-1), dt=0.01, duration=20.0
    )
    learner = PaperLearner(unknown(box()), free=tuple(TRUE), inputs="smooth")
    learner.run(log)
    assert learner.estimate["X_uu"].value == pytest.approx(-30.0, rel=0.05)


def test_smooth_inputs_pass_the_low_pass_too_where_velocity_is_derived() -> None:
    def push(t: np.ndarray) -> np.ndarray:
        return np.stack([30 * np.sin(2.5 * t), *[0 * t] * 5], axis=-1)

    log = simulate(box(), wrench=push, dt=0.01, duration=20.0)
    learner = PaperLearner(unknown(box()), free=tuple(TRUE), inputs="smooth")
    for k, t in enumerate(log["x"].t):
        pose = [log[name].values[k] for name in ("x", "y", "z", "phi", "theta", "psi")]
        learner.update(t, pose=pose, wrench=push(t))
    assert 20.0 - learner.estimate["X_udot"].value == pytest.approx(30.0, rel=0.02)


def test_wrong_shapes_name_the_argument() -> None:
    learner = PaperLearner(box())
    with pytest.raises(InputError, match=r"velocity: found shape \(3,\), expected \(6,\)"):
        learner.update(0.0, velocity=np.zeros(3))
    learner.update(0.0, velocity=np.zeros(6), wrench=np.zeros(6))
    with pytest.raises(InputError, match="wrench"):
        learner.update(0.1, velocity=np.zeros(6), wrench=np.zeros(5))


def test_a_channel_without_any_value_is_as_if_it_were_not_there() -> None:
    log = run((0, 25.0, 1.2), 10.0, sensors="perfect", disturbance=None)
    blank = log.replace([type(log["v"])("v", log["v"].t, np.full(1001, np.nan), "m/s", "FRD")])
    estimate = learn_paper(box(), [blank], delay=0.0).estimate
    assert estimate["X_udot"].value == pytest.approx(-10.0, rel=0.01)  # sway is derived, so all is low-passed
    assert set(VELOCITY) <= set(blank.names)


def test_a_log_of_which_no_input_is_known_hides_no_axis_that_another_drives() -> None:
    known = samples_of(run((0, 25.0, 1.2), 10.0), box())
    unknown_throughout = replace(known, input_force=np.full_like(known.input_force, np.nan))
    assert driven_axes([unknown_throughout, known]) == driven_axes([known]) == (True, *[False] * 5)
    assert driven_axes([unknown_throughout]) == (False,) * 6
