"""ROS 2 bags in SQLite files, one or a folder of them, and folders of MCAP files."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import zstandard

from towtank.errors import InputError
from towtank.readers.common.raw_messages import Collector, RawMessages, Topic, in_order
from towtank.readers.mcap.scan import scan_mcap
from towtank.recording.repairs import Repairs

__all__ = ["scan_rosbag2"]

Wanted = Callable[[str, str], bool]
_ZSTD = b"(\xb5/\xfd"
_FIRST = -(2**62)  # before any message's number
_LARGEST = 1 << 26  # bytes that a packed message may unpack to
_LEAPS = (1, 16, 256, 4096, 65536)  # messages that are skipped to get behind a broken page
_ENOUGH = 100  # broken pages that are skipped


def scan_rosbag2(path: Path, wanted: Wanted) -> tuple[list[Topic], Repairs]:
    """Return the topics of a bag, with the messages of those for which `wanted(topic, type)` holds.

    Raises:
        InputError: the file is no bag, or there is none in the folder.
    """
    if not path.is_dir():
        return _scan_database(path, path, wanted)
    files = sorted(file for file in path.iterdir() if {".db3", ".mcap"} & set(file.suffixes[-2:]))
    if not files:
        raise InputError(f"{path}: no .db3 or .mcap file in this folder, expected those of a ROS 2 bag")
    parts: dict[tuple[str, str], list[Topic]] = {}
    repairs = Repairs()
    for file in files:
        with _unpacked(file) as plain:
            if ".mcap" in file.suffixes:
                content = scan_mcap(plain, lambda heading: wanted(heading.name, heading.kind))
                topics, repaired = list(content.topics), content.repairs
            else:
                topics, repaired = _scan_database(plain, file, wanted)
        repairs += repaired
        for topic in topics:
            parts.setdefault((topic.name, topic.kind), []).append(topic)
    joined = [_joined(topics) for topics in parts.values()]
    return [topic for topic, _ in joined], repairs + Repairs(disorder=sum(late for _, late in joined))


def _joined(topics: list[Topic]) -> tuple[Topic, int]:
    """Return one topic of its parts in several files."""
    if len(topics) == 1:
        return topics[0], 0
    raws = [topic.raw for topic in topics if topic.raw is not None]
    raw = None
    if len(raws) == len(topics):
        raw = RawMessages(np.concatenate([each.data for each in raws]), np.concatenate([each.size for each in raws]))
    definition = next((topic.definition for topic in topics if topic.definition[0]), topics[0].definition)
    times = np.concatenate([topic.log_time for topic in topics])
    return in_order(replace(topics[0], log_time=times, raw=raw, definition=definition))


@contextmanager
def _unpacked(file: Path) -> Iterator[Path]:
    """Give the file, or where it is compressed as a whole, its content in a temporary place."""
    if file.suffix != ".zstd":
        yield file
        return
    with TemporaryDirectory() as folder:
        plain = Path(folder) / file.stem
        try:
            with file.open("rb") as source, plain.open("wb") as target:
                zstandard.ZstdDecompressor().copy_stream(source, target)
        except zstandard.ZstdError as error:
            raise InputError(f"{file}: cannot be unpacked, expected zstd; it is damaged or cut off") from error
        yield plain


def _scan_database(path: Path, shown: Path, wanted: Wanted) -> tuple[list[Topic], Repairs]:
    """Return the topics of one SQLite file, named `shown` to the user."""
    try:
        with closing(_connect(path)) as database:
            return _read(database, shown, wanted)
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise InputError(
            f"{shown}: not a readable ROS 2 bag: its database is damaged or cut, expected a whole one; copy it again"
        ) from error


def _connect(path: Path) -> sqlite3.Connection:
    """Open read-only; without locks and journals unless the recorder left one that holds the latest messages."""
    journal = path.with_name(path.name + "-wal")
    mode = "mode=ro" if journal.exists() and journal.stat().st_size else "immutable=1"
    database = sqlite3.connect(f"{path.resolve().as_uri()}?{mode}", uri=True)
    database.text_factory = lambda text: text.decode(errors="replace")
    return database


def _read(database: sqlite3.Connection, shown: Path, wanted: Wanted) -> tuple[list[Topic], Repairs]:
    names = {row[0] for row in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if not {"topics", "messages"} <= names:
        raise InputError(f"{shown}: a database without topics and messages, expected a ROS 2 bag")
    definitions: dict[str, tuple[str, str]] = {}
    if "message_definitions" in names:
        rows = database.execute("SELECT topic_type, encoded_message_definition, encoding FROM message_definitions")
        definitions = {str(kind): (str(text), str(language)) for kind, text, language in rows}
    collectors: dict[int, Collector] = {}
    taken = []
    for number, name, kind, encoding in database.execute("SELECT id, name, type, serialization_format FROM topics"):
        if not isinstance(number, int):
            continue
        keep = wanted(str(name), str(kind))
        topic = Topic(str(name), str(kind), str(encoding), np.empty(0, np.int64), None, definitions.get(kind, ("", "")))
        collectors[number] = Collector(topic, wanted=keep)
        taken += [number] * keep
    data = f"CASE WHEN topic_id IN ({','.join(map(str, taken))}) THEN data END" if taken else "NULL"
    damaged, details = 0, []
    for row in _messages(database, f"SELECT id, topic_id, timestamp, {data} FROM messages WHERE id > ? ORDER BY id"):
        if isinstance(row, int):
            damaged += row
            continue
        _, number, stamp, message = row
        try:
            if not stamp >= 0:
                raise ValueError("recorded before 1970")
            collectors[number].add(int(stamp), _plain(message or b""))
        except (KeyError, TypeError, ValueError, OverflowError, zstandard.ZstdError):  # infinite times among them
            damaged += 1
    if damaged:
        details.append("pages of the database are broken")
    found = [collector.topic() for collector in collectors.values()]
    late = sum(count for _, count in found)
    return [topic for topic, _ in found], Repairs(disorder=late, damaged=damaged, details=tuple(details))


def _messages(database: sqlite3.Connection, query: str) -> Iterator[tuple[int, int, int, bytes | None] | int]:
    """Yield the rows; where a page is broken, how many were skipped to get behind it."""
    seen = at = _FIRST
    for _ in range(_ENOUGH):
        try:
            for row in database.execute(query, (at,)):
                if at > seen:  # the first row behind a broken page
                    yield int(row[0] - seen - 1)
                seen = at = row[0]
                yield row
            return
        except sqlite3.DatabaseError:
            readable = (seen + leap for leap in _LEAPS if _readable(database, query, seen + leap))
            following = next(readable, None) if seen > _FIRST else None
            if following is None:
                break
            at = following
    yield 1  # how many follow is not known


def _readable(database: sqlite3.Connection, query: str, last: int) -> bool:
    try:
        return database.execute(query, (last,)).fetchone() is not None
    except sqlite3.DatabaseError:
        return False


def _plain(message: bytes) -> bytes:
    """Return a message that may be packed by itself."""
    if message[:4] != _ZSTD:
        return message
    if zstandard.frame_content_size(message) > _LARGEST:
        raise ValueError("a message that unpacks to more than is sensible")
    return zstandard.ZstdDecompressor().decompress(message, max_output_size=_LARGEST)
