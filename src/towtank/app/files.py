"""The files that commands read: vehicles with their warnings, logs with their mapping, their windows, what counts."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from towtank.app.commands.arguments import LogPlace, Merged
from towtank.app.terminal.output import Output, Progress
from towtank.errors import InputError

if TYPE_CHECKING:
    from towtank.recording import Recording
    from towtank.recording.grids.free_motion import LeftOut
    from towtank.recording.mapping import AnyMapping
    from towtank.vehicle import Vehicle

__all__ = [
    "LogParts",
    "counted",
    "known_beforehand",
    "merged_with",
    "naming_logs",
    "parts_of",
    "read_configurations",
    "read_logs",
    "read_prior",
    "read_vehicle",
]


@dataclass(frozen=True)
class LogParts:
    """A log and what of it counts.

    Attributes:
        log: the file. recording: it, from the first window to the last that is asked for.
        parts: stretches that count, in order of time; the recording itself where all of it does.
        left_out: stretches within the windows asked for that do not.
    """

    log: Path
    recording: Recording
    parts: tuple[Recording, ...]
    left_out: tuple[LeftOut, ...]


def read_vehicle(name_or_file: str, output: Output, *, silent: bool = False) -> Vehicle:
    """Return a vehicle; what is not physical about it is said on standard error unless `silent`."""
    from towtank.vehicle import VehicleWarning, load_vehicle

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", VehicleWarning)
        vehicle = load_vehicle(name_or_file)
    for warning in caught:
        if not issubclass(warning.category, VehicleWarning):
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
        elif not silent:
            output.warn(str(warning.message))
    return vehicle


def read_prior(name_or_file: str, output: Output) -> Vehicle:
    """Return a vehicle that says what is known beforehand. Raises InputError where it does not.

    It was learned, or has a table [prior], or coefficients that bear deviations.
    """
    return known_beforehand(read_vehicle(name_or_file, output), f"--prior {name_or_file}")


def known_beforehand(vehicle: Vehicle, place: str) -> Vehicle:
    """Return a vehicle that says what is known beforehand; `place` stands before the InputError where it does not."""
    from towtank.vehicle import COEFFICIENTS

    known = vehicle.posterior is not None or vehicle.prior
    if not known and not any(vehicle.deviation(name) for name in COEFFICIENTS):
        raise InputError(
            f"{place}: no coefficient bears a std, so the file holds no prior knowledge; write "
            "X_uu = { value = -40.0, std = 4.0 } in [hydrodynamics] or [prior], or give a model that learn wrote"
        )
    return vehicle


def read_configurations(folder: Path, output: Output) -> dict[str, Vehicle]:
    """Return the models in a folder by their names. Raises InputError where there is none, or one cannot be read."""
    from towtank.vehicle.configurations import Configurations

    if not folder.is_dir():
        raise InputError(f"--configurations {folder}: no such folder; towtank config save --folder {folder} makes one")
    found = Configurations(folder).all()
    if not found:
        output.warn(f"{folder}: holds no configuration yet; towtank config save puts one there")
    return {each.name: each.vehicle for each in found}


def read_logs(
    logs: Sequence[Path], mapping: AnyMapping | None, progress: Progress, merged: Sequence[Merged] = ()
) -> list[Recording]:
    """Return the recordings of some logs, all with one mapping; a velocity in the world is turned into the body.

    Args:
        merged: further files of the run of a single log.
    """
    from towtank.readers import read, recognised

    for log in (*logs, *(each.path for each in merged)):  # before anything that is slow to import
        recognised(log)
    from towtank.recording import mapping_of, with_body_velocity

    columns = None if mapping is None else mapping_of(mapping)
    recordings = []
    for k, log in enumerate(logs):
        progress(f"reading {log.name}", k / len(logs))
        recording = replace(read(log, columns), source=str(log))  # whatever it says of itself: messages name the file
        recordings.append(with_body_velocity(merged_with(recording, merged)))
    return recordings


def parts_of(
    logs: Sequence[LogPlace], recordings: Sequence[Recording], vehicle: Vehicle | None, *, keep_all: bool
) -> list[LogParts]:
    """Return what counts of each log: the vehicle moving freely in water, within the windows asked for.

    Args:
        vehicle: that made them; at the surface counts for one that is not made to dive.
        keep_all: leave nothing out but what lies outside of the windows.
    """
    return [_parts(log, recording, vehicle, keep_all) for log, recording in zip(logs, recordings, strict=True)]


def _parts(log: LogPlace, recording: Recording, vehicle: Vehicle | None, keep_all: bool) -> LogParts:
    from towtank.recording.grids.free_motion import FreeMotion, LeftOut, free_motion
    from towtank.recording.repairs import Repairs

    whole = recording.start, recording.end
    windows = _windows(log, recording)
    found = FreeMotion(windows, ()) if keep_all else free_motion(recording, vehicle, windows)
    kept = [each for each in found.kept if each in windows or _moves(recording, each)]
    still = [LeftOut(*each, "no motion", "no motion recorded") for each in found.kept if each not in kept]
    parts = [recording if each == whole else recording.window(*each) for each in kept]
    parts[1:] = [replace(part, repairs=Repairs(), notes=_own_notes(part, recording)) for part in parts[1:]]
    span = windows[0][0], windows[-1][1]
    asked = recording if span == whole else recording.window(*span)
    return LogParts(
        log.path, asked, tuple(parts), tuple(sorted((*found.left_out, *still), key=lambda each: each.start))
    )


def _moves(recording: Recording, stretch: tuple[float, float]) -> bool:
    """Whether enough of the motion is measured in a stretch (start, end) [s]."""
    from towtank.recording.columns import MINIMUM_SAMPLES
    from towtank.recording.standard import MEASURED, QUATERNION, WORLD_VELOCITY

    motion = [recording[name].measured.t for name in (*MEASURED, *QUATERNION, *WORLD_VELOCITY) if name in recording]
    inside = (((t >= stretch[0]) & (t <= stretch[1])).sum() for t in motion)
    return any(samples >= MINIMUM_SAMPLES for samples in inside)


def _windows(log: LogPlace, recording: Recording) -> tuple[tuple[float, float], ...]:
    """Return the windows of a log [s] in order, those that overlap as one. Raises InputError for an empty one."""
    windows = [window.within(recording) for window in log.windows]
    for window in windows:
        recording.window(*window)
    out: list[tuple[float, float]] = []
    for start, end in sorted(windows or [(recording.start, recording.end)]):
        first, last = max(start, recording.start), min(end, recording.end)
        if out and first < out[-1][1]:
            out[-1] = out[-1][0], max(last, out[-1][1])
        else:
            out.append((first, last))
    return tuple(out)


def _own_notes(part: Recording, whole: Recording) -> tuple[str, ...]:
    """Return the notes of a part that the whole does not bear: those are said of the first one."""
    return tuple(note for note in part.notes if note not in whole.notes)


def counted(logs: Sequence[LogParts]) -> list[Recording]:
    """Return all parts that count. Raises InputError where nothing does."""
    parts = [part for log in logs for part in log.parts]
    if not parts:
        reasons = [
            f"{each.log}: no part of it shows the vehicle moving freely in water "
            f"({'; '.join(cut.text for cut in each.left_out)})"
            for each in logs
        ]
        raise InputError(f"{'; '.join(reasons)}; --keep-all uses it all the same")
    return parts


@contextlib.contextmanager
def naming_logs(parts: Sequence[LogParts]) -> Iterator[None]:
    """Say of which logs it is where learning ends in numbers that are none, as forces do that no vehicle has."""
    try:
        yield
    except InputError as error:
        if not str(error).startswith("posterior:"):
            raise
        logs = ", ".join(str(each.log) for each in parts)
        raise InputError(
            f"{logs}: learning ended without numbers, expected commands or forces and motion that fit the vehicle; "
            "check their units, or leave that part out with --window START,END"
        ) from error


def merged_with(recording: Recording, merged: Sequence[Merged]) -> Recording:
    """Return a recording with the channels of further files of its run. Raises InputError."""
    from towtank.readers import read

    for each in merged:
        try:
            other = read(each.path, each.mapping)
        except InputError as error:
            raise InputError(str(error).replace("--map ", "--merge-map ")) from None
        recording = recording.merge(other, each.offset)
    return recording
