"""A vehicle under ArduSub, simulated: it obeys sticks as ArduSub does, moves in water, and tells of itself by MAVLink.

Of ArduSub it has: MANUAL_CONTROL with the pilot's gain and RC_CHANNELS_OVERRIDE, from one system alone; the mixer of
its frame; arming and modes; the last sticks held until FS_PILOT_TIMEOUT, then neutral; message intervals and
parameters on request. As far as its sources say: no such vehicle was at hand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from towtank.core.arrays import Array
from towtank.core.attitude import euler_from_quaternion
from towtank.simulation.inputs import initial_states
from towtank.simulation.integration import simulate_pieces
from towtank.vehicle import Vehicle, configuration_matrix, thruster_forces
from towtank.vehicle.thrusters.ardusub import FRAMES

__all__ = ["MANUAL", "STABILIZE", "SimulatedSub"]

MANUAL, STABILIZE = 19, 0
_DT = 0.01  # s
_AIDED = 1 | 2 | 4 | 8 | 16 | 32
_RATES = {"HEARTBEAT": 1.0, "ATTITUDE": 4.0, "LOCAL_POSITION_NED": 3.0, "SERVO_OUTPUT_RAW": 2.0}
_RATES |= {"EKF_STATUS_REPORT": 5.0, "NAMED_VALUE_FLOAT": 2.0}
_STILL = np.full(6, 1500.0)


@dataclass
class SimulatedSub:
    """One vehicle.

    Attributes:
        vehicle: as it truly is. pose: at the start (6,) [m, rad]. frame: FRAME_CONFIG. master: system it obeys.
        gain: of the pilot. timeout: FS_PILOT_TIMEOUT [s]. noise: of place and angles [m, rad].
    """

    vehicle: Vehicle
    pose: Array
    frame: int = 2
    master: int = 255
    gain: float = 1.0
    timeout: float = 0.25
    noise: float = 1e-3
    seed: int = 0
    parameters: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = len(self.vehicle.thrusters)
        self.t, self.armed, self.mode = 0.0, True, MANUAL
        self.channels, self.heard = _STILL.copy(), -math.inf  # pitch roll throttle yaw forward lateral [us]
        self.failsafe = False
        self.got: list[tuple[float, Any]] = []
        self._state = initial_states(self.pose, np.zeros(6))
        self._lags = np.array([each.time_constant for each in self.vehicle.thrusters])
        self._forces = np.zeros(count)
        self._matrix, self._p = configuration_matrix(self.vehicle), np.array(self.vehicle.parameters)
        self._given: tuple[tuple[float, ...], Array] = ((), self._forces)
        self._rng = np.random.default_rng(self.seed)
        self._mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
        self._parser = dialect.MAVLink(None)
        self._parser.robust_parsing = True
        self._intervals = {name: 1.0 / rate for name, rate in _RATES.items()}
        self._due = dict.fromkeys(_RATES, 0.0)
        self.parameters = {
            **{f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, count + 1)},
            **{f"MOT_{n}_DIRECTION": 1.0 for n in range(1, count + 1)},
            "FRAME_CONFIG": float(self.frame), "SYSID_MYGCS": float(self.master), "FS_PILOT_INPUT": 1.0,
            "FS_PILOT_TIMEOUT": self.timeout, "JS_GAIN_DEFAULT": self.gain, "JS_THR_GAIN": 1.0,
            **self.parameters,
        }  # fmt: skip

    @property
    def eta(self) -> Array:
        """True pose (6,) [m, rad]."""
        return np.array([*self._state[:3], *euler_from_quaternion(*self._state[3:7])])

    @property
    def thrusting(self) -> bool:
        """Whether sticks are anywhere but at rest, and do something."""
        return self.armed and bool(np.abs(self.channels - _STILL).max() > 1.0)

    @property
    def outputs(self) -> Array:
        """Pulses (m,) [us]."""
        if not self.armed:
            return np.full(self._forces.size, 1500.0)
        pitch, roll, throttle, yaw, ahead, right = (self.channels - 1500.0) / 400.0
        share = FRAMES[self.frame].wrench.T @ np.array([ahead, right, -throttle, roll, pitch, yaw])
        return 1500.0 + np.rint(400.0 * share / max(float(np.abs(share).max()), 1.0))

    def advance(self, seconds: float) -> None:
        """Move on."""
        for _ in range(round(seconds / _DT)):
            self.t += _DT
            if self.t - self.heard > self.timeout and self.parameters["FS_PILOT_INPUT"] and not self.failsafe:
                self.failsafe, self.channels = True, _STILL.copy()
            aim = self._aim(tuple(self.outputs.tolist()))
            self._forces = aim + (self._forces - aim) * np.exp(-_DT / np.maximum(self._lags, 1e-6))
            tau = np.tile(self._matrix @ self._forces, (1, 3, 1))
            self._state = simulate_pieces(self._p, self._state, tau, np.array([_DT]), np.zeros(3))[-1]

    def _aim(self, outputs: tuple[float, ...]) -> Array:
        if outputs != self._given[0]:
            self._given = outputs, thruster_forces(self.vehicle, np.array(outputs))
        return self._given[1]

    def take(self, data: bytes) -> list[bytes]:
        """Take bytes; return what is answered."""
        answers = []
        for message in self._parser.parse_buffer(data) or ():
            self.got.append((self.t, message))
            kind = message.get_type()
            if kind in ("MANUAL_CONTROL", "RC_CHANNELS_OVERRIDE"):
                self._sticks(kind, message)
            elif kind == "COMMAND_LONG" and message.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
                name = dialect.mavlink_map[int(message.param1)].msgname
                known = name in self._intervals
                if known:
                    self._intervals[name] = 1e-6 * message.param2
                answers.append(self._packed(dialect.MAVLink_command_ack_message(message.command, 0 if known else 3)))
            elif kind == "PARAM_REQUEST_READ" and message.param_id in self.parameters:
                value = self.parameters[message.param_id]
                answers.append(
                    self._packed(dialect.MAVLink_param_value_message(message.param_id.encode(), value, 9, 900, 1))
                )
        return answers

    def _sticks(self, kind: str, message: Any) -> None:
        if message.get_srcSystem() != self.master:
            return
        if kind == "MANUAL_CONTROL":
            scale = 0.4 * self.gain
            found = [
                1500.0 + message.s,
                1500.0 + message.t,
                1500.0 + 0.8 * self.gain * (message.z - 500.0),
                *(1500.0 + scale * each for each in (message.r, message.x, message.y)),
            ]
        else:
            raw = [getattr(message, f"chan{n}_raw") for n in range(1, 7)]
            found = [before if each in (0, 65535) else each for each, before in zip(raw, self.channels, strict=True)]
            if all(each == 0 for each in raw):
                return
        self.channels = np.clip(np.array(found, dtype=np.float64), 1100.0, 1900.0)
        self.heard, self.failsafe = self.t, False

    def says(self) -> list[tuple[str, bytes]]:
        """Return the messages that are due, by name."""
        found = []
        for name, due in self._due.items():
            if self.t >= due - 1e-9:
                self._due[name] = max(due + self._intervals[name], self.t - self._intervals[name])
                found.append((name, self._packed(self._message(name))))
        return found

    def _message(self, name: str) -> Any:
        boot = round(1e3 * (100.0 + self.t))
        state = self._state
        noise = self.noise * self._rng.standard_normal(6)
        if name == "HEARTBEAT":
            return dialect.MAVLink_heartbeat_message(12, 3, 128 * self.armed | 1, self.mode, 4, 3)
        if name == "ATTITUDE":
            angles = np.array(euler_from_quaternion(*state[3:7])) + noise[3:]
            return dialect.MAVLink_attitude_message(boot, *angles, *state[10:13])
        if name == "LOCAL_POSITION_NED":
            return dialect.MAVLink_local_position_ned_message(boot, *(state[:3] + noise[:3]), 0.0, 0.0, 0.0)
        if name == "EKF_STATUS_REPORT":
            return dialect.MAVLink_ekf_status_report_message(_AIDED, 0.1, 0.1, 0.1, 0.1, 0.1)
        if name == "NAMED_VALUE_FLOAT":
            return dialect.MAVLink_named_value_float_message(boot, b"PilotGain", self.gain)
        pulses = [round(each) for each in self.outputs]
        return dialect.MAVLink_servo_output_raw_message(1000 * boot, 0, *pulses, *[0] * (16 - len(pulses)))

    def place(self, pose: Array) -> None:
        """Put the vehicle somewhere (6,) [m, rad], at rest."""
        self._state, self._forces = initial_states(pose, np.zeros(6)), np.zeros(self._forces.size)

    def _packed(self, message: Any) -> bytes:
        data = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return data
