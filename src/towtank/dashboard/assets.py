"""The files of the page: read once, kept in memory, and served by names that are known from the start."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from importlib.resources import files

from towtank.errors import InputError

__all__ = ["INDEX", "Asset", "page_assets"]

INDEX = "/"
_TYPES = {
    "html": "text/html; charset=utf-8",
    "js": "text/javascript; charset=utf-8",
    "css": "text/css; charset=utf-8",
    "svg": "image/svg+xml",
}


@dataclass(frozen=True)
class Asset:
    """One file: its bytes, media type and tag."""

    body: bytes
    media_type: str
    tag: str


def page_assets() -> dict[str, Asset]:
    """Return the files by the path of their URL.

    Raises:
        InputError: they were never built.
    """
    folder = files("towtank.dashboard").joinpath("static")
    found = {}
    if folder.is_dir():
        for entry in folder.iterdir():
            media_type = _TYPES.get(entry.name.rpartition(".")[2])
            if media_type is not None and entry.is_file():
                body = entry.read_bytes()
                path = INDEX if entry.name == "index.html" else f"/{entry.name}"
                found[path] = Asset(body, media_type, f'"{hashlib.sha256(body).hexdigest()[:16]}"')
    if INDEX not in found:
        raise InputError("--page: the page's files are not built; run `npm ci && npm run build` in web/, or `make demo`")
    return found
