"""From poses and wanted wrenches to sticks: where the vehicle is in the tank, the guard, and whether it does as told.

The walls are known by the plan, the pose by whatever origin its source has. So the operator brings the vehicle to the
plan's start, its bow along the tank's length, and switches on: the pose of that moment is the start. From there the
observer follows the vehicle, and the guard bends what is wanted, every `guard`'s PERIOD; its forces become sticks,
and what these sticks really give is what guard and observer reckon with afterwards.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import rotation_from_quaternion
from towtank.live.driving.sticks import Sticks
from towtank.planning import Guard
from towtank.planning.braking import PERIOD
from towtank.planning.observer import Observer
from towtank.vehicle import thruster_forces

__all__ = ["Helm"]

_JUMP = 0.4  # m between two poses beyond what the speed limit allows in their time
_FAST = 2.0  # times the limits of speed and turn, and 1.2 times that of tilt: nothing that is guarded moves so
_LEANS = 1.2
_LONG = 1.0  # s: a longer gap explains no longer way
_GAP = 0.2  # s without a pose, after which the model of the motion is not carried on
_UNLIKE = 120.0  # us between what a thruster is told and what it gives,
_PATIENCE = 0.25  # s for so long: thrust then ends within 0.3 s,
_MEMORY = 0.5  # s that what was told may be late
_WALL = 0.02  # m


class Helm:
    """Steers one vehicle.

    Args:
        guard: of the vehicle in the plan's space. limit: of what is wanted, as a share; braking may take all.
    """

    def __init__(self, guard: Guard, limit: float = 1.0) -> None:
        self.guard, self.sticks_of, self._limit = guard, Sticks(guard), limit
        self._origin = np.full(6, np.nan)
        self._observer = Observer.of(guard.vehicle, guard.space.eta0)
        self._told: deque[tuple[float, Array]] = deque()
        self._rest = np.zeros(6)
        self._unlike = math.nan
        self._place: tuple[float, Array] | None = None
        self._wrench: Array | None = None
        self._plan = np.zeros((0, 6))
        self._due, self._given = -math.inf, self._rest
        self._fault, self._follows = "", ""
        self.bent = False

    # -- what is measured

    def anchor(self, t: float, pose: Array) -> None:
        """Take the pose (6,) [m, rad] of time t [s] as that of the plan's start."""
        self._origin = pose.copy()
        self._observer = Observer.of(self.guard.vehicle, self._in_tank(pose), t)
        self._place = None
        self.rest()
        self._fault = self._follows = ""

    def rest(self) -> None:
        """Forget what was given: thrusters at rest."""
        self.guard.reset()
        self._due, self._given, self._unlike, self.bent = -math.inf, self._rest, math.nan, False
        self._told.clear()
        self._follows = ""

    def _in_tank(self, pose: Array) -> Array:
        start, away = self.guard.space.eta0, pose - self._origin
        c, s = math.cos(self._origin[5]), math.sin(self._origin[5])
        turned = [c * away[0] + s * away[1], c * away[1] - s * away[0], away[2]]
        psi = math.remainder(away[5], math.tau)
        return np.array([*(start[:3] + turned), pose[3], pose[4], psi])

    def see(self, t: float, pose: Array) -> None:
        """Take a pose (6,) [m, rad] of time t [s]."""
        if not np.isfinite(self._origin).all():
            return
        placed = self._in_tank(pose)
        if self._place is not None and not self._fault:
            moved = float(np.linalg.norm(placed[:3] - self._place[1][:3]))
            if moved > _JUMP + _FAST * self.guard.space.speed * min(t - self._place[0], _LONG):
                self._fault = f"the pose jumped by {moved:.1f} m; switch off, and on again at the start"
        if self._place is not None and t - self._place[0] > _GAP:
            self._observer = Observer.of(self.guard.vehicle, placed, t)  # from rest: what was between is not known
        else:
            self._observer.see(t, placed)
        self._place = t, placed

    def hear(self, t: float, commands: Array) -> None:
        """Take the outputs (m,) [us] that the autopilot gives at time t [s]."""
        if not np.isfinite(self._origin).all():
            return
        self._observer.give(t, thruster_forces(self.guard.vehicle, commands))
        while len(self._told) > 1 and self._told[1][0] < t - _MEMORY:
            self._told.popleft()
        if not self._told:
            return
        apart = min(float(np.abs(commands - told).max()) for _, told in self._told)
        if apart <= _UNLIKE:
            self._unlike = math.nan
        elif math.isnan(self._unlike):
            self._unlike = t
        elif t - self._unlike > _PATIENCE:
            self._follows = f"the thrusters do not follow: {apart:.0f} us beside what they are told"

    def fault(self) -> str:
        """Return what is wrong with where and how the vehicle moves, "" for nothing."""
        if self._fault or self._follows:
            return self._fault or self._follows
        if self._place is None:
            return ""
        space, x = self.guard.space, self._observer.state
        if not np.isfinite(x).all():
            return "where the vehicle is cannot be followed"
        clearance = float(space.clearance(self._place[1][:3], self.guard.radius))
        speed, turn = float(np.linalg.norm(x[7:10])), float(np.linalg.norm(x[10:13]))
        lean = 2.0 * math.asin(min(math.hypot(x[4], x[5]), 1.0))
        if clearance < _WALL:
            return "the vehicle is at a wall"
        if speed > _FAST * space.speed or turn > _FAST * space.turn or lean > _LEANS * space.tilt:
            return f"the vehicle moves as nothing guarded does ({speed:.1f} m/s, {turn:.1f} rad/s)"
        return ""

    @property
    def walls(self) -> str:
        """How far the walls are, in words."""
        if self._place is None:
            return "not known yet"
        space, place = self.guard.space, self._place[1]
        low, high = place[:3] - space.lower, space.upper - place[:3]
        return (
            f"{high[0]:.1f} m ahead, {low[0]:.1f} behind, {high[1]:.1f} right, {low[1]:.1f} left, "
            f"{high[2]:.1f} to the bottom, {low[2]:.1f} to the surface"
        )

    # -- what is given

    def prepare(self, wrench: Array) -> bool:
        """Find the sticks of a segment (n, 6) [N, N m], some tenths of a second; return whether they were known."""
        if wrench is self._wrench:
            return True
        self._wrench, self._plan = wrench, self.sticks_of.of_wrench(self._limit * wrench)
        return False

    def sticks(self, t: float, wrench: Array | None, clock: float) -> Array | None:
        """Return the sticks (6,) of time t [s]; None where nothing is to be driven.

        Args:
            wrench: (n, 6) [N, N m] of a segment at 25 Hz, None without one. clock: seconds into it, below 0 before.
        """
        if wrench is None or clock >= len(wrench) * PERIOD:
            return None
        self.prepare(wrench)
        if t >= self._due - 0.25 * PERIOD:
            self._due = t + PERIOD if t > self._due + PERIOD else self._due + PERIOD
            self._given = self._guarded(t, self._plan[int(clock / PERIOD)] if clock >= 0.0 else None)
            self._told.append((t, self.sticks_of.commands(self._given)))
        return self._given

    def _guarded(self, t: float, wanted: Array | None) -> Array:
        """Return the sticks (6,) that the guard lets through; before a segment begins none."""
        wanted = self._rest if wanted is None else wanted
        asked = self.sticks_of.forces(wanted)
        forces = self.guard.step(self._ahead(t), asked)
        self.bent = bool(self.guard.memory.shares.any())
        if not self.bent:
            return wanted
        found = self.sticks_of.of_forces(forces)
        self.guard.memory.past[0] = self.sticks_of.forces(found)
        return found

    def _ahead(self, t: float) -> Array:
        """Return the state (13,) at time t [s]: that of the newest pose, moved on."""
        x, dt = self._observer.state, min(max(t - float(self._observer.clock[0]), 0.0), 0.3)
        x[:3] += dt * rotation_from_quaternion(x[3:7]) @ x[7:10]
        half = 0.5 * dt * x[10:13]
        w, i, j, k = x[3:7]
        x[3:7] += [
            -i * half[0] - j * half[1] - k * half[2],
            w * half[0] + j * half[2] - k * half[1],
            w * half[1] + k * half[0] - i * half[2],
            w * half[2] + i * half[1] - j * half[0],
        ]
        x[3:7] /= np.linalg.norm(x[3:7])
        return x
