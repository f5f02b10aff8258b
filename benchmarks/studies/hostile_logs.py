"""Logs that are whole and wrong: what a writer gone mad, a broken clock or an attacker would put into each kind.

Where `mutations` breaks bytes, these files are well formed and hold what no vehicle measures: values of 1e308, NaN,
infinite, minus zero and denormal; times that repeat, go back, lie beyond the year 9999, are infinite, or nanoseconds
apart; columns of unequal length, without names, with the same name or names of control characters; a row or two; storms
of tiny records; objects within objects without end.
"""

from __future__ import annotations

import random
import struct
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from small_logs import blueos_messages, write_json, write_matlab_73

from towtank.core.arrays import Array

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests" / "readers"))

__all__ = ["SPOILS", "STORMS", "WRITERS", "hostile", "storm"]

_VALUES = (
    *(1e308, -1e308, 1.7976931348623157e308, 1e154, 1e200, 1e38, 1e30, 1e15, -1e12, 1e9, 1e6),
    *(np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, 1e-310, 2.2250738585072014e-308, 1e-30, 2.0**53, 2.0**63),
)
_NAMES = (
    *("", " ", "u", "t", "T", "cmd_", "\x1b[31mred", "u\n", "u,v", '"u"', "ü", "速度", "u" * 3000, "a.b[3]", "\u202eu"),
    *("[bold]x[/]", "<script>alert(1)</script>", "cmd_\x07", "../../etc/passwd", "%s%n", "\ufeffu", "__class__"),
)
_ROWS = 150


@dataclass
class Table:
    """Times (n,) and columns by name, a name may stand twice and a column may be too short; commands drive it."""

    t: Array
    columns: list[tuple[str, Array]] = field(default_factory=list)

    def rows(self, rows: Any) -> None:
        """Keep some of the rows."""
        self.t = self.t[rows]
        self.columns = [(name, values[rows]) for name, values in self.columns]


def _table(rng: random.Random) -> Table:
    t = 0.02 * np.arange(_ROWS)
    table = Table(t)
    motion = {
        "u": np.sin(t), "v": 0.1 * np.cos(t), "r": 0.3 * np.cos(t), "z": 1.0 + 0.1 * t, "psi": 0.3 * np.sin(t),
        "p": 0.01 * np.sin(9.0 * t), "phi": 0.01 * np.cos(9.0 * t), "theta": 0.02 * np.sin(t), "x": -np.cos(t),
        "ax": np.cos(t), "ay": 0.0 * t, "az": -9.81 + 0.01 * np.sin(5.0 * t), "qw": np.cos(0.1 * t), "qx": 0.0 * t,
        "qy": 0.0 * t, "qz": np.sin(0.1 * t), "vn": np.sin(t), "ve": np.cos(t), "vd": 0.1 * t,
    }  # fmt: skip
    kept = rng.sample(list(motion), rng.randint(1, len(motion)))
    table.columns = [(name, motion[name].copy()) for name in kept]
    if rng.random() < 0.5:
        table.columns += [("X", 20.0 * np.sign(np.sin(3.0 * t))), ("N", 5.0 * np.sign(np.cos(2.0 * t)))]
    else:
        table.columns += [(f"cmd_{n}", np.sign(np.sin((1.0 + 0.3 * n) * t))) for n in range(1, 7)]
    if rng.random() < 0.5:
        table.columns.append(("voltage", 16.0 - t))
    return table


def _places(n: int, rng: random.Random) -> Any:
    """Return some rows: one, a few, a block, a half, all."""
    way = rng.randrange(5)
    if way == 0:
        return np.array([rng.randrange(n)])
    if way == 1:
        return np.array(sorted(rng.sample(range(n), min(n, 7))))
    if way == 2:
        start = rng.randrange(n)
        return np.arange(start, min(n, start + rng.randint(2, 60)))
    return np.arange(n // 2, n) if way == 3 else np.arange(n)


def _spoil_values(table: Table, rng: random.Random) -> None:
    for k in rng.sample(range(len(table.columns)), rng.randint(1, len(table.columns))):
        values = table.columns[k][1]
        if values.size:
            values[_places(values.size, rng)] = rng.choice(_VALUES)


def _spoil_mixed(table: Table, rng: random.Random) -> None:
    """Every cell of a column another extreme."""
    _, values = rng.choice(table.columns)
    values[:] = [rng.choice(_VALUES) for _ in range(values.size)]


def _spoil_times(table: Table, rng: random.Random) -> None:
    t = table.t
    if not t.size:
        return
    ways: list[Callable[[], Any]] = [
        lambda: t.__setitem__(_places(t.size, rng), rng.choice(_VALUES)),
        lambda: t.__iadd__(rng.choice((1.7e9, 4.0e9, 2.6e11, 9.3e12, -1e5, -1e12, 1e15, 1e300))),
        lambda: t.__imul__(rng.choice((1e-9, 1e-12, 1e-300, 1e3, 1e6, 1e9, 1e300, 0.0, -1.0))),
        lambda: t.__setitem__(slice(None), t[::-1].copy()),
        lambda: t.__setitem__(slice(t.size // 2, None), t[: t.size - t.size // 2].copy()),
        lambda: t[t.size // 2 :].__iadd__(rng.choice((3600.0, 1e6, 1e9, 1.7e9, -50.0))),
        lambda: t.__setitem__(slice(None), np.repeat(t[::10], 10)[: t.size]),
        lambda: t.__setitem__(slice(None), rng.choice(t.tolist())),
        lambda: t.__setitem__(slice(None), rng.sample(t.tolist(), t.size)),
    ]  # fmt: skip
    rng.choice(ways)()


def _spoil_rows(table: Table, rng: random.Random) -> None:
    table.rows(slice(0, rng.choice((0, 1, 1, 2, 2, 3, 4, 5, 6, 12, 13))))


def _spoil_names(table: Table, rng: random.Random) -> None:
    k = rng.randrange(len(table.columns))
    name, values = table.columns[k]
    way = rng.randrange(3)
    if way == 0:
        table.columns[k] = rng.choice(_NAMES), values
    elif way == 1:
        table.columns.append((name, values.copy()))
    else:
        table.columns += [(f"extra{i}", values) for i in range(rng.choice((30, 600)))]


def _spoil_lengths(table: Table, rng: random.Random) -> None:
    k = rng.randrange(len(table.columns))
    name, values = table.columns[k]
    less = values[: rng.randrange(values.size + 1)] if rng.random() < 0.6 else np.append(values, values[:3])
    table.columns[k] = name, less


def _spoil_constant(table: Table, rng: random.Random) -> None:
    for k in range(len(table.columns)):
        if rng.random() < 0.7:
            table.columns[k] = table.columns[k][0], np.full(table.columns[k][1].size, rng.choice(_VALUES))


def _spoil_units(table: Table, rng: random.Random) -> None:
    for k in range(len(table.columns)):
        table.columns[k][1][:] *= rng.choice((1.0, 1.0, 57.3, 1e3, 1e6, 1e12, 1e150, 1e-6, 1e-200))


SPOILS: dict[str, Callable[[Table, random.Random], None]] = {
    "values": _spoil_values, "mixed": _spoil_mixed, "times": _spoil_times, "rows": _spoil_rows, "names": _spoil_names,
    "lengths": _spoil_lengths, "constant": _spoil_constant, "units": _spoil_units,
}  # fmt: skip
_UNEQUAL = frozenset({"matlab", "matlab-7.3", "mcap-live", "csv"})  # kinds that can hold columns of unequal length


def _csv(path: Path, table: Table, rng: random.Random) -> None:
    rows = max((values.size for _, values in table.columns), default=0)
    names = ",".join(["t", *(name for name, _ in table.columns)])
    lines = [names]
    for i in range(max(rows, table.t.size)):
        cells = [f"{table.t[i]!r}" if i < table.t.size else ""]
        cells += [repr(float(values[i])) if i < values.size else "" for _, values in table.columns]
        lines.append(",".join(cells).replace("np.float64(", "").replace(")", ""))
    encoding = rng.choice((*["utf-8"] * 8, "utf-8-sig", "latin-1", "utf-16", "utf-32"))
    path.write_bytes(rng.choice((*["\n"] * 8, "\r\n", "\r")).join(lines).encode(encoding, errors="replace"))


def _parquet(path: Path, table: Table, rng: random.Random) -> None:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    types = (pa.float64(), pa.float64(), pa.float64(), pa.float32())
    arrays = [pa.array(table.t)]
    for _, values in table.columns:
        kind = rng.choice(types)
        with np.errstate(over="ignore"):
            arrays.append(pa.array(values.astype(np.float32) if kind == pa.float32() else values))
    fields = [pa.field("t", arrays[0].type, metadata={"unit": "s"})]
    for (name, _), array in zip(table.columns, arrays[1:], strict=True):
        fields.append(pa.field(name, array.type))
    rows = rng.choice((None, 1, 7))
    parquet.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields)), path, row_group_size=rows)


def _unique(table: Table) -> dict[str, Array]:
    return {name[:63]: values for name, values in table.columns}


def _matlab(path: Path, table: Table, rng: random.Random) -> None:
    from scipy.io import savemat

    variables: dict[str, Any] = {"t": table.t}
    for name, values in _unique(table).items():
        clean = "".join(letter for letter in name if letter.isascii() and (letter.isalnum() or letter == "_"))[:60]
        if clean and clean[0].isalpha():
            variables[clean] = values
    if rng.random() < 0.3:
        variables = {"dive": variables}
    if rng.random() < 0.2:
        deep: Any = variables
        for _ in range(rng.choice((3, 15, 40))):
            deep = {"a": deep}
        variables = {"t": table.t, "deep": deep}
    savemat(path, variables, long_field_names=True)


def _matlab_73(path: Path, table: Table, rng: random.Random) -> None:
    named = {name.replace("/", "_").replace("\0", ""): values for name, values in _unique(table).items()}
    write_matlab_73(path, {"t": table.t, **{name: values for name, values in named.items() if name.strip(". ")}})


def _ours(path: Path, table: Table, rng: random.Random) -> None:
    """A live session's file, which takes whatever comes."""
    from towtank.recording.mcap.format import Quantity
    from towtank.recording.mcap.log import McapLog
    from towtank.recording.standard import is_standard, standard_of

    with McapLog.open(path) as log:
        for k, (name, values) in enumerate(table.columns[:40]):
            unit, frame = standard_of(name)[:2] if is_standard(name) else ("V", "")
            log.source(f"s{k}", [Quantity(name, unit, frame)])
            for i in range(min(values.size, table.t.size)):
                t = float(table.t[i])
                log.write(f"s{k}", t if np.isfinite(t * 1e9) else 0.0, float(values[i]))


def _dataflash(path: Path, table: Table, rng: random.Random) -> None:
    path.write_bytes(bytes(_dataflash_log(table, rng).data))


def _dataflash_text(path: Path, table: Table, rng: random.Random) -> None:
    path.write_bytes("\n".join(_dataflash_log(table, rng).text).encode(rng.choice(("utf-8", "utf-8", "latin-1"))))


def _dataflash_log(table: Table, rng: random.Random) -> Any:
    from encoders import DataFlashWriter

    log = DataFlashWriter()
    log.define("PARM", "QNff", "TimeUS,Name,Value,Default")
    log.define("IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
    log.define("ATT", "Qffff", "TimeUS,Roll,Pitch,Yaw,AEKF")
    log.define("RCOU", "QHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6")
    log.define("BARO", "QBfff", "TimeUS,I,Alt,Press,Temp")
    log.define("XKF1", "QBffffffd", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,PN")
    log.define("BAT", "Qff", "TimeUS,Volt,Curr")
    for n in range(1, 7):
        log.add("PARM", 0, f"SERVO{n}_FUNCTION", 32.0 + n, 0.0)
    columns = dict(table.columns)
    rows = min((values.size for values in columns.values()), default=0)
    for i in range(min(rows, table.t.size)):
        us = _whole(1e6 * (100.0 + table.t[i]), 0, 2**63)

        def of(name: str, i: int = i) -> float:
            return _single(columns[name][i]) if name in columns else 0.0

        log.add("IMU", us, 0, of("p"), of("p"), of("r"), of("ax"), of("ay"), of("az"))
        if i % 5 == 0:
            log.add("ATT", us, of("phi"), of("theta"), of("psi"), 3)
            log.add("RCOU", us, *(_whole(1500 + 100 * of(f"cmd_{n}"), 0, 65535) for n in range(1, 7)))
            log.add("BARO", us, 0, of("z"), 1e5 + 9800.0 * of("z") if abs(of("z")) < 1e30 else of("z"), 20.0)
            log.add("XKF1", us, 0, of("phi"), of("theta"), of("psi"), of("vn"), of("ve"), of("vd"), of("x"))
            log.add("BAT", us, of("voltage"), 1.0)
    return log


def _single(value: float) -> float:
    """Return a number as one of 32 bits holds it."""
    with np.errstate(over="ignore", under="ignore"):
        return float(np.float32(value))


def _whole(value: float, low: int, high: int) -> int:
    return low if not value > low else high if value >= high else int(value)


def _tlog(path: Path, table: Table, rng: random.Random) -> None:
    from encoders import TlogWriter
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    log = TlogWriter()
    columns = dict(table.columns)
    rows = min((values.size for values in columns.values()), default=0)
    packets: list[tuple[int, bytes]] = []
    for i in range(min(rows, table.t.size)):
        t = float(table.t[i])
        ms, us = _whole(1e3 * (50.0 + t), 0, 2**32 - 1), _whole(1e6 * (1.7e9 + t), 0, 2**64 - 1)

        def of(name: str, i: int = i) -> float:
            return _single(columns[name][i]) if name in columns else 0.0

        said = [mavlink.MAVLink_attitude_message(ms, of("phi"), of("theta"), of("psi"), of("p"), 0.0, of("r"))]
        pulses = [_whole(1500 + 100 * of(f"cmd_{n}"), 0, 65535) for n in range(1, 7)]
        said.append(mavlink.MAVLink_servo_output_raw_message(ms, 0, *pulses, 0, 1100))
        said.append(mavlink.MAVLink_local_position_ned_message(ms, of("x"), 0.0, of("z"), of("vn"), of("ve"), of("vd")))
        if i % 20 == 0:
            said.append(mavlink.MAVLink_heartbeat_message(12, 3, 81, 19, 4, 3))
        packets += [(us, log.pack(each, (1, 1), 2)) for each in said]
    path.write_bytes(b"".join(stamp.to_bytes(8, "big") + packet for stamp, packet in packets))


def _blueos(path: Path, table: Table, rng: random.Random) -> None:
    columns = dict(table.columns)
    messages = blueos_messages(min(60, table.t.size))
    for k, (topic, _, content) in enumerate(messages):
        i = min(k // 2, table.t.size - 1)
        body = content["message"]
        for field_, name in (("rollspeed", "p"), ("yawspeed", "r"), ("yaw", "psi"), ("roll", "phi")):
            if field_ in body and name in columns and i < columns[name].size:
                body[field_] = float(columns[name][i])
        if rng.random() < 0.02:
            body["roll"] = rng.choice(("nan", [], {}, [[1]], 10**400, True, None, "1", {"type": "X"}))
        t = float(table.t[i]) if i >= 0 else 0.0
        messages[k] = topic, t if abs(t) < 1e9 else 0.0, content
    write_json(path, messages)


def _said(table: Table) -> list[Any]:
    import ros_bags as ros

    columns = dict(table.columns)
    rows = min((values.size for values in columns.values()), default=0)
    said = []
    for i in range(min(rows, table.t.size, 80)):
        t = float(table.t[i])
        sound = t if abs(t) < 1e8 else 0.0

        def of(name: str, i: int = i) -> float:
            return float(columns[name][i]) if name in columns else 0.0

        level = (of("qw") or 1.0, of("qx"), of("qy"), of("qz"))
        imu = ros.imu(sound, "base_link", level, (of("p"), 0.0, of("r")), (of("ax"), of("ay"), of("az")))
        odometry = ros.odometry(
            sound, "odom", "base_link", (of("x"), 0.0, of("z")), level, (of("u"), of("v"), 0.0), (of("p"), 0.0, of("r"))
        )
        stamp = {"sec": _whole(t + 1.7e9, -(2**31), 2**31 - 1), "nanosec": 2**32 - 1 if t > 1e8 else 0}
        imu["header"]["stamp"] = stamp if abs(t) >= 1e8 else imu["header"]["stamp"]
        log_time = min(max(t, -1.6e9), 7.5e9) if np.isfinite(t) else 0.0
        commands = ros.multi_array([of(f"cmd_{n}") for n in range(1, 7)])
        said += [
            ros.Said("/imu", log_time, "sensor_msgs/msg/Imu", imu),
            ros.Said("/odom", log_time, "nav_msgs/msg/Odometry", odometry),
            ros.Said("/cmd", log_time, "std_msgs/msg/Float64MultiArray", commands),
        ]
    return said


def _ros1(path: Path, table: Table, rng: random.Random) -> None:
    import ros_bags as ros

    said = [each._replace(t=min(each.t, 2.5e9)) for each in _said(table)]
    for each in said:
        stamp = each.fields.get("header", {}).get("stamp")
        if stamp is not None:
            stamp["sec"], stamp["nanosec"] = max(stamp["sec"], 0), stamp["nanosec"] % 2**32
    ros.write_bag1(path, said, rng.choice(("", "BZ2", "LZ4")))


def _ros2(path: Path, table: Table, rng: random.Random) -> None:
    import ros_bags as ros

    with tempfile.TemporaryDirectory() as folder:
        written = next(ros.write_bag2(Path(folder) / "bag", _said(table)).glob("*.db3"))
        path.write_bytes(written.read_bytes())


def _ros_mcap(path: Path, table: Table, rng: random.Random) -> None:
    import ros_bags as ros

    ros.write_mcap2(path, _said(table), end=rng.random() < 0.7)


WRITERS: dict[str, tuple[str, Callable[[Path, Table, random.Random], None]]] = {
    "csv": (".csv", _csv), "parquet": (".parquet", _parquet), "matlab": (".mat", _matlab),
    "matlab-7.3": (".mat", _matlab_73), "mcap-live": (".mcap", _ours), "dataflash": (".BIN", _dataflash),
    "dataflash-text": (".log", _dataflash_text), "tlog": (".tlog", _tlog), "mcap-json": (".mcap", _blueos),
    "ros1": (".bag", _ros1), "ros2": (".db3", _ros2), "mcap-ros": (".mcap", _ros_mcap),
}  # fmt: skip


def hostile(kind: str, rng: random.Random) -> tuple[str, str, bytes]:
    """Return what is wrong with it, the suffix and the bytes of a hostile log of a kind of `WRITERS`."""
    suffix, write = WRITERS[kind]
    able = [name for name in SPOILS if name != "lengths" or kind in _UNEQUAL]
    names = rng.sample(able, rng.choice((1, 1, 2, 3)))
    table = _table(rng)
    with np.errstate(all="ignore"):
        for name in sorted(names, key=lambda each: each == "lengths"):
            SPOILS[name](table, rng)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"hostile{suffix}"
            write(path, table, rng)
            return "+".join(names), suffix, path.read_bytes()


def _storm_dataflash(rng: random.Random, size: int) -> bytes:
    """Records of a few bytes; with `redefined` a format that is stated anew before each."""
    from encoders import DataFlashWriter

    log = DataFlashWriter()
    log.define("AB", "B", "X", number=200)
    tiny = bytes((0xA3, 0x95, 200, 1))
    if rng.random() < 0.4:
        return bytes(log.data) + tiny * (size // len(tiny))
    if rng.random() < 0.5:
        other = DataFlashWriter()
        other.define("AB", "B", "Y", number=200)
        again = (bytes(log.data[89:]) + tiny, bytes(other.data[89:]) + tiny)
        return bytes(log.data) + b"".join(again) * (size // 200)
    return bytes(log.data) + (tiny + b"\0") * (size // 5)


def _storm_dataflash_text(rng: random.Random, size: int) -> bytes:
    line = rng.choice(("A,1\n", "\n", ",\n", "FMT, 1, 9, A, B, X\n", "FMT,\n"))
    return ("FMT, 1, 9, A, B, X\n" + line * (size // len(line))).encode()


def _storm_tlog(rng: random.Random, size: int) -> bytes:
    from encoders import TlogWriter
    from pymavlink.dialects.v20 import ardupilotmega as mavlink

    log = TlogWriter()
    packet = log.pack(mavlink.MAVLink_heartbeat_message(12, 3, 81, 19, 4, 3), (1, 1), 2)
    many = size // (len(packet) + 8)
    way = rng.randrange(3)
    if way == 0:
        return b"".join((1_700_000_000_000_000 + k).to_bytes(8, "big") + packet for k in range(many))
    if way == 1:  # every sender there can be
        from_all = [log.pack(mavlink.MAVLink_heartbeat_message(12, 3, 81, 19, 4, 3), (1 + k % 255, k // 255 % 255), 2)
                    for k in range(min(many, 20_000))]  # fmt: skip
        return b"".join((1_700_000_000_000_000 + k).to_bytes(8, "big") + each for k, each in enumerate(from_all))
    return (1_700_000_000_000_000).to_bytes(8, "big") + b"\xfd\x00" * (size // 2)


def _storm_bag(rng: random.Random, size: int) -> bytes:
    def text(**fields: bytes) -> bytes:
        whole = b"".join(
            struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value
            for name, value in fields.items()
        )
        return struct.pack("<I", len(whole)) + whole

    def record(header: bytes, body: bytes = b"") -> bytes:
        return header + struct.pack("<I", len(body)) + body

    head = b"#ROSBAG V2.0\n"
    way = rng.randrange(4)
    empty = record(text(op=b"\x05", compression=b"none", size=struct.pack("<I", 0)))
    if way == 0:
        return head + empty * (size // len(empty))
    if way == 1:  # every chunk broken
        broken = record(text(op=b"\x05", compression=b"bz2", size=struct.pack("<I", 9)), b"x")
        return head + broken * (size // len(broken))
    if way == 2:  # connections without end
        about = text(type=b"std_msgs/Float64", md5sum=b"x", message_definition=b"float64 data")[4:]
        made = [
            record(text(op=b"\x07", conn=struct.pack("<I", k), topic=f"/t{k}".encode()), about)
            for k in range(size // 140)
        ]
        return head + b"".join(made)
    return head + (b"\x04\x00\x00\x00op=\x05" + b"\0") * (size // 9)  # marks of chunks that are none


def _storm_mcap(rng: random.Random, size: int) -> bytes:
    magic = b"\x89MCAP0\r\n"

    def record(opcode: int, body: bytes) -> bytes:
        return struct.pack("<BQ", opcode, len(body)) + body

    def text(value: bytes) -> bytes:
        return struct.pack("<I", len(value)) + value

    head = magic + record(1, text(b"") + text(b""))
    channel = record(4, struct.pack("<HH", 1, 0) + text(b"/a") + text(b"json") + struct.pack("<I", 0))
    message = record(5, struct.pack("<HIQQ", 1, 0, 1_700_000_000_000_000_000, 0) + b"{}")
    way = rng.randrange(5)
    if way == 0:
        return head + channel + message * (size // len(message))
    if way == 1:  # a chunk for each message
        packed = record(
            6, struct.pack("<QQQI", 0, 0, len(message), 0) + text(b"") + struct.pack("<Q", len(message)) + message
        )
        return head + channel + packed * (size // len(packed))
    if way == 2:
        broken = record(6, struct.pack("<QQQI", 0, 0, 99, 7) + text(b"zstd") + struct.pack("<Q", 4) + b"abcd")
        return head + channel + broken * (size // len(broken))
    if way == 3:
        made = [
            record(4, struct.pack("<HH", k % 65536, 0) + text(f"/{k}".encode()) + text(b"json") + b"\0" * 4)
            for k in range(size // 32)
        ]
        return head + b"".join(made)
    return head + b"\x05\0\0\0\0\0\0\0\0" * (size // 9)


def _storm_json(rng: random.Random, size: int) -> bytes:
    deep = rng.choice((b"[" * 90_000, b'{"a":' * 90_000, b"[" * 500 + b"]" * 500, b'{"header":' + b"[" * 50_000))
    wide = b'{"header":{"system_id":1,"component_id":1},"message":{"type":"A",' + b",".join(
        b'"k%d":%d' % (k, k) for k in range(5000)
    ) + b"}}"  # fmt: skip
    content = rng.choice((deep, wide))
    with tempfile.TemporaryDirectory() as folder:
        topics = ("mavlink/out", "/other", "mavlink/1/1/X")
        many = max(1, min(size // len(content), 60))
        path = write_json(
            Path(folder) / "storm.mcap", [(rng.choice(topics), 0.01 * k, content) for k in range(many)]
        )  # fmt: skip
        return path.read_bytes()


def _storm_csv(rng: random.Random, size: int) -> bytes:
    line = rng.choice((b"0,1\n", b",\n", b"\n", b"1,nan\n", b'"', b"1,1e999\n", b"x", b"1,2,3\n"))
    head = rng.choice((b"t,u\n", b"t,u" + b",u" * 5000 + b"\n", b"t,u\n0,1\n", b"," * 20_000 + b"\n"))
    return head + line * (size // len(line))


def _storm_parquet(rng: random.Random, size: int) -> bytes:
    import pyarrow as pa
    import pyarrow.parquet as parquet

    rows = rng.choice((min(size // 400, 3000), 50))
    table = pa.table({"t": 0.01 * np.arange(rows), "u": np.zeros(rows), **{f"c{k}": np.zeros(rows) for k in range(9)}})
    with tempfile.TemporaryDirectory() as folder:
        parquet.write_table(table, Path(folder) / "s.parquet", row_group_size=1)
        return (Path(folder) / "s.parquet").read_bytes()


def _storm_matlab(rng: random.Random, size: int) -> bytes:
    from scipy.io import savemat

    t = 0.02 * np.arange(20)
    count = min(size // 60, 4000)
    variables: dict[str, Any] = {f"v{k}": np.zeros(1) for k in range(count)} if rng.random() < 0.5 else {
        "s": [{"t": t, "u": t} for _ in range(min(count, 900))]
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        savemat(Path(folder) / "s.mat", {"t": t, "u": np.sin(t), **variables})
        return (Path(folder) / "s.mat").read_bytes()


STORMS: dict[str, tuple[str, Callable[[random.Random, int], bytes]]] = {
    "dataflash": (".BIN", _storm_dataflash), "dataflash-text": (".log", _storm_dataflash_text),
    "tlog": (".tlog", _storm_tlog), "ros1": (".bag", _storm_bag), "mcap-live": (".mcap", _storm_mcap),
    "mcap-json": (".mcap", _storm_json), "csv": (".csv", _storm_csv), "parquet": (".parquet", _storm_parquet),
    "matlab": (".mat", _storm_matlab),
}  # fmt: skip


def storm(kind: str, rng: random.Random, size: int) -> tuple[str, bytes]:
    """Return the suffix and the bytes of a file of about `size` bytes of tiny records, of a kind of `STORMS`."""
    suffix, make = STORMS[kind]
    return suffix, make(rng, size)
