"""Who may do what: hosts, origins, and the token, compared in constant time; refusals are counted and named once."""

from __future__ import annotations

import hmac
import ipaddress
import socket
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from towtank.errors import InputError

__all__ = ["DEFAULT_PAGE", "Access", "Address", "Refusals"]

DEFAULT_PAGE = "127.0.0.1:8765"
_PORTS = 65535
_MOST = 256  # peers that are named


@dataclass(frozen=True)
class Address:
    """Where the page is served; port 0 is any that is free."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> Address:
        """Read `HOST:PORT`, `HOST`, `:PORT` or `[HOST]:PORT`. Raises InputError."""
        host, colon, port = text.rpartition(":")
        if not colon or text.endswith("]"):
            host, port = text, DEFAULT_PAGE.rpartition(":")[2]
        host = host.removeprefix("[").removesuffix("]") or "127.0.0.1"
        if not port.isdecimal() or int(port) > _PORTS or "/" in host or " " in host:
            raise InputError(f'--page: found "{text}", expected HOST:PORT, as {DEFAULT_PAGE}')
        return cls(host, int(port))

    @property
    def loopback(self) -> bool:
        """Whether nobody but this machine gets there."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    @property
    def text(self) -> str:
        """As it stands in a URL."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


class Access:
    """Judges requests to one address.

    Args:
        address: with its true port. token: for controls, and for everything where the address is not loopback.
    """

    def __init__(self, address: Address, token: str) -> None:
        self.address, self.token = address, token
        self.cookie = f"towtank_{address.port}"  # browsers do not tell ports apart
        self._names = {"localhost", address.host.lower()} if address.loopback else _names(address.host)
        self._everywhere = address.host in ("0.0.0.0", "::")

    def host(self, headers: Mapping[str, str]) -> bool:
        """Whether `Host` names us. A name of somebody else's that leads here is a rebinding of names."""
        return self._ours(headers.get("host", ""))

    def origin(self, headers: Mapping[str, str]) -> bool:
        """Whether the request comes from our own page, or from no page at all."""
        origin = headers.get("origin")
        if origin is None:
            return headers.get("sec-fetch-site", "none") in ("none", "same-origin")
        return origin == f"http://{headers.get('host', '')}" and self.host(headers)

    def known(self, headers: Mapping[str, str], cookies: Mapping[str, str]) -> bool:
        """Whether the request bears the token, as a cookie or as `Authorization: Bearer`."""
        scheme, _, token = headers.get("authorization", "").partition(" ")
        by_cookie = self.right(cookies.get(self.cookie, ""))
        by_header = self.right(token.strip()) and scheme.lower() == "bearer"
        return by_cookie or by_header

    def may_look(self, headers: Mapping[str, str], cookies: Mapping[str, str]) -> bool:
        """Whether the request may see the page."""
        return self.address.loopback or self.known(headers, cookies)

    def may_steer(self, headers: Mapping[str, str], cookies: Mapping[str, str]) -> bool:
        """Whether the request may pause, mark, and so on; a cookie alone counts only with our own origin."""
        if not self.known(headers, cookies) or not self.origin(headers):
            return False
        return "origin" in headers or "authorization" in headers

    def right(self, token: str) -> bool:
        """Whether this is the token."""
        return hmac.compare_digest(token.encode("utf-8", "surrogateescape"), self.token.encode())

    def _ours(self, host: str) -> bool:
        name, _, port = host.rpartition(":")
        if port != str(self.address.port):
            if self.address.port != 80 or (port.isdecimal() and name):
                return False
            name = host
        name = name.removeprefix("[").removesuffix("]").lower()
        if name in self._names:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return self._everywhere or name == self.address.host


def _names(host: str) -> set[str]:
    """Return the names of this machine under which others may call it."""
    own = socket.gethostname().lower()
    return {host.lower(), own, own.partition(".")[0], f"{own.partition('.')[0]}.local"}


class Refusals:
    """Counts by reason.

    Args:
        say: called with one line for each peer and reason, the first time.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self.counts: Counter[str] = Counter()
        self._say, self._said = say, set[tuple[str, str]]()

    def add(self, peer: str, reason: str) -> None:
        """Count one refusal of a peer, by its address."""
        self.counts[reason] += 1
        if (peer, reason) not in self._said and len(self._said) < _MOST:
            self._said.add((peer, reason))
            self._say(f"page: {peer}: {reason}: refused, and counted from now on without a word")

    @property
    def total(self) -> int:
        """How many there were."""
        return sum(self.counts.values())
