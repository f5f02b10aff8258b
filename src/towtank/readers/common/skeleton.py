"""A mapping to fill in: every column of numbers that a log holds, and which channel it may be, as a mapping file.

What is likely is filled in, what is doubtful is a comment, and all else is listed.
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import short
from towtank.errors import InputError
from towtank.readers import recognised
from towtank.readers.common.column_names import Suggestion, suggestion
from towtank.readers.common.tables import Tables
from towtank.recording.grids.timing import sampling_rate
from towtank.recording.standard import (
    ACCELERATIONS,
    EULER,
    FURTHER,
    LINEAR_VELOCITY,
    POSITION,
    QUANTITIES,
    QUATERNION,
    RATES,
    STANDARD,
    WORLD_VELOCITY,
    WRENCH,
    is_command,
)

__all__ = ["Skeleton", "mapping_skeleton"]

_TABLES = {
    "ArduPilot DataFlash": "towtank.readers.dataflash.reader",
    "MAVLink telemetry log": "towtank.readers.mavlink.tlog",
    "MATLAB": "towtank.readers.matlab.reader",
    "MCAP": "towtank.readers.mcap.reader",
    "ROS bag": "towtank.readers.ros.reader",
}
_COLUMNS = {"CSV": "towtank.recording.tables.csv", "Parquet": "towtank.recording.tables.parquet"}
_DEGREE, _G = 0.017453292519943295, 9.80665
_UPRIGHT, _TURNS = 1.65, 25.0  # rad: a pitch, and a roll or heading over several turns, beyond it is in degrees
_STEEP, _MANY_TURNS, _TURN = 95.0, 3600.0, 400.0  # degrees: beyond it a pitch or a heading is in hundredths of them
_FAST = 25.0  # rad/s: a rate beyond it is in degrees or thousandths
_OTHERS = 2  # further candidates of a channel that are shown
_FEW = 12  # fields of a message that are listed with their ranges
_COLUMN = 44  # where comments begin
_WIDTH = 110
_GROUPS = (
    ("position", POSITION),
    ("attitude: Euler angles, or a quaternion", EULER + QUATERNION),
    ("velocity over ground, along the body", LINEAR_VELOCITY),
    ("velocity over ground, along the world's axes", WORLD_VELOCITY),
    *((f"{each.name}, along the body", each.channels) for each in QUANTITIES if each.channels[0] in FURTHER),
    ("angular rates", RATES),
    ("specific force, as an accelerometer measures it", ACCELERATIONS),
    ("force and moment of the thrusters, where they are recorded", WRENCH),
    ("supply", ("voltage",)),
)
_USUAL = tuple(names for _, names in _GROUPS if names[0] in ("x", "phi", "u", "p", "ax"))  # asked for where absent


@dataclass(frozen=True, eq=False)
class FoundColumn:
    """A column of numbers.

    Attributes:
        source: as a mapping names it. path: within its table. values: (n,), NaN where there is none.
    """

    source: str
    path: str
    values: Array

    @property
    def range(self) -> str:
        """Its values in words: "-0.21 .. 0.34", "always 3", "no values"."""
        known = self.values[np.isfinite(self.values)]
        if not known.size:
            return "no values"
        low, high = float(known.min()), float(known.max())
        return f"always {short(low)}" if low == high else f"{short(low)} .. {short(high)}"


@dataclass(frozen=True, eq=False)
class FoundTable:
    """The columns of a table; `name` is "" where the file has but one.

    Attributes:
        t: its own times (n,) [s], None where it has none. kind: type of its messages.
    """

    name: str
    columns: tuple[FoundColumn, ...]
    t: Array | None = None
    kind: str = ""

    @property
    def rate(self) -> float | None:
        """Usual rate [Hz] of its own times, None where it has none."""
        known = np.unique(self.t[np.isfinite(self.t)]) if self.t is not None else np.empty(0)
        return sampling_rate(known) if known.size > 1 else None


@dataclass(frozen=True)
class Skeleton:
    """A mapping to fill in.

    Attributes:
        text: of the TOML file. suggested: channel -> source column, of what is filled in. thrusters: likewise.
        columns: every column of the log that a mapping may name.
    """

    text: str
    suggested: dict[str, str]
    thrusters: tuple[str, ...]
    columns: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A column with what its name suggests; table: that it stands in."""

    column: FoundColumn
    table: FoundTable
    said: Suggestion

    @property
    def still(self) -> bool:
        """Whether it never changes, or holds nothing."""
        known = self.column.values[np.isfinite(self.column.values)]
        return not known.size or float(np.ptp(known)) == 0.0


def mapping_skeleton(path: Path) -> Skeleton:
    """Return a mapping for a log, to be checked and filled in by who knows it.

    Raises:
        InputError: the file is missing or damaged, or holds no number.
    """
    tables = found_tables(path)
    single = len(tables) == 1 and not tables[0].name
    candidates = [
        _Candidate(column, table, said)
        for table in tables
        for column in table.columns
        if (said := suggestion(column.path, table.name, table.kind)) is not None
    ]
    thrusters = _thrusters(candidates)
    ranked = _ranked(candidates)
    chosen = {name: found[0] for name, found in ranked.items()}
    lines = _head(path, single)
    lines += _thruster_lines(thrusters, candidates)
    lines += ["", *_frame_lines(chosen)]
    lines += _time_lines(chosen.get("t"), single)
    lines += _channel_lines(ranked, chosen)
    shown = [each for found in ranked.values() for each in found[: 1 + _OTHERS]]
    named = {each.column.source for each in (*shown, *thrusters)}
    lines += _rest_lines(tables, named)
    over = {"u", "v"} <= chosen.keys()
    left_out = {*(WORLD_VELOCITY if over else ()), *(() if single else ("t",))}
    suggested = {name: each.column.source for name, each in chosen.items() if name not in left_out}
    columns = tuple(column.source for table in tables for column in table.columns)
    return Skeleton("\n".join(lines) + "\n", suggested, tuple(each.column.source for each in thrusters), columns)


def _head(path: Path, single: bool) -> list[str]:
    what = "columns" if single else "fields (TABLE.field)"
    return [
        f"# Which of the {what} of {path.name} is which channel.",
        "# What names and numbers suggest is filled in: check every line, delete what is wrong, fill in what is",
        "# missing, take the # away from what is right. Then try it:",
        f"#   towtank inspect {path.name} --map THIS_FILE",
        "# channel = scale * column + offset; degrees to radians:",
        '#   psi = { from = "yaw", scale = 0.017453292519943295, offset = 0.0 }',
        *([] if single else ["# Without a mapping a log of messages is read as well, by what its messages mean."]),
        "",
    ]


def _thrusters(candidates: Sequence[_Candidate]) -> list[_Candidate]:
    """Return the largest family of numbered commands in order of their numbers.

    One that never moves rests where its value is among those of the others, and is unused where it is not.
    """
    families: dict[tuple[str, str], list[_Candidate]] = {}
    for each in candidates:
        if each.said.quantity == "thruster" and not is_command(each.said.channel):
            families.setdefault((each.table.name, each.said.family), []).append(each)
    moving = {key: [each for each in family if not each.still] for key, family in families.items()}
    best = max(families, key=lambda key: (len(moving[key]), len(families[key])), default=None)
    if best is None:
        return []
    own = families[best]
    if moving[best]:
        values = np.concatenate([each.column.values for each in moving[best]])
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        own = [each for each in own if not each.still or low < float(np.nanmax(each.column.values)) < high]
    return sorted(own, key=lambda each: int(each.said.channel))


def _thruster_lines(thrusters: Sequence[_Candidate], candidates: Sequence[_Candidate]) -> list[str]:
    commands = [each for each in candidates if is_command(each.said.channel)]
    if commands and not thrusters:
        return ["# Commands that bear the names of thrusters stand under [columns].", "# thrusters = []"]
    out = [
        "# Commands: source columns in the order of the vehicle's [[thrusters]], in the unit of its thruster curves."
    ]
    if not thrusters:
        return [*out, '# thrusters = ["", ""]']
    quoted = [_text(each.column.source) for each in thrusters]
    line = f"thrusters = [{', '.join(quoted)}]"
    out += [line] if len(line) <= _WIDTH else ["thrusters = [", *(f"    {each}," for each in quoted), "]"]
    return [*out, *(f"#   {each.column.path}: {each.column.range}" for each in thrusters)]


def _frame_lines(chosen: dict[str, _Candidate]) -> list[str]:
    """Return the frames; of the body's the one that gravity tells where an accelerometer is there."""
    body, why = "FRD", "x forward, y to starboard, z down; FLU: y to port, z up"
    az = chosen.get("az")
    if az is not None:
        mean = float(np.nanmean(az.column.values)) * _scale(az)[0]
        if mean > 0.5 * _G:
            body, why = "FLU", f"{az.column.path} averages {short(mean, 3)}: z up if it was mostly level; FRD: z down"
        elif mean < -0.5 * _G:
            why = f"{az.column.path} averages {short(mean, 3)}: z down if it was mostly level; FLU: z up"
    return [
        _line(f'body = "{body}"', why),
        _line('world = "NED"', "x north, y east, z down; ENU: x east, y north, z up"),
    ]


def _time_lines(time: _Candidate | None, single: bool) -> list[str]:
    if not single:
        return ["", "[columns]", "# The messages have times of their own."]
    if time is None:
        rate = _line(
            "rate = 100.0", "Hz, of the rows: no column is known to be a time; or name it: t = under [columns]"
        )
        return [f"# {rate}", "", "[columns]"]
    scale, why = _time_scale(time)
    return ["", "[columns]", _line(_entry("t", time, scale), f"s; {time.column.range}{why}")]


def _time_scale(time: _Candidate) -> tuple[float, str]:
    """Return seconds per unit of a column of time, by its name or its steps, and why."""
    known = time.column.values[np.isfinite(time.column.values)]
    step = float(np.median(np.diff(known))) if known.size > 1 else 0.0
    if time.said.unit:
        return time.said.scale, f", in {time.said.unit}"
    for least, scale, unit in ((1e6, 1e-9, "nanoseconds"), (1e3, 1e-6, "microseconds"), (2.0, 1e-3, "milliseconds")):
        if step >= least:
            return scale, f", in steps of {short(step)}: {unit}?"
    return 1.0, ""


def _ranked(candidates: Sequence[_Candidate]) -> dict[str, list[_Candidate]]:
    """Return the candidates of each channel, the likeliest first: of a family that tells most, by the surest name."""
    size: dict[tuple[str, str, str], int] = {}
    for each in candidates:
        key = (each.table.name, each.said.quantity, each.said.family)
        size[key] = size.get(key, 0) + 1

    def unlikely(each: _Candidate) -> tuple[float, ...]:
        known = np.isfinite(each.column.values)
        own = size[each.table.name, each.said.quantity, each.said.family]
        return (each.said.rank >= 0, each.still, -min(own, 3), each.said.rank, -int(np.count_nonzero(known)))

    out: dict[str, list[_Candidate]] = {}
    for each in sorted(candidates, key=unlikely):
        if each.said.quantity != "thruster" or is_command(each.said.channel):
            out.setdefault(each.said.channel, []).append(each)
    if "phi" in out and "qw" in out:  # one attitude: a mapping takes no two
        for name in ("qw", "qx", "qy", "qz"):
            out.pop(name, None)
    if not {"qw", "qx", "qy", "qz"} <= out.keys():
        for name in ("qw", "qx", "qy", "qz"):
            out.pop(name, None)
    return out


def _channel_lines(ranked: dict[str, list[_Candidate]], chosen: dict[str, _Candidate]) -> list[str]:
    out = []
    commands = [name for name in chosen if is_command(name)]
    for title, names in (*_GROUPS, ("commands, by the names of thrusters", tuple(commands))):
        if not any(name in ranked for name in names) and names not in _USUAL:
            continue
        unit = "" if is_command(names[0]) else f" [{STANDARD[names[0]].unit}]"
        out += ["", f"# {title}{unit}"]
        instead = names == WORLD_VELOCITY and {"u", "v"} <= chosen.keys()  # one velocity over ground is enough
        for name in names:
            if name not in ranked and names in _USUAL and name not in QUATERNION:
                out.append(f'# {name} = ""')
            found = ranked.get(name, [])
            for k, each in enumerate([*found[:1], *(other for other in found[1 : 1 + _OTHERS] if not other.still)]):
                scale, why = _scale(each)
                line = _line(_entry(name, each, scale), f"{each.column.range}{why}")
                out.append(f"# or: {line}" if k or instead else line)
    return out


def _scale(each: _Candidate) -> tuple[float, str]:
    """Return what to multiply a column by, and why: by the unit in its name, or by its values."""
    said, values = each.said, each.column.values[np.isfinite(each.column.values)]
    if said.rank < 0:  # a standard name
        return 1.0, ""
    if said.unit:
        return said.scale, f", in {said.unit}" if said.scale != 1.0 else ""
    most = float(np.abs(values).max()) if values.size else 0.0
    if said.channel in EULER:
        return _scale_of_angles(each)
    if said.channel in RATES and most > _FAST:
        return (1e-3, ": thousandths of rad/s?") if "gyro" in each.column.path.lower() else (_DEGREE, ": degrees/s?")
    if said.channel == "az" and values.size:
        usual = float(np.median(np.abs(values)))
        if 0.7 < usual < 1.3:
            return _G, ": multiples of g? then ax and ay as well"
        if 700.0 < usual < 1300.0:
            return 1e-3 * _G, ": thousandths of g? then ax and ay as well"
    return said.scale, ", turned round: down is positive" if said.scale < 0.0 else ""


def _scale_of_angles(each: _Candidate) -> tuple[float, str]:
    """Return what to multiply an angle by, and why: all angles of a family have one unit, which the largest tells.

    A calm vehicle's roll and pitch are small in any unit; its heading still goes round.
    """
    most = {name: _most(each, name) for name in EULER}
    pitch, largest = most["theta"], max(most.values())
    if largest > _MANY_TURNS or (pitch > _STEEP if pitch else largest > _TURN):
        return 0.01 * _DEGREE, ": hundredths of a degree?"
    if largest > _TURNS or pitch > _UPRIGHT:
        return _DEGREE, ": degrees?"
    return 1.0, ""


def _most(each: _Candidate, channel: str) -> float:
    """Return how far an angle of the family of `each` goes, in the unit of its column; 0 where there is none."""
    for column in each.table.columns:
        said = suggestion(column.path, each.table.name, each.table.kind)
        family = said is not None and said.channel == channel and said.family == each.said.family
        if family and np.isfinite(column.values).any():
            return float(np.nanmax(np.abs(column.values)))
    return 0.0


def _entry(name: str, each: _Candidate, scale: float) -> str:
    source = _text(each.column.source)
    return f"{name} = {source}" if scale == 1.0 else f"{name} = {{ from = {source}, scale = {scale!r} }}"


def _text(source: str) -> str:
    return json.dumps(source, ensure_ascii=False)


def _line(code: str, comment: str) -> str:
    return f"{code:{_COLUMN}}  # {comment}"


def _rest_lines(tables: Sequence[FoundTable], named: set[str]) -> list[str]:
    """Return all that is not named, table by table, as comments."""
    out = []
    for table in tables:
        rest = [each for each in table.columns if each.source not in named and not each.path.startswith("layout.")]
        if not rest:
            continue
        rate = f", {short(table.rate, 3)} Hz" if table.rate else ""
        if not table.name:
            out += [f"#   {_text(column.source):{_COLUMN - 4}}  {column.range}" for column in rest]
        else:
            ranges = len(rest) <= _FEW
            words = [f"{column.path} ({column.range})," if ranges else column.path for column in rest]
            out += _wrapped(f"#   {table.name}{rate}: ", words)
    return ["", "# What else the log holds:", *out] if out else []


def _wrapped(begin: str, words: Sequence[str]) -> list[str]:
    lines = [begin]
    for word in words:
        if len(lines[-1]) + len(word) > _WIDTH:
            lines.append("#     ")
        lines[-1] += f"{word} "
    return [line.rstrip(" ,") for line in lines]


def found_tables(path: Path) -> list[FoundTable]:
    """Return the tables of a log, of any kind that can be read, those without numbers left out.

    Raises:
        InputError: the file is missing or damaged, or holds no number.
    """
    reader = recognised(path)
    try:
        with np.errstate(invalid="ignore", over="ignore"):
            if reader.name in _COLUMNS:
                columns = importlib.import_module(_COLUMNS[reader.name]).read_columns(path)
                tables = [_table("", columns, None, reader.name, joined=False)]
            else:
                found: Tables = importlib.import_module(_TABLES[reader.name]).tables_of(path)
                tables = [
                    _table(name, table.columns, table.t, table.kind, joined=reader.name != "MATLAB")
                    for name, table in found.tables.items()
                ]
    except (InputError, MemoryError):
        raise
    except Exception as error:
        text = str(error).strip() or type(error).__name__
        raise InputError(f"{path}: damaged, cannot be read as {reader.name} ({text.splitlines()[0][:200]})") from error
    tables = [table for table in tables if table.columns]
    if not tables:
        raise InputError(f"{path}: holds no column of numbers that a mapping could name")
    return tables


def _table(name: str, columns: Mapping[str, Array], t: Array | None, kind: str, *, joined: bool) -> FoundTable:
    """Return a table; `joined` where a mapping names its columns by "TABLE.field"."""
    found = (
        FoundColumn(f"{name}.{path}" if joined and name else path, path, values) for path, values in columns.items()
    )
    return FoundTable(name, tuple(found), t, kind)
