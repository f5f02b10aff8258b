"""MAVLink messages, as pymavlink knows them: their layout for whole arrays of payloads, and their checksum.

The checksum, CRC-16/MCRF4XX, is the CRC of `binascii.crc_hqx` with the bits of every byte, and of the result, in
reverse order: both have the polynomial x^16 + x^12 + x^5 + 1, and the initial value 0xFFFF is its own mirror image.
"""

from __future__ import annotations

from binascii import crc_hqx
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from towtank.readers.common.tables import Place

__all__ = ["MessageLayout", "checksum", "layouts"]

_LONGEST_ARRAY = 64  # elements; longer ones carry files and images
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_INITIAL = 0xFFFF


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


def checksum(data: bytes) -> int:
    """Return the checksum of a message without its first byte, with the extra byte of its type behind it."""
    found = crc_hqx(data.translate(_REVERSED), _INITIAL)
    return _REVERSED[found & 0xFF] << 8 | _REVERSED[found >> 8]
