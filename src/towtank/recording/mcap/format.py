"""Our recordings in MCAP: what a channel of the file, a message and the metadata hold.

Channels of a recording that share their times are one *source*: one MCAP channel, one message per sample. A message is
plain CDR of a flat ROS 2 message, described in the file by its own schema, so that robotics tools plot every field
under its name:

    float64 t      # s, exact; log_time is the same instant in ns
    float64 u      # m/s, FRD

Names, units and frames stand once in the metadata of the MCAP channel; everything about the recording as a whole in the
metadata record "towtank".
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import towtank
from towtank.core.arrays import Array
from towtank.recording.recording import Recording
from towtank.recording.repairs import Content, Repairs

__all__ = [
    "ABOUT",
    "ENCODING",
    "KEY",
    "LIBRARY",
    "MAGIC",
    "MESSAGE_HEAD",
    "RAW_ENCODING",
    "RECORD_HEAD",
    "About",
    "Quantity",
    "SourceFormat",
    "decode_samples",
    "encode_samples",
    "log_times",
]

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of the content
MESSAGE_HEAD = np.dtype(  # a message record before its data
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
KEY = "towtank"  # in the metadata of a channel: it is ours, and which version of this format
ABOUT = "towtank"  # name of the metadata record
LIBRARY = f"towtank {towtank.__version__}"
ENCODING = "cdr"
RAW_ENCODING = "application/octet-stream"
_VERSION = "1"
_CDR_LITTLE = b"\x00\x01\x00\x00"
_LONGEST = 48  # characters of a topic made of names


class Quantity(NamedTuple):
    """One column of a source."""

    name: str
    unit: str = ""
    frame: str = ""


@dataclass(frozen=True)
class SourceFormat:
    """A source as an MCAP channel: its topic and its columns."""

    topic: str
    quantities: tuple[Quantity, ...]

    @property
    def message_size(self) -> int:
        """Bytes of a message: the head, the time and the values."""
        return len(_CDR_LITTLE) + 8 * (1 + len(self.quantities))

    @property
    def schema(self) -> tuple[str, str, bytes]:
        """Name, encoding and text of the schema: a ROS 2 message with the columns as fields."""
        lines = ["float64 t  # s"]
        for field, each in zip(_fields(self.quantities), self.quantities, strict=True):
            remark = ", ".join(text for text in (each.unit, each.frame) if text)
            lines.append(f"float64 {field}" + (f"  # {remark}" if remark else ""))
        name = "".join(part.capitalize() for part in re.split(r"[^A-Za-z0-9]+", self.topic) if part)
        return f"towtank/msg/{name}", "ros2msg", ("\n".join(lines) + "\n").encode()

    @property
    def metadata(self) -> dict[str, str]:
        """Metadata of the channel."""
        return {KEY: _VERSION, "columns": json.dumps([list(each) for each in self.quantities])}

    @classmethod
    def of_metadata(cls, topic: str, metadata: Mapping[str, str]) -> SourceFormat | None:
        """Return the source that a channel's metadata describe; None where it is not one of ours.

        Raises:
            ValueError: it was one of ours and is damaged, or is of a later version.
        """
        if KEY not in metadata:
            return None
        if metadata[KEY] != _VERSION:
            raise ValueError(f'channel "{topic}" is of version {metadata[KEY]} of the format, expected {_VERSION}')
        try:
            columns = json.loads(metadata.get("columns", "null"))
            quantities = tuple(Quantity(*(_text(part) for part in column)) for column in columns)
        except (TypeError, ValueError, RecursionError) as error:
            raise ValueError(
                f'channel "{topic}" does not say its columns, expected [[name, unit, frame], ...]; the file is damaged'
            ) from error
        return cls(topic, quantities)

    @classmethod
    def named_after(cls, quantities: Sequence[Quantity], taken: Iterable[str]) -> SourceFormat:
        """Return a source with a topic made of its columns' names, other than those taken."""
        names = [each.name for each in quantities]
        commands = all(name.startswith("cmd_") for name in names)
        stem = "commands" if commands else re.sub(r"[^A-Za-z0-9_]", "_", "_".join(names))[:_LONGEST]
        known = set(taken)
        topics = (f"/{stem}" + (f"_{k}" if k > 1 else "") for k in range(1, len(known) + 2))
        return cls(next(topic for topic in topics if topic not in known), tuple(quantities))


def encode_samples(t: Array, values: Array) -> NDArray[np.uint8]:
    """Return the messages (n, 12 + 8 m) of times (n,) [s] and values (n, m)."""
    head = np.tile(np.frombuffer(_CDR_LITTLE, dtype=np.uint8), (len(t), 1))
    body = np.ascontiguousarray(np.column_stack([t, values]), dtype="<f8").view(np.uint8)
    return np.hstack([head, body])


def decode_samples(messages: NDArray[np.uint8]) -> tuple[Array, Array]:
    """Return times (n,) [s] and values (n, m) of messages (n, 12 + 8 m); the inverse of `encode_samples`."""
    numbers = np.ascontiguousarray(messages[:, len(_CDR_LITTLE) :]).view("<f8").astype(np.float64, copy=False)
    return numbers[:, 0], numbers[:, 1:]


def log_times(t: Array, base: int) -> NDArray[np.uint64]:
    """Return `base` [ns] plus times (n,) [s] as ns, within what MCAP can hold."""
    nanoseconds = np.rint(np.clip(t, -4e9, 4e9) * 1e9).astype(np.int64)
    return np.maximum(nanoseconds + base, 0).astype(np.uint64)


@dataclass(frozen=True)
class About:
    """All of a recording but its channels.

    Attributes:
        order: names of the channels in their order.
        base: time of t = 0 on the file's clock [ns].
        contents: None where the file has no record of them.
    """

    source: str = ""
    notes: tuple[str, ...] = ()
    attributes: Mapping[str, str] | None = None
    repairs: Repairs = Repairs()
    contents: tuple[Content, ...] | None = None
    order: tuple[str, ...] = ()
    base: int = 0

    @classmethod
    def of(cls, recording: Recording) -> About:
        """Return what there is to say of a recording."""
        starts = [float(channel.t[0]) for channel in recording.channels.values() if len(channel)]
        return cls(
            recording.source,
            recording.notes,
            recording.attributes,
            recording.repairs,
            recording.contents,
            recording.names,
            _base(recording.attributes.get("epoch", ""), min(starts)),
        )

    def metadata(self) -> dict[str, str]:
        """Return the content of the metadata record."""
        about = {
            "source": self.source,
            "notes": self.notes,
            "attributes": dict(self.attributes or {}),
            "repairs": asdict(self.repairs),
            "order": self.order,
            "base_ns": self.base,
        }
        if self.contents is not None:
            about["contents"] = [asdict(content) for content in self.contents]
        return {"version": _VERSION, "about": json.dumps(about)}

    @classmethod
    def of_metadata(cls, metadata: Mapping[str, str]) -> About:
        """Return what a metadata record says. Raises ValueError where it is damaged."""
        try:
            about: dict[str, Any] = json.loads(metadata["about"])
            contents = about.get("contents")
            return cls(
                _text(about["source"]),
                tuple(_text(note) for note in about["notes"]),
                {_text(key): _text(value) for key, value in about["attributes"].items()},
                Repairs(**{key: _tuples(value) for key, value in about["repairs"].items()}),
                None if contents is None else tuple(Content(**_record(each)) for each in contents),
                tuple(_text(name) for name in about["order"]),
                int(about["base_ns"]),
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"the record about the recording is damaged ({error})") from error


def _base(epoch: str, start: float) -> int:
    """Return the time [ns] of t = 0: the epoch if it is known, and never so early that `start` lies before zero."""
    try:
        moment = datetime.fromisoformat(epoch)
        known = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError):
        known = 0.0
    return max(round(known * 1e6) * 1000, round(-min(max(start, -4e9), 0.0) * 1e9), 0)


def _fields(quantities: Sequence[Quantity]) -> list[str]:
    """Return a name for each column that a ROS message may have: a letter, then letters, digits and underscores."""
    fields: list[str] = []
    for each in quantities:
        stem = re.sub(r"[^A-Za-z0-9]+", "_", each.name).strip("_") or "column"
        stem = stem if stem[0].isalpha() else f"n{stem}"
        name, k = stem, 1
        while name in ("t", *fields):
            k += 1
            name = f"{stem}_{k}"
        fields.append(name)
    return fields


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError(f"found {value!r}, expected text")
    return value


def _tuples(value: object) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _record(value: Mapping[str, Any]) -> dict[str, Any]:
    return {key: _tuples(item) for key, item in value.items()}
