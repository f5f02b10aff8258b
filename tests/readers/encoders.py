"""Writes logs as autopilots and ground stations do, byte by byte, for tests of the readers."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

__all__ = ["DataFlashWriter", "TlogWriter", "dive_bin", "dive_tlog"]

# letter -> struct code and scale, as ArduPilot's LogStructure.h states them
_LETTERS = {
    **{letter: (letter, 1.0) for letter in "bBhHiIfdqQ"},
    **{"c": ("h", 100.0), "C": ("H", 100.0), "e": ("i", 100.0), "E": ("I", 100.0), "L": ("i", 1e7), "M": ("B", 1.0)},
    **{"n": ("4s", None), "N": ("16s", None), "Z": ("64s", None)},
}


class DataFlashWriter:
    """A DataFlash log: FMT records first, then messages."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.text: list[str] = []
        self._formats: dict[str, tuple[int, str, tuple[str, ...]]] = {}
        self.define("FMT", "BBnNZ", "Type,Length,Name,Format,Columns", number=128)

    def define(self, name: str, letters: str, columns: str, number: int | None = None) -> None:
        """Write the FMT record of a message."""
        number = number or 150 + len(self._formats)
        self._formats[name] = number, letters, tuple(columns.split(","))
        size = 3 + struct.calcsize("<" + "".join(_LETTERS[letter][0] for letter in letters))
        row = struct.pack("<BB4s16s64s", number, size, name.encode(), letters.encode(), columns.encode())
        self.data += b"\xa3\x95\x80" + row
        self.text.append(f"FMT, {number}, {size}, {name}, {letters}, {columns}")

    def number(self, name: str) -> int:
        """Return the number of a message."""
        return self._formats[name][0]

    def add(self, name: str, *values: Any) -> None:
        """Write one message."""
        number, letters, _ = self._formats[name]
        packed = [_packed(letter, value) for letter, value in zip(letters, values, strict=True)]
        code = "<" + "".join(_LETTERS[letter][0] for letter in letters)
        self.data += bytes((0xA3, 0x95, number)) + struct.pack(code, *packed)
        self.text.append(", ".join([name, *(str(value) for value in values)]))


def _packed(letter: str, value: Any) -> Any:
    scale = _LETTERS[letter][1]
    if scale is None:
        return str(value).encode()
    return float(value) if letter in "fd" else round(value * scale)


class TlogWriter:
    """A telemetry log: MAVLink packets, packed by pymavlink, each behind the time of receipt."""

    def __init__(self, epoch: float = 1_700_000_000.0) -> None:
        self.epoch = epoch
        self._packets: list[tuple[int, bytes]] = []
        self._senders: dict[tuple[int, int, int], Any] = {}

    def add(self, t: float, message: Any, sender: tuple[int, int] = (1, 1), version: int = 2) -> None:
        """Write one message of a dialect, received at t [s] after the epoch."""
        self._packets.append((round((self.epoch + t) * 1e6), self.pack(message, sender, version)))

    @property
    def data(self) -> bytearray:
        """The file, in the order of receipt."""
        ordered = sorted(self._packets, key=lambda each: each[0])
        return bytearray(b"".join(stamp.to_bytes(8, "big") + packet for stamp, packet in ordered))

    @property
    def packets(self) -> list[bytes]:
        """The packets alone."""
        return [packet for _, packet in sorted(self._packets, key=lambda each: each[0])]

    def pack(self, message: Any, sender: tuple[int, int], version: int) -> bytes:
        """Return the packet of a message."""
        from pymavlink.dialects.v10 import ardupilotmega as v1
        from pymavlink.dialects.v20 import ardupilotmega as v2

        version = 2 if message.get_msgId() > 255 else version
        key = (*sender, version)
        if key not in self._senders:
            self._senders[key] = (v2 if version == 2 else v1).MAVLink(None, *sender)
        packed: bytes = message.pack(self._senders[key], force_mavlink1=version == 1)
        return packed


def dive_bin(
    seconds: float = 4.0,
    *,
    parameters: Mapping[str, float] | None = None,
    dvl: bool = True,
    flags: int = 0b10000000101101111,
    start: float = 100.0,
    beyond: bool = False,
    said: Sequence[tuple[float, str, Sequence[float]]] = (),
) -> DataFlashWriter:
    """Return a short dive: IMU at 50 Hz, the rest at 10 Hz; every channel is a function of time that tests know.

    p = 0.1 t, ax = 1 + t, az = -9.8, roll = 1 + t deg, depth = 2 + 0.1 t m, u = 0.2 t, v = -0.1, w = 0.05 m/s,
    output n = 1500 + 10 n + 5 t us, supply = 16 - 0.1 t V; t counts from `start` s after boot. `said` is what else is
    said when: time, ARM, EV or MODE, its fields but the time.
    """
    log = DataFlashWriter()
    log.define("FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
    log.define("PARM", "QNff", "TimeUS,Name,Value,Default")
    log.define("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define("ATT", "QccccCCB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF")
    log.define("RCOU", "QHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8")
    if beyond:  # outputs 15 and 16
        log.define("RCO2", "QHH", "TimeUS,C15,C16")
    log.define("BARO", "QBfff", "TimeUS,I,Alt,Press,Temp")
    log.define("BAT", "QBff", "TimeUS,Inst,Volt,Curr")
    log.define("VISO", "Qffffffff", "TimeUS,dt,AngDX,AngDY,AngDZ,PosDX,PosDY,PosDZ,conf")
    log.define("XKF1", "QBccCffffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD")
    log.define("XKF4", "QBIb", "TimeUS,C,SS,PI")
    log.define("MSG", "QZ", "TimeUS,Message")
    log.define("ARM", "QBIBB", "TimeUS,ArmState,ArmChecks,Forced,Method")
    log.define("EV", "QB", "TimeUS,Id")
    log.define("MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn")
    waiting = sorted(said, key=lambda each: each[0])
    log.add("FMTU", start * 1e6, log.number("BAT"), "s#vA", "F---")
    log.add("MSG", start * 1e6, "ArduSub V4.5.0, a test")
    for name, value in (parameters or {}).items():
        log.add("PARM", start * 1e6, name, value, value)
    for k in range(round(seconds * 50)):
        t = k / 50.0
        us = round((start + t) * 1e6)
        while waiting and waiting[0][0] <= t + 1e-9:
            at, name, values = waiting.pop(0)
            log.add(name, round((start + at) * 1e6), *values)
        log.add("IMU", us, 0, 0.1 * t, 0.0, -0.1 * t, 1.0 + t, 0.0, -9.8)
        log.add("IMU", us, 1, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0)
        if k % 5:
            continue
        log.add("ATT", us, 0.0, 1.0 + t, 0.0, -2.0, 0.0, 350.0, 3)
        log.add("RCOU", us, *(round(1500 + 10 * n + 5 * t) for n in range(1, 7)), 0, 1100)
        if beyond:
            log.add("RCO2", us, 1700 + k // 5, 1600 - k // 5)
        log.add("BARO", us, 0, -80.0, 102_800.0, 20.0)
        log.add("BARO", us, 1, -(2.0 + 0.1 * t), 100_000.0 + 9800.0 * (2.0 + 0.1 * t), 12.0)
        log.add("BAT", us, 0, 16.0 - 0.1 * t, 1.0)
        if dvl:
            log.add("VISO", us, 0.1, 0.0, 0.0, 0.0, 0.1 * 0.2 * t, -0.01, 0.005, 99.0)
        log.add("XKF1", us, 0, 1.0 + t, -2.0, 350.0, 7.0, 7.0, 7.0, 70.0, 70.0, 2.0 + 0.1 * t)
        log.add("XKF4", us, 0, flags, 0)
    return log


def dive_tlog(
    seconds: float = 6.0,
    *,
    parameters: Mapping[str, float] | None = None,
    flags: int = 831,
    dvl: bool = True,
    late: Sequence[float] = (0.005,),
    versions: Iterable[int] = (2,),
    boot: float = 50.0,
    epoch: float = 1_700_000_000.0,
) -> TlogWriter:
    """Return the telemetry of the same dive at 10 Hz, by an autopilot (1.1) with companions and a ground station.

    Messages are received `late` s after they were sent, one delay after the other; the autopilot started `boot` s
    before.
    """
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    log = TlogWriter(epoch)
    kinds = list(versions)
    sent = 0

    def add(t: float, message: Any, sender: tuple[int, int] = (1, 1)) -> None:
        nonlocal sent
        log.add(t + late[sent % len(late)], message, sender, kinds[sent % len(kinds)])
        sent += 1

    for name, value in (parameters or {}).items():
        add(0.0, mavlink.MAVLink_param_value_message(name.encode(), value, 9, 1, 0))
    for k in range(round(seconds * 10)):
        t = k / 10.0
        ms, us = round(1e3 * (boot + t)), round(1e6 * (boot + t))
        if k % 10 == 0:
            add(t, mavlink.MAVLink_heartbeat_message(12, 3, 81, 19, 4, 3))
            add(t, mavlink.MAVLink_heartbeat_message(6, 8, 192, 0, 4, 3), (255, 190))
            add(t, mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), (1, 194))
        add(t, mavlink.MAVLink_attitude_message(ms, 0.1 + 0.01 * t, -0.2, 3.0, 0.1 * t, 0.0, -0.1 * t))
        add(t, mavlink.MAVLink_attitude_message(7, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0), (1, 194))
        acc = (round(1e3 * (1.0 + t) / 9.80665), 0, -1000)
        add(t, mavlink.MAVLink_raw_imu_message(us, *acc, round(100.0 * t), 0, -round(100.0 * t), 0, 0, 0))
        pulses = [round(1500 + 10 * n + 5 * t) for n in range(1, 7)]
        add(t, mavlink.MAVLink_servo_output_raw_message(us % 2**32, 0, *pulses, 0, 1100))
        add(t, mavlink.MAVLink_scaled_pressure_message(ms, 1020.0, 0.0, 2000))
        add(t, mavlink.MAVLink_scaled_pressure2_message(ms, 1000.0 + 98.0 * (2.0 + 0.1 * t), 0.0, 1200))
        add(t, mavlink.MAVLink_sys_status_message(0, 0, 0, 0, round(1e3 * (16.0 - 0.1 * t)), 100, 90, 0, 0, 0, 0, 0, 0))
        add(t, mavlink.MAVLink_local_position_ned_message(ms, 0.3 * t, 0.0, 2.0 + 0.1 * t, 0.3, 0.0, 0.1))
        add(t, mavlink.MAVLink_ekf_status_report_message(flags, 0.0, 0.0, 0.0, 0.0, 0.0))
        if dvl:
            delta = (0.1 * 0.2 * t, -0.01, 0.005)
            add(t, mavlink.MAVLink_vision_position_delta_message(0, 100_000, (0.0, 0.0, 0.0), delta, 95.0), (255, 0))
    return log
