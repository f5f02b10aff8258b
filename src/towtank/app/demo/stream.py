"""The demo's session, sample by sample through the learner: the path that live data take."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from towtank.app.demo.progress import LearningCurve, quantities
from towtank.core.arrays import Array
from towtank.identification import Estimate, Learner
from towtank.simulation.tank import Session

__all__ = ["Moment", "Watch", "pose_and_commands", "stream"]

_POSE = ("x", "y", "z", "phi", "theta", "psi")
_READING = 0.25  # s of the session between two readings of the estimate
_SHOWING = 0.2  # s of the clock between two showings


class Watch(Protocol):
    """Somebody beside the stream, as the live page."""

    def before(self, t: float, arguments: Mapping[str, Any]) -> bool:
        """Take an instant; return whether it is to be learned from."""

    def after(self, seconds: float) -> None:
        """Take how long that took."""

    def read(self, estimate: Estimate) -> None:
        """Take a reading of the estimate."""


@dataclass(frozen=True)
class Moment:
    """Where the stream stands.

    Attributes:
        t, end: time in the session, and its end [s]. samples: taken so far. elapsed: by the clock [s].
        latencies: of every update so far [s]. curve: of the estimate.
    """

    t: float
    end: float
    samples: int
    elapsed: float
    latencies: Array
    curve: LearningCurve

    @property
    def rate(self) -> float:
        """Samples per second of the clock."""
        return self.samples / self.elapsed if self.elapsed > 0.0 else 0.0

    @property
    def latency_ms(self) -> dict[str, float]:
        """Median, 99th percentile and maximum of the time that one update takes [ms]."""
        if not self.latencies.size:
            return {"median": float("nan"), "p99": float("nan"), "max": float("nan")}
        median, p99, most = 1e3 * np.percentile(self.latencies, (50.0, 99.0, 100.0))
        return {"median": float(median), "p99": float(p99), "max": float(most)}


def pose_and_commands(session: Session) -> tuple[Array, Array, Array]:
    """Return times (n,), poses (n, 6) and commands (n, m); the last pose of all has no command and is left out."""
    recording = session.recording
    commands = np.column_stack([recording[f"cmd_{thruster.name}"].values for thruster in session.truth.thrusters])
    n = len(commands)
    poses = np.column_stack([recording[name].values[:n] for name in _POSE])
    return recording["x"].t[:n], poses, commands


def stream(
    session: Session,
    learner: Learner,
    curve: LearningCurve,
    *,
    paced: bool,
    show: Callable[[Moment], None],
    watch: Watch | None = None,
) -> Moment:
    """Feed the session to the learner, in its own time where `paced`, else as fast as the machine can.

    Args:
        curve: takes a reading of the estimate every quarter of a second of the session.
        show: called about five times a second of the clock, and at the end. watch: sees every instant.
    """
    times, poses, commands = pose_and_commands(session)
    n, end = times.size, session.recording.duration
    latencies = np.empty(n)
    began = shown = time.perf_counter()
    reading = _READING
    for i in range(n):
        t = float(times[i])
        if paced:
            wait = began + t - time.perf_counter()
            if wait > 0.0:
                time.sleep(wait)
        arguments = {"pose": poses[i], "commands": commands[i]}
        learns = watch is None or watch.before(t, arguments)
        start = time.perf_counter()
        if learns:
            learner.update(t, **arguments)
        now = time.perf_counter()
        latencies[i] = now - start
        if learns and watch is not None:
            watch.after(now - start)
        if t >= reading:
            reading += _READING
            estimate = learner.estimate
            _take(curve, session, learner, t)
            if watch is not None:
                watch.read(estimate)
        if now - shown >= _SHOWING:
            shown = now
            show(Moment(t, end, i + 1, now - began, latencies[: i + 1], curve))
    _take(curve, session, learner, end)
    last = Moment(end, end, n, time.perf_counter() - began, latencies, curve)
    show(last)
    return last


def _take(curve: LearningCurve, session: Session, learner: Learner, t: float) -> None:
    """Add a reading, beside the truth of its time."""
    curve.learned = quantities(session.truth_at(t), weight=session.later is not None)
    curve.events = learner.events
    curve.read(t, learner.estimate)
