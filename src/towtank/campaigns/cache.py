"""What logs hold: the hash of their content, and copies of remote ones in a bounded cache on this machine.

The cache is the folder that TOWTANK_CACHE names, else `towtank` in the user's folder of caches; it holds at most
TOWTANK_CACHE_GB gigabytes (10), the least recently used go first. A log in use is a link of its own beside the cache,
so that nobody takes it away. A hash is remembered with the size and the time of change of its file, as make does it.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import shutil
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from towtank.campaigns.places import Found, is_remote, patiently, place_of, without_credentials
from towtank.errors import InputError
from towtank.outputs import write_text

__all__ = ["digests_of", "fetched", "name_of"]

_GIGABYTES = 10.0
_READERS = 8  # logs that are hashed at a time; most of that is waiting
_BLOCK = 1 << 20  # bytes
_FRESH = 2_000_000_000  # ns, within which a file may change without another time of change
_FORGOTTEN = 86_400.0  # s, after which nobody uses a link any more
_MOST = 200_000  # hashes that are remembered
_STRANGE = re.compile(r'[<>:"|\\?*\x00-\x1f]')  # what not every file system has in names


def folder() -> Path:
    """Return the folder of the cache."""
    named = os.environ.get("TOWTANK_CACHE")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "towtank"


def limit() -> float:
    """Return the most that the cache may hold [bytes]. Raises InputError."""
    text = os.environ.get("TOWTANK_CACHE_GB", str(_GIGABYTES))
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not value > 0.0:
        raise InputError(f'TOWTANK_CACHE_GB: found "{text}", expected a number of gigabytes above 0')
    return value * 1e9


def digests_of(logs: Sequence[Found]) -> list[str]:
    """Return the hash of the content of each log, remote ones through the cache. Raises InputError, OSError."""
    known = _remembered()
    now = time.time_ns()
    keys = [
        f"{without_credentials(log.uri) if is_remote(log.uri) else log.uri}|{log.size}|{log.changed}" for log in logs
    ]
    missing = [k for k, key in enumerate(keys) if key not in known or now - logs[k].changed < _FRESH]
    with ThreadPoolExecutor(_READERS) as pool:
        found = dict(zip(missing, pool.map(lambda k: _digest(logs[k]), missing), strict=True))
    digests = [found.get(k) or known[key] for k, key in enumerate(keys)]
    fresh = {keys[k]: digest for k, digest in found.items() if now - logs[k].changed >= _FRESH}
    if fresh:
        kept = dict(list({**known, **fresh}.items())[-_MOST:])
        with contextlib.suppress(OSError, InputError):  # then they are hashed again
            folder().mkdir(parents=True, exist_ok=True)
            write_text(folder() / "digests.json", json.dumps(kept))
    return digests


@contextlib.contextmanager
def fetched(uri: str, digest: str) -> Iterator[Path]:
    """Yield the path of a log on this machine, under its own name, for as long as it is used.

    Raises:
        InputError: it is not there, or no longer what it was when the campaign began.
        OSError: it cannot be had.
    """
    if not is_remote(uri):
        path = Path(uri)
        if not path.exists():
            raise InputError(f"{path}: no such file; a log must be there for every worker under the same path")
        if digest_of(path) != digest:
            raise InputError(f"{path}: changed since the campaign began; touch it, then start it again")
        yield path
        return
    kept = folder() / "logs" / digest
    users = folder() / "in-use"
    users.mkdir(parents=True, exist_ok=True)
    own = Path(tempfile.mkdtemp(dir=users))
    path = own / name_of(uri)
    try:
        with contextlib.suppress(OSError):
            os.utime(kept)
        try:
            _link(kept, path)
        except FileNotFoundError:
            if _download(uri, path) != digest:
                raise InputError(
                    f"{without_credentials(uri)}: changed since the campaign began; start it again"
                ) from None
            _keep(path, digest)
        yield path
    finally:
        shutil.rmtree(own, ignore_errors=True)


def name_of(uri: str) -> str:
    """Return the name that a log has on this machine, one that every file system takes.

    >>> name_of("s3://archive/rov7/a:b?.BIN?region=eu-north-1")
    'a_b_.BIN'
    """
    return _STRANGE.sub("_", without_credentials(uri).rpartition("/")[2]).strip(". ") or "log"


def digest_of(path: Path) -> str:
    """Return the hash of a file, or of all files of a folder with their names."""
    if path.is_file():
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    whole = hashlib.sha256()
    for each in sorted(each for each in path.rglob("*") if each.is_file()):
        whole.update(f"{each.relative_to(path).as_posix()}\0{digest_of(each)}\n".encode())
    return whole.hexdigest()


def _digest(log: Found) -> str:
    if not is_remote(log.uri):
        try:
            return digest_of(Path(log.uri))
        except OSError as error:
            raise InputError(f"{log.uri}: cannot be read ({error.strerror})") from error
    users = folder() / "in-use"
    users.mkdir(parents=True, exist_ok=True)
    own = Path(tempfile.mkdtemp(dir=users))
    try:
        digest = _download(log.uri, own / "log")
        _keep(own / "log", digest)
    finally:
        shutil.rmtree(own, ignore_errors=True)
    return digest


def _download(uri: str, path: Path) -> str:
    """Write a remote log to a path and return the hash of what came; all of it, or OSError."""
    place = place_of(uri)
    files = place.files
    if files is None:
        raise InputError(f"{uri}: found a path, expected an object")

    def whole() -> str:
        info: Any = files.get_file_info(place.root)
        if not info.is_file:
            raise InputError(f"{place.name}: no such object")
        found, size = hashlib.sha256(), 0
        with files.open_input_stream(place.root) as stream, path.open("wb") as copy:
            while block := stream.read(_BLOCK):
                found.update(block)
                copy.write(block)
                size += len(block)
        if size != info.size:
            raise OSError(f"{size} bytes came of {info.size}")
        return found.hexdigest()

    return patiently(whole, place.name)


def _keep(path: Path, digest: str) -> None:
    """Put a copy into the cache, and take the least recently used out of it where it holds too much."""
    logs, size = folder() / "logs", path.stat().st_size
    most = limit()
    if size > most:
        return
    logs.mkdir(parents=True, exist_ok=True)
    entries = []
    for each in logs.iterdir():
        with contextlib.suppress(FileNotFoundError):
            about = each.stat()
            entries.append((about.st_mtime, about.st_size, each))
    held = sum(entry[1] for entry in entries)
    for _, freed, each in sorted(entries, key=lambda entry: entry[0]):
        if held + size <= most:
            break
        each.unlink(missing_ok=True)
        held -= freed
    own = path.with_name(f"{path.name}.kept")
    _link(path, own)
    own.replace(logs / digest)
    _sweep(folder() / "in-use")


def _link(source: Path, target: Path) -> None:
    """Give a file a second name, or a copy where the disk knows no second names."""
    try:
        target.hardlink_to(source)
    except FileNotFoundError:
        raise
    except OSError:
        shutil.copyfile(source, target)


def _sweep(users: Path) -> None:
    """Remove the links of processes that were killed."""
    for each in users.iterdir():
        with contextlib.suppress(FileNotFoundError):
            if time.time() - each.stat().st_mtime > _FORGOTTEN:
                shutil.rmtree(each, ignore_errors=True)


def _remembered() -> dict[str, str]:
    with contextlib.suppress(OSError, ValueError):
        found = json.loads((folder() / "digests.json").read_text(encoding="utf-8"))
        if isinstance(found, dict) and all(isinstance(value, str) for value in found.values()):
            return found
    return {}
