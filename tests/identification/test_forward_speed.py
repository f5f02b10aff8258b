"""Forward-speed terms are learned: a torpedo's yaw, who learns them, and what is said of them."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.identification import Learner, LogLearning, learn_recordings
from towtank.identification.changes.hypotheses import hypotheses, steps_of
from towtank.identification.kalman.state import coefficient_block
from towtank.identification.model.belief import belief
from towtank.identification.model.terms import TERMS
from towtank.identification.posterior.wording import phrase, role
from towtank.simulation import simulate
from towtank.vehicle import FORWARD_SPEED
from towtank.vehicle.names import KINDS

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from torpedo_study import LEAST_FIT, LIFT, known, learned, torpedo, zigzag, zigzags


def test_the_yaw_of_a_torpedo_is_predicted_with_them_and_not_without() -> None:
    with_them, without = (learned(case, "joint", seed=1, duration=120.0) for case in ("with", "without"))
    assert with_them.fit[0] >= LEAST_FIT
    assert without.fit[0] < LEAST_FIT - 20.0
    assert max(abs(off) for off in with_them.errors) < 15.0  # percent


def test_they_are_unknowns_where_the_file_has_them() -> None:
    truth = torpedo()
    names = belief(known(truth, 0.5)).names
    assert {*LIFT, "Z_uw", "Z_uq", "M_uw", "M_uq"} <= set(names)
    assert not set(FORWARD_SPEED) & set(belief(truth.model_copy(update={"hydrodynamics": {}})).names)


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


def test_a_change_of_drag_changes_them_too_where_they_are_identified() -> None:
    learner = Learner(torpedo(), free=("N_rr", "N_uv", "N_rdot"), changes=False)
    learner.run(zigzags(torpedo(), 1, 10.0))
    running = learner._stream.running  # type: ignore[attr-defined]
    for share, changes in ((0.2, True), (0.8, False)):
        coefficient_block(running.state)[:] = np.diag((share * running.prior.reference) ** 2)
        running = running._replace(disagreement=np.ones(len(running.free)))
        steps = steps_of(torpedo(), running, running.prior)
        parts = {each.parts for each in hypotheses(running.free, steps)}
        assert np.all((steps[[name != "delay" for name in running.free.names]] > 0.0) == changes)
        assert parts == ({("inertia",), ("drag",), ("inertia", "drag")} if changes else set())


def test_a_centre_of_gravity_may_shift() -> None:
    truth = torpedo()
    wide = belief(truth).only(("BG_x", "BG_y", "BG_z", "N_rr"))
    shift = next(each for each in hypotheses(wide.free, np.ones(4)) if each.parts == ("trim",))
    assert {name for name, step in zip(wide.names, shift.steps, strict=True) if step} == {"BG_x", "BG_y"}
