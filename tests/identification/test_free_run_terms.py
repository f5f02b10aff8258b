"""What free runs try beyond the first model: which terms, in which order, and thrusters that are not what they say."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from towtank.identification import LogLearning, learn_recordings
from towtank.identification.data.samples import samples_of
from towtank.identification.model.parameters import free_parameters
from towtank.identification.offline.free_runs import TermGroups, groups_of_terms, prior_with_terms
from towtank.recording import Recording
from towtank.simulation import Ins, simulate
from towtank.vehicle import Vehicle

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from tumbling import INERTIAS, TURNING, named, true_vehicle, tumble


def learn(vehicle: Vehicle, *, seed: int) -> LogLearning:
    return learn_recordings(named(), [tumble(vehicle, seed=seed)])


def test_thrusters_that_give_less_than_their_curves_say_are_found() -> None:
    """Both at once leave the yaw that they cause as it is: only the gyroscopic coupling of the axes betrays them."""
    learning = learn(true_vehicle(f3=0.6, f4=0.6), seed=1)
    assert set(learning.gains) == {"f3", "f4"}
    for gain, std in learning.gains.values():
        assert abs(gain - 0.6) < 3.0 * std < 0.15
    assert [each.gain for each in learning.model.thrusters][2:4] == [learning.gains[name][0] for name in ("f3", "f4")]
    for name in INERTIAS:
        assert learning.model.coefficient(name) == pytest.approx(TURNING[name], rel=0.1)
    assert any("gain_f3" in text for text in learning.remarks)


def test_thrusters_that_give_what_they_say_are_left_alone() -> None:
    learning = learn(true_vehicle(), seed=1)
    assert not learning.gains
    assert [each.gain for each in learning.model.thrusters] == [1.0] * 6


def tried(vehicle: Vehicle, run: Recording, names: tuple[str, ...], *, find_lag: bool = True) -> TermGroups:
    return groups_of_terms(vehicle, names, [samples_of(run, vehicle)], find_lag=find_lag)


def test_gains_are_tried_of_thrusters_that_act_on_the_modelled_axes() -> None:
    run = tumble(named(), seed=0, seconds=4.0)
    turning = tried(named(), run, INERTIAS)
    assert turning.gains == ("gain_f1", "gain_f2", "gain_f3", "gain_f4", "gain_f5")  # f6 pushes to the side only
    assert turning.lag == ("lag",)
    assert tried(named(), run, ("N_rdot",)).gains == ()  # two turn it, of which neither can be told from the other


def test_without_commands_there_are_no_gains_to_try() -> None:
    run = simulate(named(), wrench=np.tile([10.0, 0.0, 0.0, 0.0, 0.0, 1.0], (400, 1)), dt=0.01, sensors=Ins())
    groups = tried(named(), run, INERTIAS, find_lag=False)
    assert not any(name.startswith("gain_") for group in groups for name in group)


def stopped(run: Recording, *thrusters: str) -> Recording:
    """The run as if some thrusters had been told to rest."""
    names = [f"cmd_{each}" for each in thrusters]
    return run.replace(replace(run[name], values=np.full(len(run[name]), 1500.0)) for name in names)


def test_a_thruster_that_was_not_driven_is_not_compared() -> None:
    run = tumble(named(), seed=0, seconds=4.0)
    assert tried(named(), stopped(run, "f1", "f2"), INERTIAS).gains == ("gain_f3", "gain_f4", "gain_f5")
    assert tried(named(), stopped(run, "f1", "f2", "f5"), INERTIAS).gains == ()


def test_what_is_known_of_a_gain_beforehand_stays_known_when_more_terms_are_tried() -> None:
    first = free_parameters(named(), INERTIAS)
    known = prior_with_terms(named(), first, lambda free: None)
    for names in ((*INERTIAS, "gain_f3"), (*INERTIAS, "gain_f3", "lag", "M_p")):
        free = free_parameters(named(), names)
        mean, information = known(free)
        k = free.names.index("gain_f3")
        assert information[k, k] == pytest.approx(0.3**-2)
        assert mean[k] == 0.0


def test_a_prior_brings_the_gains_that_its_coefficients_were_learned_with() -> None:
    run = tumble(named(), seed=0, seconds=10.0)
    learning = learn_recordings(named(), [run], prior=true_vehicle(f3=0.6, f4=0.7), free=INERTIAS)
    assert [each.gain for each in learning.model.thrusters] == [1.0, 1.0, 0.6, 0.7, 1.0, 1.0]
    assert any("taken from the prior" in text and "f3 0.6, f4 0.7" in text for text in learning.warnings)
    assert not any("taken from the prior" in text for text in learn_recordings(named(), [run], free=INERTIAS).warnings)
