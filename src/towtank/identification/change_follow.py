"""Follows a stream for changes of its vehicle: the watch, fed as the filter is fed, and the story of what it saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.change_doubt import Doubt
from towtank.identification.change_found import Change, Recognised
from towtank.identification.change_story import Story
from towtank.identification.change_watch import Watch
from towtank.identification.held_input import HeldInput
from towtank.identification.joint_buffer import Buffer
from towtank.identification.joint_state import JointState
from towtank.identification.parameters import FreeParameters
from towtank.recording.event import Event
from towtank.vehicle import Vehicle

__all__ = ["Follow"]

_WATCHED = 15.0  # s of motion from which on changes are watched for


class Follow:
    """What watches, once the inputs are known.

    Args:
        vehicle: what is known of it. known: configurations that it may become, by name; None: nobody watches.
    """

    def __init__(self, vehicle: Vehicle, known: Mapping[str, Vehicle] | None) -> None:
        self._vehicle, self._known = vehicle, known
        self.watch: Watch | None = None
        self.story = Story(vehicle)
        self._doubt = Doubt()

    @property
    def watching(self) -> bool:
        """Whether changes are watched for."""
        return self._known is not None

    @property
    def asked(self) -> float:
        """When a look was asked for, since what was seen may be no change [s]."""
        return -np.inf if self.watch is None else self.watch.asked

    @property
    def events(self) -> tuple[Event, ...]:
        """What happened, in the order of noticing."""
        return self.story.events

    @property
    def likely(self) -> dict[str, float]:
        """Known configurations and how probable each is, since the last change."""
        return {} if self.watch is None else dict(self.watch.likely)

    @property
    def doubt(self) -> tuple[float, ...]:
        """What was learned of how much windows err."""
        return self._doubt.numbers

    def restore(self, events: Sequence[Event], doubt: Sequence[float]) -> None:
        """Go on with what `events` and `doubt` of another one were."""
        self.story.restore(tuple(events))
        self._doubt.restore(doubt)

    def restart(self) -> None:
        """Begin anew: the filter is another one, or its motion is."""
        self.story.settle()
        if self.watch is not None:
            self.watch.restart()

    def mended(self, t: float) -> None:
        """Begin anew, since the filter had to be mended at t [s]."""
        self.restart()
        self.story.mended(t)

    def take_input(self, t: float, force: Array) -> None:
        """Take the forces (m,) asked for from t [s] on."""
        if self.watch is not None:
            self.watch.take_input(t, force)

    def take_row(
        self,
        t: float,
        z: Array,
        seen: float,
        filter_: tuple[FreeParameters, JointState, HeldInput],
        like: Buffer,
        *,
        may_look: bool,
    ) -> Change | Recognised | None:
        """Take the row z (15,) of time t [s], after the filter; return what goes on in its place, where one does.

        Args:
            seen: motion so far [s]. filter_: its coordinates, itself, its inputs. like: a buffer of such inputs.
            may_look: see `Watch`.
        """
        if self._known is None:
            return None
        if self.watch is None:
            self.watch = Watch(self._vehicle, like.fresh(), self._known, self._doubt)
        self.watch.take_row(t, z)
        self.watch.may_look = may_look
        if seen < _WATCHED:
            return None
        free, state, held = filter_
        self.story.tell(t, free, state)
        found = self.watch.look(t, state, held, free)
        if found is not None:
            self.story.add(found, found.state)
        return found
