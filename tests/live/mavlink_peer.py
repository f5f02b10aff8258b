"""An autopilot made of pymavlink: what it sends, and how it answers."""

from __future__ import annotations

import math
import socket
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

GRANTED, UNSUPPORTED = 0, 3


class Autopilot:
    """Encodes messages of one sender; `boot` [s] is how long it has been running at t = 0."""

    def __init__(self, system: int = 1, component: int = 1, boot: float = 100.0, version: int = 2) -> None:
        self.encoder = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        self.boot, self.version = boot, version
        self.parameters: dict[str, float] = {}
        self.refuses: tuple[int, ...] = ()
        self.intervals: dict[int, float] = {}
        self.got: list[Any] = []

    def pack(self, message: Any) -> bytes:
        data = bytes(message.pack(self.encoder, force_mavlink1=self.version == 1))
        self.encoder.seq = (self.encoder.seq + 1) % 256
        return data

    def heartbeat(self, autopilot: int = 3, kind: int = 12, armed: bool = False, mode: int = 0) -> bytes:
        return self.pack(dialect.MAVLink_heartbeat_message(kind, autopilot, 128 * armed, mode, 4, 3))

    def pressure(self, t: float, hectopascals: float) -> bytes:
        boot = round(1e3 * (self.boot + t))
        return self.pack(dialect.MAVLink_scaled_pressure2_message(boot, hectopascals, 0.0, 2000))

    def attitude(self, t: float, yaw: float = 0.0, yaw_rate: float = 0.0) -> bytes:
        boot = round(1e3 * (self.boot + t)) % 2**32
        return self.pack(dialect.MAVLink_attitude_message(boot, 0.01, -0.02, yaw, 0.0, 0.0, yaw_rate))

    def outputs(self, t: float, pulses: list[int], port: int = 0) -> bytes:
        boot = round(1e6 * (self.boot + t)) % 2**32
        sixteen = [*pulses, *[0] * (16 - len(pulses))]
        return self.pack(dialect.MAVLink_servo_output_raw_message(boot, port, *sixteen))

    def position(self, t: float, xyz: tuple[float, ...], velocity: tuple[float, ...]) -> bytes:
        boot = round(1e3 * (self.boot + t)) % 2**32
        return self.pack(dialect.MAVLink_local_position_ned_message(boot, *xyz, *velocity))

    def filter_status(self, flags: int) -> bytes:
        return self.pack(dialect.MAVLink_ekf_status_report_message(flags, 0.1, 0.1, 0.1, 0.1, 0.1))

    def answers(self, data: bytes) -> list[bytes]:
        """Return what an autopilot answers, and keep what it was told in `got`."""
        found = []
        for message in dialect.MAVLink(None).parse_buffer(data) or ():
            self.got.append(message)
            if message.get_type() == "COMMAND_LONG":
                number = int(message.param1)
                result = UNSUPPORTED if number in self.refuses else GRANTED
                if result == GRANTED:
                    self.intervals[number] = message.param2
                found.append(self.pack(dialect.MAVLink_command_ack_message(message.command, result)))
            elif message.get_type() == "PARAM_REQUEST_READ" and message.param_id in self.parameters:
                value = self.parameters[message.param_id]
                found.append(
                    self.pack(dialect.MAVLink_param_value_message(message.param_id.encode(), value, 9, 900, 1))
                )
        return found


AIDED = 1 | 2 | 4 | 8 | 16 | 32  # attitude, velocity, position relative and absolute, vertical
UNAIDED = 1 | 4 | 32 | 128  # constant position mode


def free_port(kind: socket.SocketKind = socket.SOCK_DGRAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def second(autopilot: Autopilot, start: float, flags: int = AIDED, rate: float = 20.0) -> list[tuple[float, bytes]]:
    """Return a second of a vehicle that turns: when each message is sent [s], and its bytes."""
    found = [(start, autopilot.heartbeat()), (start, autopilot.filter_status(flags))]
    for k in range(round(rate)):
        t = start + k / rate
        yaw = math.remainder(0.5 * t, math.tau)
        pulses = [1500 + 10 * n + k for n in range(1, 9)]
        ahead = (0.4 * math.cos(yaw), 0.4 * math.sin(yaw), 0.1)
        found += [
            (t, autopilot.attitude(t, yaw, 0.5)),
            (t + 0.001, autopilot.position(t + 0.001, (1.0, 2.0, 3.0), ahead)),
            (t + 0.002, autopilot.outputs(t + 0.002, pulses)),
        ]
    return found
