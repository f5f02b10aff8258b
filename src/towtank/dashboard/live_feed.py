"""A live session as the page sees it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from towtank.dashboard.feed import About, Instant, Link, Now, RecordingFile
from towtank.live.session import Session
from towtank.live.status import Status
from towtank.vehicle import Vehicle

__all__ = ["Guide", "LiveFeed", "Tap", "now_of"]

_KEPT = 5000  # instants


class Tap:
    """Takes instants from the learning thread and hands them to the page's; neither waits."""

    def __init__(self) -> None:
        self._instants: deque[Instant] = deque(maxlen=_KEPT)

    def __call__(self, t: float, arguments: Mapping[str, Any]) -> None:
        """Take one."""
        self._instants.append((t, arguments))

    def drain(self) -> list[Instant]:
        """Return those that came since the last call."""
        found = []
        for _ in range(len(self._instants)):
            found.append(self._instants.popleft())
        return found


def now_of(status: Status, verdict: str = "", plan: Mapping[str, Any] | None = None) -> Now:
    """Return where a session stands; verdict: what its model can be used for; plan: what is to be driven."""
    learnt, recording = status.learnt, status.recording
    return Now(
        elapsed=status.elapsed,
        t=learnt.t,
        estimate=learnt.estimate,
        delay=learnt.delay,
        lag=learnt.lag,
        latency=learnt.latency,
        processing=learnt.processing,
        excitation=() if status.silent is not None else learnt.excitation,
        samples=status.samples,
        instants=learnt.instants,
        dropped=status.dropped,
        late=status.late,
        rejected=status.bad,
        waiting=status.waiting,
        paused=learnt.paused,
        state=status.state,
        silent=status.silent,
        links=tuple(
            Link(each.text, each.samples, each.state.rates, each.state.asked, each.state.said, each.silent)
            for each in status.sources
        ),
        recording=None if recording is None else RecordingFile(recording.path, recording.size, recording.lost),
        warnings=status.warnings,
        events=status.events,
        verdict=verdict,
        remarks=learnt.remarks,
        not_learning="" if learnt.left_out is None else learnt.left_out.reason,
        plan=plan,
    )


class Guide(Protocol):
    """Leads the pilot of a session."""

    def document(self) -> Mapping[str, Any]:
        """Return what is to be driven now and next."""

    def ask(self, what: str) -> bool:
        """Do what the pilot asks for; return whether that was possible."""


class LiveFeed:
    """A `Session`; to be made before that runs.

    `verdict` returns what its model can be used for; `guide` says what is to be driven, None: nobody does.
    """

    def __init__(
        self, session: Session, about: About, verdict: Callable[[], str] = str, guide: Guide | None = None
    ) -> None:
        self.about, self._session, self._tap, self._verdict = about, session, Tap(), verdict
        self._guide = guide
        session.learning.tap = self._tap

    def now(self) -> Now:
        """Return where the session stands."""
        plan = None if self._guide is None else self._guide.document()
        return now_of(self._session.status(), self._verdict(), plan)

    def taken(self) -> Sequence[Instant]:
        """Return the instants that came since the last call."""
        return self._tap.drain()

    def model(self) -> Vehicle:
        """Return the model as learned by now."""
        learning = self._session.learning
        return learning.errands.ask(learning.learner.model)

    def pause(self, paused: bool) -> None:
        """Halt learning, or go on."""
        self._session.learning.pause(paused)

    def mark(self, text: str) -> None:
        """Add an event of somebody's own."""
        self._session.mark(text)

    def ask(self, what: str) -> bool:
        """Do what the pilot of a plan asks for."""
        return self._guide is not None and self._guide.ask(what)
