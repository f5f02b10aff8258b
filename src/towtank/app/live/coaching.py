"""Leads the pilot of a live session: counts down, follows, and designs the next segment from what is known by now.

What is known is the learner's own posterior, so that it does not matter how well a segment was driven. Designing takes
seconds, in a process of its own; the pilot brings the vehicle back meanwhile.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from typing import Any, Self

from towtank.app.live.designing import Designer
from towtank.errors import InputError
from towtank.identification import Estimate
from towtank.live.session import Session
from towtank.planning import Outlook, Plan, Segment, diagonal
from towtank.planning.coach import AXES, TRIES, Coach, Known, Movement, Next, Stage, View
from towtank.recording.event import Event
from towtank.vehicle import Vehicle, index

__all__ = ["Coaching", "plan_document", "plan_lines"]

_TICK = 0.05  # s
_ACCURACY = 0.05  # without a plan
_FIRST = 10.0  # s that must have been learned from before a segment is thought of, without a plan,
_ANEW = 30.0  # s that must have come since, until it is designed anew
_AGAIN = 10.0  # s, after which it is tried again where no segment could be designed
_KNOWN = 0.25  # s between two looks at what is known


class Coaching:
    """Leads a pilot while it is entered.

    Args:
        session: whose samples are followed, and whose learner is asked. vehicle: as the learner was given it.
        plan: what is to be driven; None: what narrows most, from ten seconds of learning on, begun by the pilot alone.
        waits: begin a segment of a plan, too, only when the pilot asks for it. tries: segments judged for each.
    """

    def __init__(
        self, session: Session, vehicle: Vehicle, plan: Plan | None, *, waits: bool = False, tries: int = TRIES
    ) -> None:
        self._session, self._vehicle, self._plan = session, vehicle, plan
        if plan is None:
            self._coach = Coach(vehicle, diagonal(Outlook.of(vehicle)), _ACCURACY, waits=True)
        else:
            wanted, segments = (each.name for each in plan.expected), (each.segment for each in plan.segments)
            self._coach = Coach(vehicle, tuple(wanted), plan.accuracy, tuple(segments), space=plan.space, waits=waits)
        self._sensors = "" if plan is None else plan.sensors
        self._seen: set[str] = set()
        self._seed, self._designed, self._tries = 0, 0.0, tries
        self._looked = self._again = -math.inf
        self._designer = Designer(vehicle)
        session.learning.listeners += (self._see,)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="coach", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._stop.set()
        self._thread.join()
        self._designer.close()

    def view(self) -> View:
        """Return what the pilot is shown now."""
        return self._coach.view(self._session.t)

    def under_way(self) -> tuple[Segment, float] | None:
        """Return the segment that is counted down to or driven, and seconds into it."""
        return self._coach.under_way(self._session.t)

    def document(self) -> dict[str, Any]:
        """Return the same for the page and for programs."""
        return plan_document(self.view())

    def ask(self, what: str) -> bool:
        """Do what the pilot asks for: "begin", "hold" or "on"; return whether that was possible."""
        done = self._coach.ask(what)
        if done and what == "hold":
            self._tell("held by the pilot")
        return done

    def _see(self, t: float, arguments: Mapping[str, Any]) -> None:
        self._coach.see(t, arguments)
        if not self._sensors and len(self._seen) < 3:
            pose = arguments.get("pose")
            if pose is not None and pose[0] == pose[0]:
                self._seen.add("pose")
            velocity = arguments.get("velocity")
            if velocity is not None and velocity[0] == velocity[0]:
                self._seen.add("dvl")

    def _run(self) -> None:
        while not self._stop.wait(_TICK):
            if not math.isfinite(self._session.t):
                continue
            happened = self._coach.tick(self._session.t, self._unable())
            if happened:
                self._tell(happened)
            self._look()
            try:
                if self._designer.designs:
                    self._take()
                elif time.monotonic() >= self._again and self._is_due():
                    self._think()
            except Exception as error:  # whatever it is, the pilot is led by what was foreseen
                self._offer(None, f"{type(error).__name__}: {error}")

    def _is_due(self) -> bool:
        """Whether a segment is to be designed: after each; without a plan also anew, while none is begun."""
        if self._plan is not None:
            return self._coach.thinks
        learned = self._session.learning.now.estimate.duration
        if self._coach.thinks:
            return learned >= _FIRST
        return self._coach.may_change and learned >= self._designed + _ANEW

    def _tell(self, text: str) -> None:
        self._session.events.add(Event(max(self._session.t, 0.0), "plan", text))

    def _unable(self) -> str:
        """Return why nothing can be driven now, "" where it can."""
        learnt = self._session.learning.now
        if learnt.trouble:
            return "learning has stopped"
        if learnt.paused:
            return "learning is paused"
        if learnt.left_out is not None:
            return learnt.left_out.reason
        return "no commands come" if learnt.silent is not None or not math.isfinite(learnt.t) else ""

    def _look(self) -> None:
        """Take note of how well the coefficients are known by now."""
        if self._session.t - self._looked >= _KNOWN:
            self._looked = self._session.t
            self._coach.learn(_shares(self._session.learning.now.estimate, self._vehicle, self._coach.wanted))

    def _think(self) -> None:
        """Have the next segment designed from what is known now."""
        learning, coach = self._session.learning, self._coach
        self._designed = learning.now.estimate.duration
        try:
            model = learning.errands.ask(learning.learner.model)
        except TimeoutError:  # the learner is too busy; it is asked again
            return
        self._seed += 1
        sensors = self._sensors or self._sensors_seen()
        settings = {"sensors": sensors, "plan": self._plan, "seed": self._seed, "tries": self._tries}
        try:
            self._designer.ask(model, coach.wanted, coach.accuracy, **settings)
        except InputError as error:
            self._offer(None, str(error))

    def _take(self) -> None:
        """Take the segment that was designed, once it is there."""
        try:
            found = self._designer.answer()
        except InputError as error:
            self._offer(None, str(error))
            return
        if found is not None:
            self._offer(found)

    def _offer(self, found: Next | None, trouble: str = "") -> None:
        """Offer a segment to the pilot; where there was trouble with it the one that was foreseen, if any."""
        if trouble and not self._coach.foresees:
            self._again = time.monotonic() + _AGAIN
            self._tell(f"no further segment yet: {trouble}")
            return
        if trouble:
            self._tell(f"the next segment stays as it was planned: {trouble}")
        means = self._coach.offer(found)
        if means:
            self._tell(means)

    def _sensors_seen(self) -> str:
        return next((name for name in ("pose", "dvl") if name in self._seen), "gyro-depth")


def _shares(estimate: Estimate, vehicle: Vehicle, wanted: tuple[str, ...]) -> dict[str, float]:
    """Return how well coefficients are known as shares of their size; an added mass as a share of the total inertia."""
    out = {}
    for each in estimate.coefficients:
        if each.name not in wanted or not each.identified:
            continue
        kind, i, j = index(each.name)
        size = abs(vehicle.rigid_body_matrix[i, j] - each.value) if kind == "mass" else abs(each.value)
        out[each.name] = float(each.std / size) if size > 0.0 else math.inf
    return out


# -- for the page, the terminal and programs


def plan_document(view: View) -> dict[str, Any]:
    """Return what the page and `--json-lines` say of a plan."""
    clock = view.clock if math.isfinite(view.clock) else None
    return {
        "stage": view.stage.value,
        "text": view.text,
        "clock_s": clock,
        "segment": view.number,
        "planned": view.planned,
        "duration_s": view.duration,
        "manoeuvred_s": view.seconds,
        "accuracy": view.accuracy,
        "offset_m": list(view.offset),
        "axes": sorted({AXES[each.row] for each in view.movements}, key=AXES.index),
        "movements": [
            {
                "axis": AXES[each.row],
                "text": each.text,
                "amount": each.amount,
                "start_s": each.start,
                "end_s": each.end,
                "done": share,
            }
            for each, share in zip(view.movements, (*view.done, *[None] * len(view.movements)), strict=False)
        ],
        "known": [{"name": each.name, "share": _number(each.share), "met": each.met} for each in view.known],
    }


def plan_lines(view: View) -> list[str]:
    """Return lines for a terminal: what to do, each axis now and next, and how far everything has come."""
    met = sum(each.met for each in view.known)
    worst = max((each for each in view.known if not each.met), key=_badness, default=None)
    still = "" if worst is None else f"; least known: {_known_text(worst)}"
    lines = [view.text]
    if view.stage in (Stage.BRING, Stage.COUNT, Stage.DRIVE):
        t = view.clock if math.isfinite(view.clock) else -math.inf
        for row, axis in enumerate(AXES):
            now, following = view.now_and_next(row)
            if now is None and following is None:
                continue
            parts = [] if now is None else [f"now {now.text} for {now.end - t:.1f} s"]
            parts += [_next_text(following, t)] if following is not None else ["then let go"]
            lines.append(f"  {axis:<6} {', '.join(parts)}")
    lines.append(f"{met} of {len(view.known)} known to {100.0 * view.accuracy:g} % after {view.seconds:.0f} s{still}")
    return lines


def _next_text(movement: Movement, t: float) -> str:
    return f"next {movement.text}" + (f" in {movement.start - t:.1f} s" if math.isfinite(t) else " at the start")


def _known_text(known: Known) -> str:
    return f"{known.name} " + (f"{100.0 * known.share:.0f} %" if math.isfinite(known.share) else "not at all")


def _badness(known: Known) -> float:
    return known.share if math.isfinite(known.share) else math.inf


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
