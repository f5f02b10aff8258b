"""Learning from recordings, by any method."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from towtank.errors import InputError, nearest
from towtank.identification.joint_logs import learn_joint
from towtank.identification.log_learning import LogLearning
from towtank.identification.paper_logs import learn_paper
from towtank.identification.passes import Progress
from towtank.recording import Recording
from towtank.vehicle import Vehicle

__all__ = ["METHODS", "LogLearning", "learn_recordings"]

METHODS = ("joint", "output-error", "paper")


def learn_recordings(
    vehicle: Vehicle,
    recordings: Sequence[Recording],
    *,
    method: str = "joint",
    free: Collection[str] | None = None,
    delay: float | None = None,
    longest_delay: float = 0.4,
    prior: Vehicle | None = None,
    progress: Progress | None = None,
) -> LogLearning:
    """Learn a vehicle's coefficients from one or several recordings.

    Args:
        method: "joint": the Kalman filter over motion, disturbance and coefficients, refined by output error where its
            residuals say that it is the better judge. "output-error": that refinement in any case. "paper": filtered
            regressors, one axis after the other.
        free: names of the coefficients to learn, see `Learner`.
        delay: from command (or recorded wrench) to force [s]; found, up to `longest_delay`, where omitted.
        prior: a vehicle whose coefficients bear deviations: what is known beforehand. Not for "paper".
        progress: called with a text and the share done, 0 .. 1.

    Raises:
        InputError: no recording, no motion, no commands, thrusters that the vehicle lacks, an unknown name or method.
    """
    if method not in METHODS:
        raise InputError(f'method: found "{method}", expected one of {", ".join(METHODS)}{nearest(method, METHODS)}')
    if method == "paper":
        if prior is not None:
            raise InputError("prior: the paper's method takes none; use method joint or output-error")
        return learn_paper(vehicle, recordings, free=free, delay=delay, longest_delay=longest_delay, progress=progress)
    return learn_joint(
        vehicle,
        recordings,
        free=free,
        delay=delay,
        longest_delay=longest_delay,
        prior=prior,
        refine="always" if method == "output-error" else "where better",
        progress=progress,
    )
