"""What the studies of the surge experiments share: trials, the bound averaged over runs, t5 of an ideal estimator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from bound import SurgeBound, surge_bound
from experiments import DT, experiment
from summary import Spread, course, percentile, relative_errors, settling, spreads
from trial import Outcome, Trial

from towtank.core.arrays import Array

__all__ = ["READ_EVERY", "Least", "Part", "part", "trials_of"]

READ_EVERY = 0.25  # s between two readings of a stream: t5 is on this grid
_SEEN = 20  # runs whose hidden samples the bound is averaged over
_IDEAL = 4000  # runs of an estimator at the bound


@dataclass(frozen=True, eq=False)
class Least:
    """The bound averaged over runs: least deviations (n, k) of all unknowns at times t (n,) [s]."""

    unknowns: tuple[str, ...]
    t: Array
    std: Array

    def at(self, t: float) -> Array:
        """Return the bound (k,) of the samples up to time t [s]."""
        return np.asarray(self.std[int(np.searchsorted(self.t, t + 1e-9)) - 1])


@dataclass(frozen=True, eq=False)
class Part:
    """One surge experiment of a study.

    Attributes:
        batch: spreads after learning from the first seconds. outcomes: all of them. stream: course of the streams.
        t5: (runs,) [s] of the streams. ideal: (n,) [s] of an estimator at the bound, read as often.
        least: the bound.
    """

    name: str
    batch: list[Spread]
    outcomes: list[Outcome]
    stream: dict[str, Any]
    t5: Array
    ideal: Array
    least: Least

    @property
    def times_row(self) -> tuple[str, float, float, float, float]:
        """Name, median and 90th percentile of t5, and the same of an estimator at the bound."""
        found, ideal = ((percentile(each, 50.0), percentile(each, 90.0)) for each in (self.t5, self.ideal))
        return self.name, *found, *ideal

    def document(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        batch = [{**asdict(each), "ratio": each.ratio} for each in self.batch]
        every = round(READ_EVERY / DT)
        least = self.least
        bound = {"unknowns": least.unknowns, "t": least.t[every::every], "std": least.std[every::every]}
        return {
            "experiment": self.name, "batch": batch, "stream": self.stream, "t5": self.t5, "t5_at_bound": self.ideal,
            "bound": bound,
        }  # fmt: skip


def trials_of(
    names: Sequence[str], seeds: Sequence[int], method: str, times: tuple[float, ...], until: float | None = None
) -> list[Trial]:
    """Return for every experiment and seed a batch of all times and a stream."""
    modes: tuple[tuple[Any, tuple[float, ...]], ...] = (("batch", times), ("stream", (READ_EVERY,)))
    return [Trial(name, seed, mode, at, method, until) for name in names for seed in seeds for mode, at in modes]


def part(name: str, outcomes: Sequence[Outcome], seeds: Sequence[int]) -> Part:
    """Put the outcomes of one experiment together with its bound."""
    own = [outcome for outcome in outcomes if outcome.trial.experiment == name]
    batch = [outcome for outcome in own if outcome.trial.mode == "batch"]
    stream = [outcome for outcome in own if outcome.trial.mode == "stream"]
    bounds = [surge_bound(experiment(name), seed) for seed in list(seeds)[:_SEEN]]
    least = Least(bounds[0].unknowns, bounds[0].t, np.sqrt(np.mean([each.std**2 for each in bounds], axis=0)))
    read, errors, _ = relative_errors(stream)
    return Part(
        name=name,
        batch=spreads(batch, least.at),
        outcomes=own,
        stream=course(stream, least.at),
        t5=np.array([settling(read, each) if len(read) else np.inf for each in errors]),
        ideal=_ideal(bounds, len(experiment(name).free)),
        least=least,
    )


def _ideal(bounds: Sequence[SurgeBound], k: int) -> Array:
    """Return t5 (n,) [s] of an estimator that is at the bound at every time."""
    generator = np.random.default_rng(0)
    every = round(READ_EVERY / DT)
    read = bounds[0].t[every::every]
    runs = [bounds[i % len(bounds)].ideal_errors(generator)[every::every, :k] for i in range(_IDEAL)]
    return np.array([settling(read, errors) for errors in runs])
