"""Learning from recordings, by any method."""

from __future__ import annotations

import contextlib
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import PurePath
from typing import TypedDict, Unpack

from towtank.errors import InputError, nearest
from towtank.identification.data.samples import Samples, prepared, samples_of
from towtank.identification.least_squares.batch import Progress, learn_paper
from towtank.identification.model.terms import AXES
from towtank.identification.offline.first_look import driven_axes
from towtank.identification.offline.joint import LearningRequest, joint_problem, learn_joint
from towtank.identification.offline.wiring import wiring_of
from towtank.identification.posterior.assembly import LogLearning
from towtank.identification.posterior.plausibility import implausible
from towtank.identification.posterior.thrusters import with_gains_of, with_scale
from towtank.identification.posterior.wording import reversed_force
from towtank.methods import METHODS
from towtank.recording import Recording
from towtank.recording.consistency import Finding, inconsistencies
from towtank.recording.standard import WRENCH
from towtank.vehicle import AnyVehicle, Vehicle, vehicle_of
from towtank.vehicle.thrusters.ardusub import by_frame
from towtank.vehicle.thrusters.wiring import rewired

__all__ = ["as_wired", "findings_before", "learn_recordings", "wiring_findings"]

_USED = "learning uses them as they act"


class LearningOptions(TypedDict, total=False):
    """What `learn_recordings` can be told of a learning."""

    free: Collection[str] | None
    delay: float | None
    longest_delay: float
    free_runs: bool | None


def learn_recordings(
    vehicle: AnyVehicle,
    recordings: Sequence[Recording],
    *,
    method: str = "joint",
    progress: Progress | None = None,
    prior: AnyVehicle | None = None,
    **options: Unpack[LearningOptions],
) -> LogLearning:
    """Learn a vehicle's coefficients from one or several recordings.

    Where recordings have thrusters the other way round, or outputs swapped, beyond doubt, the findings say so, and the
    model that is learned has them so. No thruster is moved.

    Args:
        vehicle: or its name in the catalog, or the path of its file; `prior` likewise.
        method: "joint": the Kalman filter over motion, disturbance and all unknowns, from the prior; free runs with the
            same prior speak where they predict better. "output-error": these in any case. "paper": filtered
            regressors, one axis after the other.
        progress: called with a text and the share done, 0 .. 1.
        free: names of the unknowns to learn; all others but delay and lag are fixed at the prior's mean.
        delay: from command (or recorded wrench) to force [s]; found, up to `longest_delay` (0.4 s), where omitted.
        prior: a vehicle whose coefficients bear deviations, or that was learned: what is known beforehand. Not for
            "paper".
        free_runs: False for the filter alone.

    Raises:
        InputError: no recording, no motion, no commands, thrusters that the vehicle lacks, an unknown name or method.
    """
    if method not in METHODS:
        raise InputError(f'method: found "{method}", expected one of {", ".join(METHODS)}{nearest(method, METHODS)}')
    vehicle, known = vehicle_of(vehicle), None if prior is None else vehicle_of(prior)
    request = LearningRequest(vehicle, recordings, prior=known, **options)
    if method == "output-error":
        request = replace(request, free_runs=True)
    if method == "paper" and request.prior is not None:
        raise InputError("prior: the paper's method takes none; use method joint or output-error")
    recordings = [prepared(recording, vehicle) for recording in recordings]
    vehicle, of_frame = _in_frame(vehicle, recordings)
    vehicle, of_gains = (vehicle, ()) if request.prior is None else with_gains_of(vehicle, request.prior)
    try:
        samples = tuple(samples_of(recording, vehicle) for recording in recordings)
    except InputError:
        samples = ()  # learning says it, and says more
    found, driven = _findings_of(recordings, samples), driven_axes(samples)
    if progress is not None:
        progress("how thrusters are wired", 0.0)
    request, of_wiring = as_wired(replace(request, vehicle=vehicle, recordings=recordings, samples=samples))
    vehicle = request.vehicle
    if method == "paper":
        delay, longest, free = request.delay, request.longest_delay, request.free
        learning = learn_paper(vehicle, recordings, free=free, delay=delay, longest_delay=longest, progress=progress)
        learning = with_scale(learning, free or ())
    else:
        learning = learn_joint(request, progress)
    learning = replace(learning, driven=driven, warnings=(*of_gains, *learning.warnings))
    return _with_findings(learning, (*of_frame, *of_wiring, *found))


def findings_before(vehicle: Vehicle | None, recording: Recording) -> tuple[Finding, ...]:
    """Return what of a recording cannot be right before anything is learned from it, gravest first.

    Args:
        vehicle: that made it; without one nothing is said of thrusters.
    """
    if vehicle is None:
        return inconsistencies(recording)
    recording = prepared(recording, vehicle)
    vehicle, of_frame = _in_frame(vehicle, [recording])
    samples: tuple[Samples, ...] = ()
    with contextlib.suppress(InputError):  # no motion, or no inputs
        samples = (samples_of(recording, vehicle),)
    _, of_wiring = as_wired(LearningRequest(vehicle, [recording], samples))
    return (*of_frame, *of_wiring, *_findings_of([recording], samples))


def _findings_of(recordings: Sequence[Recording], samples: Sequence[Samples]) -> tuple[Finding, ...]:
    """Return what contradicts itself in recordings; samples: of each, none where they could not be had."""
    out: list[Finding] = []
    for k, recording in enumerate(recordings):
        each = samples[k] if samples else None
        commanded = None if each is None or not each.commands else (each.input_t, each.input_force @ each.B.T)
        name = f"{PurePath(recording.source).name or f'recording {k + 1}'}: " if len(recordings) > 1 else ""
        recorded = any(axis in recording for axis in WRENCH)
        found = inconsistencies(recording, commanded if recorded else None)
        out += [replace(finding, text=name + finding.text) for finding in found]
    return tuple(out)


def _with_findings(learning: LogLearning, before: Sequence[Finding]) -> LogLearning:
    """Return what was learned with all findings, those that it has allowed for last, and none twice."""
    found = (*before, *implausible(learning))
    grave = [each for each in found if not each.allowed_for]
    said = tuple(f"the data pull {each.what} to " for each in grave)
    warnings = tuple(text for text in learning.warnings if not (said and text.startswith(said)))
    return replace(learning, findings=(*grave, *(each for each in found if each.allowed_for)), warnings=warnings)


def _in_frame(vehicle: Vehicle, recordings: Sequence[Recording]) -> tuple[Vehicle, tuple[Finding, ...]]:
    """Return the vehicle with its thrusters as the frame has them that the recordings' autopilot was set to."""
    frames = {frame for recording in recordings if (frame := recording.attributes.get("ardusub_frame"))}
    if len(frames) != 1:
        return vehicle, ()
    vehicle, said = by_frame(vehicle, frames.pop())
    return vehicle, (Finding("thrusters", said, of_model=True),) if said else ()


def wiring_findings(vehicle: Vehicle, recordings: Sequence[Recording], done: str) -> tuple[Finding, ...]:
    """Return how recordings have the thrusters wired against the vehicle's file; `done`: what is made of that."""
    with contextlib.suppress(InputError):  # no motion, or no inputs
        ready = [prepared(recording, vehicle) for recording in recordings]
        return as_wired(LearningRequest(vehicle, ready, [samples_of(each, vehicle) for each in ready]), done)[1]
    return ()


def as_wired(request: LearningRequest, done: str = _USED) -> tuple[LearningRequest, tuple[Finding, ...]]:
    """Return the question with its thrusters wired as the recordings have them, and what differs from the file."""
    vehicle, samples = request.vehicle, request.samples
    if not samples:
        return request, ()
    problem = joint_problem(request)  # a name that is no coefficient is told at once
    wiring = wiring_of(problem if request.free is None else joint_problem(replace(request, free=None)))
    if not wiring:
        return request, ()
    if not samples[0].commands:
        check = "check its sign in the mapping (scale = -1.0 turns a column round)"
        return request, tuple(Finding(AXES[k].name, f"{reversed_force(k)}; {check}") for k in wiring.turned)
    other = rewired(vehicle, wiring)
    rebound = tuple(samples_of(each, other) for each in request.recordings)
    found = Finding("thrusters", f"{wiring.said(vehicle)}; {done}", of_model=True)
    return replace(request, vehicle=other, samples=rebound), (found,)
