"""What happened to the vehicle, told as events; the numbers of the last one are told anew while they settle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from towtank.identification.change_found import Change, Recognised
from towtank.identification.change_words import change_details, change_words
from towtank.identification.joint_health import known_to
from towtank.identification.joint_state import JointState
from towtank.identification.parameters import FreeParameters
from towtank.recording.event import Event
from towtank.vehicle import Vehicle

__all__ = ["Story"]

_FIRST, _SETTLES = 1.0, 8.0  # s after which a change is told anew, ever later, and at last


class Story:
    """Events in the order in which they were noticed.

    A change that is noticed again while its numbers settle is the same one, seen better.

    Args:
        vehicle: that they happen to.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self.events: tuple[Event, ...] = ()
        self._open: tuple[Change, int] | None = None  # the last change, its place among the events
        self._again = _FIRST  # s after it was noticed that it is told anew

    def add(self, found: Change | Recognised, state: JointState) -> None:
        """Add a change, or a configuration that was recognised."""
        if isinstance(found, Recognised):
            if found.taken:
                text = f"this is {found.name}, met before (probability {100.0 * found.probability:.1f} %)"
            else:
                text = f"this is not {found.name} after all (probability {100.0 * found.probability:.1f} %)"
            details: dict[str, float | str] = {
                "configuration": found.name,
                "probability": found.probability,
                "taken": float(found.taken),
            }
            self._put(Event(found.t, "configuration", text, details))
            return
        before = self._open
        if before is not None and _goes_on(before[0], found):
            self._open = replace(found, t=before[0].t, noticed=before[0].noticed, before=before[0].before), before[1]
            self.tell(found.noticed, found.free, state)
            return
        self._open, self._again = (found, len(self.events)), _FIRST
        self._put(self._event(found, found.free, state))

    def settle(self) -> None:
        """Leave the last change as it has been told."""
        self._open = None

    def mended(self, t: float) -> None:
        """Add that the filter had lost itself and was set right."""
        self.settle()
        text = "the filter had lost itself; it goes on with what it knew, less sure"
        self._put(Event(t, "mended", text))

    def tell(self, t: float, free: FreeParameters, state: JointState) -> None:
        """Tell the last change anew with what is known at t [s]."""
        if self._open is None:
            return
        change, place = self._open
        if free.names != change.free.names:
            self._open = None
        if self._open is None or t < change.noticed + self._again:
            return
        self._again *= 2.0
        if self._again > _SETTLES:
            self._open = None
        self.events = (*self.events[:place], self._event(change, free, state), *self.events[place + 1 :])

    def restore(self, events: tuple[Event, ...]) -> None:
        """Put in what was told before."""
        self.events, self._open = events, None

    def _put(self, event: Event) -> None:
        self.events = (*self.events, event)

    def _event(self, change: Change, free: FreeParameters, state: JointState) -> Event:
        before, now = change.before, (state.theta.copy(), known_to(state))
        verdict = change.verdict
        text = change_words(self.vehicle, free, before, now, thruster=verdict.thruster)
        details: dict[str, float | str] = {
            "noticed": change.noticed,
            "log_evidence": verdict.evidence,
            "log_odds": float(np.nan_to_num(verdict.clear, posinf=99.0)),
            **({"thruster": verdict.thruster} if verdict.thruster else verdict.parts),
            **change_details(self.vehicle, free, before, now),
        }
        return Event(change.t, "thruster" if verdict.thruster else "change", text, details)


def _goes_on(one: Change, other: Change) -> bool:
    """Whether a change is the same one, seen better: of the same kind, while its numbers settle."""
    alike = one.verdict.thruster == other.verdict.thruster and one.free.names == other.free.names
    return alike and other.noticed <= one.noticed + _SETTLES
