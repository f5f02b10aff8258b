"""What nobody measures and nobody was told: how stiff a vehicle is that only gyros see swing."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from towtank.identification.data.samples import samples_of
from towtank.identification.logs import learn_recordings
from towtank.identification.offline.joint import LearningRequest, joint_problem

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks" / "studies"))

from swing_study import CASES, driven, hull, told


def test_gyros_alone_tell_the_stiffness_of_what_nobody_pushes() -> None:
    """Roll swings once a second. From the prior's mean, once in 3 s, passes end at an inertia 9 deviations off."""
    truth = hull(CASES["stiff"])
    found = learn_recordings(told(truth), [driven(truth, 1, seconds=40.0)], free_runs=False).estimate
    for name in ("K_pdot", "BG_z"):
        assert found[name].identified
        assert abs(found[name].value - truth.coefficient(name)) < 4.0 * found[name].std
    assert sum(each.identified for each in found.coefficients) > 30


def test_passes_begin_stiff_too_where_nothing_shows_how_the_vehicle_leans_and_nobody_said_how_stiff_it_is() -> None:
    truth = hull(CASES["stiff"])
    seen = driven(truth, 1, seconds=5.0)

    def stiff(vehicle_is_told: bool, attitude: bool) -> np.ndarray | None:
        vehicle = truth if vehicle_is_told else told(truth)
        samples = samples_of(seen, vehicle)
        if attitude:
            samples.values[::4, 3:6] = 0.0
        return joint_problem(LearningRequest(vehicle, [seen], [samples])).stiff

    begun, problem = stiff(False, False), joint_problem(LearningRequest(told(truth), [seen]))
    assert begun is not None
    moved = (begun - problem.prior.mean) / problem.prior.std
    assert dict(zip(problem.prior.names, moved, strict=True)) == {
        name: 1.0 if name == "BG_z" else 0.0 for name in problem.prior.names
    }
    assert stiff(True, False) is None
    assert stiff(False, True) is None
