"""Configurations: a folder of vehicle files with names, for a vehicle that is not always the same one.

    configurations/
        index.toml            name, file, note, when it was saved, hashes of the model and of the logs
        with-gripper.toml     the vehicle file, as it was given

The files are what counts: the index can be made anew from them, and where a file was edited by hand that is said.

The index of a folder of configurations, `index.toml`, and the lock that lets several programs save at once.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
import sys
import time
import tomllib
import unicodedata
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import tomlkit
from pydantic import AfterValidator, BeforeValidator, ValidationError

from towtank.errors import InputError, nearest
from towtank.outputs import write_text
from towtank.printable import toml_escaped
from towtank.vehicle.base import Record, described, first_line
from towtank.vehicle.files import VehicleWarning, load_vehicle, parse_vehicle, vehicle_text
from towtank.vehicle.vehicle import Vehicle

__all__ = ["Configuration", "Configurations", "slug"]

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
    return toml_escaped(tomlkit.dumps(document))


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


@dataclass(frozen=True)
class Configuration:
    """One configuration of a vehicle.

    Attributes:
        name: what people call it. path: its vehicle file. vehicle: what the file says. note: free text.
        saved: when (UTC); None where the index did not know. logs: what it was learned from, with SHA-256.
        sha256: of the file as it is. version: of towtank when it was saved. changed: the file was edited since.
    """

    name: str
    path: Path
    vehicle: Vehicle
    note: str
    saved: datetime | None
    logs: tuple[LogHash, ...]
    sha256: str
    version: str
    changed: bool


class Configurations:
    """The configurations in a folder, which need not exist before something is saved.

    Every call reads what is there; several programs may save at the same time.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)

    def all(self) -> tuple[Configuration, ...]:
        """Return every configuration, the oldest first. Raises InputError where a file cannot be read."""
        if not self.folder.exists():
            return ()
        return tuple(self._loaded(entry) for entry in self._entries())

    def get(self, name: str) -> Configuration:
        """Return the configuration of this name (or file name). Raises InputError."""
        entries = self._entries() if self.folder.exists() else ()
        for entry in entries:
            if name in (entry.name, entry.file, entry.file.removesuffix(".toml")):
                return self._loaded(entry)
        names = [entry.name for entry in entries]
        known = f"{nearest(name, names)}; there are {', '.join(names)}" if names else "; it holds none yet"
        raise InputError(f'{self.folder}: no configuration "{name}"{known}')

    def save(
        self,
        vehicle: Vehicle | str | os.PathLike[str],
        name: str,
        *,
        note: str = "",
        logs: Sequence[str | os.PathLike[str]] = (),
        version: str = "",
    ) -> Configuration:
        """Save a vehicle, or a vehicle file as it is, under a new name; whole or not at all.

        Args:
            version: of towtank, for the index.

        Raises:
            InputError: the name is taken or has no letter or digit, or a file cannot be read.
        """
        stem = slug(name)
        hashes = tuple(LogHash(name=Path(log).name, sha256=path_digest(Path(log))) for log in logs)
        text = vehicle_text(vehicle) if isinstance(vehicle, Vehicle) else _vehicle_file(vehicle)
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{self.folder}: cannot create this folder ({error.strerror}); choose another") from None
        with locked(self.folder):
            entries = self._entries()
            for entry in entries:
                if entry.name == name or entry.file == f"{stem}.toml":
                    raise InputError(
                        f'{self.folder}: "{entry.name}" ({entry.file}) is there already; choose another name, or '
                        "delete that file first"
                    )
            path = self.folder / f"{stem}.toml"
            write_text(path, text)
            saved = datetime.now(UTC).replace(microsecond=0)
            new = Entry(
                name=name, file=path.name, note=note, saved=saved, sha256=digest(text.encode()), logs=hashes,
                towtank=version,
            )  # fmt: skip
            write_text(self.folder / INDEX, index_text((*entries, new)))
        return self._loaded(new)

    def _entries(self) -> tuple[Entry, ...]:
        """Return the index's entries whose files are there, then the files that it does not know."""
        if not self.folder.is_dir():
            raise InputError(f"{self.folder}: this is a file, expected a folder of configurations")
        files = {path.name: path for path in sorted(self.folder.glob("*.toml")) if path.name != INDEX}
        known = [entry for entry in read_index(self.folder) if entry.file in files]
        taken, names = {entry.file for entry in known}, {entry.name for entry in known}
        for file, path in files.items():
            if file in taken:
                continue
            name = path.stem if path.stem not in names else file
            known.append(Entry(name=name, file=file, sha256=path_digest(path)))
        return tuple(known)

    def _loaded(self, entry: Entry) -> Configuration:
        path = self.folder / entry.file
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VehicleWarning)
            vehicle = load_vehicle(path)
        now = path_digest(path)
        return Configuration(
            name=entry.name,
            path=path,
            vehicle=vehicle,
            note=entry.note,
            saved=entry.saved,
            logs=entry.logs,
            sha256=now,
            version=entry.towtank,
            changed=now != entry.sha256,
        )


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def _vehicle_file(path: str | os.PathLike[str]) -> str:
    """Return the text of a vehicle file, or of a vehicle of the catalog, that can be read. Raises InputError."""
    if isinstance(path, str) and not Path(path).is_file():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VehicleWarning)
            return vehicle_text(load_vehicle(path))
    data = _bytes(Path(path))
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: byte {error.start} is not UTF-8 text, expected a vehicle file (.toml)") from None
    parse_vehicle(text, str(path))
    return text
