"""Configurations: a folder of vehicle files with names, for a vehicle that is not always the same one.

    configurations/
        index.toml            name, file, note, when it was saved, hashes of the model and of the logs
        with-gripper.toml     the vehicle file, as it was given

The files are what counts: the index can be made anew from them, and where a file was edited by hand that is said.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from towtank.errors import InputError, nearest
from towtank.outputs import write_text
from towtank.vehicle.configuration_index import (
    INDEX,
    Entry,
    LogHash,
    digest,
    index_text,
    locked,
    path_digest,
    read_index,
    slug,
)
from towtank.vehicle.files import VehicleWarning, load_vehicle, parse_vehicle, vehicle_text
from towtank.vehicle.vehicle import Vehicle

__all__ = ["Configuration", "Configurations"]


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
            raise InputError(f"{self.folder}: cannot be made a folder ({error.strerror}); choose another one") from None
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
