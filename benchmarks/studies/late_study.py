"""Forces that act otherwise than the model has it: a part of them late, or too much at first; water that stirs quickly.

    python benchmarks/studies/late_study.py [--runs 20] [--only third] [--output late.json]

The box of `smooth_study.py`, with rates as the gyros have them. `as recorded`: what pushes it is the wrench that is
recorded. `quick water`: a random force beside it that changes within 0.1 s. `a tenth late`, `a third late`: so much of
the force acts 0.2 s later than the rest, as of motors that reverse in two steps. `overshoots`: a third too much acts at
first, for 0.2 s. Nothing of that is in the model, nor can be: delay and lag are those of a recorded wrench, none. How
many intervals hold all the same, and how far off the total yaw inertia is; and what would be stated if nobody asked
whether another picture of the data is likelier (`identification.kalman.rivals`).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from unittest.mock import patch

import numpy as np
import smooth_study
from by_case import by_case
from pushed_box import FORCES
from summary import Check

from towtank.identification.offline import joint

Found = tuple[smooth_study.Found, smooth_study.Found]


def learned(case: str, seed: int) -> Found:
    """Return what comes of a run, and what would if nobody asked for another picture."""
    asked = smooth_study.learned(case, seed)
    with patch.object(joint, "likeliest_rival", return_value=None):
        return asked, smooth_study.learned(case, seed)


def checks(case: str, found: Sequence[Found]) -> list[Check]:
    """Return what must hold of one case, and figures beside it."""
    off = np.abs([each for _, (alone, _, _) in found for each in alone.values()])
    return [
        *smooth_study.checks(case, [asked for asked, _ in found]),
        Check(f"{case}, nobody asked: intervals that hold", float(np.mean(off < 1.96))),
        Check(f"{case}, nobody asked: beyond 4 deviations", float(np.mean(off > 4.0))),
    ]


def row(found: Found) -> dict[str, str]:
    """Return a run as its table shows it."""
    asked, alone = (smooth_study.row(each) for each in found)
    of_yaw = "off in deviations (yaw)"
    return {**asked, "nobody asked": alone[of_yaw]}


if __name__ == "__main__":
    sys.exit(by_case("late", __doc__ or "", FORCES, learned, row, checks))
