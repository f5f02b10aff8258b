"""The drive of a live session: what the plan wants, the operator's switch and key, and what is told of both.

Nothing else of towtank commands a vehicle, and this only with `--drive`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Self

from towtank.app.live.coaching import Coaching
from towtank.errors import InputError
from towtank.live.driving.driver import PARAMETERS, RATES, Driver, Outside, Standing, Task
from towtank.live.driving.heard import Autopilot, Measured
from towtank.live.driving.helm import Helm
from towtank.live.driving.interlock import Stage
from towtank.live.driving.sticks import Encoder, Way
from towtank.live.links.mavlink.source import MavlinkSource
from towtank.live.links.source import Raw, Source
from towtank.live.pipeline.clock import steady_time
from towtank.live.session import Session
from towtank.planning import Guard, Plan, Segment, Space, drawn_around
from towtank.planning.coach import View
from towtank.recording.event import Event
from towtank.vehicle import Vehicle

__all__ = ["Driving", "helm_of", "link_of", "space_of"]

_DRAWN, _UNSURE = 19, 0.3  # vehicles that the guard reckons with beside the file's, and how far off they are
_SWITCH = {"drive-on": True, "drive-off": False}


def link_of(sources: Sequence[tuple[str, Source]]) -> MavlinkSource:
    """Return the link that is driven through, the first that speaks MAVLink. Raises InputError."""
    for _, source in sources:
        if isinstance(source, MavlinkSource):
            source.also(RATES, PARAMETERS)
            return source
    names = ", ".join(text for text, _ in sources)
    raise InputError(f"--drive: found {names}, expected a MAVLink source as udpin:0.0.0.0:14550")


def space_of(plan: Plan | None) -> Space:
    """Return the space that a plan is driven in. Raises InputError where it cannot be kept to."""
    if plan is None:
        raise InputError("--drive: expected --plan PLAN.toml, which says what to drive and where the walls are")
    if plan.sensors != "pose":
        raise InputError(f"--drive: the plan is for {plan.sensors}; the guard needs a pose: plan with --sensors pose")
    if plan.space is None:
        raise InputError("--drive: the plan is for open water; plan with --space, whose walls the guard keeps")
    return plan.space


def helm_of(vehicle: Vehicle, space: Space, limit: float = 1.0) -> Helm:
    """Return the helm of a vehicle in a space, compiled. Raises InputError where it cannot be driven or guarded."""
    helm = Helm(Guard.of(vehicle, space, drawn_around(vehicle, _DRAWN, _UNSURE)), limit)
    warm = Helm(Guard.of(vehicle, space, drawn_around(vehicle, 1, _UNSURE)))
    at_wall = space.eta0.copy()
    warm.anchor(0.0, at_wall)
    at_wall[0] += 0.5 * space.size[0] - warm.guard.radius - 0.5 * space.margin
    for k in range(1, 4):  # near a wall, so that everything is compiled before a vehicle moves
        warm.see(0.02 * k, at_wall)
        warm.sticks(0.04 * k, helm.guard.brake.matrix[:, :1].T * 0.0 + 0.1, 0.0)
    return helm


class Driving:
    """Drives while it is entered; the page and the terminal speak to it as to the coach.

    Args:
        session: whose links are heard. link: that commands go through. helm: that steers.
        coaching: which says what is to be driven. way: how sticks are sent.
    """

    def __init__(self, session: Session, link: MavlinkSource, helm: Helm, coaching: Coaching, way: Way) -> None:
        self._session, self._link, self._coaching = session, link, coaching
        autopilot, measured = Autopilot(session.epoch), Measured(helm.guard.vehicle)
        link.watch = autopilot.hear
        session.taps += (measured.take,)
        session.before_end += (self.close,)
        self._segment: Segment | None = None
        self._task: Task | None = None
        outside = Outside(
            send=link.send,
            encoder=self._encoder,
            parameters=lambda: link.parameters,
            task=self._wanted,
            happened=self._happened,
            sent=lambda t, data: session.keep(t, Raw("drive", "sent", t + session.epoch, data)),
        )
        self.driver = Driver(helm, autopilot, measured, way, outside, now=lambda: steady_time() - session.epoch)

    def __enter__(self) -> Self:
        self._coaching.__enter__()
        self.driver.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
        self._coaching.__exit__(*error)

    def close(self) -> None:
        """Stop thrust and end, while the links are open still."""
        self.driver.close()

    def _encoder(self, way: Way, system: int, gain: float) -> Encoder | None:
        target = self._link.target
        return None if target is None else Encoder(way, system, target, gain)

    def _wanted(self, t: float) -> Task | None:
        """Return what the coach has under way; the session's own clock is what it goes by."""
        found = self._coaching.under_way()
        if found is None:
            return None
        segment, clock = found
        if segment is not self._segment or self._task is None:
            self._segment, self._task = segment, Task(segment.wrench, clock)
        return replace(self._task, clock=clock)

    def _happened(self, text: str, fault: str) -> None:
        t = self._session.t
        self._session.events.add(Event(t if math.isfinite(t) and t > 0.0 else 0.0, "drive", text))
        if fault:
            self._coaching.ask("hold")

    # -- as the coach

    def ask(self, what: str) -> bool:
        """Do what the operator asks for; return whether that was possible.

        "drive-on", "drive-off": the switch. "drive-key", "drive-let-go": the dead-man key. All else is the coach's.
        """
        if what in _SWITCH:
            return not self.driver.switch(_SWITCH[what])
        if what == "drive-key":
            self.driver.hold()
            return True
        if what == "drive-let-go":
            self.driver.let_go()
            return True
        return self._coaching.ask(what)

    def document(self) -> dict[str, Any]:
        """Return what the page and programs are told: the plan, and how the drive stands."""
        standing = self.driver.standing
        drive = {
            "stage": standing.stage.value,
            "text": standing_text(standing),
            "held": standing.held,
            "guarded": standing.bent,
            "walls": standing.walls,
        }
        return {**self._coaching.document(), "drive": drive}

    def view(self) -> View:
        """Return what the pilot is shown on a terminal."""
        view = self._coaching.view()
        return replace(view, text=f"{view.text} {standing_text(self.driver.standing)}")


def standing_text(standing: Standing) -> str:
    """Return how a drive stands, in a sentence or two."""
    if standing.stage is Stage.OFF:
        why = f" ({standing.why})" if standing.why else ""
        return f"The drive is off{why}: bring the vehicle to the start, its bow along the tank, and switch on."
    if standing.stage is Stage.READY:
        lacks = f" Waiting: {standing.why}." if standing.why else ""
        return f"The drive is on: begin the segment, then press the key and keep it down.{lacks}"
    if standing.stage is Stage.STOPPING:
        return "Thrust is off."
    return "Driving: let go of the key to stop." + (" The guard keeps it off a wall." if standing.bent else "")
