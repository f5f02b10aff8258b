"""What was learned so far, beside the recording: written whole every few seconds, so that a new start goes on from it.

The file holds one line of JSON and then what `Learner.save` writes. It is seen to the disk before it takes the place of
the one before, and so is the folder: a power cut leaves one of the two. Only the learner's own part is written by the
thread that learns; the rest, which waits for the disk, by a thread of its own. A learner that cannot be saved has none;
then, as where the file is missing or damaged, the recording is learned from once more. What an earlier session learned
is gone on from: its checkpoint, and what its recording has after it.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import tempfile
import threading
import weakref
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from towtank.errors import InputError
from towtank.identification import Learner
from towtank.live.pipeline.clock import steady_time
from towtank.live.pipeline.instants import Row, rows_of
from towtank.readers import read
from towtank.recording import Recording, bind_thrusters
from towtank.recording.grids.grid import held_at
from towtank.recording.standard import is_held
from towtank.vehicle import Vehicle

__all__ = ["Checkpoint", "Earlier", "earlier"]

_VERSION = 2
_PAUSE = 3.0  # s between the end of a recording and what follows it, where the clock does not tell: a new stretch
_MEMORY = "/dev/shm"


class Checkpoint:
    """The file beside a recording.

    Attributes:
        path: `FILE.mcap.state`.
        trouble: why the last one could not be written, "" where it could.
    """

    def __init__(self, recording: Path, about: Mapping[str, Any]) -> None:
        """`about`: settings of the learner, plain data; a checkpoint of others is not gone on from."""
        self.path = recording.with_name(f"{recording.name}.state")
        self.trouble = ""
        self._writing: threading.Thread | None = None
        self._quick: Path | None = None  # a folder in memory, of this process alone
        self._about = json.loads(json.dumps({"version": _VERSION, **about}))

    def save(self, learner: Learner, t: float, *, wait: bool = False) -> bool:
        """Write what was learned up to t [s of the recording]; return whether that was begun, or done.

        Args:
            wait: until it is on the disk. Else nothing is begun while the one before still waits for the disk.
        """
        if not learner.keeps_checkpoints:
            return False
        if self._writing is not None:
            if not wait and self._writing.is_alive():
                return False
            self._writing.join()
        part = self._part()
        try:
            learner.save(part)
        except (OSError, InputError) as error:
            self._failed(error)
            return False
        head = json.dumps({**self._about, "t": t}).encode() + b"\n"
        self._writing = threading.Thread(target=self._put, args=(head, part), name="checkpoint", daemon=True)
        self._writing.start()
        if wait:
            self._writing.join()
        return not (wait and self.trouble)

    def _part(self) -> Path:
        """Return where the learner writes: in memory where the system has a folder there, to wait for no disk."""
        if self._quick is None and os.access(_MEMORY, os.W_OK):
            with contextlib.suppress(OSError):
                _clear_after_the_killed()
                self._quick = Path(tempfile.mkdtemp(prefix=f"towtank-{os.getpid()}-", dir=_MEMORY))
                weakref.finalize(self, shutil.rmtree, self._quick, ignore_errors=True)
        return self._beside("part") if self._quick is None else self._quick / "part"

    def _put(self, head: bytes, part: Path) -> None:
        """Make the file of its two parts, and see it to the disk."""
        whole = self._beside("tmp")
        try:
            with whole.open("wb") as stream:
                stream.write(head)
                stream.write(part.read_bytes())
                stream.flush()
                os.fsync(stream.fileno())
            whole.replace(self.path)
            _sync_folder(self.path.parent)
            self.trouble = ""
        except OSError as error:
            self._failed(error)
        finally:
            with contextlib.suppress(OSError):
                whole.unlink(missing_ok=True)
                part.unlink(missing_ok=True)

    def _failed(self, error: OSError | InputError) -> None:
        self.trouble = f"{self.path}: {getattr(error, 'strerror', None) or error}"

    def load(self, vehicle: Vehicle, **settings: Any) -> tuple[Learner, float] | None:
        """Return the learner and the time [s of the recording] it has come to; None where none can be had.

        Args:
            vehicle: the one it was made with.
            settings: of `Learner.load`.
        """
        part = self._beside("load")
        try:
            head, _, body = self.path.read_bytes().partition(b"\n")
            about = json.loads(head)
            t = float(about.pop("t"))
            if about != self._about:
                return None
            part.write_bytes(body)
            learner = Learner.load(part, vehicle, **settings)
        except Exception:  # whatever is wrong with it, the recording has everything
            return None
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
        return learner, t

    def _beside(self, suffix: str) -> Path:
        return self.path.with_name(f"{self.path.name}.{suffix}")


def _sync_folder(folder: Path) -> None:
    """See a new name to the disk, where the system can."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _clear_after_the_killed() -> None:
    """Remove our folders in memory whose processes are gone without a chance to."""
    for folder in Path(_MEMORY).glob("towtank-*-*"):
        number = folder.name.split("-")[1]
        if number.isdecimal() and not Path("/proc", number).exists() and folder.stat().st_uid == os.getuid():
            shutil.rmtree(folder, ignore_errors=True)


@dataclass(frozen=True)
class Earlier:
    """An earlier session.

    Attributes:
        epoch: Unix time [s] at which its time is 0.
        learner: of its checkpoint; None where there is none to go on from.
        since: time [s] up to which that has learned. inputs: in force then, and states of the autopilot.
        recording: None where nothing was recorded yet.
    """

    epoch: float
    learner: Learner | None = None
    since: float = -math.inf
    inputs: Mapping[str, float] = field(default_factory=dict)
    recording: Recording | None = None

    def now_epoch(self) -> float:
        """Return the Unix time [s] at which the session's time is 0, by this computer's clock.

        It is the recording's own but where that clock is behind the end of the recording, as a computer without a
        battery may be: then times go on from that end.
        """
        end = self.since if self.recording is None else max(self.recording.end, self.since)
        return self.epoch if steady_time() - self.epoch > end else round(steady_time() - end - _PAUSE, 3)

    def rows(self, progress: Callable[[str, float], None]) -> Iterator[Row]:
        """Yield what was recorded after the checkpoint."""
        if self.recording is None:
            return
        start = max(self.since, self.recording.start)
        span = max(self.recording.end - start, 1e-9)
        for row in rows_of(self.recording, self.since):
            progress("learning from what was recorded", (row[0] - start) / span)
            yield row


def earlier(path: Path, vehicle: Vehicle, checkpoint: Checkpoint, **settings: Any) -> Earlier:
    """Return the session that wrote a recording.

    Args:
        path: the recording. vehicle: that the session was for. checkpoint: beside the recording.
        settings: of `Learner.load`.

    Raises:
        InputError: it is no recording of a live session, or one of another vehicle's thrusters.
    """
    try:
        recording = read(path)
    except InputError:
        from towtank.recording.mcap.resume import interrupted

        return Earlier(_epoch(path, interrupted(path).about.attributes or {}))  # closed before the first sample came
    epoch = _epoch(path, recording.attributes)
    recording = bind_thrusters(recording, [each.name for each in vehicle.thrusters])
    loaded = checkpoint.load(vehicle, **settings)
    if loaded is None:
        return Earlier(epoch, recording=recording)
    learner, since = loaded
    at = np.array([since])
    inputs = {
        channel.name: float(held_at(channel.t, channel.values[:, None], at)[0, 0])
        for channel in (each.measured for each in recording.channels.values())
        if is_held(channel.name) and len(channel)
    }
    return Earlier(epoch, learner, since, {name: x for name, x in inputs.items() if math.isfinite(x)}, recording)


def _epoch(path: Path, attributes: Mapping[str, str]) -> float:
    try:
        return datetime.fromisoformat(attributes["epoch"]).timestamp()
    except (KeyError, ValueError):
        raise InputError(f"{path}: does not say when it began, so it cannot be resumed") from None
