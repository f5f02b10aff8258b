"""HOST:PORT as it stands on the command line."""

from __future__ import annotations

from towtank.errors import InputError

__all__ = ["host_and_port"]


def host_and_port(text: str, prefix: str) -> tuple[str, int]:
    """Return host and port of "PREFIXHOST:PORT"; the host may be in brackets, or absent: this machine alone.

    Raises:
        InputError: there is no port, or it is none.
    """
    host, colon, port = text.removeprefix(prefix).rpartition(":")
    if not colon or not port.isascii() or not port.isdigit() or not 0 < int(port) < 65536:
        raise InputError(f'source "{text}": expected {prefix}HOST:PORT with a port of 1 to 65535')
    return host.strip("[]") or "127.0.0.1", int(port)
