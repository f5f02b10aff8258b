"""What an earlier session learned, gone on from: its checkpoint and what its recording has after it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from towtank.errors import InputError
from towtank.identification import Learner
from towtank.live.checkpoint import Checkpoint
from towtank.live.recorded import Row, rows_of
from towtank.readers import read
from towtank.recording import Recording, bind_thrusters
from towtank.recording.held import held_at
from towtank.recording.standard import is_held
from towtank.vehicle import Vehicle

__all__ = ["Earlier", "earlier"]


@dataclass(frozen=True)
class Earlier:
    """An earlier session.

    Attributes:
        epoch: Unix time [s] at which its time is 0.
        learner: of its checkpoint; None where there is none to go on from.
        since: time [s] up to which that has learned. inputs: in force then.
        recording: None where nothing was recorded yet.
    """

    epoch: float
    learner: Learner | None = None
    since: float = -math.inf
    inputs: Mapping[str, float] = field(default_factory=dict)
    recording: Recording | None = None

    def rows(self, tell: Callable[[str, float], None]) -> Iterator[Row]:
        """Yield what was recorded after the checkpoint."""
        if self.recording is None:
            return
        start = max(self.since, self.recording.start)
        span = max(self.recording.end - start, 1e-9)
        for row in rows_of(self.recording, self.since):
            tell("learning from what was recorded", (row[0] - start) / span)
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
        from towtank.recording.mcap_resume import interrupted

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
        raise InputError(f"{path}: does not say when it began, so that it cannot be gone on with") from None
