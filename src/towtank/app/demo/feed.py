"""The demo's session as the live page sees it."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from towtank.app.demo.progress import LearningCurve, convergence_of
from towtank.app.live.facts import Knowledge, knowledge_of, stream_facts
from towtank.app.live.judge import Judge, Moment
from towtank.dashboard.feed import About, Instant, Link, Now
from towtank.dashboard.live_feed import Tap
from towtank.identification import Estimate, Learner
from towtank.identification.offline.convergence import Convergence
from towtank.live.events import EventLog, Sight
from towtank.live.pipeline.lane import Errands
from towtank.live.pipeline.measures import Excitation, Latency
from towtank.recording.event import Event
from towtank.report.learn_page import report_html
from towtank.simulation.tank import WEIGHT, Session
from towtank.vehicle import Vehicle

__all__ = ["DemoFeed"]

_SOURCE = "simulated motion capture"
_SHORTEST, _LOOKS_BACK = 1.0, 60.0  # s of the recording that a report looks at


class DemoFeed:
    """Stands between the demo's stream and the page; `before`, `after` and `read` are called by the stream."""

    def __init__(self, session: Session, learner: Learner, curve: LearningCurve) -> None:
        truth = session.truth
        names = (*truth.hydrodynamics, "BG_z", *(() if session.later is None else (WEIGHT,)))
        self.about = About(
            title="towtank demo",
            vehicle=session.known,
            method="joint",
            reference={name: truth.coefficient(name) for name in names},
            reference_word="truth",
            seconds=session.recording.duration,
        )
        self._names, self._session, self._curve = names, session, curve
        self._written = b""
        self._learner, self._tap, self._errands = learner, Tap(), Errands()
        self._events, self._sight = EventLog(), Sight()
        self._excitation, self._latency = Excitation(session.known), Latency()
        self._estimate, self._model = learner.estimate, session.known
        self._t, self._count, self._learned = -math.inf, 0, 0
        self._delay = self._lag = math.nan
        self._remarks: tuple[str, ...] = ()
        self._paused = self._halted = self._finished = False
        self._began = self._ended = time.monotonic()
        self.judge = Judge(session.known, self._moment)

    def before(self, t: float, arguments: Mapping[str, Any]) -> bool:
        """Take the instant of time t [s]; return whether it is to be learned from."""
        if not self._count:
            self._began = time.monotonic()
        self._errands.run()
        self._tap(t, arguments)
        self._excitation.see(t, dict(arguments))
        self._t, self._count = t, self._count + 1
        if t >= self._session.changed and self.about.earlier is None:
            later = {name: self._session.final.coefficient(name) for name in self._names}
            self.about = replace(self.about, reference=later, earlier=(self._session.changed, self.about.reference))
        back = self._sight.see(t, arguments)
        if back is not None:
            self._events.add(back)
        if self._halted and not self._paused:
            self._learner.restart()
        self._halted = self._paused
        return not self._paused

    def after(self, seconds: float) -> None:
        """Take how long an update took."""
        self._latency.add(seconds)
        self._learned += 1

    def read(self, estimate: Estimate) -> None:
        """Take the estimate of now."""
        self._estimate = estimate
        self._delay, self._lag, self._remarks = self._learner.delay, self._learner.lag, self._learner.remarks
        self._events.take(self._learner.events)
        self._ended = time.monotonic()

    def streamed(self) -> None:
        """Take that the stream has ended; who asks something of the learner does it from now on."""
        self._errands.close()

    def finish(self, estimate: Estimate, model: Vehicle, delay: float, note: str) -> None:
        """Take what is known in the end, and an event that says why."""
        self._estimate, self._model, self._delay, self._finished = estimate, model, delay, True
        if note:
            self._events.add(Event(self._t, "mark", note))

    def written(self, report: bytes) -> None:
        """Take the demo's own page, which is the report from now on."""
        self._written = report

    def report(self) -> bytes:
        """Return the report as of now, for the page's thread. Raises TimeoutError where the learner is too busy."""
        if self._written:
            return self._written
        now, convergence = self._errands.ask(self._knowledge)
        end = max(self._t, _SHORTEST)
        recording = self._session.recording.window(max(end - _LOOKS_BACK, 0.0), end)
        span = f"the last {recording.duration:.0f} s"
        facts = stream_facts(now, recording, of=span, events=self._events.all, convergence=convergence)
        return report_html(replace(facts, title="A vehicle learned in a simulated tank")).encode()

    def now(self) -> Now:
        """Return where the session stands."""
        elapsed = (self._ended if self._finished else time.monotonic()) - self._began if self._count else 0.0
        rate = self._count / elapsed if elapsed > 0.5 and not self._finished else 0.0
        latency = self._latency.milliseconds()
        return Now(
            elapsed=elapsed,
            t=self._t,
            estimate=self._estimate,
            delay=self._delay,
            lag=self._lag,
            latency=latency,
            processing=latency,
            excitation=self._excitation.rms,
            samples=self._count,
            instants=self._learned,
            paused=self._paused,
            state="paused" if self._paused else "learning",
            links=(Link(_SOURCE, self._count, {"pose and commands": rate}, {}),),
            events=self._events.all,
            verdict=self.judge.text,
            remarks=self._remarks,
        )

    def taken(self) -> Sequence[Instant]:
        """Return the instants that came since the last call."""
        return self._tap.drain()

    def model(self) -> Vehicle:
        """Return the model as learned by now."""
        return self._model if self._finished else self._errands.ask(self._learner.model)

    def pause(self, paused: bool) -> None:
        """Halt learning, or go on; the vehicle moves on."""
        if paused != self._paused:
            self._paused = paused
            self.mark("learning paused" if paused else "learning resumed")

    def mark(self, text: str) -> None:
        """Add an event of somebody's own."""
        self._events.add(Event(max(self._t, 0.0), "mark", text))

    def ask(self, what: str) -> bool:
        """Do nothing: the demo drives by itself."""
        return False

    def _moment(self) -> Moment:
        """Return what there is to judge."""
        learner, end = self._learner, max(self._t, _SHORTEST)
        known = self._model, self._estimate
        model, estimate = known if self._finished else self._errands.ask(lambda: (learner.model(), learner.estimate))
        recording = self._session.recording.window(max(end - _LOOKS_BACK, 0.0), end)
        return Moment(model, estimate, recording, self._events.all)

    def _knowledge(self) -> tuple[Knowledge, Convergence]:
        now = knowledge_of(self._learner)
        known = [each.name for each in now.estimate.coefficients if each.identified]
        return now, convergence_of(self._curve, self._session.known, known)
