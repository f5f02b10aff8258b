"""Says what to drive now and what next, follows what is really driven, and designs a new segment after each.

A segment becomes movements of the sticks: one way, so far, so long. It begins with a count-down once the pilot holds
the sticks still, or asks for it. What was driven is compared with what was asked, movement by movement, for the pilot
to see; learning itself takes what was driven, well or badly, and the next segment is designed from what is known then.
Times are the session's own [s].
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import some_of
from towtank.planning.design import design, judged
from towtank.planning.forecast import RATE, Outlook, draws_of, quantity_of
from towtank.planning.plan import Plan, aims, gentle
from towtank.planning.segments import Segment, full_wrench
from towtank.planning.space import Space
from towtank.vehicle import Vehicle, allocate, thruster_wrench
from towtank.vehicle.thrusters.curves import force_range

__all__ = [
    "AXES",
    "TRIES",
    "Coach",
    "Known",
    "Movement",
    "Next",
    "Stage",
    "View",
    "deflection",
    "movements",
    "next_segment",
]

AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_WAYS = (
    ("forward", "back"),
    ("right", "left"),
    ("down", "up"),
    ("roll right", "roll left"),
    ("nose up", "nose down"),
    ("turn right", "turn left"),
)
_COUNT = 5.0  # s of the count-down
_EARLY = 1.0  # s before its end, from which on the sticks may move
_STILL = 3.0  # s for which the sticks are held still before it begins
_CALM = 0.1  # of the largest force or moment: by which they may move meanwhile
_GONE = 1.0  # s without commands, after which nobody drives
_DELAYS = (-0.2, 0.0, 0.2, 0.4, 0.6, 0.8)  # s, by which a pilot may be late
_LATE = max(_DELAYS) + 0.4  # s after a segment, until what was driven of it has come
_SPAN, _AHEAD = 0.3, 1.0  # s over which the speed is measured; s ahead, at which a wall is near
_BEYOND = 1e6  # N, N m: more than any vehicle's thrusters make
_DONE, _SHORTEST = 0.5, 0.05  # share of a movement that counts as done; s of one that is shown
TRIES = 40  # segments that are judged while somebody waits for one
_DRAWS = 2  # vehicles that each is judged for
_ENOUGH = 0.02  # by which a segment is expected to lessen what is missing, as a share of it, to be worth driving
_DURATION = 8.0  # s of a segment, without a plan


@dataclass(frozen=True)
class Movement:
    """One movement of a stick, from `start` to `end` [s of the segment].

    Attributes:
        row: of the wrench, 0..5 for X .. N. amount: of the full stick, -1 .. 1; above 0 as in FRD.
        force: that it stands for [N, N m], with its sign.
    """

    row: int
    start: float
    end: float
    amount: float
    force: float

    @property
    def text(self) -> str:
        """In words, as "forward 60 %"."""
        return f"{_WAYS[self.row][self.amount < 0.0]} {100.0 * abs(self.amount):.0f} %"


def deflection(vehicle: Vehicle, row: int, force: float) -> float:
    """Return how far a stick is moved for a force or moment along one axis [N, N m], as a share of the full stick.

    Sticks move commands in proportion, and the full stick is where the first of the thrusters is at its limit; without
    limits it is what `full_wrench` says.
    """
    limited = all(math.isfinite(each) for thruster in vehicle.thrusters for each in force_range(thruster.curve))
    wrench = np.zeros((2, 6))
    wrench[:, row] = force, math.copysign(_BEYOND if limited else full_wrench(vehicle)[row], force)
    rest = np.array([thruster.curve.rest for thruster in vehicle.thrusters])
    asked, full = np.abs(allocate(vehicle, wrench) - rest).max(axis=1)
    return math.copysign(min(asked / full, 1.0) if full > 0.0 else 0.0, force)


def movements(segment: Segment, vehicle: Vehicle) -> tuple[Movement, ...]:
    """Return the movements of a segment in the order of their starts; of a wave each half, at its largest."""
    out = []
    wrench = segment.wrench
    for row in segment.rows:
        way = np.sign(wrench[:, row])
        turns = np.flatnonzero(np.diff(way)) + 1
        for first, last in zip([0, *turns], [*turns, way.size], strict=True):
            largest = float(np.abs(wrench[first:last, row]).max()) * float(way[first])
            if largest and (last - first) / RATE >= _SHORTEST:
                amount = deflection(vehicle, row, largest)
                out.append(Movement(row, float(first / RATE), float(last / RATE), amount, largest))
    return tuple(sorted(out, key=lambda each: (each.start, each.row)))


class Stage(StrEnum):
    """Where the pilot stands."""

    BRING = "bring"  # the vehicle back to the start, and hold the sticks still
    COUNT = "count"  # the segment begins in a moment
    DRIVE = "drive"
    THINK = "think"  # the next segment is being designed
    HELD = "held"  # by the pilot
    MET = "met"  # all that is wanted is known
    OVER = "over"  # nothing more to be had


@dataclass(frozen=True)
class Known:
    """How well a wanted coefficient is known now, as a share of its size; NaN where nothing is known yet."""

    name: str
    share: float
    met: bool


@dataclass(frozen=True)
class View:
    """What a pilot is shown.

    Attributes:
        stage: text: a line that says what to do. clock: seconds into the segment, below 0 in the count-down; NaN where
            none is under way.
        number: of the segment that is driven or comes next, from 1. planned: of how many, as far as foreseen.
        duration: of it [s]. movements: of it. done: what was driven of those that are over, shares in their order.
        known: the wanted coefficients. accuracy: that is wanted, a share. seconds: manoeuvred so far.
        offset: (3,) [m] to the start: ahead, right, down; empty where the place is not measured.
    """

    stage: Stage
    text: str
    clock: float
    number: int
    planned: int
    duration: float
    movements: tuple[Movement, ...]
    done: tuple[float, ...]
    known: tuple[Known, ...]
    accuracy: float
    seconds: float
    offset: tuple[float, ...] = ()

    def now_and_next(self, row: int) -> tuple[Movement | None, Movement | None]:
        """Return the movement of an axis that is under way, and the one after it."""
        own = [each for each in self.movements if each.row == row]
        t = self.clock if math.isfinite(self.clock) else -math.inf
        now = next((each for each in own if each.start <= t < each.end), None)
        return now, next((each for each in own if each.start > t), None)


@dataclass(frozen=True)
class Next:
    """What comes after a segment.

    Attributes:
        shares: how well each wanted coefficient is known, as a share of its size. unmet: those that are not yet.
        segment: to be driven; None where all is known, or more driving would hardly tell more.
        more: how many are foreseen after it.
    """

    shares: Mapping[str, float]
    unmet: tuple[str, ...]
    segment: Segment | None = None
    more: int = 0


def next_segment(
    model: Vehicle,
    wanted: tuple[str, ...],
    accuracy: float,
    *,
    sensors: str,
    plan: Plan | None = None,
    seed: int = 0,
    tries: int = TRIES,
) -> Next:
    """Return the segment that makes most known of what is not known yet: a matter of seconds.

    Args:
        model: what is known by now, with its covariance. accuracy: that is wanted, a share. sensors: as `Outlook.of`.
        plan: whose space, duration and way of driving are kept to; without one, open water and a pilot.
        tries: segments that are judged.

    Raises:
        InputError: the model cannot be planned for.
    """
    outlook = Outlook.of(model, sensors)
    known = outlook.known
    shares = {
        name: math.sqrt(float(known.covariance[k, k])) / quantity_of(outlook.vehicle, name)
        for k, name in enumerate(known.names)
        if name in wanted
    }
    unmet = tuple(name for name in wanted if shares.get(name, 0.0) > accuracy)
    if not unmet:
        return Next(shares, unmet)
    best = design(
        outlook,
        aims(outlook.vehicle, unmet),
        space=None if plan is None else plan.space,
        duration=_DURATION if plan is None else plan.segments[-1].segment.duration,
        draws=_DRAWS,
        tries=tries,
        seed=seed,
        by_hand=plan is None or plan.by_hand,
    )
    if plan is not None and plan.space is not None and not plan.pose:
        radius, soft = plan.space.require_room(outlook.vehicle), gentle(outlook, best.segment, plan.space)
        vehicles = draws_of(outlook, _DRAWS, seed)
        best = judged(outlook, aims(outlook.vehicle, unmet), soft, vehicles, plan.space, radius) or best
    missing = sum(math.log(shares[name] / accuracy) for name in unmet)
    left = sum(max(math.log(share / accuracy), 0.0) for share in best.forecasts[0].relative(unmet))
    if left > (1.0 - _ENOUGH) * missing:
        return Next(shares, unmet)
    return Next(shares, unmet, best.segment, 0 if left == 0.0 else 1)


class _Place:
    """Where the vehicle is, as seen from where it began.

    It began at the start of the space, heading along its length: the frame in which poses are measured does not count.
    """

    def __init__(self, space: Space | None, radius: float) -> None:
        self._space, self._radius = space, radius
        self._pose = self._home = np.full(6, np.nan)
        self._track: deque[tuple[float, Array]] = deque(maxlen=200)

    def see(self, t: float, pose: Array) -> None:
        """Take a pose (6,), NaN where not measured."""
        self._pose = np.where(np.isfinite(pose), pose, self._pose)
        if np.isfinite(pose[:3]).all():
            self._track.append((t, self._pose[:3]))

    def begin(self) -> None:
        """Take the present place for the start, if none is known yet."""
        if not np.isfinite(self._home[:3]).all():
            self._home = self._pose.copy()

    @property
    def offset(self) -> tuple[float, ...]:
        """(3,) [m] to the start: ahead, right, down; empty where the place is not measured."""
        away = self._home[:3] - self._pose[:3]
        if not (np.isfinite(away).all() and math.isfinite(self._pose[5])):
            return ()
        return _turned(away, self._pose[5])

    def nears_a_wall(self, t: float) -> bool:
        """Whether the vehicle is within a second of the margin that is to stay free."""
        if self._space is None or not np.isfinite(self._home).all():
            return False
        recent = [(at, place) for at, place in self._track if t - _SPAN <= at]
        if len(recent) < 2 or recent[-1][0] <= recent[0][0]:
            return False
        speed = (recent[-1][1] - recent[0][1]) / (recent[-1][0] - recent[0][0])
        soon = recent[-1][1] + _AHEAD * speed - self._home[:3]
        now = recent[-1][1] - self._home[:3]
        places = self._space.eta0[:3] + np.array([_turned(now, self._home[5]), _turned(soon, self._home[5])])
        clearance = self._space.clearance(places, self._radius)
        return bool(clearance[1] < self._space.margin and clearance[1] < clearance[0])


def _turned(way: Array, psi: float) -> tuple[float, float, float]:
    """Return a way (3,), NED, as ahead, right and down of a heading [rad]."""
    c, s = math.cos(psi), math.sin(psi)
    return float(c * way[0] + s * way[1]), float(c * way[1] - s * way[0]), float(way[2])


class Coach:
    """Leads a pilot through segments; any thread may call it.

    Args:
        vehicle: that is driven. wanted: coefficients. accuracy: that they are to be known to, a share.
        segments: that are foreseen; the first is driven, each later one unless `offer` brings a better one.
        space: whose walls end a segment that comes too close to them; None for open water.
        waits: begin a segment only when the pilot asks for it.

    Raises:
        InputError: the vehicle has no room in the space.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        wanted: tuple[str, ...],
        accuracy: float,
        segments: tuple[Segment, ...] = (),
        *,
        space: Space | None = None,
        waits: bool = False,
    ) -> None:
        self._vehicle, self._accuracy, self._waits = vehicle, accuracy, waits
        self._place = _Place(space, 0.0 if space is None else space.require_room(vehicle))
        self._foreseen = deque(segments)
        self._full = np.where(full_wrench(vehicle) > 0.0, full_wrench(vehicle), np.inf)
        self._known = tuple(Known(name, math.nan, met=False) for name in wanted)
        self._stage = Stage.BRING if segments else Stage.THINK
        self._segment: Segment | None = None
        self._movements: tuple[Movement, ...] = ()
        self._take(self._foreseen.popleft() if segments else None)
        self._starts = math.nan
        self._number, self._seconds, self._left_in = 1, 0.0, len(segments)
        self._driven: deque[tuple[float, Array]] = deque(maxlen=20_000)
        self._shares: tuple[float, ...] = ()
        self._able = ""
        self._asked_for = False
        self._lock = threading.RLock()

    # -- what is seen

    def see(self, t: float, arguments: Mapping[str, object]) -> None:
        """Take the arguments of `Learner.update` of time t [s]; called by the thread that learns."""
        if "commands" in arguments:
            wrench = thruster_wrench(self._vehicle, arguments["commands"], arguments.get("voltage"))  # type: ignore[arg-type]
        elif "wrench" in arguments:
            wrench = np.nan_to_num(np.asarray(arguments["wrench"], dtype=np.float64))
        else:
            wrench = None
        pose = arguments.get("pose")
        with self._lock:
            if wrench is not None:
                self._driven.append((t, wrench))
            if pose is not None:
                self._place.see(t, np.asarray(pose, dtype=np.float64))

    def tick(self, t: float, able: str = "") -> str:
        """Go on to time t [s]; return what happened, "" for nothing.

        Args:
            able: why nothing can be driven, "" where it can.
        """
        with self._lock:
            self._able = able
            if self._stage is Stage.BRING and self._segment is not None and not able:
                if self._asked_for or (not self._waits and self._is_still(t)):
                    self._stage, self._starts, self._shares = Stage.COUNT, t + _COUNT, ()
            elif self._stage is Stage.COUNT:
                early = t >= self._starts - _EARLY
                if able or not (early or self._asked_for or self._is_still(t)):
                    self._stage, self._starts = Stage.BRING, math.nan
                elif t >= self._starts:
                    self._stage, self._asked_for = Stage.DRIVE, False
                    self._place.begin()
                    return f"segment {self._number} begins"
            elif self._stage is Stage.DRIVE and self._segment is not None:
                end = self._starts + self._segment.duration
                why = able or (t < end and self._place.nears_a_wall(t) and "a wall is near")
                if why:
                    self._end_segment(t)
                    return f"segment {self._number - 1} broken off: {why}"
                if t >= end + _LATE:
                    self._end_segment(end)
                    done = [share for share in self._shares if share >= _DONE]
                    return f"segment {self._number - 1} driven: {len(done)} of {len(self._shares)} movements done"
                self._shares = self._done(t)
            return ""

    def _end_segment(self, t: float) -> None:
        self._seconds += max(t - self._starts, 0.0)
        self._shares = self._done(math.inf)
        self._number += 1
        self._stage, self._starts = Stage.THINK, math.nan

    def _is_still(self, t: float) -> bool:
        """Whether commands come, and have hardly changed for some seconds."""
        recent = []
        for at, wrench in reversed(self._driven):
            if at < t - _STILL:
                break
            recent.append((at, wrench))
        if len(recent) < 3 or recent[0][0] < t - _GONE or recent[-1][0] > t - 0.5 * _STILL:
            return False
        values = np.array([wrench for _, wrench in recent]) / self._full
        return bool(np.ptp(values, axis=0).max() <= 2.0 * _CALM)

    def _done(self, t: float) -> tuple[float, ...]:
        """Return how much of each movement that is over by t [s] was driven, 1 for all of it, however late."""
        over = [each for each in self._movements if self._starts + each.end + max(_DELAYS) <= t]
        if len(over) == len(self._shares) or not self._driven:
            return self._shares
        driven = [(at, wrench) for at, wrench in self._driven if at >= self._starts - _GONE]
        if not driven:
            return (0.0,) * len(over)
        stamps, values = np.array([at for at, _ in driven]), np.array([wrench for _, wrench in driven])
        return tuple(self._share(each, stamps, values) for each in over)

    def _share(self, movement: Movement, stamps: Array, values: Array) -> float:
        n = max(round((movement.end - movement.start) * RATE), 1)
        at = self._starts + movement.start + (np.arange(n) + 0.5) / RATE
        best = 0.0
        for delay in _DELAYS:
            k = np.searchsorted(stamps, at + delay, "right") - 1
            held = np.where(k >= 0, values[np.maximum(k, 0), movement.row], 0.0)
            best = max(best, float(held.mean()) / movement.force)
        return best

    # -- what is known, and what comes next

    @property
    def thinks(self) -> bool:
        """Whether a new segment is waited for, `offer`."""
        with self._lock:
            return self._stage is Stage.THINK

    @property
    def foresees(self) -> bool:
        """Whether there is another segment than the present one, should nobody offer any."""
        with self._lock:
            return bool(self._foreseen)

    @property
    def may_change(self) -> bool:
        """Whether another segment may be offered, since none is counted down or driven."""
        with self._lock:
            return self._stage in (Stage.THINK, Stage.BRING, Stage.MET, Stage.OVER) and not self._asked_for

    @property
    def wanted(self) -> tuple[str, ...]:
        """The coefficients that are wanted."""
        return tuple(each.name for each in self._known)

    @property
    def accuracy(self) -> float:
        """To what they are to be known, a share."""
        return self._accuracy

    def learn(self, shares: Mapping[str, float]) -> None:
        """Take how well coefficients are known now, as shares of their size."""
        with self._lock:
            self._known = tuple(
                replace(each, share=share, met=bool(share <= self._accuracy))
                for each in self._known
                for share in [float(shares.get(each.name, math.nan))]
            )

    def offer(self, found: Next | None) -> str:
        """Take what comes next; None: the segment that was foreseen. Return what that means, "" where it is driven.

        Nothing is taken while a segment is counted down, driven or held.
        """
        with self._lock:
            if not self.may_change:
                return ""
            if found is not None:
                self.learn(found.shares)
            foreseen = self._foreseen.popleft() if self._foreseen else None
            segment = foreseen if found is None else found.segment
            more = len(self._foreseen) if found is None else found.more
            self._left_in = self._number + more
            self._take(segment)
            before = self._stage
            if segment is not None:
                self._stage = Stage.BRING
            else:
                self._stage = Stage.OVER if found is None or found.unmet else Stage.MET
            return "" if self._stage in (Stage.BRING, before) else self._text(math.nan, ())

    def _take(self, segment: Segment | None) -> None:
        self._segment = segment
        self._movements = () if segment is None else movements(segment, self._vehicle)

    # -- what the pilot asks for

    def ask(self, what: str) -> bool:
        """Do what the pilot asks for: "begin" the count-down, "hold", go "on"; return whether that was possible."""
        with self._lock:
            if what == "begin" and self._stage in (Stage.BRING, Stage.HELD) and self._segment is not None:
                self._stage, self._asked_for = Stage.BRING, True
            elif what == "hold" and self._stage in (Stage.BRING, Stage.COUNT):
                self._stage, self._asked_for, self._starts = Stage.HELD, False, math.nan
            elif what == "hold" and self._stage is Stage.DRIVE:
                self._end_segment(self._driven[-1][0] if self._driven else self._starts)
            elif what == "on" and self._stage is Stage.HELD:
                self._stage = Stage.BRING
            else:
                return False
            return True

    # -- what is shown

    def under_way(self, t: float) -> tuple[Segment, float] | None:
        """Return the segment that is counted down to or driven at time t [s], and seconds into it; None without one."""
        with self._lock:
            if self._segment is None or self._stage not in (Stage.COUNT, Stage.DRIVE):
                return None
            return self._segment, t - self._starts

    def view(self, t: float) -> View:
        """Return what the pilot is shown at time t [s]."""
        with self._lock:
            duration = 0.0 if self._segment is None else self._segment.duration
            clock = t - self._starts if self._stage in (Stage.COUNT, Stage.DRIVE) else math.nan
            offset = self._place.offset
            return View(
                self._stage,
                self._text(t, offset),
                clock,
                self._number,
                max(self._left_in, self._number if self._segment is not None else 0),
                duration,
                self._movements,
                self._shares,
                self._known,
                self._accuracy,
                self._seconds,
                offset,
            )

    def _text(self, t: float, offset: tuple[float, ...]) -> str:
        which = f"segment {self._number}"
        unmet = [each.name for each in self._known if not each.met]
        wait = self._starts - t if math.isfinite(self._starts) else 0.0
        left = wait + (0.0 if self._segment is None else self._segment.duration)
        texts = {
            Stage.THINK: "Stop, and bring the vehicle back to the start; the next segment is being designed.",
            Stage.HELD: f"Held. Go on, or begin {which}, when you are ready.",
            Stage.MET: f"All {len(self._known)} coefficients are known to {100.0 * self._accuracy:g} %.",
            Stage.OVER: f"More driving would hardly tell more of {some_of(unmet, 3)}.",
            Stage.COUNT: f"Segment {self._number} begins in {max(math.ceil(wait), 0)}.",
            Stage.DRIVE: f"Drive {which}: {left:.0f} s left." if left > 0.0 else "Let go of the sticks.",
        }
        if self._stage in texts:
            return texts[self._stage]
        if self._able:
            return f"Waiting: {self._able}."
        where = f" ({offset_text(offset)})" if offset and max(abs(each) for each in offset) > 0.1 else ""
        back = "to its start, heading along the tank" if self._number == 1 else "back to the start"
        then = "press Begin" if self._waits else f"hold the sticks still for {_STILL:.0f} s"
        return f"Bring the vehicle {back}{where}, then {then}."


def offset_text(offset: tuple[float, ...]) -> str:
    """Return the way to the start in words, as "1.2 m ahead, 0.4 m left"."""
    words = (("ahead", "back"), ("right", "left"), ("down", "up"))
    parts = [
        f"{abs(each):.1f} m {pair[each < 0.0]}" for each, pair in zip(offset, words, strict=True) if abs(each) > 0.05
    ]
    return ", ".join(parts) or "at the start"
