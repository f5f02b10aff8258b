"""A streaming joint learner on disk: plain arrays in one `.npz` file, so that a session goes on where it was cut off.

Nothing in the file is executed when it is read. It belongs to one vehicle, whose numbers are checked, and to one
version of the filter's layout.
"""

from __future__ import annotations

import json
import math
import os
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from towtank.errors import InputError
from towtank.identification.data.noise import NoiseLevels
from towtank.identification.data.samples import Buffer, Samples
from towtank.identification.data.zero_order_hold import restored_hold
from towtank.identification.kalman.state import healthy_snapshot, restored_state
from towtank.identification.model.parameters import free_parameters
from towtank.identification.online.joint import JointLearner
from towtank.identification.online.schedule import Schedule
from towtank.outputs import write_atomically
from towtank.recording.event import Event
from towtank.vehicle import Vehicle

__all__ = ["load_learner", "save_learner"]

_VERSION = 7
_LEVELS = ("noise", "disturbance", "velocity_walk")
_BUFFER = ("t", "values", "input_t", "input_force")


def save_learner(learner: JointLearner, path: str | os.PathLike[str]) -> None:
    """Write the learner to `path`, whole or not at all; it goes on learning.

    A look that runs beside is not waited for: the learner that is loaded begins it anew.

    Raises:
        InputError: the folder cannot be written.
    """
    stream = learner._stream
    busy = stream.busy
    buffer = stream._buffer
    about: dict[str, Any] = {
        "version": _VERSION,
        "vehicle": learner.vehicle.name,
        "asked": stream.requested,
        "current": learner._current,
        "given_delay": stream.given_delay,
        "free": None if stream.free is None else stream.free.names,
        "looking": stream.reestimating,
        "last_one": stream.looks.last_one and not busy,
        "stirred": stream.looks.stirred,
        "left_out": stream.looks.left_out,
        "damping": stream.looks.damping,
        "seen": stream.seen,
        "mended": stream.mended,
        "watching": stream.changes.watching,
        "doubt": stream.changes.overdispersion,
        "events": [[each.t, each.kind, each.text, dict(each.details)] for each in stream.changes.events],
        "next_check": stream._next_check,
        "schedule": {**asdict(stream.looks.schedule), **({"next": stream.seen, "starts": stream.seen} if busy else {})},
        "last_t": stream._last_t if math.isfinite(stream._last_t) else None,
        "buffer": None if buffer is None else {"commands": buffer.commands, "starts": buffer.starts},
    }
    arrays: dict[str, Any] = {
        "about": np.frombuffer(json.dumps(about).encode(), dtype=np.uint8),
        "parameters": np.array(learner.vehicle.parameters),
        **{f"levels.{name}": getattr(stream.levels, name) for name in _LEVELS},
        **{f"next.{name}": getattr(stream.looks.levels, name) for name in _LEVELS},
    }
    if buffer is not None:
        arrays.update({"buffer.B": buffer.B, "buffer.lag": buffer.lag})
        whole = buffer.whole
        arrays.update({f"buffer.{name}": getattr(whole, name) for name in _BUFFER})
    if stream.state is not None and stream._held is not None:
        arrays.update({f"state.{name}": value for name, value in stream.state._asdict().items()})
        arrays.update({f"held.{name}": value for name, value in stream._held._asdict().items()})

    def write(file: BinaryIO) -> None:
        np.savez(file, **arrays)

    write_atomically(path, write)


def load_learner(
    path: str | os.PathLike[str],
    vehicle: Vehicle,
    *,
    prior: Vehicle | None = None,
    background: bool = False,
    known: Mapping[str, Vehicle] | None = None,
) -> JointLearner:
    """Return the learner that was written to `path`; it goes on as if it had never stopped.

    Args:
        vehicle: the one that it was made with. prior, background, known: as of `JointLearner`.

    Raises:
        InputError: the file is missing, damaged, of another version, or of another vehicle.
    """
    path = Path(path)
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        about = json.loads(arrays["about"].tobytes())
        if about["version"] != _VERSION:
            raise InputError(f"{path}: found a checkpoint of version {about['version']}, expected {_VERSION}")
        if not np.array_equal(arrays["parameters"], np.array(vehicle.parameters)):
            raise InputError(
                f'{path}: this checkpoint was made with other numbers of the vehicle "{about["vehicle"]}"; give the '
                "vehicle file that the session began with"
            )
        return _restored(arrays, about, vehicle, prior, known, background=background)
    except FileNotFoundError:
        raise InputError(f"{path}: no such checkpoint") from None
    except (OSError, ValueError, KeyError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not a checkpoint, or a damaged one ({error})") from error


def _restored(
    arrays: dict[str, Any],
    about: dict[str, Any],
    vehicle: Vehicle,
    prior: Vehicle | None,
    known: Mapping[str, Vehicle] | None,
    *,
    background: bool,
) -> JointLearner:
    learner = JointLearner(
        vehicle,
        free=about["asked"],
        delay=about["given_delay"],
        prior=prior,
        background=background,
        current=about["current"],
        changes=about["watching"],
        known=known,
    )
    stream = learner._stream
    stream.changes.restore(
        [Event(t, kind, text, details) for t, kind, text, details in about["events"]], about["doubt"]
    )
    stream.reestimating = bool(about["looking"])
    looks = stream.looks
    looks.last_one, looks.stirred = bool(about["last_one"]), int(about["stirred"])
    looks.left_out, looks.damping = float(about["left_out"]), dict(about["damping"])
    looks.schedule = Schedule(**about["schedule"])
    stream.seen, stream.mended = float(about["seen"]), int(about["mended"])
    stream._next_check = float(about["next_check"])
    stream._last_t = -math.inf if about["last_t"] is None else float(about["last_t"])
    stream.levels = NoiseLevels(*(arrays[f"levels.{name}"] for name in _LEVELS))
    looks.levels = NoiseLevels(*(arrays[f"next.{name}"] for name in _LEVELS))
    if about["buffer"] is not None:
        kept = about["buffer"]
        stream._buffer = Buffer(arrays["buffer.B"], arrays["buffer.lag"], commands=bool(kept["commands"]))
        t, values, input_t, input_force = (arrays[f"buffer.{name}"] for name in _BUFFER)
        stream._buffer.restore(t, values, input_t, input_force, kept["starts"])
        if learner._paper is not None and stream.reestimating:
            for k, each in enumerate(stream._buffer.stretches):
                if k:
                    learner._paper.restart()
                _feed(learner, each)
    if about["free"] is not None:
        stream.free = free_parameters(vehicle, about["free"])
        stream.state = restored_state(arrays, "state.")
        stream._held = restored_hold(arrays, "held.")
        stream._sound = healthy_snapshot(stream.state)
    return learner


def _feed(learner: JointLearner, samples: Samples) -> None:
    """Give the least squares that runs beside what the stream has seen."""
    paper, pushed = learner._paper, 0
    assert paper is not None
    for i in range(len(samples)):
        while pushed < samples.input_t.size and samples.input_t[pushed] <= samples.t[i]:
            paper.push(float(samples.input_t[pushed]), samples.input_force[pushed], commands=samples.commands)
            pushed += 1
        z = samples.values[i]
        paper.update(float(samples.t[i]), pose=z[:6], velocity=z[6:12], acceleration=z[12:])
