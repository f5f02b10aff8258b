"""What was learned so far, beside the recording: written whole every few seconds, so that a new start goes on from it.

The file holds one line of JSON and then what `Learner.save` writes. A learner that cannot be saved has none; then, as
where the file is missing or damaged, the recording is learned from once more.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from towtank.errors import InputError
from towtank.identification import Learner
from towtank.vehicle import Vehicle

__all__ = ["Checkpoint"]

_VERSION = 1


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
        self._about = json.loads(json.dumps({"version": _VERSION, **about}))

    def save(self, learner: Learner, t: float) -> bool:
        """Write what was learned up to t [s of the recording]; return whether that was done."""
        if not learner.keeps_checkpoints:
            return False
        part, whole = self._beside("part"), self._beside("tmp")
        try:
            learner.save(part)
            head = json.dumps({**self._about, "t": t}).encode() + b"\n"
            whole.write_bytes(head + part.read_bytes())
            whole.replace(self.path)
        except (OSError, InputError) as error:
            self.trouble = f"{self.path}: {getattr(error, 'strerror', None) or error}"
            with contextlib.suppress(OSError):
                whole.unlink(missing_ok=True)
            return False
        finally:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
        self.trouble = ""
        return True

    def load(self, vehicle: Vehicle, **settings: Any) -> tuple[Learner, float] | None:
        """Return the learner and the time [s of the recording] it has come to; None where none can be had.

        Args:
            vehicle: the one it was made with.
            settings: of `Learner.load`.
        """
        part = self._beside("part")
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
