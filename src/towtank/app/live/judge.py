"""What a model that is learned from a stream can be used for, and whether its thrusters are wired as its file says.

Both are told while the stream goes on, in a thread beside learning, by the rules and in the words of `learn` and of its
report: free runs over the last minute that was learned from, and the test of every thruster's sign and order over all
of it, after 30, 60, 120 and 240 s. The estimate is not touched.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Self

from towtank.errors import InputError
from towtank.identification import Estimate
from towtank.identification.data.samples import prepared, samples_of
from towtank.identification.logs import wiring_findings
from towtank.identification.model.terms import AXES
from towtank.identification.offline.first_look import driven_axes
from towtank.live.learning import Row, recording_of
from towtank.recording import Recording, align
from towtank.recording.consistency import Finding
from towtank.recording.event import Event
from towtank.report.verdict import learn_verdict
from towtank.validation import Usability, usability
from towtank.validation.usability import SHORTEST
from towtank.vehicle import Vehicle, allocatable_axes

__all__ = ["Driven", "Judge", "Moment"]

_PERIOD, _SOON = 2.0, 0.5  # s between two verdicts; while nothing is identified, which may change any moment
_DUE = (30.0, 60.0, 120.0, 240.0)  # s of driving after which the wiring is looked at
_STEP = 0.04  # s between two samples that are kept of one kind
_SHORTEST = 5.0  # s; what is shorter tells nothing of wiring
_ANOTHER_ONE = ("change", "thruster")  # events after which the vehicle is another one
_DONE = "it is learned as the file has them; towtank learn of a recording turns them round"


class Moment(NamedTuple):
    """What a verdict is made of: the model as learned by now, its estimate, the last minute learned from, events."""

    model: Vehicle
    estimate: Estimate
    recording: Recording | None
    events: Sequence[Event]


class Driven:
    """What was learned from, stretch by stretch, at 25 Hz of each kind; until the last look at the wiring is done."""

    def __init__(self) -> None:
        self.seconds, self.t = 0.0, 0.0
        self._stretches: list[list[Row]] = [[]]
        self._latest: dict[tuple[str, ...], float] = {}
        self._due = list(_DUE)
        self._lock = threading.Lock()

    def add(self, t: float, sample: Mapping[str, float]) -> None:
        """Take what belongs to one instant."""
        names = tuple(sample)
        with self._lock:
            if not self._due or 0.0 <= t - self._latest.get(names, -1e9) < _STEP:
                return
            rows = self._stretches[-1]
            self.seconds += t - self.t if rows else 0.0
            self.t = self._latest[names] = t
            rows.append((t, names, tuple(sample.values())))

    def break_off(self) -> None:
        """Begin a new stretch."""
        with self._lock:
            self._latest.clear()
            if self._stretches[-1]:
                self._stretches.append([])

    def due(self) -> list[Recording]:
        """Return the stretches where it is time for a look, none before; after the last one nothing is kept."""
        with self._lock:
            if not self._due or self.seconds < self._due[0]:
                return []
            self._due = [each for each in self._due if each > self.seconds]
            stretches = [list(rows) for rows in self._stretches if rows and rows[-1][0] - rows[0][0] >= _SHORTEST]
            if not self._due:
                self._stretches = [[]]
        made = (recording_of(rows, "the session") for rows in stretches)
        return [each for each in made if each is not None]


class Judge:
    """Judges a stream every two seconds while it is entered, oftener until something is identified.

    Args:
        vehicle: as the learner was given it.
        look: returns what there is to judge; raises TimeoutError where the learner is too busy.
        driven: follows what is learned from, for the wiring; add: takes the event of a wrong one.
        shown: whether anybody sees the verdict; else only the wiring is looked at.

    Attributes:
        text: the verdict by now, "" before the first. use: for how long the model predicts, None where nothing tells.
        findings: what cannot be right of the thrusters.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        look: Callable[[], Moment],
        driven: Driven | None = None,
        add: Callable[[Event], None] | None = None,
        *,
        shown: bool = True,
    ) -> None:
        self._shown = shown
        self._vehicle, self._look, self._driven, self._add = vehicle, look, driven, add
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="judge", daemon=True)
        self.text = ""
        self._known = False  # whether anything was identified when it was judged last
        self.use: Usability | None = None
        self.findings: tuple[Finding, ...] = ()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with contextlib.suppress(TimeoutError):
                (self.judge if self._shown else self._look_at_wiring)()
            if self._stop.wait(_PERIOD if self._known or not self._shown else _SOON):
                return

    def judge(self) -> None:
        """Look once; the wiring where it is due. Raises TimeoutError where the learner is too busy to be asked."""
        self._look_at_wiring()
        now = self._look()
        self._known = any(now.estimate.identified)
        recording = _since_the_change(now)
        driven: tuple[bool, ...] = ()
        use = _nothing_yet(self._vehicle)
        if recording is not None:
            with contextlib.suppress(InputError):  # no motion, or no inputs, in it
                run = prepared(recording, self._vehicle)
                driven = driven_axes([samples_of(run, self._vehicle)])
                if run.duration >= SHORTEST and self._known:
                    use = usability(now.model, [align(run)])
        span = 0.0 if recording is None else recording.duration
        self.text = learn_verdict(now.estimate, {}, f"the last {span:.0f} s", self.findings, driven, use).text
        self.use = use

    def _look_at_wiring(self) -> None:
        recordings = [] if self._driven is None else self._driven.due()
        if not recordings:
            return
        found = wiring_findings(self._vehicle, recordings, _DONE)
        new = [each for each in found if each not in self.findings]
        self.findings = found
        if self._add is not None and self._driven is not None:
            for each in new:
                self._add(Event(self._driven.t, "wiring", each.text, {"what": each.what}))


def _nothing_yet(vehicle: Vehicle) -> Usability:
    """Return what can be said before anything was driven: what the thrusters could drive."""
    able = allocatable_axes(vehicle) if vehicle.thrusters else tuple(range(6))
    names = tuple(axis.name for axis in AXES if axis.index in able)
    return Usability((), names, (), 0.0, names)


def _since_the_change(now: Moment) -> Recording | None:
    """Return what was learned from since the vehicle changed; None where that is too little."""
    recording = now.recording
    last = max((event.t for event in now.events if event.kind in _ANOTHER_ONE), default=None)
    if recording is None or last is None or last <= recording.start:
        return recording
    return recording.window(last, recording.end) if recording.end - last >= SHORTEST else None
