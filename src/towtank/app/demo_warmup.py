"""Everything compiled before the clock of the demo starts, with a word to whoever waits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from towtank.app.demo_progress import Course, quantities
from towtank.app.demo_session import FREE, tank_session, unseen_session
from towtank.app.demo_stream import stream
from towtank.identification import Learner, learn_recordings
from towtank.validation import validate

__all__ = ["warm_up"]

_SECONDS = 2.0


def warm_up(compiling: Callable[[], None]) -> None:
    """Run a session of two seconds through the whole demo; `compiling` is called once if a kernel must be compiled."""
    from numba.core import event

    class Listener(event.Listener):  # type: ignore[misc]
        told = False

        def on_start(self, event: Any) -> None:
            if not self.told:
                self.told = True
                compiling()

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Listener()):
        session = tank_session(_SECONDS)
        learner = Learner(session.known, free=FREE)
        stream(session, learner, Course(quantities(session.truth)), paced=False, show=lambda moment: None)
        learn_recordings(session.known, [session.recording], free=FREE)
        validate(session.truth, [unseen_session().recording.window(0.0, _SECONDS)])
