"""From forces to the pilot's sticks as ArduSub mixes them, and the messages that carry sticks.

In MANUAL mode ArduSub adds, for each motor, the sticks times the factors of its frame, and gives 1500 us plus 400 us
times the sum (`AP_Motors6DOF`; sums beyond 1 are scaled down). So the sticks for commands c are the least squares of
F s = (c - 1500) / 400 with F (n, 6) the frame's signs. Sticks have no internal forces: of what a guard asks for, as
much is given as sticks can say.

MANUAL_CONTROL: x forward, y right, r to starboard -1000 .. 1000, z up 0 .. 1000 with 500 at rest; these are multiplied
by the pilot's gain, z by JS_THR_GAIN besides; s (nose up) and t (roll to starboard) are microseconds to be added to
1500, without gain, from ArduSub 4.1 on. RC_CHANNELS_OVERRIDE: channels 1 to 6 are pitch, roll, throttle, yaw, forward
and lateral, 1100 .. 1900 us, without gain; 0 lets go of a channel, 65535 leaves it alone. Both count only from the
system that SYSID_MYGCS (later MAV_GCS_SYSID) names.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.planning import Guard
from towtank.readers.mavlink.senders import Sender
from towtank.vehicle import Vehicle, thruster_commands, thruster_forces, thruster_wrench
from towtank.vehicle.thrusters.ardusub import FRAMES, Frame
from towtank.vehicle.thrusters.wrench import allocate, configuration_matrix

__all__ = ["Encoder", "Sticks", "Way"]

_NEUTRAL, _FULL = 1500.0, 400.0  # us
_ALIKE = 0.7  # cosine between what a motor of a frame and a thruster of the vehicle do
_COMPONENT = 190  # MAV_COMP_ID_MISSIONPLANNER, as ground stations have
_IGNORE, _LET_GO = 65535, 0  # us, of a channel
_PITCH_AND_ROLL = 0b11  # enabled_extensions: s and t
_ROUNDS = 6  # of the search for sticks that make a wrench
_GRID = 4097  # steps of force, of the curves' inverse
_NOTHING = 1e-6  # N: no force at all, which a step of the grid would miss by a dead band


class Way(StrEnum):
    """How sticks are sent."""

    MANUAL = "manual"
    RC = "rc"


class Sticks:
    """What sticks (6,) do with a vehicle: as shares of the full way, in the order and sense of X Y Z K M N.

    Args:
        guard: of the vehicle, which says what each thruster can do.

    Attributes:
        frame: of ArduSub whose motors the thrusters are; number: its FRAME_CONFIG.

    Raises:
        InputError: the thrusters are those of no frame, or are not driven by pulses.
    """

    def __init__(self, guard: Guard) -> None:
        vehicle = guard.vehicle
        self.number, self.frame = _frame_of(vehicle)
        self._vehicle, self._F = vehicle, self.frame.wrench.T
        self._inverse = np.linalg.pinv(self._F)
        low, high = guard.brake.low, guard.brake.high
        self._low, self._high = low, high
        self._rest = np.array([each.curve.rest for each in vehicle.thrusters])
        grid = np.linspace(low, high, _GRID)
        self._commands, self._columns = thruster_commands(vehicle, grid), np.arange(low.size)

    def commands(self, sticks: Array) -> Array:
        """Return the pulses (..., m) [us] that sticks (..., 6) give."""
        share = sticks @ self._F.T
        return np.asarray(_NEUTRAL + _FULL * share / np.maximum(np.abs(share).max(axis=-1, keepdims=True), 1.0))

    def forces(self, sticks: Array) -> Array:
        """Return the forces (..., m) [N] that sticks (..., 6) give in the end."""
        return np.clip(thruster_forces(self._vehicle, self.commands(sticks)), self._low, self._high)

    def of_forces(self, forces: Array) -> Array:
        """Return the sticks (6,) that come nearest to forces (m,) [N]."""
        share = (forces - self._low) / (self._high - self._low)
        rows = np.clip(np.rint(share * (_GRID - 1)), 0, _GRID - 1).astype(np.intp)
        commands = np.where(np.abs(forces) < _NOTHING, self._rest, self._commands[rows, self._columns])
        return self._of_commands(commands)

    def of_wrench(self, wrench: Array) -> Array:
        """Return the sticks (n, 6) that make a wrench (n, 6) [N, N m] as nearly as the mixer can."""
        wanted = np.asarray(wrench, dtype=np.float64)
        aim, sticks, best = wanted.copy(), np.zeros_like(wanted), np.full(len(wanted), np.inf)
        scale = np.maximum(np.abs(thruster_wrench(self._vehicle, self.commands(np.eye(6)))).max(axis=0), 1e-9)
        for _ in range(_ROUNDS):  # curves are not alike both ways, so that what a pattern of pulses makes is not it
            tried = self._of_commands(allocate(self._vehicle, aim))
            lacks = wanted - thruster_wrench(self._vehicle, self.commands(tried))
            error = np.abs(lacks / scale).max(axis=1)
            better = error < best
            sticks[better], best[better] = tried[better], error[better]
            aim = aim + 0.7 * lacks
        return sticks

    def _of_commands(self, commands: Array) -> Array:
        sticks = (commands - _NEUTRAL) / _FULL @ self._inverse.T
        most = np.maximum(np.abs(sticks @ self._F.T).max(axis=-1, keepdims=True), 1.0)
        return np.asarray(np.clip(sticks / most, -1.0, 1.0))


def _frame_of(vehicle: Vehicle) -> tuple[int, Frame]:
    for thruster in vehicle.thrusters:
        if thruster.curve.rest != _NEUTRAL or thruster.curve.limits is None:
            raise InputError(
                f"--drive: {vehicle.name}: thruster {thruster.name} rests at {thruster.curve.rest:g}, expected pulses "
                "about 1500 us with limits: only vehicles under ArduSub are driven"
            )
    table = configuration_matrix(vehicle)
    for number, frame in FRAMES.items():
        if len(frame.motors) == table.shape[1] and _least_alike(frame.wrench, table) >= _ALIKE:
            return number, frame
    names = ", ".join(each.name for each in FRAMES.values())
    raise InputError(
        f"--drive: {vehicle.name}: its {table.shape[1]} thrusters are, in their order and sense, the motors of none of "
        f"ArduSub's frames ({names}); without that nobody knows what a stick does"
    )


def _least_alike(frame: Array, vehicle: Array) -> float:
    """Return the least cosine between what motors and thrusters do, one by one, arms alike."""
    arms = np.abs(vehicle[3:]).max(axis=1)
    columns = vehicle / np.concatenate([np.ones(3), np.where(arms > 1e-3, arms, 1.0)])[:, None]
    columns = np.where(np.abs(columns) > 0.3 * np.abs(columns).max(axis=0), np.sign(columns), 0.0)
    rows = np.sign(frame)
    lengths = np.linalg.norm(rows, axis=0) * np.linalg.norm(columns, axis=0)
    return float(((rows * columns).sum(axis=0) / np.maximum(lengths, 1e-9)).min())


class Encoder:
    """Makes the messages.

    Args:
        way: how sticks are sent. system: that we speak as. target: autopilot. gain: of the pilot's z axis,
            JS_THR_GAIN.
    """

    def __init__(self, way: Way, system: int, target: Sender, gain: float = 1.0) -> None:
        from pymavlink.dialects.v20 import ardupilotmega

        self._dialect: Any = ardupilotmega
        self._encoder = ardupilotmega.MAVLink(None, srcSystem=system, srcComponent=_COMPONENT)
        self.way, self.system, self.target, self._gain = way, system, target, gain

    def sticks(self, sticks: Array) -> bytes:
        """Return the message of sticks (6,)."""
        x, y, z, roll, pitch, yaw = (min(max(float(each), -1.0), 1.0) for each in sticks)
        if self.way is Way.RC:
            channels = [round(_NEUTRAL + _FULL * each) for each in (pitch, roll, -z, yaw, x, y)]
            return self._override(channels)
        up = min(max(-z / self._gain, -1.0), 1.0)
        return self._packed(
            self._dialect.MAVLink_manual_control_message(
                self.target.system, round(1000 * x), round(1000 * y), round(500 + 500 * up), round(1000 * yaw), 0,
                0, _PITCH_AND_ROLL, round(_FULL * pitch), round(_FULL * roll),
            )
        )  # fmt: skip

    def neutral(self) -> bytes:
        """Return the message of sticks at rest."""
        return self.sticks(np.zeros(6))

    def release(self) -> bytes:
        """Return the message that lets go of overridden channels."""
        return self._override([_LET_GO] * 6)

    def _override(self, channels: list[int]) -> bytes:
        return self._packed(
            self._dialect.MAVLink_rc_channels_override_message(*self.target, *channels, _IGNORE, _IGNORE)
        )

    def _packed(self, message: Any) -> bytes:
        data = bytes(message.pack(self._encoder))
        self._encoder.seq = (self._encoder.seq + 1) % 256
        return data
