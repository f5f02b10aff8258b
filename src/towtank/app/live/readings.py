"""What a live session comes to while it runs, for terminal and JSON lines: the words are those of the page."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from towtank.dashboard.live_feed import Tap, now_of
from towtank.dashboard.prediction import Prediction
from towtank.dashboard.verdict import notes, predicted, verdict
from towtank.live.session import Session
from towtank.live.status import Status
from towtank.planning.coach import View
from towtank.vehicle import Vehicle

__all__ = ["Reading", "Readings"]

_PERIOD = 1.0  # s between two free runs


@dataclass(frozen=True)
class Reading:
    """What a session comes to.

    Attributes:
        state: "learning", "no data since 12 s" and so on. verdict: what the model is of use for, what to drive next.
        prediction: how far off the free run of the last seconds is. notes: of links and filter, each once.
        plan: what the pilot is shown; None where nothing is planned.
        rms: of the free run (6,) [m/s, rad/s], NaN where not measured; empty where there is none of now.
    """

    state: str
    verdict: str
    prediction: str
    notes: tuple[str, ...]
    rms: tuple[float, ...] = ()
    plan: View | None = None


class Readings:
    """Reads a session; to be made before that runs.

    `verdict` returns what its model can be used for, `plan` what the pilot is shown.
    """

    def __init__(
        self,
        session: Session,
        vehicle: Vehicle,
        verdict: Callable[[], str] = str,
        plan: Callable[[], View] | None = None,
    ) -> None:
        self._verdict, self._plan = verdict, plan
        self._tap, self._vehicle = Tap(), vehicle
        self._prediction = Prediction(vehicle)
        self._due = 0.0
        session.learning.listeners += (self._tap,)

    def read(self, status: Status) -> Reading:
        """Return what the session comes to."""
        now, prediction = now_of(status, self._verdict()), self._prediction
        prediction.motion.add(self._tap.drain())
        if now.silent is None and time.monotonic() >= self._due:
            self._due = time.monotonic() + _PERIOD
            prediction.renew(self._vehicle, now.estimate, now.delay)
        run = None if now.silent is not None else prediction.run
        return Reading(
            state=now.state,
            verdict=verdict(now),
            prediction=predicted(now, run),
            notes=notes(now),
            rms=() if run is None else tuple(run.rms.tolist()),
            plan=None if self._plan is None else self._plan(),
        )
