"""What towtank says on a MAVLink link, which is little: nothing here commands a vehicle (`live.driving` does).

It asks the autopilot to send some messages more often, and for the values of some parameters; where nothing comes
until somebody speaks it sends a heartbeat. There is no code here for anything else. It speaks as a system of its own,
254, not as the pilot's ground station, 255: the autopilot's watch over the pilot's link must not be lulled by us.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from towtank.live.links.mavlink.frames import Frame
from towtank.readers.mavlink.senders import Sender

__all__ = ["SYSTEM", "Requests", "parameter_of"]

SYSTEM, _COMPONENT = 254, 190  # of our own; MAV_COMP_ID_MISSIONPLANNER, as ground stations have
_GROUND_STATION, _NO_AUTOPILOT, _ACTIVE = 6, 8, 4  # MAV_TYPE, MAV_AUTOPILOT, MAV_STATE
_SET_INTERVAL = 511  # MAV_CMD_SET_MESSAGE_INTERVAL
_ANSWERS = {0: "granted", 1: "refused for now", 2: "refused", 3: "not known", 4: "failed"}  # MAV_RESULT
_IN_PROGRESS = 5
_RATES = {  # Hz
    "SERVO_OUTPUT_RAW": 50.0, "ATTITUDE": 50.0, "LOCAL_POSITION_NED": 50.0, "RAW_IMU": 50.0, "SCALED_PRESSURE2": 20.0,
    "EKF_STATUS_REPORT": 5.0, "SYS_STATUS": 2.0,
}  # fmt: skip
_BYTES = 48.0  # of a message, about
_SHARE = 0.5  # of a slow line that may be filled
_SLOWEST = 2.0  # Hz
_PARAMETERS = (
    *(f"SERVO{n}_FUNCTION" for n in range(1, 17)),
    *(f"MOT_{n}_DIRECTION" for n in range(1, 13)),
    "BARO_PRIMARY", "BARO1_GND_PRESS", "BARO2_GND_PRESS", "BARO3_GND_PRESS", "BARO_SPEC_GRAV",
    "VISO_POS_X", "VISO_POS_Y", "VISO_POS_Z", "GPS_TYPE", "GPS1_TYPE",
)  # fmt: skip
_PATIENCE = 1.0  # s until something is asked again
_ATTEMPTS = 4
_AT_ONCE = 8  # parameters
_SILENCE = 3.0  # s without a message, after which a heartbeat may be what is missing
_BEAT = 1.0  # s
_DENORMAL = 1e-37


@dataclass
class _Asked:
    """One question: when it was put last, how often, and what the answer was."""

    last: float = -1e9
    attempts: int = 0
    answer: str = ""

    def due(self, now: float) -> bool:
        return not self.answer and self.attempts < _ATTEMPTS and now - self.last >= _PATIENCE

    def put(self, now: float) -> None:
        self.last, self.attempts = now, self.attempts + 1

    @property
    def settled(self) -> bool:
        return bool(self.answer) or self.attempts >= _ATTEMPTS


class Requests:
    """Puts the questions, again where no answer comes, and keeps the answers.

    Args:
        speaks_first: whether nothing comes until we have spoken.
        bandwidth: of the link [bytes/s], 0 where it is plenty.
        silent: say nothing at all.

    Attributes:
        silent: nothing is said.
    """

    def __init__(self, *, speaks_first: bool, bandwidth: float = 0.0, silent: bool = False) -> None:
        from pymavlink.dialects.v20 import ardupilotmega

        self._dialect: Any = ardupilotmega
        self._encoder = ardupilotmega.MAVLink(None, srcSystem=SYSTEM, srcComponent=_COMPONENT)
        self._numbers = {kind.msgname: number for number, kind in ardupilotmega.mavlink_map.items()}
        self._speaks_first, self.silent = speaks_first, silent
        need = _BYTES * sum(_RATES.values())
        slower = min(1.0, _SHARE * bandwidth / need) if bandwidth else 1.0
        self.asked = {name: max(_SLOWEST, slower * rate) for name, rate in _RATES.items()}
        self.parameters: dict[str, float] = {}
        self.target: Sender | None = None
        self._wanted = _PARAMETERS
        self._version = 2
        self._beat = -1e9
        self._begin()

    def _begin(self) -> None:
        self._rates = {name: _Asked() for name in self.asked}
        self._reads = {name: _Asked() for name in self._wanted}

    def also(self, rates: Mapping[str, float], parameters: Sequence[str]) -> None:
        """Ask for further messages [Hz] and parameters."""
        self.asked |= rates
        self._wanted = (*parameters, *self._wanted)
        self._begin()

    def begin_anew(self) -> None:
        """Ask for everything again: the autopilot has started anew and forgotten the rates."""
        self._begin()

    def aim(self, target: Sender, version: int) -> None:
        """Ask this autopilot, in this version of MAVLink."""
        if target != self.target:
            self.target, self._version = target, version
            self.parameters = {}
            self._begin()

    @property
    def settled(self) -> bool:
        """Whether nothing more can be expected of the parameters."""
        return self.silent or all(each.settled for each in self._reads.values())

    def due(self, now: float, heard: float) -> list[bytes]:
        """Return what is to be sent now.

        Args:
            now: time [s]. heard: when the last message came [s].
        """
        if self.silent:
            return []
        found = []
        if now - self._beat >= _BEAT and (self._speaks_first or now - heard > _SILENCE):
            self._beat = now
            found.append(self._dialect.MAVLink_heartbeat_message(_GROUND_STATION, _NO_AUTOPILOT, 0, 0, _ACTIVE, 3))
        if self.target is not None:
            found += self._questions(now, *self.target)
        return [self._packed(message) for message in found]

    def _questions(self, now: float, system: int, component: int) -> Iterable[Any]:
        for name, rate in self.asked.items():
            if self._rates[name].due(now):
                self._rates[name].put(now)
                interval = 1e6 / rate
                yield self._dialect.MAVLink_command_long_message(
                    system, component, _SET_INTERVAL, 0, self._numbers[name], interval, 0, 0, 0, 0, 0
                )
                return  # an answer does not say which message it is for: one question at a time
            if not self._rates[name].settled:
                break
        due = [name for name, each in self._reads.items() if each.due(now)]
        for name in due[:_AT_ONCE]:
            self._reads[name].put(now)
            yield self._dialect.MAVLink_param_request_read_message(system, component, name.encode(), -1)

    def _packed(self, message: Any) -> bytes:
        data = bytes(message.pack(self._encoder, force_mavlink1=self._version == 1))
        self._encoder.seq = (self._encoder.seq + 1) % 256
        return data

    def hear(self, frame: Frame, command: float, result: float) -> None:
        """Take the answer to a question for a rate: COMMAND_ACK of the autopilot."""
        if frame.sender != self.target or command != _SET_INTERVAL or result == _IN_PROGRESS:
            return
        waiting = next((each for each in self._rates.values() if each.attempts and not each.settled), None)
        if waiting is not None:
            waiting.answer = _ANSWERS.get(int(result), "refused")

    def learn(self, name: str, value: float) -> bool:
        """Take a parameter of the autopilot, whoever asked for it; return whether it is new."""
        if name in self._reads:
            self._reads[name].answer = "told"
        new = self.parameters.get(name) != value
        if len(self.parameters) < 10_000:
            self.parameters[name] = value
        return new

    def said(self) -> list[str]:
        """Return what was asked and answered, in lines for a person."""
        if self.silent:
            return ["asks for nothing, as told"]
        if self.target is None:
            return []
        refused: dict[str, list[str]] = {}
        for name, each in self._rates.items():
            if each.settled and each.answer != "granted":
                refused.setdefault(each.answer or "no answer", []).append(name)
        granted = sum(each.answer == "granted" for each in self._rates.values())
        line = f"asked {self.target} for the rates of {len(self._rates)} messages, {granted} granted"
        return [line + "".join(f"; {answer}: {', '.join(names)}" for answer, names in refused.items())]


def parameter_of(name: str, value: float, kind: float) -> float:
    """Return the value of a parameter as it is meant.

    ArduPilot casts whole numbers to float, others send their bits as if they were one: tiny numbers, which no
    parameter has.
    """
    import numpy as np

    if kind <= 6.0 and 0.0 < abs(value) < _DENORMAL:  # MAV_PARAM_TYPE: whole numbers of 8 to 32 bits
        return float(np.float32(value).view(np.int32))
    return value
