"""Where a live session stands, for whoever looks at it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from towtank.live.learning import Learnt
from towtank.live.links.source import SourceState
from towtank.live.pipeline.hearing import no_data
from towtank.live.recording.recorder import RecordingState
from towtank.recording.event import Event

__all__ = ["SourceStatus", "Status"]


@dataclass(frozen=True)
class SourceStatus:
    """How one link fares.

    Attributes:
        text: as it was named. state: its own account. samples: that came from it.
        strange: stamps that were not believed. offset: our clock less its own [s]. drift: [s/s].
        silent: for how long [s] no sample has come; None where that is not too long, or none will come any more.
    """

    text: str
    state: SourceState
    samples: int
    strange: int
    offset: float
    drift: float
    silent: float | None = None


@dataclass(frozen=True)
class Status:
    """Where a session stands.

    Attributes:
        elapsed: since it began [s]. learnt: by now.
        sources: how each link fares. recording: None where there is none.
        dropped: samples passed over because learning could not keep up. gaps: how often that began.
        late: samples that came after later ones had been learned from. waiting: samples to be learned from.
        doubled: channels that several links measure. warnings: what a person had better know.
        events: what happened, in the order of noticing.
        epoch: Unix time [s] at which the session's time is 0; NaN where samples come in a time of their own.
        ending: no link is read any more; what came is still learned from and recorded. ended: nothing will change.
    """

    elapsed: float
    learnt: Learnt
    sources: tuple[SourceStatus, ...]
    recording: RecordingState | None
    dropped: int
    gaps: int
    late: int
    waiting: int
    doubled: tuple[str, ...]
    warnings: tuple[str, ...]
    events: tuple[Event, ...] = ()
    epoch: float = math.nan
    ending: bool = False
    ended: bool = False

    @property
    def bad(self) -> int:
        """Datagrams and messages that could not be decoded, and stamps that were not believed."""
        return sum(each.state.bad + each.strange for each in self.sources)

    @property
    def samples(self) -> int:
        """Samples of all links."""
        return sum(each.samples for each in self.sources)

    @property
    def silent(self) -> float | None:
        """For how long [s] nothing has come from any link that has not ended; None where something comes."""
        left = [each.silent for each in self.sources if not each.state.ended]
        found = [each for each in left if each is not None]
        return min(found) if found and len(found) == len(left) else None

    @property
    def in_trouble(self) -> bool:
        """Whether the recording cannot be written at present."""
        return self.recording is not None and bool(self.recording.trouble)

    @property
    def state(self) -> str:
        """In words: "learning", "paused", "not learning: disarmed since 12 s", "no data since 12 s", "learning has
        stopped", "ending" or "ended".
        """
        if self.ended or self.ending:
            return "ended" if self.ended else "ending"
        if self.silent is not None:
            return no_data(self.silent)
        if self.learnt.trouble:
            return "learning has stopped"
        if self.learnt.paused:
            return "paused"
        return f"not learning: {self.learnt.not_learning}" if self.learnt.left_out is not None else "learning"
