"""Everything of the demo compiled before its clock starts: `python -m towtank.app.demo.warm_up filter` and `... rest`.

`make` runs the two groups beside each other while the page is built; the demo runs both, which costs little where the
machine code is on disk already. `... free-runs` and `... others` compile what other methods and plans use, no demo.
"""

from __future__ import annotations

import sys

import numpy as np

from towtank.app.demo.progress import LearningCurve, quantities
from towtank.app.demo.stream import stream
from towtank.identification import Learner, learn_recordings
from towtank.planning import plan
from towtank.planning.guard import Guard, drawn_around
from towtank.planning.space import Space
from towtank.simulation import simulate_batch
from towtank.simulation.tank import tank_session, unseen_session
from towtank.validation import validate

__all__ = ["GROUPS", "warm_up"]

_SECONDS = 2.0


def warm_up_filter() -> None:
    """Learn from a session of two seconds, row by row: two thirds of all that is compiled."""
    session = tank_session(_SECONDS)
    learner = Learner(session.known)
    stream(session, learner, LearningCurve(quantities(session.truth)), paced=False, show=lambda moment: None)
    learn_recordings(session.known, [session.recording])


def warm_up_rest() -> None:
    """Simulate what is never seen, and judge a model on two seconds of it."""
    unseen = unseen_session()
    validate(unseen.truth, [unseen.recording.window(0.0, _SECONDS)])


def warm_up_free_runs() -> None:
    """Learn by free runs, and guard a step."""
    session = tank_session(_SECONDS)
    learn_recordings(session.known, [session.recording], method="output-error")
    guard = Guard.of(session.truth, Space.from_text("5x5x2.5"), drawn_around(session.truth, 1, 0.3))
    guard.step(np.array([0.0, 0.0, 1.0, 1.0] + 9 * [0.0]), np.zeros(len(session.truth.thrusters)))


def warm_up_others() -> None:
    """Learn by the paper's method, look for a segment to drive, simulate a batch."""
    session = tank_session(_SECONDS)
    learn_recordings(session.known, [session.recording], method="paper")
    plan(session.truth, want=("X_udot",), minutes=0.1, tries=1, draws=1)
    simulate_batch(session.truth, wrench=np.zeros((1, 6)))


GROUPS = {"filter": warm_up_filter, "rest": warm_up_rest, "free-runs": warm_up_free_runs, "others": warm_up_others}


def warm_up() -> None:
    """Compile all that the demo uses."""
    warm_up_filter()
    warm_up_rest()


if __name__ == "__main__":
    GROUPS[sys.argv[1]]()
