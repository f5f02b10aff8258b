"""The one place where the studies call an estimator."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.identification import Estimate, Learner
from towtank.identification.logs import learn_recordings
from towtank.recording import Recording
from towtank.recording.standard import ACCELERATIONS, POSE, VELOCITIES
from towtank.vehicle import Vehicle

__all__ = ["Batch", "Samples", "Stream", "learn_batch", "learn_stream", "samples"]


class Batch(NamedTuple):
    """Values and deviations (k,) of `names`, NaN where not identified, and the delay used or found [s]."""

    names: tuple[str, ...]
    values: Array
    std: Array
    delay: float


class Stream(NamedTuple):
    """Times (m,) [s] and, at each, values and deviations (m, k), NaN where not identified, and delays (m,) [s]."""

    t: Array
    values: Array
    std: Array
    delay: Array


def learn_batch(
    start: Vehicle, recording: Recording, free: Collection[str], *, delay_known: bool = True, method: str = "joint"
) -> Batch:
    """Learn from a whole recording. `lag` may be among the names where the delay is not known."""
    options: dict[str, Any] = {"free": requested(free, delay_known, method)}
    if delay_known:
        options["delay"] = start.command_delay
    if method != "paper":
        options["method"] = method
    learning = learn_recordings(start, [recording], **options)
    names = tuple(free)
    values, std = _readings(learning.estimate, names)
    return Batch(names, values, std, float(learning.delay))


def learn_stream(
    start: Vehicle,
    recording: Recording,
    free: Collection[str],
    report_every: float,
    *,
    delay_known: bool = True,
    method: str = "joint",
) -> Stream:
    """Learn sample by sample, as live data come, and read the estimate every `report_every` seconds."""
    options: dict[str, Any] = {"free": requested(free, delay_known, method)}
    if delay_known:
        options["delay"] = start.command_delay
    learner = Learner(start, method, **options)
    names = tuple(free)
    t: list[float] = []
    rows: list[tuple[Array, Array, float]] = []
    live = samples(recording, start)
    due = report_every
    for i, now in enumerate(live.t):
        learner.update(
            float(now),
            pose=live.pose[i],
            velocity=live.velocity[i],
            acceleration=live.acceleration[i],
            commands=live.commands[i] if live.commanded[i] else None,
        )
        if now >= due - 1e-9:
            due += report_every
            t.append(float(now))
            rows.append((*_readings(learner.estimate, names), _delay(learner)))
    return Stream(
        np.array(t), np.array([row[0] for row in rows]), np.array([row[1] for row in rows]),
        np.array([row[2] for row in rows]),
    )  # fmt: skip


class Samples(NamedTuple):
    """A recording as it would come live.

    t (n,) [s]; pose (n, 6), velocity (n, 6), acceleration (n, 3), NaN where not measured at that time; commands (n, m)
    and whether there is one (n,).
    """

    t: Array
    pose: Array
    velocity: Array
    acceleration: Array
    commands: Array
    commanded: NDArray[np.bool_]


def samples(recording: Recording, vehicle: Vehicle) -> Samples:
    """Return the samples of all channels in the order of their times."""
    orders = tuple(f"cmd_{thruster.name}" for thruster in vehicle.thrusters)
    groups = (POSE, VELOCITIES, ACCELERATIONS, orders)
    t = np.unique(np.concatenate([recording[name].t for group in groups for name in group if name in recording]))
    columns = []
    for group in groups:
        table = np.full((t.size, len(group)), np.nan)
        for j, name in enumerate(group):
            if name in recording:
                table[np.searchsorted(t, recording[name].t), j] = recording[name].values
        columns.append(table)
    commanded = np.isfinite(columns[3]).all(axis=1) if orders else np.zeros(t.size, dtype=np.bool_)
    return Samples(t, columns[0], columns[1], columns[2], columns[3], commanded)


def requested(free: Collection[str], delay_known: bool, method: str) -> tuple[str, ...]:
    """Return the names to ask for: with an unknown delay the lag too, where the method knows one."""
    return tuple(free) if delay_known or method == "paper" else (*free, "lag")


def _readings(estimate: Estimate, names: tuple[str, ...]) -> tuple[Array, Array]:
    values, std = np.full(len(names), np.nan), np.full(len(names), np.nan)
    for i, name in enumerate(names):
        if name in estimate and estimate[name].identified:
            values[i], std[i] = estimate[name].value, estimate[name].std
    return values, std


def _delay(learner: Learner) -> float:
    """Return the delay that the learner works with [s]: what it found, else what it was given."""
    found = getattr(learner, "delay", None)
    return float(learner.settings.delay if found is None else found)
