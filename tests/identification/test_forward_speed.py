"""Forward-speed terms are learned: a torpedo's yaw, who learns them, and what is said of them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.identification import Learner, LogLearning, learn_recordings
from towtank.identification.changes.hypotheses import hypotheses
from towtank.identification.model.parameters import free_parameters
from towtank.identification.model.prior import prior_of
from towtank.identification.model.terms import TERMS
from towtank.identification.posterior.wording import phrase, role
from towtank.simulation import simulate
from towtank.vehicle import FORWARD_SPEED
from towtank.vehicle.names import KINDS

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from torpedo_study import FINS, LEAST_FIT, LIFT, finned, known, learned, torpedo, zigzag, zigzags


def test_the_yaw_of_a_torpedo_is_predicted_whether_the_file_has_them_or_not() -> None:
    """They are plausible of a vehicle that goes ahead."""
    for case in ("with", "without"):
        assert learned(case, "joint", seed=1, duration=60.0).fit[0] >= LEAST_FIT


def test_they_are_free_where_the_file_has_them() -> None:
    truth = torpedo()
    half = known(truth, 0.5)
    assert {*LIFT, "Z_uw", "M_uq"} <= set(prior_of(half).names)
    assert set(LIFT) <= set(prior_of(finned(known(truth, 0.0))).names)
    assert not set(LIFT) & set(prior_of(known(truth, 0.0)).names)


def test_what_is_known_of_them_beforehand_is_the_file_s_value_and_deviation() -> None:
    truth = torpedo()
    half, nothing = prior_of(known(truth, 0.5)), prior_of(finned(known(truth, 0.0)))
    for name, size in zip(LIFT, FINS, strict=True):
        k, j = half.names.index(name), nothing.names.index(name)
        assert half.mean[k] == 0.5 * truth.coefficient(name)
        assert half.std[k] == pytest.approx(0.25 * abs(truth.coefficient(name)))
        assert nothing.mean[j] == 0.0
        assert nothing.std[j] == pytest.approx(size)


def test_the_papers_method_names_those_that_can_learn_them() -> None:
    truth = torpedo()
    run = zigzags(truth, 1, 10.0)
    for refused in (
        lambda: learn_recordings(truth, [run], method="paper", free=("N_r", "N_uv")),
        lambda: Learner(truth, "paper", free=("N_uv",)),
    ):
        with pytest.raises(InputError, match="methods joint and output-error learn them"):
            refused()


def test_the_papers_method_takes_them_as_known() -> None:
    truth = torpedo()
    run = simulate(truth, commands=zigzag(60.0, 3), dt=0.02, nu0=(1.0, 0, 0, 0, 0, 0))
    names = ("Y_vdot", "Y_vv", "Y_v", "N_rdot", "N_r", "N_rr")
    right = learn_recordings(known(truth, 1.0), [run], method="paper", free=names, delay=0.05)
    plain = learn_recordings(known(truth, 0.0), [run], method="paper", free=names, delay=0.05)

    def off(name: str, learning: LogLearning) -> float:
        total = truth.rigid_body_matrix[int(role(name).row), int(role(name).row)]
        return abs((learning.model.coefficient(name) - truth.coefficient(name)) / (total - truth.coefficient(name)))

    for name in ("Y_vdot", "N_rdot"):
        assert off(name, right) < 0.03
        assert off(name, plain) > 3.0 * off(name, right)


def test_every_kind_of_coefficient_has_its_row() -> None:
    assert set(TERMS) == {kind.code for kind in KINDS.values()}
    assert phrase("N_uv") == "the forward-speed term N_uv"
    assert phrase("N_v") == "the coupling N_v"


def test_a_change_of_drag_changes_them_too() -> None:
    truth = torpedo()
    free = free_parameters(truth, ("N_rr", "N_uv", "N_rdot"))
    drag = next(each for each in hypotheses(free, np.ones(3)) if each.parts == ("drag",))
    assert np.array_equal(drag.steps > 0.0, [True, True, False])
    forward = free_parameters(truth, FORWARD_SPEED)
    assert [each.parts for each in hypotheses(forward, np.ones(len(forward)))] == [("drag",)]
