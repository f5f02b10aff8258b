"""What of a recording counts: the vehicle moving freely in water, under commands that are known.

A dive log begins on deck and ends there. In between the autopilot is disarmed, the vehicle comes up, lies upside down
while somebody turns it over, stands on the bottom, or the commands fall silent: forces act that no thruster gives and
no model knows. Each rule below finds such stretches by what the recording says itself; where it says nothing of the
kind (a table without states, without depth from pressure) the rule cuts nothing.

| constant | value | unit | why |
|---|---|---|---|
| SURFACE | 0.10 | m | ArduSub's own SURFACE_DEPTH: the back of a small ROV breaks the surface |
| UNDER | 0.15 | m | under water again, 5 cm deeper, as ArduSub has it: waves do not toggle it |
| DIVES | 0.5 | m | a log that goes deeper is of a vehicle that dives, whatever its thrusters |
| VERTICAL | 0.3 | - | share of a thruster's force along z with which a vehicle is made to dive |
| BRIEF | 1.0 | s | a depth above the surface for less is a spike or a splash |
| HOLDS | 2.0 | s | how long a depth or an attitude counts where the next one is missing |
| OVER | 120 | deg | between the vehicle's down and the world's; pitching to the vertical is 90 |
| LIES | 5.0 | s | on its back for longer; the tumbling runs of the pool pass through within 2.7 s |
| UPRIGHT | 0.3 | s | upright for less is noise of the attitude, not a vehicle that came round |
| MOUNTED | 0.5 | - | share of the log on its back from which it is the sensor that is mounted so |
| _SILENCE | 2.0 | s | and _INTERVALS usual intervals: commands that come steadily have fallen silent |
| _INTERVALS | 10 | - | see _SILENCE; messages get lost, ten in a row do not |
| _STEADY | 2.0 | - | most intervals (25 to 95 of 100) within this factor of the usual one: silence means something |
| _FEWEST | 20 | - | commands from which one can tell that they come steadily |
| UNCOMMANDED | 0.5 | s | motion before the first command, or after the last one, is worth a cut from here on |
| _AFTER | 3 | - | and so many usual intervals after the last one: the next ones are not merely late |
| _SHORTEST | 5.0 | s | what is left between two cuts teaches less than the state that it starts from costs |
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.recording.channel import Channel
from towtank.recording.recording import Recording
from towtank.recording.standard import ACCELERATIONS, QUATERNION, is_input
from towtank.vehicle import Vehicle

__all__ = [
    "DEPTH_BELOW_SURFACE",
    "FreeMotion",
    "LeftOut",
    "driven_down",
    "free_motion",
    "free_parts",
    "mode_names",
    "modes_of",
    "usual_interval",
]

DEPTH_BELOW_SURFACE = ("depth", "below the water's surface, by pressure")  # attribute of a recording with such a z
SURFACE, UNDER, DIVES, VERTICAL, BRIEF, HOLDS = 0.10, 0.15, 0.5, 0.3, 1.0, 2.0
OVER, LIES, UPRIGHT, MOUNTED = 120.0, 5.0, 0.3, 0.5
_SILENCE, _INTERVALS, _STEADY, _FEWEST, UNCOMMANDED, _AFTER = 2.0, 10.0, 2.0, 20, 0.5, 3.0
_SHORTEST = 5.0
SMOOTHED = 1.0  # s, over which a specific force is averaged where it tells which way is down
CUT_MODES = {
    "SURFACE": "autopilot in mode SURFACE, which comes up by itself, as after a leak",
    "MOTOR_DETECT": "autopilot in mode MOTOR_DETECT, which tries one thruster after the other and turns them round",
    "INITIALISING": "autopilot still starting (mode INITIALISING)",
}
ACROBATIC = ("ACRO",)  # modes in which a vehicle may fly on its back
DISARMED, ON_THE_BOTTOM, UPSIDE_DOWN = "disarmed", "on the bottom", "upside down"  # reasons, in words
AT_THE_SURFACE = f"at the surface or out of the water (depth below {SURFACE:g} m)"
BEFORE_COMMANDS = "before the first command"
Interval = tuple[float, float]


@dataclass(frozen=True)
class LeftOut:
    """A stretch that does not count.

    Attributes:
        start, end: [s]. kind: "disarmed", "mode", "no commands", "surface", "bottom", "upside down",
            "too short", "no motion".
        reason: in words.
    """

    start: float
    end: float
    kind: str
    reason: str

    @property
    def text(self) -> str:
        """One line: when, and why.

        >>> LeftOut(178.04, 190.0, "surface", "at the surface").text
        '178 to 190 s: at the surface'
        """
        return f"{round(self.start, 1) + 0.0:.10g} to {round(self.end, 1) + 0.0:.10g} s: {self.reason}"


@dataclass(frozen=True)
class FreeMotion:
    """What of a recording counts and what does not: both in order of time, together all of it."""

    kept: tuple[Interval, ...]
    left_out: tuple[LeftOut, ...]


def free_motion(recording: Recording, vehicle: Vehicle | None = None, within: Sequence[Interval] = ()) -> FreeMotion:
    """Return which stretches of a recording show the vehicle moving freely in water under known commands.

    Args:
        recording: as it was read; inputs under any name.
        vehicle: that made it. One that no thruster drives up or down is not left out for being at the surface, unless
            the recording goes deeper; without a vehicle the recording alone decides.
        within: stretches (start, end) [s] that are asked for, one after the other; all of the recording where omitted.
    """
    asked = list(within) or [(recording.start, recording.end)]
    kept = asked
    out: list[LeftOut] = []
    for kind, rule in _RULES:
        for a, b, reason in rule(recording, vehicle):
            cut = [(max(a, c), min(b, d)) for c, d in kept if min(b, d) > max(a, c)]
            out += [LeftOut(c, d, kind, reason) for c, d in cut]
            kept = _without(kept, (a, b))
    long = [each for each in kept if each[1] - each[0] >= _SHORTEST or each in asked]
    reason = f"less than {_SHORTEST:g} s between two that are left out"
    out += [LeftOut(a, b, "too short", reason) for a, b in kept if (a, b) not in long and b > a]
    return FreeMotion(tuple(long), tuple(sorted(out, key=lambda each: each.start)))


def free_parts(recording: Recording, vehicle: Vehicle | None = None) -> list[Recording]:
    """Return the stretches of a recording that count, each as a recording; the recording itself where all of it does.

    Raises:
        InputError: nothing of it counts.
    """
    found = free_motion(recording, vehicle)
    if not found.kept:
        reasons = "; ".join(cut.text for cut in found.left_out)
        raise InputError(f"{recording.source or 'recording'}: nothing of it counts ({reasons}); keep_all=True takes it")
    return [recording.window(*each) for each in found.kept] if found.left_out else [recording]


def _without(kept: Sequence[Interval], cut: Interval) -> list[Interval]:
    out: list[Interval] = []
    for a, b in kept:
        if cut[1] <= a or cut[0] >= b:
            out.append((a, b))
            continue
        if cut[0] > a:
            out.append((a, cut[0]))
        if cut[1] < b:
            out.append((cut[1], b))
    return out


def mode_names(recording: Recording) -> dict[int, str]:
    """Return the names of the autopilot's modes by number, as the attribute "modes" has them: "0 STABILIZE, 19 MANUAL".

    >>> from towtank.recording.channel import Channel
    >>> mode_names(Recording({"mode": Channel("mode", [0.0], [19.0], "1")}, attributes={"modes": "19 MANUAL"}))
    {19: 'MANUAL'}
    """
    return modes_of(recording.attributes)


def modes_of(attributes: Mapping[str, str]) -> dict[int, str]:
    """Return the names of modes by number out of the attributes of a recording."""
    pairs = (part.strip().partition(" ") for part in attributes.get("modes", "").split(","))
    return {int(number): name for number, _, name in pairs if number.isdigit() and name}


Found = Iterable[tuple[float, float, str]]


def _disarmed(recording: Recording, vehicle: Vehicle | None) -> Found:
    return [(a, b, DISARMED) for a, b in _while(recording, "armed", lambda armed: armed < 0.5)]


def _modes(recording: Recording, vehicle: Vehicle | None) -> Found:
    out = []
    for number, name in mode_names(recording).items():
        if name in CUT_MODES:
            out += [(a, b, CUT_MODES[name]) for a, b in _in_mode(recording, number)]
    return out


def _in_mode(recording: Recording, number: int) -> list[Interval]:
    return _while(recording, "mode", lambda modes: modes == number)


def _while(recording: Recording, name: str, holds: Callable[[Array], NDArray[np.bool_]]) -> list[Interval]:
    """Return when a state of the autopilot holds; before its first word, that counts."""
    if name not in recording or not len(channel := recording[name].measured):
        return []
    t = np.concatenate([[min(recording.start, channel.t[0])], channel.t[1:], [np.inf]])
    return _intervals(t, holds(channel.values), recording)


def _intervals(t: Array, holds: NDArray[np.bool_], recording: Recording) -> list[Interval]:
    """Return the intervals (n - 1) between times t (n,) in which something holds, neighbours joined."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], holds, [False]]).astype(np.int8)))
    ends = np.minimum(t, recording.end)
    return [(float(ends[a]), float(ends[b])) for a, b in edges.reshape(-1, 2) if ends[b] > ends[a]]


def _commands(recording: Recording, vehicle: Vehicle | None) -> Found:
    inputs = [channel.measured for name, channel in recording.channels.items() if is_input(name)]
    motion = [channel for name, channel in recording.channels.items() if _is_motion(name, channel)]
    if not any(len(each) for each in inputs) or not motion:
        return []
    stamps = np.unique(np.concatenate([each.t for each in inputs if len(each)]))
    begun = min(float(channel.t[0]) for channel in motion)
    out = []
    if stamps[0] - begun > UNCOMMANDED:
        out.append((recording.start, float(stamps[0]), BEFORE_COMMANDS))
    usual = usual_interval(stamps)
    if usual is None:
        return out
    steps = np.diff(stamps)
    for k in np.flatnonzero(steps > max(_SILENCE, _INTERVALS * usual)):
        out.append((float(stamps[k]) + usual, float(stamps[k + 1]), "no commands recorded"))
    last = float(stamps[-1])
    if max(float(channel.t[-1]) for channel in motion) - last > max(UNCOMMANDED, _AFTER * usual):
        out.append((last + usual, recording.end, "after the last command"))
    return out


def usual_interval(t: Array) -> float | None:
    """Return the usual interval [s] of commands at times t (n,) that come steadily, all the time or when they change;
    None where they are few or recorded now and then, so that silence says nothing."""
    if t.size < _FEWEST:
        return None
    steps = np.diff(t)
    short, usual, long = np.quantile(steps, (0.25, 0.5, 0.95)).tolist()
    return float(usual) if long <= _STEADY * usual and short >= usual / _STEADY else None


def _is_motion(name: str, channel: Channel) -> bool:
    return channel.frame != "" and not is_input(name) and len(channel) > 0


def _surface(recording: Recording, vehicle: Vehicle | None) -> Found:
    """Return when the vehicle, if it is one that dives, is at the surface or out of the water."""
    key, value = DEPTH_BELOW_SURFACE
    if recording.attributes.get(key) != value or "z" not in recording or not _is_made_to_dive(recording, vehicle):
        return []
    depth = recording["z"].measured
    known = np.where(depth.values < SURFACE, 1, np.where(depth.values > UNDER, -1, 0))
    latest = np.maximum.accumulate(np.where(known != 0, np.arange(known.size), 0))  # in between, what was last sure
    up = known[latest] > 0
    t = _bounded(depth.t, HOLDS, recording)
    found = _joined(_pieces(t, up), BRIEF)
    return [(a, b, AT_THE_SURFACE) for a, b in found if b - a >= BRIEF]


def _is_made_to_dive(recording: Recording, vehicle: Vehicle | None) -> bool:
    if vehicle is not None and driven_down(vehicle):
        return True
    depth = recording["z"].measured
    deep = _joined(_pieces(_bounded(depth.t, HOLDS, recording), depth.values > DIVES), BRIEF)
    return any(b - a >= BRIEF for a, b in deep)


def driven_down(vehicle: Vehicle) -> bool:
    """Whether a vehicle has a thruster that drives it up or down."""
    return any(abs(each.direction[2]) > VERTICAL for each in vehicle.thrusters)


def _bounded(t: Array, holds: float, recording: Recording) -> tuple[Array, Array]:
    """Return from when until when (n,) each sample at t (n,) counts: to the next one, or for so long [s]."""
    begin = t.copy()
    if t.size and t[0] - recording.start < holds:
        begin[0] = recording.start
    end = np.minimum(np.append(t[1:], recording.end), t + holds)
    return begin, end


def _pieces(times: tuple[Array, Array], holds: NDArray[np.bool_]) -> list[Interval]:
    """Return when samples that count from begin (n,) to end (n,) hold."""
    begin, end = times
    return [(float(a), float(b)) for a, b in zip(begin[holds], end[holds], strict=True)]


def _joined(intervals: Sequence[Interval], gap: float) -> list[Interval]:
    """Return intervals in order of time with those joined between which there is less than a gap [s]."""
    out: list[Interval] = []
    for a, b in intervals:
        if out and a - out[-1][1] < gap:
            out[-1] = (out[-1][0], max(b, out[-1][1]))
        else:
            out.append((a, b))
    return out


def _bottom(recording: Recording, vehicle: Vehicle | None) -> Found:
    return [(a, b, ON_THE_BOTTOM) for a, b in _while(recording, "bottomed", lambda state: state > 0.5)]


def _upside_down(recording: Recording, vehicle: Vehicle | None) -> Found:
    """Return when the vehicle lies on its back for longer than a tumbling one does."""
    t, upright = _uprightness(recording)
    if not t.size:
        return []
    over = upright < np.cos(np.deg2rad(OVER))
    if np.count_nonzero(over) > MOUNTED * over.size:
        return []
    found = _joined(_pieces(_bounded(t, HOLDS, recording), over), UPRIGHT)
    acrobatic = [
        interval
        for number, name in mode_names(recording).items()
        if name in ACROBATIC
        for interval in _in_mode(recording, number)
    ]
    for flown in acrobatic:
        found = _without(found, flown)
    return [(a, b, UPSIDE_DOWN) for a, b in found if b - a > LIES]


def _uprightness(recording: Recording) -> tuple[Array, Array]:
    """Return times (n,) and the cosine (n,) between the vehicle's down and the world's; by the specific force where no
    attitude is measured."""
    nothing = np.empty(0), np.empty(0)
    if all(name in recording for name in QUATERNION):
        t, (w, x, y, z) = _together(recording, QUATERNION)
        norm = w * w + x * x + y * y + z * z
        return t, np.divide(w * w - x * x - y * y + z * z, norm, out=np.ones_like(norm), where=norm > 0.0)
    if all(name in recording for name in ("phi", "theta")):
        t, (phi, theta) = _together(recording, ("phi", "theta"))
        return t, np.cos(phi) * np.cos(theta)
    if not all(name in recording for name in ACCELERATIONS):
        return nothing
    t, force = _together(recording, ACCELERATIONS)
    if t.size < 2:
        return nothing
    first, last = np.searchsorted(t, t - 0.5 * SMOOTHED), np.searchsorted(t, t + 0.5 * SMOOTHED, "right")
    total = np.vstack([np.zeros(3), np.cumsum(np.column_stack(force), axis=0)])
    mean = (total[last] - total[first]) / (last - first)[:, None]
    size = np.linalg.norm(mean, axis=1)
    return t, np.divide(-mean[:, 2], size, out=np.ones(t.size), where=size > 0.0)


def _together(recording: Recording, names: Sequence[str]) -> tuple[Array, list[Array]]:
    """Return the times at which all of some channels are measured, and their values."""
    channels = [recording[name].measured for name in names]
    t = channels[0].t
    for each in channels[1:]:
        t = t if each.t is t else np.intersect1d(t, each.t, assume_unique=True)
    return t, [each.values[np.searchsorted(each.t, t)] for each in channels]


_RULES: tuple[tuple[str, Callable[[Recording, Vehicle | None], Found]], ...] = (
    ("disarmed", _disarmed),  # of two reasons for one stretch the first is told
    ("mode", _modes),
    ("no commands", _commands),
    ("surface", _surface),
    ("bottom", _bottom),
    ("upside down", _upside_down),
)
