"""Mapping files: which column of a foreign table is which channel, and in which frames it stands.

    thrusters = ["pwm1", "pwm2"]       # source columns in the order of the vehicle's [[thrusters]]
    body = "FLU"                       # FRD (default) or FLU
    world = "ENU"                      # NED (default) or ENU
    rate = 100.0                       # Hz, only where the source has no time column
    [columns]
    t = "time"
    psi = { from = "yaw_deg", scale = 0.017453292519943295, offset = 0.0 }    # scale * column + offset
    [marker]                           # what x y z (and u v w, u_w v_w w_w) are measured at
    position = [0.10, 0.0, -0.20]      # m from the body origin, body FRD
    of = ["position", "velocity"]      # what is moved to the body origin; default both

Channel names stand on the left, columns of the table on the right. Thrusters are commands by their place, until they
are bound to those of a vehicle.
"""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn, Self, TypeAlias

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    ValidationError,
    model_validator,
)

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.recording.recording import Recording
from towtank.recording.standard import COMMAND_PREFIX, EULER, QUATERNION, STANDARD, STATES, is_command, is_standard

__all__ = ["AnyMapping", "Column", "ColumnMapping", "Marker", "bind_thrusters", "load_mapping", "mapping_of"]

_KEYS: Mapping[str, tuple[str, ...]] = {
    "": ("thrusters", "body", "world", "rate", "columns", "marker"),
    "columns": ("from", "scale", "offset"),
    "thrusters": ("from", "scale", "offset"),
    "marker": ("position", "of"),
}


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", populate_by_name=True)


def _not_zero(value: float) -> float:
    if value == 0.0:
        raise ValueError("found 0, expected another number")
    return value


def _channel_name(name: str) -> str:
    if name != "t" and not is_standard(name) and name not in STATES:
        known = ["t", *STANDARD, *STATES]
        raise ValueError(f'unknown channel "{name}"{nearest(name, known)}; known: {", ".join(known)}, cmd_<thruster>')
    return name


class Column(_Record):
    """Where a channel comes from: channel = scale * column + offset."""

    source: str = Field(alias="from", min_length=1)
    scale: Annotated[FiniteFloat, AfterValidator(_not_zero)] = 1.0
    offset: FiniteFloat = 0.0

    def apply(self, values: Array) -> Array:
        """Return the channel's values (n,) for the column's."""
        if self.scale == 1.0 and self.offset == 0.0:
            return values
        return self.scale * values + self.offset


_ColumnEntry = Annotated[Column, BeforeValidator(lambda value: {"from": value} if isinstance(value, str) else value)]


_ChannelName = Annotated[str, AfterValidator(_channel_name)]


class Marker(_Record):
    """The tracked point: its position (3,) [m] in body FRD, and what is measured at it."""

    position: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    of: tuple[Literal["position", "velocity"], ...] = ("position", "velocity")


class ColumnMapping(_Record):
    """A mapping file. Columns it does not name are ignored, but a column `t` is taken as the time."""

    thrusters: tuple[_ColumnEntry, ...] = ()
    body: Literal["FRD", "FLU"] = "FRD"
    world: Literal["NED", "ENU"] = "NED"
    rate: Annotated[FiniteFloat, Field(gt=0)] | None = None
    columns: dict[_ChannelName, _ColumnEntry] = Field(default_factory=dict)
    marker: Marker | None = None

    @model_validator(mode="after")
    def _check_whole(self) -> Self:
        if self.rate is not None and "t" in self.columns:
            raise ValueError("rate and columns.t are both given, expected one of them")
        if self.thrusters and any(map(is_command, self.columns)):
            raise ValueError(f"thrusters and columns.{COMMAND_PREFIX}... are both given, expected one of them")
        given = [name for name in QUATERNION if name in self.columns]
        if given and len(given) < len(QUATERNION):
            raise ValueError(f"columns: found {' '.join(given)}, expected all of {' '.join(QUATERNION)} or none")
        if given and any(name in self.columns for name in EULER):
            raise ValueError("columns: found both Euler angles and a quaternion, expected one attitude")
        return self

    def channels(self) -> dict[str, Column]:
        """Return channel name -> column, without the time; thrusters are cmd_1, cmd_2, ... until bound."""
        commands = {f"{COMMAND_PREFIX}{k}": column for k, column in enumerate(self.thrusters, 1)}
        return {**{name: column for name, column in self.columns.items() if name != "t"}, **commands}

    def time(self, names: Sequence[str]) -> Column | float | None:
        """Return the column of time, else the rate [Hz] of the rows, else None."""
        if "t" in self.columns:
            return self.columns["t"]
        if self.rate is not None:
            return self.rate
        return Column(source="t") if "t" in names else None


def load_mapping(path: str | os.PathLike[str]) -> ColumnMapping:
    """Read a mapping file. Raises InputError with file, key, what was found and what was expected."""
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such mapping file") from None
    except tomllib.TOMLDecodeError as error:
        place = re.search(r" \(at line (\d+), column (\d+)\)", str(error))
        where = f":{place[1]}:{place[2]}" if place else ""
        reason = str(error).replace(place[0], "") if place else str(error)
        raise InputError(f"{path}{where}: not valid TOML: {reason}") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as TOML ({error})") from error
    return _validated(data, str(path))


AnyMapping: TypeAlias = ColumnMapping | Mapping[str, Any] | str | os.PathLike[str]  # or its tables, or its file


def mapping_of(mapping: AnyMapping) -> ColumnMapping:
    """Return a mapping as it is given: a record, the tables of its file as a dictionary, or the path of that file.

    Raises:
        InputError: as `load_mapping`.
    """
    if isinstance(mapping, ColumnMapping):
        return mapping
    return _validated(mapping, "mapping") if isinstance(mapping, Mapping) else load_mapping(mapping)


def _validated(data: Mapping[str, Any], place: str) -> ColumnMapping:
    try:
        return ColumnMapping.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{place}: {_explain(error.errors()[0], error.error_count())}") from error


def _explain(error: Any, count: int) -> str:
    location = [str(part) for part in error["loc"] if part != "[key]"]
    key = ".".join(location)
    more = f" (and {count - 1} more)" if count > 1 else ""
    if error["type"] == "extra_forbidden":
        known = _KEYS[location[0] if len(location) > 1 else ""]
        hint = nearest(location[-1], known)
        if len(location) == 1 and (is_standard(key) or key == "t"):
            hint = "; channels stand under [columns]"
        return f'unknown key "{key}"{hint}; known: {", ".join(known)}{more}'
    if error["type"] == "missing":
        return f'missing key "{key}"{more}'
    reason = error["msg"].removeprefix("Value error, ")
    if error["type"] == "value_error":
        if reason.startswith("unknown channel"):
            key = "columns"
        return (f"{key}: {reason}" if key else reason) + more
    return f"{key}: found {error['input']!r}, expected {_expected(reason)}{more}"


def _expected(reason: str) -> str:
    return reason.removeprefix("Input should be ").removeprefix("a valid ")


def bind_thrusters(recording: Recording, thrusters: Sequence[str]) -> Recording:
    """Return the recording with one command channel `cmd_<thruster>` for each thruster, in the vehicle's
    order.

    Commands cmd_1 .. cmd_n, as a mapping's `thrusters = [...]` gives them, are renamed in order; commands
    that bear the vehicle's names stay. A recording without commands (of wrenches) is returned as it is.

    Raises:
        InputError: the recording has more, fewer or other thrusters than the vehicle.
    """
    commanded = [name.removeprefix(COMMAND_PREFIX) for name in recording.names if is_command(name)]
    if not commanded:
        return recording
    prefix = f"{recording.source}: " if recording.source else ""
    if set(commanded) == set(thrusters):
        names = {name: name for name in thrusters}
    elif set(commanded) == {str(k) for k in range(1, len(commanded) + 1)}:
        if len(commanded) != len(thrusters):
            many = "thruster" if len(commanded) == 1 else "thrusters"
            raise InputError(
                f"{prefix}found commands of {len(commanded)} {many}, the vehicle has {len(thrusters)} "
                f"({', '.join(thrusters) or 'none'}); choose the vehicle that made the log, towtank vehicle list shows "
                "the thrusters of each"
            )
        names = {str(k): name for k, name in enumerate(thrusters, 1)}
    else:
        _refuse(prefix, commanded, thrusters)
    bound = [recording[COMMAND_PREFIX + old].renamed(COMMAND_PREFIX + new) for old, new in names.items()]
    rest = [channel for name, channel in recording.channels.items() if not is_command(name)]
    return recording.with_channels([*rest, *bound])


def _refuse(prefix: str, commanded: Sequence[str], thrusters: Sequence[str]) -> NoReturn:
    known = ", ".join(thrusters) or "none"
    for name in commanded:
        if name not in thrusters:
            raise InputError(
                f'{prefix}the vehicle has no thruster "{name}" for "{COMMAND_PREFIX}{name}"'
                f"{nearest(name, thrusters)}; its thrusters: {known}"
            )
    missing = [COMMAND_PREFIX + name for name in thrusters if name not in commanded]
    raise InputError(f"{prefix}no {', '.join(missing)}; expected a command for each thruster of the vehicle ({known})")
