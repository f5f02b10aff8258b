"""The checksum of MAVLink, CRC-16/MCRF4XX, at the speed of the standard library.

It is the CRC of `binascii.crc_hqx` with the bits of every byte, and of the result, in reverse order: both have the
polynomial x^16 + x^12 + x^5 + 1, and the initial value 0xFFFF is its own mirror image.
"""

from __future__ import annotations

from binascii import crc_hqx

__all__ = ["checksum"]

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_INITIAL = 0xFFFF


def checksum(data: bytes) -> int:
    """Return the checksum of a message without its first byte, with the extra byte of its type behind it."""
    found = crc_hqx(data.translate(_REVERSED), _INITIAL)
    return _REVERSED[found & 0xFF] << 8 | _REVERSED[found >> 8]
