"""The index of a folder of configurations, `index.toml`, and the lock that lets several programs save at once."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import sys
import time
import tomllib
import unicodedata
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import tomlkit
from pydantic import AfterValidator, BeforeValidator, ValidationError

from towtank.errors import InputError
from towtank.vehicle.base import Record, described
from towtank.vehicle.messages import first_line

__all__ = ["INDEX", "Entry", "LogHash", "digest", "index_text", "locked", "path_digest", "read_index", "slug"]

INDEX = "index.toml"
_LOCK = ".lock"
_PATIENCE = 10.0  # s that one waits for the lock
_LONGEST = 80
_PIECE = 1 << 20
_FILE = re.compile(r"[a-z0-9][a-z0-9._-]*\.toml", re.IGNORECASE)


def slug(name: str) -> str:
    """Return the file name, without suffix, for a configuration's name: lower-case letters, digits and hyphens.

    >>> slug("With gripper, 2 kg")
    'with-gripper-2-kg'

    Raises:
        InputError: the name has no letter or digit, is too long, has line breaks, or is that of the index.
    """
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    found = re.sub(r"[^a-z0-9]+", "-", plain).strip("-")
    if not found or len(name) > _LONGEST or not name.isprintable() or name != name.strip():
        raise InputError(
            f'name: found "{name[:_LONGEST]}", expected one line of up to {_LONGEST} characters with a letter a to z '
            'or a digit among them, such as "with gripper"'
        )
    if f"{found}.toml" == INDEX:
        raise InputError(f'name: found "{name}", which is the name of the index; choose another one')
    return found


def digest(data: bytes) -> str:
    """Return the SHA-256 of some bytes, as hexadecimal text."""
    return hashlib.sha256(data).hexdigest()


def path_digest(path: Path) -> str:
    """Return the SHA-256 of a file, or of the files of a folder (a ROS 2 bag) in order. Raises InputError."""
    sha = hashlib.sha256()
    try:
        for part in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if part.is_file() or part == path:
                with part.open("rb") as stream:
                    while piece := stream.read(_PIECE):
                        sha.update(piece)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    return sha.hexdigest()


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise ValueError(f"found {described(value)}, expected a text")
    return value


def _file(value: str) -> str:
    if not _FILE.fullmatch(value) or value == INDEX:
        raise ValueError(f'found "{value}", expected the name of a vehicle file in this folder')
    return value


def _time(value: object) -> datetime | None:
    if not isinstance(value, datetime):
        raise ValueError(f"found {described(value)}, expected a date and time such as 2026-01-31T12:00:00Z")
    return value if value.tzinfo else value.replace(tzinfo=UTC)


_Text = Annotated[str, BeforeValidator(_text)]


class LogHash(Record):
    """A log that a configuration was learned from: its file name and SHA-256."""

    name: _Text
    sha256: _Text


class Entry(Record):
    """What the index says of one configuration."""

    name: _Text
    file: Annotated[_Text, AfterValidator(_file)]
    note: _Text = ""
    saved: Annotated[datetime, BeforeValidator(_time)] | None = None
    sha256: _Text = ""
    logs: tuple[LogHash, ...] = ()
    towtank: _Text = ""


class _Index(Record):
    configuration: tuple[Entry, ...] = ()


def read_index(folder: Path) -> tuple[Entry, ...]:
    """Return what the index of a folder says; nothing where there is none. Raises InputError."""
    path = folder / INDEX
    try:
        data = tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except FileNotFoundError:
        return ()
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}); delete it, and it is made anew from the files") from None
    try:
        entries = _Index.model_validate(data).configuration
    except ValidationError as error:
        told = first_line(error, data)
        raise InputError(f"{path}: {told}; mend it, or delete it, and it is made anew from the files") from None
    seen: dict[str, str] = {}
    for entry in entries:
        for key in (f"name {entry.name}", f"file {entry.file}"):
            if key in seen:
                raise InputError(f"{path}: the {key} stands there twice; delete one of the two tables")
            seen[key] = entry.file
    return entries


def index_text(entries: Sequence[Entry]) -> str:
    """Return the TOML text of an index."""
    document = tomlkit.document()
    document.add(tomlkit.comment("written by towtank config; the vehicle files beside it are what counts"))
    tables = tomlkit.aot()
    for entry in entries:
        table = tomlkit.table()
        for key, value in entry.model_dump(exclude_none=True, exclude={"logs"}).items():
            table.add(key, value)
        if entry.logs:
            logs = tomlkit.array()
            for log in entry.logs:
                inline = tomlkit.inline_table()
                inline.update(log.model_dump())
                logs.append(inline)
            table.add("logs", logs.multiline(True))
        tables.append(table)
    document.add("configuration", tables)
    return tomlkit.dumps(document)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, so that nobody else saves meanwhile; it ends with the program that holds it.

    Raises:
        InputError: the folder cannot be written, or somebody holds the lock for long.
    """
    path = folder / _LOCK
    try:
        handle = os.open(path, os.O_CREAT | os.O_RDWR, 0o666)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); choose another folder") from None
    try:
        began = time.monotonic()
        while not _try_lock(handle):
            if time.monotonic() - began > _PATIENCE:
                raise InputError(f"{folder}: another program has been saving here for {_PATIENCE:g} s; try again later")
            time.sleep(0.02)
        yield
    finally:
        os.close(handle)


def _try_lock(handle: int) -> bool:
    """Lock an open file for this program alone, without waiting; False where another has it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
