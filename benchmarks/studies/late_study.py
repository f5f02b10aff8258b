"""Forces that act otherwise than the model has it: a part of them late, or too much at first; water that stirs quickly.

    python benchmarks/studies/late_study.py [--runs 20] [--only third] [--output late.json]

The box of `smooth_study.py`, with rates as the gyros have them. `as recorded`: what pushes it is the wrench that is
recorded. `quick water`: a random force beside it that changes within 0.1 s. `a tenth late`, `a third late`: so much of
the force acts 0.2 s later than the rest, as of motors that reverse in two steps. `overshoots`: a third too much acts at
first, for 0.2 s. Nothing of that is in the model, nor can be: delay and lag are those of a recorded wrench, none. How
many intervals hold all the same, and how far off the total yaw inertia is.
"""

from __future__ import annotations

import sys

from by_case import by_case
from pushed_box import FORCES
from smooth_study import checks, learned, row

if __name__ == "__main__":
    sys.exit(by_case("late", __doc__ or "", FORCES, learned, row, checks))
