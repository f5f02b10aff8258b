"""How well the model of a live session predicts what the session saw, and the noise of its sensors."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from towtank.errors import InputError
from towtank.identification import Learner
from towtank.live.learning import Learning
from towtank.recording import STANDARD, Recording
from towtank.recording.standard import EULER, MOTION, QUATERNION, VELOCITIES

__all__ = ["LiveFit", "judged"]


@dataclass(frozen=True)
class LiveFit:
    """Free-running prediction of a session by its own model.

    Attributes:
        fit: [%] by channel, None where not measured. of: what was predicted. reason: why there is no fit, "" where
            there is. noise: of each measured channel, "std" and "unit".
    """

    fit: dict[str, float | None] = field(default_factory=lambda: dict.fromkeys(VELOCITIES))
    of: str | None = None
    reason: str = ""
    noise: dict[str, dict[str, Any]] = field(default_factory=dict)


def judged(learning: Learning, recorded: Path | None) -> LiveFit:
    """Return how the model predicts the recording, else the last minute, since the last change; once it has ended."""
    learner = learning.learner
    if not any(learner.estimate.identified):
        return LiveFit(reason="nothing was identified")
    try:
        run, of = _session(learning, recorded)
        if run is None:
            return LiveFit(reason="no motion was learned from")
        from towtank.app.stream_facts import judged_since

        found, of, reason = judged_since(learner.model(), run, learner.events, of)
    except InputError as error:
        return LiveFit(reason=str(error))
    if found is None:
        return LiveFit(reason=reason, noise=_noise(learner, run))
    return LiveFit({**dict.fromkeys(VELOCITIES), **found.fit}, of, noise=_noise(learner, run))


def _session(learning: Learning, recorded: Path | None) -> tuple[Recording | None, str]:
    if recorded is not None:
        from towtank.readers import read

        return read(recorded), f"the recording {recorded.name}"
    run = learning.recent.recording()
    return run, "" if run is None else f"the last {run.duration:.0f} s"


def _noise(learner: Learner, run: Recording) -> dict[str, dict[str, Any]]:
    """Return the noise that a learner with levels has found; a quaternion is measured as angles."""
    from towtank.identification.joint_learner import JointLearner

    if not isinstance(learner, JointLearner):
        return {}
    measured = set(run.channels) | (set(EULER) if set(QUATERNION) <= set(run.channels) else set())
    return {
        name: {"std": float(learner.noise[k]), "unit": STANDARD[name].unit}
        for k, name in enumerate(MOTION)
        if name in measured
    }
