"""What a log held, table by table: what each was used for, and why the others were not."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Content"]


@dataclass(frozen=True)
class Content:
    """One table of a log: a topic, a message type or one instance of it.

    Attributes:
        name: as a mapping names it: "IMU[0]", "SERVO_OUTPUT_RAW", "/rov/dvl".
        kind: type of its messages: "DataFlash", "MAVLink", "sensor_msgs/msg/Imu".
        count: messages.
        rate: usual rate [Hz], None where fewer than two have a time.
        used: the channels that were taken from it.
        reason: why it, or the rest of it, was not used; empty where there is nothing to say.
    """

    name: str
    kind: str
    count: int
    rate: float | None
    used: tuple[str, ...] = ()
    reason: str = ""
