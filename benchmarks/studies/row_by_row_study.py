"""Streams of what the model lacks: are they as honest as logs?

    python benchmarks/studies/row_by_row_study.py [--runs 20] [--only third,1.2] [--output row_by_row.json]

The boxes of `late_study.py` (forces that act otherwise) and `smooth_study.py` (speeds that were smoothed), each learned
sample by sample. How many intervals hold at the end of 80 s, and how far off the total yaw inertia is; and what a
stream would state that looks neither for speeds without noise nor for another picture of the data.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from unittest.mock import patch

import numpy as np
from by_case import by_case
from pushed_box import CASES, FORCES, flight, true_box
from summary import Check

from towtank.identification import Learner
from towtank.identification.data.samples import N_MEASURED
from towtank.identification.online import reestimation

EVERY = {**FORCES, **{name: case for name, case in CASES.items() if name != "raw"}}
Stream = tuple[dict[str, float], float]


def learned(case: str, seed: int) -> tuple[Stream, Stream]:
    """Return what comes of a run, and what would if nobody asked."""
    asked = streamed(case, seed)
    with (
        patch.object(reestimation, "likeliest_rival", return_value=None),
        patch.object(reestimation, "noise_of_smooth_speeds", return_value=np.zeros(N_MEASURED)),
    ):
        return asked, streamed(case, seed)


def streamed(case: str, seed: int) -> Stream:
    """Return by how many deviations each identified coefficient is off, and the error of the total yaw inertia."""
    truth = true_box()
    learner = Learner(truth.model_copy(update={"hydrodynamics": {}}))
    learner.run(flight(case, seed))
    off = {
        each.name: (each.value - truth.coefficient(each.name)) / each.std
        for each in learner.estimate.coefficients
        if each.identified and each.std
    }
    own = truth.rigid_body.inertia[2]
    total = own - truth.coefficient("N_rdot")
    return off, (own - learner.estimate["N_rdot"].value) / total - 1.0


def checks(case: str, found: Sequence[tuple[Stream, Stream]]) -> list[Check]:
    """Return what must hold of one case, and figures beside it."""
    asked, alone = (np.abs([x for off, _ in side for x in off.values()]) for side in zip(*found, strict=True))
    errors = [float(np.sqrt(np.mean([error**2 for _, error in side]))) for side in zip(*found, strict=True)]
    return [
        Check(f"{case}: intervals that hold", float(np.mean(asked < 1.96)), low=0.9),
        Check(f"{case}: beyond 4 deviations", float(np.mean(asked > 4.0)), high=0.005),
        Check(f"{case}: RMSE of the total yaw inertia", errors[0]),
        Check(f"{case}, nobody asked: intervals that hold", float(np.mean(alone < 1.96))),
        Check(f"{case}, nobody asked: beyond 4 deviations", float(np.mean(alone > 4.0))),
        Check(f"{case}, nobody asked: RMSE of the total yaw inertia", errors[1]),
    ]


def row(found: tuple[Stream, Stream]) -> dict[str, str]:
    """Return a run as its table shows it."""
    cells = {}
    for name, (off, error) in zip(("", ", nobody asked"), found, strict=True):
        far = max(off.items(), key=lambda each: abs(each[1]))
        cells[f"identified{name}"] = str(len(off))
        cells[f"furthest off{name}"] = f"{far[0]} {far[1]:+.1f}"
        cells[f"error of the yaw inertia %{name}"] = f"{100.0 * error:+.1f}"
    return cells


if __name__ == "__main__":
    sys.exit(by_case("row by row", __doc__ or "", EVERY, learned, row, checks))
