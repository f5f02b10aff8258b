"""What of a stream counts: the rules of `free_motion`, decided instant by instant while it comes.

A log is judged knowing what comes afterwards; here nothing is. States of the autopilot and the first command decide at
once. A depth and an attitude decide as soon as they have lasted: until then an instant is in doubt (for a second near
the surface, for five on the back), and whoever learns holds it back. What turns out to be a splash or a tumble counts
after all. So the same stretches count as of the log, but for what only its whole length can tell:

| rule of logs | here |
|---|---|
| armed between two heartbeats that say so | from each that says so to the next: up to a second of a disarmed vehicle |
| one without vertical thrusters that ever dives | from its first dive on |
| on its back for most of the log: the sensor is mounted so | for most of what has come so far |
| commands that fall silent; after the last one | not here: who learns notices it, after the delay that it takes |
| less than 5 s between two cuts | counts: that another one follows is not known yet |
| each rule by itself | what is in doubt by one rule as another leaves out is left out with it |
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple

from towtank.recording.grids.free_motion import (
    ACROBATIC,
    AT_THE_SURFACE,
    BEFORE_COMMANDS,
    BRIEF,
    CUT_MODES,
    DEPTH_BELOW_SURFACE,
    DISARMED,
    DIVES,
    HOLDS,
    LIES,
    MOUNTED,
    ON_THE_BOTTOM,
    OVER,
    SMOOTHED,
    SURFACE,
    UNDER,
    UPRIGHT,
    UPSIDE_DOWN,
    driven_down,
    modes_of,
)
from towtank.recording.standard import ACCELERATIONS, QUATERNION, is_input
from towtank.vehicle import Vehicle

__all__ = ["Decision", "OnlineFreeMotion", "Standing"]

_OVER = math.cos(math.radians(OVER))


class Standing(Enum):
    """Whether an instant counts."""

    COUNTS = 0
    IN_DOUBT = 1
    LEFT_OUT = 2


class Decision(NamedTuple):
    """Whether an instant counts; where it does not, or may not: kind and reason as of `LeftOut`, and since when [s]."""

    standing: Standing = Standing.COUNTS
    kind: str = ""
    reason: str = ""
    since: float = math.nan


_COUNTS = Decision()


class _Lasting:
    """Notices what lasts: what holds again within `gap` [s] never ended, and what holds for less than `least` [s] is
    nothing."""

    def __init__(self, least: float, gap: float) -> None:
        self._least, self._gap = least, gap
        self._on = self._off = math.nan  # when it began, and when it ended or seems to
        self.since = math.nan

    def see(self, t: float, holds: bool) -> Standing:
        """Take whether it holds at t [s]; return LEFT_OUT where it has lasted, IN_DOUBT where that is to be seen."""
        if holds:
            self._on = t if math.isnan(self._on) else self._on
            self._off = math.nan
            self.since = self._on
            return Standing.LEFT_OUT if t - self._on >= self._least else Standing.IN_DOUBT
        if math.isnan(self._on):
            return Standing.COUNTS
        if math.isnan(self._off):
            self._off = t
            if t - self._on >= self._least:  # it lasted, and that shows only now: what was in doubt is out
                return Standing.LEFT_OUT
        if t - self._off < self._gap:
            return Standing.IN_DOUBT
        self._on = self._off = math.nan
        return Standing.COUNTS


class _Latest:
    """The latest of a quantity: it counts until the next one comes, for HOLDS seconds at most."""

    def __init__(self) -> None:
        self.holds, self._t = False, -math.inf

    def take(self, t: float, *, holds: bool) -> None:
        self.holds, self._t = holds, t

    def at(self, t: float) -> bool:
        return self.holds and t - self._t <= HOLDS


class OnlineFreeMotion:
    """Follows a stream and says of every instant whether it shows the vehicle moving freely in water.

    Args:
        vehicle: that makes it; at the surface counts for one that no thruster drives down, until it has dived.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._states: dict[str, tuple[float, float]] = {}  # state -> value, and since when [s]
        self._dives = driven_down(vehicle)
        self._deep, self._near = _Latest(), _Latest()
        self._dived, self._surfaced = _Lasting(BRIEF, BRIEF), _Lasting(BRIEF, BRIEF)
        self._upright, self._turned = _Latest(), _Lasting(LIES, UPRIGHT)
        self._told = self._over = 0  # attitudes seen, and those on the back
        self._forces: deque[tuple[float, tuple[float, float, float]]] = deque()
        self._sum = [0.0, 0.0, 0.0]
        self._by_attitude = self._commanded = False
        self._began = math.nan
        self._modes_text, self._modes = "", dict[int, str]()

    def see(self, t: float, sample: Mapping[str, float], attributes: Mapping[str, str]) -> Decision:
        """Take what was measured and commanded at t [s], by standard names; return whether that instant counts.

        Args:
            attributes: what is said of the stream, as of a recording: "modes", and that z is the depth by pressure.
        """
        self._began = t if math.isnan(self._began) else self._began
        for name in ("armed", "mode", "bottomed"):
            value = sample.get(name, math.nan)
            if value == value and self._states.get(name, (math.nan, t))[0] != value:
                self._states[name] = value, t
        self._commanded = self._commanded or any(is_input(name) for name in sample)
        by_pressure = attributes.get(DEPTH_BELOW_SURFACE[0]) == DEPTH_BELOW_SURFACE[1]
        self._take_depth(t, sample.get("z", math.nan))
        self._take_attitude(t, sample)
        self._dives = self._dives or self._dived.see(t, by_pressure and self._deep.at(t)) is Standing.LEFT_OUT
        surfaced = self._surfaced.see(t, by_pressure and self._dives and self._near.at(t))
        mode = self._mode(attributes)
        over = self._upright.at(t) and self._over <= MOUNTED * self._told and mode not in ACROBATIC
        turned = self._turned.see(t, over)
        since = {name: each[1] for name, each in self._states.items()}
        if self._state("armed", 1.0) < 0.5:
            return Decision(Standing.LEFT_OUT, "disarmed", DISARMED, since["armed"])
        if mode in CUT_MODES:
            return Decision(Standing.LEFT_OUT, "mode", CUT_MODES[mode], since["mode"])
        if not self._commanded:
            return Decision(Standing.LEFT_OUT, "no commands", BEFORE_COMMANDS, self._began)
        lasting = [
            Decision(surfaced, "surface", AT_THE_SURFACE, self._surfaced.since),
            Decision(turned, "upside down", UPSIDE_DOWN, self._turned.since),
        ]
        if self._state("bottomed", 0.0) > 0.5:
            lasting.insert(1, Decision(Standing.LEFT_OUT, "bottom", ON_THE_BOTTOM, since["bottomed"]))
        worst = max(lasting, key=lambda each: each.standing.value)  # of equals the first
        return _COUNTS if worst.standing is Standing.COUNTS else worst

    def _state(self, name: str, unknown: float) -> float:
        return self._states.get(name, (unknown, 0.0))[0]

    def _mode(self, attributes: Mapping[str, str]) -> str:
        """Return the name of the autopilot's mode, "" where it is not known."""
        if attributes.get("modes", "") != self._modes_text:
            self._modes_text, self._modes = attributes.get("modes", ""), modes_of(attributes)
        number = self._state("mode", -1.0)
        return self._modes.get(int(number), "") if math.isfinite(number) else ""

    def _take_depth(self, t: float, depth: float) -> None:
        if not math.isfinite(depth):
            return
        self._deep.take(t, holds=depth > DIVES)
        self._near.take(t, holds=depth < SURFACE or (self._near.holds and depth <= UNDER))

    def _take_attitude(self, t: float, sample: Mapping[str, float]) -> None:
        """Take the cosine between the vehicle's down and the world's, by the specific force where nothing tells it."""
        upright = math.nan
        if QUATERNION[0] in sample:
            w, x, y, z = (sample.get(name, math.nan) for name in QUATERNION)
            norm = w * w + x * x + y * y + z * z
            upright = (w * w - x * x - y * y + z * z) / norm if norm > 0.0 else math.nan
        elif "phi" in sample and "theta" in sample:
            phi, theta = sample["phi"], sample["theta"]
            upright = math.cos(phi) * math.cos(theta) if math.isfinite(phi + theta) else math.nan
        elif not self._by_attitude and all(math.isfinite(sample.get(name, math.nan)) for name in ACCELERATIONS):
            upright = self._by_force(t, sample)
        self._by_attitude = self._by_attitude or QUATERNION[0] in sample or "phi" in sample
        if upright == upright:
            self._told, self._over = self._told + 1, self._over + (upright < _OVER)
            self._upright.take(t, holds=upright < _OVER)

    def _by_force(self, t: float, sample: Mapping[str, float]) -> float:
        """Return the cosine by the mean specific force of the last second."""
        force = sample["ax"], sample["ay"], sample["az"]
        self._forces.append((t, force))
        self._sum = [total + each for total, each in zip(self._sum, force, strict=True)]
        while t - self._forces[0][0] > SMOOTHED:
            _, gone = self._forces.popleft()
            self._sum = [total - each for total, each in zip(self._sum, gone, strict=True)]
        size = math.hypot(*self._sum)
        return -self._sum[2] / size if size > 0.0 else math.nan
