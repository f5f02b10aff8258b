"""The layout of MAVLink messages, as pymavlink knows it, for whole arrays of payloads at once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from towtank.readers.record_columns import Place

__all__ = ["MessageLayout", "layouts"]

_LONGEST_ARRAY = 64  # elements; longer ones carry files and images


@dataclass(frozen=True)
class MessageLayout:
    """One message type.

    Attributes:
        number, name: of the type. crc_extra: the byte that its checksum covers last.
        dtype: its payload, extension fields included, in the order on the wire.
        places: where each column of numbers stands; elements of arrays are columns of their own.
        texts: fields of text.
        instance: field that tells several sensors apart, "" where there is none.
    """

    number: int
    name: str
    crc_extra: bytes
    dtype: np.dtype[np.void]
    places: dict[str, Place]
    texts: tuple[str, ...]
    instance: str

    def rows(self, payloads: list[bytes]) -> NDArray[Any]:
        """Return payloads (n,) as records; what was cut off (zeros at the end, extensions) reads as 0."""
        size = self.dtype.itemsize
        return np.frombuffer(b"".join(payload[:size].ljust(size, b"\0") for payload in payloads), self.dtype)


@cache
def layouts() -> dict[int, MessageLayout]:
    """Return the layout of every message of ArduPilot's dialect, by its number."""
    from pymavlink.dialects.v20 import ardupilotmega

    return {number: _layout(kind) for number, kind in ardupilotmega.mavlink_map.items()}


def _layout(kind: Any) -> MessageLayout:
    """Return the layout of a message class of pymavlink."""
    fields: list[Any] = []
    found: dict[str, dict[str, Place]] = {}
    texts: list[str] = []
    codes = kind.native_format.decode().lstrip("<")
    for name, code, length in zip(kind.ordered_fieldnames, codes, kind.array_lengths, strict=True):
        if code == "c":
            fields.append((name, f"S{max(length, 1)}"))
            texts.append(name)
        elif length:
            fields.append((name, f"<{code}", (length,)))
            found[name] = {f"{name}[{k}]": Place(name, k) for k in range(length) if length <= _LONGEST_ARRAY}
        else:
            fields.append((name, f"<{code}"))
            found[name] = {name: Place(name)}
    places = {column: place for name in kind.fieldnames for column, place in found.get(name, {}).items()}
    return MessageLayout(
        kind.id,
        kind.msgname,
        bytes((kind.crc_extra,)),
        np.dtype(fields),
        places,
        tuple(texts),
        kind.instance_field or "",
    )
