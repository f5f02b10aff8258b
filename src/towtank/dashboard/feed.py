"""What the page shows, whoever runs the session: a live one, the demo, or a test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from towtank.identification import Estimate
from towtank.recording.event import Event
from towtank.vehicle import Vehicle

__all__ = ["About", "Feed", "Instant", "Link", "Now", "RecordingFile"]

Instant = tuple[float, Mapping[str, Any]]  # t [s] and the arguments of `Learner.update`


@dataclass(frozen=True)
class About:
    """What a session is about.

    Attributes:
        title: a line for the head of the page. vehicle: what the learner was given. method: of learning.
        reference: values to compare with, by coefficient. reference_word: what they are, "truth" or "before".
        earlier: until when [s] others were to be compared with, and which; None where these were right all along.
        seconds: length of the session where it is known.
    """

    title: str
    vehicle: Vehicle
    method: str
    reference: Mapping[str, float] = field(default_factory=dict)
    reference_word: str = "before"
    earlier: tuple[float, Mapping[str, float]] | None = None
    seconds: float | None = None


@dataclass(frozen=True)
class Link:
    """Where samples come from: rates got and asked for [Hz] by topic, and what the link says for itself.

    `silent`: for how long [s] nothing has come; None where that is not too long.
    """

    text: str
    samples: int
    rates: Mapping[str, float]
    asked: Mapping[str, float]
    said: tuple[str, ...] = ()
    silent: float | None = None


@dataclass(frozen=True)
class RecordingFile:
    """The session's own recording, as it stands."""

    path: Path
    size: int
    lost: int


@dataclass(frozen=True)
class Now:
    """Where a session stands.

    Attributes:
        elapsed: since it began [s]. t: of the latest instant learned from [s].
        estimate: of the coefficients. delay, lag: [s], NaN where not known.
        latency, processing: "median", "p99", "max" [ms]; NaN where they mean nothing.
        excitation: root mean square (6,) [N, N m] of the wrench asked for over ten seconds, empty where none was.
        samples: that came. instants: learned from. dropped, late, rejected: that were not. waiting: still to be.
        paused: learning was halted.
        state: in words, as "learning". silent: for how long [s] no link has sent anything; None while one sends.
        warnings: what a person had better know. events: what happened.
        verdict: what the model can be used for, and what to drive next; "" where nothing was judged yet.
        remarks: what is to be said of what was learned.
        not_learning: why what comes is not learned from, as "disarmed"; "" where it is.
        plan: what is to be driven now and next, as of `towtank live --plan`; None where nothing is planned.
    """

    elapsed: float
    t: float
    estimate: Estimate
    delay: float
    lag: float
    latency: Mapping[str, float]
    processing: Mapping[str, float]
    excitation: tuple[float, ...]
    samples: int
    instants: int
    dropped: int = 0
    late: int = 0
    rejected: int = 0
    waiting: int = 0
    paused: bool = False
    state: str = "learning"
    silent: float | None = None
    links: tuple[Link, ...] = ()
    recording: RecordingFile | None = None
    warnings: tuple[str, ...] = ()
    events: tuple[Event, ...] = ()
    verdict: str = ""
    remarks: tuple[str, ...] = ()
    not_learning: str = ""
    plan: Mapping[str, Any] | None = None


class Feed(Protocol):
    """A session as the page sees it. Called by the page's thread; no method may keep the session waiting."""

    about: About  # another object where that changes

    def now(self) -> Now:
        """Return where the session stands."""

    def taken(self) -> Sequence[Instant]:
        """Return the instants that came since the last call, in order; old ones are lost where that is long ago."""

    def model(self) -> Vehicle:
        """Return the model as learned by now. Raises TimeoutError where the learner is too busy."""

    def pause(self, paused: bool) -> None:
        """Halt learning, or go on."""

    def mark(self, text: str) -> None:
        """Add an event of somebody's own."""

    def ask(self, what: str) -> bool:
        """Do what the pilot of a plan asks for, "begin", "hold" or "on", or who drives it: "drive-on" and so on.

        Returns whether that was possible.
        """
