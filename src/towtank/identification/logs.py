"""Learning from recordings, by any method."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import TypedDict, Unpack

from towtank.errors import InputError, nearest
from towtank.identification.data.samples import Samples, prepared, samples_of
from towtank.identification.least_squares.batch import Progress, learn_paper
from towtank.identification.offline.first_look import mirrored, reversals
from towtank.identification.offline.joint import LearningRequest, learn_joint
from towtank.identification.posterior.assembly import LogLearning
from towtank.identification.posterior.thrusters import with_gains_of, with_scale
from towtank.methods import METHODS
from towtank.recording import Recording
from towtank.vehicle import Vehicle, configuration_matrix
from towtank.vehicle.names import ROWS

__all__ = ["learn_recordings"]


class LearningOptions(TypedDict, total=False):
    """What `learn_recordings` can be told of a learning."""

    free: Collection[str] | None
    delay: float | None
    longest_delay: float
    prior: Vehicle | None
    current: bool


def learn_recordings(
    vehicle: Vehicle,
    recordings: Sequence[Recording],
    *,
    method: str = "joint",
    progress: Progress | None = None,
    **options: Unpack[LearningOptions],
) -> LogLearning:
    """Learn a vehicle's coefficients from one or several recordings.

    Where a commanded force acts with the opposite sign beyond doubt, thrusters are taken to be on the other side, and
    the warnings say so; the model that is learned has them there.

    Args:
        method: "joint": the Kalman filter over motion, disturbance and coefficients, refined by output error where its
            residuals say that it is the better judge. "output-error": that refinement in any case. "paper": filtered
            regressors, one axis after the other.
        progress: called with a text and the share done, 0 .. 1.
        free: names of the coefficients to learn, see `Learner`.
        delay: from command (or recorded wrench) to force [s]; found, up to `longest_delay` (0.4 s), where omitted.
        prior: a vehicle whose coefficients bear deviations, or that was learned: what is known beforehand. Not for
            "paper".
        current: of the water, estimated along; free runs, which know none, then judge nothing. Not for "paper" and
            "output-error".

    Raises:
        InputError: no recording, no motion, no commands, thrusters that the vehicle lacks, an unknown name or method.
    """
    if method not in METHODS:
        raise InputError(f'method: found "{method}", expected one of {", ".join(METHODS)}{nearest(method, METHODS)}')
    request = LearningRequest(vehicle, recordings, always_free_runs=method == "output-error", **options)
    if method == "paper" and request.prior is not None:
        raise InputError("prior: the paper's method takes none; use method joint or output-error")
    if method != "joint" and request.current:
        raise InputError(f"current: method {method} knows none; use method joint")
    recordings = [prepared(recording, vehicle) for recording in recordings]
    vehicle, of_gains = (vehicle, ()) if request.prior is None else with_gains_of(vehicle, request.prior)
    free = request.free
    try:
        samples = tuple(samples_of(recording, vehicle) for recording in recordings)
    except InputError:
        samples = ()  # learning says it, and says more
    vehicle, of_signs = _right_way_round(vehicle, samples, free)
    if of_signs and all(each.commands for each in samples):
        samples = tuple(replace(each, B=configuration_matrix(vehicle)) for each in samples)
    request = replace(request, vehicle=vehicle, recordings=recordings, samples=samples)
    if method == "paper":
        delay, longest = request.delay, request.longest_delay
        learning = learn_paper(vehicle, recordings, free=free, delay=delay, longest_delay=longest, progress=progress)
        learning = with_scale(learning, free or ())
    else:
        learning = learn_joint(request, progress)
    return replace(learning, warnings=(*of_signs, *of_gains, *learning.warnings))


def _right_way_round(
    vehicle: Vehicle, samples: Sequence[Samples], free: Collection[str] | None
) -> tuple[Vehicle, tuple[str, ...]]:
    """Return the vehicle with its thrusters where the recordings have them, and warnings where that is elsewhere.

    Where `free` says what to learn, axes of which nothing is learned are left alone.
    """
    found = [each for each in reversals(samples) if free is None or any(name[0] == ROWS[each.axis] for name in free)]
    if not found:
        return vehicle, ()
    texts = [reversal.text for reversal in found]
    if all(each.commands for each in samples):
        other = mirrored(vehicle, [reversal.axis for reversal in found])
        if other is not None:
            done = "learned with the thrusters on the other side; check their positions, directions and order"
            return other, tuple(f"{text}; {done}" for text in texts)
        done = "check the thrusters' positions, directions and order in the vehicle's file"
    else:
        done = "check its sign in the mapping (scale = -1.0 turns a column round)"
    return vehicle, tuple(f"{text}; {done}" for text in texts)
