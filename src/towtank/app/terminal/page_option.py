"""The options `--page` and `--foxglove [HOST:PORT]` of commands that run a session, and the page itself around that."""

from __future__ import annotations

import contextlib
import ipaddress
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated, Any

import typer

from towtank.app.terminal.guard import PlainCommand

if TYPE_CHECKING:
    from towtank.dashboard.feed import Feed
    from towtank.dashboard.page import Page
    from towtank.dashboard.routes import Reports

__all__ = ["FoxgloveOption", "PageOption", "PagedCommand", "new_page", "page_address", "serving"]

_OPTION, _DEFAULT = "--page", "127.0.0.1:8765"
_FOXGLOVE = "127.0.0.1:8766"
_ALONE = {_OPTION: _DEFAULT, "--foxglove": _FOXGLOVE}  # options that may stand without a value, and what they mean then
FoxgloveOption = Annotated[
    str | None,
    typer.Option(
        "--foxglove",
        metavar="[HOST:PORT]",
        help=f"Serve the session to Foxglove; default: {_FOXGLOVE}. Its protocol has no token: at any other address "
        "anybody on the network can look.",
    ),
]
PageOption = Annotated[
    str | None,
    typer.Option(
        _OPTION,
        metavar="[HOST:PORT]",
        help=f"Show the session in a browser; default: {_DEFAULT}. Others on the network need the token that is "
        f"printed. "
        "Give a host by name as --page=NAME:PORT.",
    ),
]


class PagedCommand(PlainCommand):
    """A command whose `--page` and `--foxglove` may stand alone; what follows is a value only if it is an address."""

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        """Parse the arguments."""
        given = []
        for k, word in enumerate(args):
            following = args[k + 1] if k + 1 < len(args) else ""
            alone = word in _ALONE and not _is_address(following)
            given.append(f"{word}={_ALONE[word]}" if alone else word)
        return super().parse_args(ctx, given)


def _is_address(word: str) -> bool:
    """Whether a word is HOST:PORT of an IP address or of this machine, and not the name of a source."""
    host, _, port = word.rpartition(":")
    if not port.isdecimal():
        return False
    try:
        ipaddress.ip_address(host.removeprefix("[").removesuffix("]"))
    except ValueError:
        return host in ("", "localhost")
    return True


def page_address(text: str | None) -> Any:
    """Return the address of `--page`; None where no page is asked for. Raises InputError."""
    if text is None:
        return None
    from towtank.dashboard.access import Address
    from towtank.dashboard.assets import page_assets

    page_assets()
    return Address.parse(text)


@contextlib.contextmanager
def serving(page: Page | None, say: Callable[[str], None], *, browser: bool = False) -> Iterator[Page | None]:
    """Serve a page and say where it is; open it where a browser is wanted."""
    if page is None:
        yield None
        return
    with page:
        say(f"page: {page.url}")
        if not page.address.loopback:
            say("page: anyone with this address and its token can watch and control; the connection is not encrypted")
        if browser:
            import webbrowser

            webbrowser.open(page.url)
        yield page


def new_page(feed: Feed, text: str | None, say: Callable[[str], None], reports: Reports | None = None) -> Page | None:
    """Return the page for a feed, bound to its address but not serving yet; None where none is asked for.

    Raises:
        InputError: as `Page`.
    """
    address = page_address(text)
    if address is None:
        return None
    from towtank.dashboard.page import Page

    return Page(feed, address, say=say, reports=reports)
