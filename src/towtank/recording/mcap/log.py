"""A recording that is written while it is made: appended to, flushed at least every second, readable after `kill -9`.

    with McapLog.open("dive.mcap", epoch=datetime.now(UTC)) as log:
        log.source("pose", [Quantity("x", "m", "NED"), Quantity("y", "m", "NED")])
        log.write("pose", 0.02, 1.5, -0.3)       # NaN: not measured
        log.write_raw("udp:14550", 0.02, packet)

The format is that of `write_mcap`. Samples may come late or out of order; reading sorts them, and counts. A file that
is removed while it is written is made anew from what the system still holds of it; of one that is cut, what is left is
gone on with. One process writes a file: another one is refused.
"""

from __future__ import annotations

import errno
import os
import struct
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from towtank.errors import InputError
from towtank.recording.event import EVENT_ENCODING, EVENT_SCHEMA, EVENT_TOPIC, Event, event_json
from towtank.recording.mcap.container import McapFile, Messages
from towtank.recording.mcap.format import ABOUT, ENCODING, LIBRARY, RAW_ENCODING, About, Quantity, SourceFormat
from towtank.recording.mcap.resume import Interrupted, interrupted

if sys.platform != "win32":
    import fcntl

__all__ = ["McapLog", "Quantity"]

_RECORD = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE = 5  # opcode
_CDR = b"\x00\x01\x00\x00"
_LONGEST = 1 << 20  # bytes of messages after which a chunk is closed
_LATEST = 2**63 - 1  # ns
_PATIENCE = 1 << 25  # bytes that wait for a disk that takes nothing
_PIECE = 1 << 20  # bytes copied at once
_SYNCED = 0.5  # s at least between two times that what the system holds is seen to the disk


@dataclass
class _Pending:
    """Messages of the chunk in progress."""

    records: bytearray = field(default_factory=bytearray)
    places: dict[int, tuple[list[int], list[int]]] = field(default_factory=dict)
    count: int = 0

    def add(self, channel: int, log_time: int, data: bytes) -> None:
        times, offsets = self.places.setdefault(channel, ([], []))
        times.append(log_time)
        offsets.append(len(self.records))
        self.records += _RECORD.pack(_MESSAGE, 22 + len(data), channel, self.count & 0xFFFFFFFF, log_time, log_time)
        self.records += data
        self.count += 1

    @property
    def messages(self) -> dict[int, Messages]:
        return {
            channel: Messages(np.array(times, dtype=np.uint64), np.array(offsets, dtype=np.uint64))
            for channel, (times, offsets) in self.places.items()
        }


class McapLog:
    """The writer; used by one thread at a time.

    A disk that is full costs samples, never the session: nothing here raises for it once the file is open. What cannot
    be written waits, up to 32 MB, and is counted in `lost` when that is exceeded; `trouble` says what is wrong, ""
    where nothing is.

    Attributes:
        path: the file.
        lost: samples and packets that could not be written, or were cut off from outside.
        incidents: what befell the file from outside, in words.
        complete: whether it was closed with its index.
    """

    def __init__(
        self, path: Path, descriptor: int, about: About, interval: float, before: Interrupted | None = None
    ) -> None:
        self.path, self.lost, self.complete = path, 0, False
        self.incidents: list[str] = []
        self._untaken = self._unsynced = ""  # what the disk said to the last write, and to the last sync
        self._moved = False
        self._descriptor, self._about, self._interval = descriptor, about, interval
        self._written = 0 if before is None else before.length  # bytes of the file that are whole
        if before is None:
            self._file = McapFile(self._append, LIBRARY)
            self._file.metadata(ABOUT, about.metadata())
            self._file.write_descriptions()
        else:
            self._file = McapFile.resumed(self._append, before.length, before.summary)
        self._sources: dict[str, tuple[int, struct.Struct, int]] = {}
        self._columns: dict[str, tuple[str, ...]] = {}
        self._raw: dict[str, int] = {}
        self._texts: dict[str, int] = {}
        self._pending = _Pending()
        self._flushed = self._synced = time.monotonic()
        self._syncing: threading.Thread | None = None
        self._closed = False

    @classmethod
    def open(
        cls,
        path: str | os.PathLike[str],
        *,
        source: str = "",
        epoch: datetime | None = None,
        attributes: Mapping[str, str] | None = None,
        interval: float = 1.0,
    ) -> McapLog:
        """Create the file.

        Args:
            path: must not exist: a recording is never overwritten.
            source: what is recorded.
            epoch: the instant of t = 0, with its time zone; without it the times of the file count from t = 0.
            attributes: of the recording.
            interval: longest time [s] for which a sample waits in memory while others follow.

        Raises:
            InputError: the file exists or cannot be created.
        """
        path = Path(path)
        known = dict(attributes or {})
        if epoch is not None:
            known["epoch"] = epoch.isoformat()
        base = 0 if epoch is None else max(round(epoch.timestamp() * 1e6) * 1000, 0)
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            raise InputError(f"{path}: exists already, and a recording is never overwritten; choose another") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be created ({error.strerror})") from error
        try:
            _lock(descriptor)
            log = cls(path, descriptor, About(source=source, attributes=known, base=base), interval)
        except OSError as error:
            os.close(descriptor)
            path.unlink(missing_ok=True)
            raise InputError(f"{path}: cannot be written ({error.strerror})") from error
        return log

    @classmethod
    def resume(cls, path: str | os.PathLike[str], *, interval: float = 1.0) -> McapLog:
        """Go on with a file that an earlier `McapLog` wrote, whether that was closed or killed.

        A record that was torn, or the file's summary, is cut off; everything else stays as it is, and so do the
        epoch, the attributes and the sources.

        Raises:
            InputError: there is no such file, it is no recording of ours, or it cannot be written.
        """
        path = Path(path)
        interrupted(path)
        try:
            descriptor = os.open(path, os.O_RDWR)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror})") from error
        try:
            _lock(descriptor)
            before = interrupted(path)  # as it is now that nobody else writes
            os.ftruncate(descriptor, before.length)
            os.lseek(descriptor, before.length, os.SEEK_SET)
        except BlockingIOError:
            os.close(descriptor)
            raise InputError(
                f"{path}: another session is recording to it; end that one first, or record to another file"
            ) from None
        except OSError as error:
            os.close(descriptor)
            raise InputError(f"{path}: cannot be written ({error.strerror})") from error
        log = cls(path, descriptor, before.about, interval, before)
        for identity, form in before.sources.items():
            count = len(form.quantities)
            layout = struct.Struct(f"<4s{1 + count}d")
            log._sources[form.topic.lstrip("/")] = identity, layout, count
            log._columns[form.topic.lstrip("/")] = tuple(each.name for each in form.quantities)
        log._texts.update(before.texts)
        log._raw.update({topic.removeprefix("/raw/"): identity for identity, topic in before.raw.items()})
        return log

    @property
    def about(self) -> About:
        """What the file says of the recording."""
        return self._about

    @property
    def trouble(self) -> str:
        """What is wrong with the disk, "" where nothing is."""
        return self._untaken or self._unsynced

    @property
    def size(self) -> int:
        """Bytes written so far."""
        return self._written

    @property
    def sources(self) -> dict[str, tuple[str, ...]]:
        """The sources announced, each with the names of its columns."""
        return dict(self._columns)

    def describe(self, attributes: Mapping[str, str | None]) -> None:
        """Say more of the recording, or anew: attributes that are known only while it is made; None takes one back."""
        said = {**(self._about.attributes or {}), **attributes}
        self._about = replace(self._about, attributes={key: text for key, text in said.items() if text is not None})
        self._file.metadata(ABOUT, self._about.metadata())

    def source(self, name: str, quantities: Sequence[Quantity]) -> None:
        """Announce a source: the columns that come together, each with name, unit and frame.

        Raises:
            InputError: the name is taken, there is no column, or one stands twice.
        """
        names = [each.name for each in quantities]
        if name in self._sources:
            raise InputError(f'{self.path}: source "{name}" is announced twice')
        if not names or len(set(names)) < len(names):
            raise InputError(
                f'{self.path}: source "{name}": found columns {names}, expected one or more, all different'
            )
        form = SourceFormat(f"/{name.lstrip('/')}", tuple(quantities))
        identity = self._file.channel(form.topic, ENCODING, form.metadata, form.schema)
        self._sources[name] = identity, struct.Struct(f"<4s{1 + len(names)}d"), len(names)
        self._columns[name] = tuple(names)

    def write(self, name: str, t: float, *values: float) -> None:
        """Append one sample at time t [s] of an announced source; NaN where not measured."""
        identity, layout, count = self._sources[name]
        if len(values) != count:
            raise ValueError(f'source "{name}": found {len(values)} values, expected {count}')
        self._add(identity, t, layout.pack(_CDR, t, *values))

    def write_raw(self, name: str, t: float, data: bytes) -> None:
        """Append bytes as they were received at time t [s]; a channel of their own is made on first use."""
        if name not in self._raw:
            self._raw[name] = self._file.channel(f"/raw/{name.lstrip('/')}", RAW_ENCODING, {})
        self._add(self._raw[name], t, data)

    def write_event(self, event: Event) -> None:
        """Append an event, as JSON on a topic of its own."""
        self.write_text(EVENT_TOPIC, EVENT_SCHEMA, event.t, event_json(event))

    def write_text(self, topic: str, schema: tuple[str, str, bytes], t: float, text: str) -> None:
        """Append JSON of time t [s] on a topic of its own, described by a schema (name, encoding, text)."""
        if topic not in self._texts:
            self._texts[topic] = self._file.channel(topic, EVENT_ENCODING, {}, schema)
        self._add(self._texts[topic], t, text.encode())

    def flush(self) -> bool:
        """Write what waits and see it to the disk; return whether everything is there now."""
        if not self._written_out():
            return False
        self._sync()
        return not self._unsynced

    def flush_if_due(self) -> None:
        """Flush where the last time was longer than the interval ago; to be called when nothing arrives."""
        if time.monotonic() - self._flushed >= self._interval:
            self._flush_beside()

    def _flush_beside(self) -> None:
        """Write what waits, which outlives this process; a thread sees it to the disk, however busy that is."""
        idle = self._syncing is None or not self._syncing.is_alive()
        if self._written_out() and idle and self._flushed - self._synced >= _SYNCED:
            self._synced = self._flushed
            self._syncing = threading.Thread(target=self._sync, name="disk", daemon=True)
            self._syncing.start()

    def _sync(self) -> None:
        try:
            os.fsync(self._descriptor)
            self._unsynced = ""
        except OSError as error:
            self._unsynced = self._said(error)

    def _said(self, error: OSError) -> str:
        return f"{self.path}: {error.strerror or error}"

    def _written_out(self) -> bool:
        """Hand what waits to the system; return whether it took everything."""
        self._flushed = time.monotonic()
        pending = self._pending
        try:
            self._look_after_file()
            if pending.count:
                self._file.chunk(bytes(pending.records), pending.messages)
                self._pending = _Pending()
                self._untaken = ""
            elif self._file.undescribed:
                self._file.write_descriptions()
                self._untaken = ""
        except OSError as error:
            self._untaken = self._said(error)
            if len(pending.records) >= _PATIENCE:
                self.lost += pending.count
                self._pending = _Pending()
            return False
        return True

    def _look_after_file(self) -> None:
        """See whether the file is still what was written, and mend it where it is not. Raises OSError."""
        found = os.fstat(self._descriptor)
        if found.st_size < self._written:
            self._go_on_behind_cut(found.st_size)
        if not found.st_nlink:
            self._make_anew()
        elif not self._moved and not self.path.exists():
            self._moved = True
            self.incidents.append(f"{self.path} was moved; it is written on under its new name")

    def _go_on_behind_cut(self, size: int) -> None:
        """Keep the whole records that somebody has left of the file, and describe again what follows them."""
        gone, before = self._written - size, self._file.summary
        try:
            left = interrupted(self.path)
        except InputError:  # not even its beginning
            left = Interrupted()
        os.ftruncate(self._descriptor, left.length)
        os.lseek(self._descriptor, left.length, os.SEEK_SET)
        self._written = left.length
        if left.length:
            self._file = McapFile.resumed(self._append, left.length, left.summary)
        else:
            self._file = McapFile(self._append, LIBRARY)
        self._file.metadata(ABOUT, self._about.metadata())
        self._file.describe_again(before)
        lost = sum(before.counts.values()) - sum(left.summary.counts.values())
        self.lost += lost
        self.incidents.append(
            f"{gone} bytes were cut off {self.path} from outside, {lost} samples and packets in them; it goes on"
        )

    def _make_anew(self) -> None:
        """Write the file again, under its name or a free one, from what the system holds of it while it is open."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        place, number = self.path, 2
        while place.exists():
            place = self.path.with_name(f"{self.path.stem}-{number}{self.path.suffix}")
            number += 1
        fresh = os.open(place, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        try:
            _lock(fresh)
            at = 0
            while at < self._written:
                piece = memoryview(os.pread(self._descriptor, min(_PIECE, self._written - at), at))
                at += len(piece)
                while piece:
                    piece = piece[os.write(fresh, piece) :]
            os.dup2(fresh, self._descriptor, inheritable=False)
        except OSError:
            place.unlink(missing_ok=True)
            raise
        finally:
            os.close(fresh)
        name = "under its name" if place == self.path else f"as {place}"
        self.incidents.append(f"{self.path} was removed from outside; what it held is written anew {name}")
        self.path = place

    def close(self, notes: Sequence[str] = ()) -> None:
        """Flush, add notes and what was lost, and write the index; a file without it is read all the same."""
        if self._closed:
            return
        self._closed = True
        if self._syncing is not None:
            self._syncing.join()
        self.flush()
        self.lost += self._pending.count
        lost = [f"{self.lost} samples could not be written ({self.trouble or 'the disk was full'})"] * bool(self.lost)
        if notes or lost:
            self._file.metadata(ABOUT, replace(self._about, notes=(*self._about.notes, *notes, *lost)).metadata())
        try:
            self._file.finish()
            os.fsync(self._descriptor)
            self.complete = True
        except OSError as error:
            self._untaken = self._said(error)
        os.close(self._descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _add(self, identity: int, t: float, data: bytes) -> None:
        log_time = min(max(self._about.base + round(t * 1e9), 0), _LATEST)
        self._pending.add(identity, log_time, data)
        full = len(self._pending.records) >= (_PATIENCE if self.trouble else _LONGEST)
        if full or time.monotonic() - self._flushed >= self._interval:
            self._flush_beside()

    def _append(self, data: bytes) -> None:
        """Append whole records or nothing: what a full disk cuts short is taken back."""
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self._descriptor, view) :]
        except OSError:
            os.ftruncate(self._descriptor, self._written)
            os.lseek(self._descriptor, self._written, os.SEEK_SET)
            raise
        self._written += len(data)


def _lock(descriptor: int) -> None:
    """Keep other processes from writing a file, where the system can. Raises BlockingIOError where one does."""
    if sys.platform == "win32":
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError as error:  # network disks without locks
        if error.errno in (errno.EACCES, errno.EAGAIN):
            raise BlockingIOError(error.errno, error.strerror) from error
