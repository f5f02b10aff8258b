"""Places: folders of this machine, or of an object store by `pyarrow.fs`. What is written there is whole or absent.

`s3://BUCKET/FOLDER` and `gs://BUCKET/FOLDER` name object stores; everything else is a path. Credentials come from the
environment, from the files of the vendors' own tools, or from the machine; a store that is not Amazon's is named by
AWS_ENDPOINT_URL. Networks fail now and then, so everything remote is tried several times, and what was written is
looked at.
"""

from __future__ import annotations

import contextlib
import datetime
import errno
import fnmatch
import os
import random
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import parse_qs, unquote

from towtank.errors import InputError
from towtank.outputs import write_atomically

if TYPE_CHECKING:
    from pyarrow.fs import FileSystem

__all__ = [
    "Found",
    "Place",
    "Unreachable",
    "is_remote",
    "logs_of",
    "place_of",
    "remote_place",
    "told",
    "without_credentials",
]

T = TypeVar("T")

_SCHEMES = ("s3", "gs")
_TRIES = 8  # of anything remote; with one failure in twenty a run of eight comes once in 4e10
_FIRST_PAUSE = 0.1  # s, twice as long each time
_REQUEST, _CONNECT = 10.0, 5.0  # s
_GOOGLE_PATIENCE = 60.0  # s
_BLOCK = 1 << 20  # bytes
_WILD = re.compile(r"[*?\[]")
_URI = re.compile(r"(.*?)://(?:([^/]*|[^/]*:.*)@)?(.*?)(\?\w+=.*)?", re.DOTALL)  # scheme, user, path, options
_BUCKET = re.compile(r"[\w.-]+")
_CHECK = "check the network, the bucket's name and, where the store is not Amazon's, AWS_ENDPOINT_URL"
_LEFT_OVER = 86_400.0  # s, after which a temporary file is nobody's
_TEMPORARY = re.compile(r"\..+\.part")
_DENIED = re.compile(
    r"ACCESS_DENIED|AccessDenied|INVALID_ACCESS_KEY|InvalidAccessKey|SIGNATURE_DOES_NOT_MATCH|SignatureDoesNotMatch|"
    r"EXPIRED_TOKEN|ExpiredToken|UNRECOGNIZED_CLIENT|MISSING_AUTHENTICATION|HTTP response code 40[13]|"
    r"(?i:no credentials|could not (find|create).*credentials|unauthenticated|permission denied)"
)
_NO_BUCKET = re.compile(r"NO_SUCH_BUCKET|NoSuchBucket|(?i:bucket .*(not found|does not exist))")


class Unreachable(OSError):
    """An object store that failed every time; `filename` is its name, `strerror` how it failed and what to check."""

    def __str__(self) -> str:
        return f"{self.filename}: {self.strerror}"


@dataclass(frozen=True)
class Found:
    """A log that is there: where, what messages call it, its size [bytes] and when it was changed [ns]."""

    uri: str
    label: str
    size: int
    changed: int


@dataclass(frozen=True)
class Place:
    """A folder, here or in an object store.

    Attributes:
        uri: that names it, an absolute path or with its scheme; it may hold credentials. name: without them.
        files: of pyarrow where it is remote, None for a folder of this machine. root: its path there.
    """

    uri: str
    name: str
    files: FileSystem | None
    root: str

    def names(self, folder: str, suffix: str) -> set[str]:
        """Return the names, without the suffix, of the files in a folder below; none where it is missing."""
        if self.files is None:
            return _local_names(Path(self.root, folder), suffix)
        from pyarrow.fs import FileSelector

        files, chosen = self.files, FileSelector(f"{self.root}/{folder}", allow_not_found=True)
        entries = self._patiently(lambda: files.get_file_info(chosen))
        return {each.base_name.removesuffix(suffix) for each in entries if each.base_name.endswith(suffix)}

    def read(self, name: str) -> bytes | None:
        """Return what a file holds, None where there is none."""
        if self.files is None:
            try:
                return Path(self.root, name).read_bytes()
            except (FileNotFoundError, NotADirectoryError):
                return None
            except (PermissionError, IsADirectoryError) as error:
                raise InputError(f"{Path(self.root, name)}: cannot be read ({error.strerror})") from None
        files = self.files

        def whole() -> bytes | None:
            info = files.get_file_info(f"{self.root}/{name}")
            if not info.is_file:
                return None
            with files.open_input_stream(info.path) as stream:
                data: bytes = stream.read()
            if len(data) != info.size:
                raise OSError(f"{self.name}/{name}: {len(data)} bytes came of {info.size}")
            return data

        return self._patiently(whole)

    def exists(self, name: str) -> bool:
        """Whether there is a file of this name."""
        if self.files is None:
            return Path(self.root, name).is_file()
        files = self.files
        return bool(self._patiently(lambda: files.get_file_info(f"{self.root}/{name}").is_file))

    def write(self, name: str, data: bytes) -> None:
        """Write a file, whole or not at all; one of this name is replaced."""
        if self.files is None:
            path = Path(self.root, name)
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
            except (FileExistsError, NotADirectoryError, PermissionError) as error:
                raise InputError(
                    f"{path.parent}: cannot be made a folder ({error.strerror}); choose another place"
                ) from None
            write_atomically(path, lambda stream: _write(stream, data))
            return
        files = self.files

        def put() -> None:
            stream = files.open_output_stream(f"{self.root}/{name}")
            stream.write(data)
            stream.close()
            size = files.get_file_info(f"{self.root}/{name}").size
            if size != len(data):
                raise OSError(f"{self.name}/{name}: {size} bytes are there of {len(data)}")

        self._patiently(put)

    def remove(self, name: str) -> None:
        """Remove a file, if it is there."""
        if self.files is None:
            Path(self.root, name).unlink(missing_ok=True)
            return
        files = self.files
        with contextlib.suppress(FileNotFoundError):
            self._patiently(lambda: files.delete_file(f"{self.root}/{name}"))

    def sweep(self, folder: str) -> None:
        """Remove what processes that were killed left half written a day ago or longer."""
        if self.files is not None:
            return  # of an object that was not finished nothing is seen
        with contextlib.suppress(FileNotFoundError):
            for entry in os.scandir(Path(self.root, folder)):
                with contextlib.suppress(FileNotFoundError):
                    if _TEMPORARY.fullmatch(entry.name) and time.time() - entry.stat().st_mtime > _LEFT_OVER:
                        Path(entry.path).unlink()

    def _patiently(self, ask: Callable[[], T]) -> T:
        return patiently(ask, self.name)


def patiently(ask: Callable[[], T], name: str) -> T:
    """Return what `ask` returns, asked again where a network fails; `name` is that of the place, for messages.

    Raises:
        InputError: no such bucket, or it may not be used with these credentials.
        Unreachable: it failed every time.
    """
    failed = OSError()
    for k in range(_TRIES):
        if k:
            time.sleep(_FIRST_PAUSE * 2.0 ** (k - 1) * random.uniform(0.5, 1.0))
        try:
            return ask()
        except FileNotFoundError:
            raise
        except OSError as error:
            refuse(error, name)
            failed = error
    text = f"{told(failed)}, {_TRIES} times in a row; {_CHECK}"
    raise Unreachable(errno.EHOSTUNREACH, text, name) from failed


def refuse(error: OSError, name: str) -> None:
    """Raise InputError where asking again would change nothing: no bucket, no credentials."""
    text = str(error)
    if _NO_BUCKET.search(text):
        raise InputError(f"{name}: there is no such bucket; create it first, or mend its name") from None
    if _DENIED.search(text):
        raise InputError(
            f"{name}: access is denied, expected credentials that may use it (AWS_ACCESS_KEY_ID and "
            "AWS_SECRET_ACCESS_KEY, ~/.aws, or for gs:// gcloud auth application-default login)"
        ) from None


def told(error: BaseException) -> str:
    """Return what a library says of an error, on one line and not too long."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def is_remote(uri: str) -> bool:
    """Whether a text names a place in an object store. Raises InputError for schemes that are not known."""
    scheme, separator, _ = uri.partition("://")
    if not separator:
        return False
    if scheme not in _SCHEMES:
        raise InputError(
            f"{without_credentials(uri)}: found {scheme}://, expected s3://BUCKET/FOLDER, gs://BUCKET/FOLDER or a path"
        )
    return True


def place_of(uri: str) -> Place:
    """Return a place by its path or URI; a folder of this machine need not exist.

    Raises:
        InputError: no bucket, no credentials, or another scheme.
    """
    if not is_remote(uri):
        path = Path(uri).absolute()
        with contextlib.suppress(OSError):
            if path.is_file():
                raise InputError(f"{path}: this is a file, expected a folder")
        return Place(str(path), str(path), None, str(path))
    return remote_place(uri)


@cache
def remote_place(uri: str) -> Place:
    """Return a place in an object store; it is asked for once. Raises InputError."""
    files, root = _remote(uri)
    name = without_credentials(uri)
    place = Place(uri, name, files, root)
    bucket = root.partition("/")[0]
    if not patiently(lambda: files.get_file_info(bucket).type.name != "NotFound", name):
        raise InputError(f"{name}: there is no such bucket; create it first, or mend its name")
    return place


def without_credentials(uri: str) -> str:
    """Return a URI as it may be shown: without user, password and options.

    >>> without_credentials("s3://key:secret@archive/logs?region=eu-north-1")
    's3://archive/logs'
    """
    scheme, _, rest, _ = _split(uri)
    return f"{scheme}://{rest.rstrip('/')}"


def _split(uri: str) -> tuple[str, str, str, str]:
    """Return scheme, user and password, path with the bucket first, and options of a URI; "" for what it lacks.

    >>> _split("s3://key:secret@archive/a#?.BIN?region=eu-north-1")
    ('s3', 'key:secret', 'archive/a#?.BIN', '?region=eu-north-1')
    """
    found = _URI.fullmatch(uri)
    if found is None:
        raise InputError(f'found "{uri}", expected SCHEME://BUCKET/FOLDER')
    return found[1], found[2] or "", found[3], found[4] or ""


def _remote(uri: str) -> tuple[Any, str]:
    """Return the file system of a URI and the path in it, bucket first."""
    from pyarrow import fs

    scheme, user, rest, asked = _split(uri)
    bucket, _, path = rest.partition("/")
    if not _BUCKET.fullmatch(bucket):
        raise InputError(f"{without_credentials(uri)}: names no bucket, expected {scheme}://BUCKET/FOLDER")
    root = f"{bucket}/{path.strip('/')}".rstrip("/")
    if scheme == "gs":
        wait = datetime.timedelta(seconds=_GOOGLE_PATIENCE)
        return fs.GcsFileSystem(anonymous=user == "anonymous", retry_time_limit=wait), root
    given = {name: values[-1] for name, values in parse_qs(asked[1:]).items()}
    endpoint = (
        given.get("endpoint_override") or os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL")
    )
    region = given.get("region") or os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION")
    options: dict[str, Any] = {"request_timeout": _REQUEST, "connect_timeout": _CONNECT, "allow_delayed_open": True}
    if endpoint:
        kind, _, host = endpoint.rpartition("://")
        options |= {"endpoint_override": host.rstrip("/"), "scheme": given.get("scheme") or kind or "https"}
    elif not region:
        region = patiently(lambda: str(fs.resolve_s3_region(bucket)), without_credentials(uri))
    name, _, password = user.partition(":")
    if name and password:
        options |= {"access_key": unquote(name), "secret_key": unquote(password)}
    return fs.S3FileSystem(region=region or "us-east-1", background_writes=False, **options), root


# -- logs by their patterns


def logs_of(pattern: str, folder: Path) -> list[Found]:
    """Return the logs that a pattern names, in the order of their names; none where there are none.

    Args:
        pattern: a path or URI in which `*` and `?` stand for anything within one name, `**` for any folders between.
        folder: that a path begins in unless it is absolute; logs below it are called by their paths in it.

    Raises:
        InputError: no bucket, no credentials, another scheme, or no pattern at all.
    """
    if is_remote(pattern):
        return sorted(_remote_logs(pattern), key=lambda f: f.uri)
    try:
        return sorted(_local_logs(pattern, folder), key=lambda f: f.uri)
    except (ValueError, IndexError, RuntimeError, NotImplementedError):
        raise InputError(
            f'logs: "{pattern}" is no pattern of paths; expected one such as archive/**/*.BIN, ** alone between slashes'
        ) from None


def _local_logs(pattern: str, folder: Path) -> Iterator[Found]:
    wanted = Path(pattern).expanduser()
    base = Path(wanted.anchor) if wanted.is_absolute() else folder
    for path in base.glob(str(wanted.relative_to(wanted.anchor))):
        if path.is_dir() and not (path / "metadata.yaml").is_file():
            continue  # a folder that is no bag
        label = path.relative_to(folder) if path.is_relative_to(folder) else path
        parts = [path] if path.is_file() else sorted(each for each in path.rglob("*") if each.is_file())
        about = [each.stat() for each in parts]
        size, changed = sum(each.st_size for each in about), max((each.st_mtime_ns for each in about), default=0)
        yield Found(str(path.absolute()), label.as_posix(), size, changed)


def _remote_logs(pattern: str) -> Iterator[Found]:
    from pyarrow.fs import FileSelector

    scheme, user, rest, options = _split(pattern)
    before = f"{scheme}://{user}@" if user else f"{scheme}://"
    wild = _WILD.search(rest)
    fixed = rest if wild is None else rest[: wild.start()].rpartition("/")[0]
    place = place_of(f"{before}{fixed}{options}")
    if place.files is None:
        return
    files = place.files
    asked = place.root if wild is None else FileSelector(place.root, recursive=True, allow_not_found=True)
    found = patiently(lambda: files.get_file_info(asked), place.name)
    wanted = re.compile(_expression(rest))
    for entry in found if isinstance(found, list) else [found]:
        if entry.is_file and wanted.fullmatch(entry.path):
            yield Found(
                f"{before}{entry.path}{options}", f"{scheme}://{entry.path}", int(entry.size), int(entry.mtime_ns or 0)
            )


def _expression(pattern: str) -> str:
    """Return the regular expression of a pattern of paths.

    >>> bool(re.fullmatch(_expression("a/**/*.csv"), "a/b/c/d.csv"))
    True
    >>> bool(re.fullmatch(_expression("a/*.csv"), "a/b/d.csv"))
    False
    """
    out = []
    for part in re.split(r"(\*\*/|\*\*|\*|\?)", pattern):
        known = {"**/": "(?:[^/]+/)*", "**": ".*", "*": "[^/]*", "?": "[^/]"}
        out.append(known[part] if part in known else fnmatch.translate(part)[4:-3] if part else "")
    return "".join(out)


def _local_names(folder: Path, suffix: str) -> set[str]:
    try:
        with os.scandir(folder) as entries:
            names = [entry.name for entry in entries]
    except (FileNotFoundError, NotADirectoryError):
        return set()
    return {name.removesuffix(suffix) for name in names if name.endswith(suffix) and not name.startswith(".")}


def _write(stream: Any, data: bytes) -> None:
    stream.write(data)
