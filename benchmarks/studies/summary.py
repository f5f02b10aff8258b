"""From the outcomes of many seeds to the figures that a study reports."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from excitation import REST
from experiments import experiment
from trial import Outcome

from towtank.core.arrays import Array
from towtank.identification.model.terms import AXES

__all__ = [
    "ERROR",
    "Check",
    "DelaySpread",
    "Spread",
    "course",
    "delay_spreads",
    "failures",
    "judged",
    "percentile",
    "relative_errors",
    "settling",
    "spreads",
]

ERROR = 0.05  # of "t5"
_INTERVAL = 1.959964  # deviations of a 95 % interval


@dataclass(frozen=True)
class Spread:
    """One quantity at one time over all runs, everything relative to the truth.

    Attributes:
        rmse, bias: of the runs in which it is identified. bias_std: deviation of the mean. stated: root mean square of
            the deviations that the estimator states. bound: Cramer-Rao, NaN where there is none.
        coverage: share of the 95 % intervals that hold the truth. identified, runs: numbers.
    """

    name: str
    t: float
    rmse: float
    bias: float
    bias_std: float
    stated: float
    bound: float
    coverage: float
    identified: int
    runs: int

    @property
    def ratio(self) -> float:
        """RMSE over bound."""
        return self.rmse / self.bound if self.bound > 0.0 else math.nan

    @property
    def ratio_of_all(self) -> float:
        """RMSE over bound where every run counts: as 100 % off where the coefficient is called unknown."""
        known = self.rmse**2 * self.identified if self.identified else 0.0
        rmse = math.sqrt((known + self.runs - self.identified) / self.runs)
        return rmse / self.bound if self.bound > 0.0 else math.nan


@dataclass(frozen=True)
class Check:
    """A figure and the limits that it has to keep."""

    name: str
    value: float
    low: float = -math.inf
    high: float = math.inf
    note: str = ""

    @property
    def met(self) -> bool:
        """Whether the value is a number within the limits."""
        return self.low <= self.value <= self.high

    def document(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {**asdict(self), "met": self.met}


@dataclass(frozen=True)
class DelaySpread:
    """The delay found at one time over all runs [s]: RMSE, bias, Cramer-Rao bound, share of the runs near enough."""

    t: float
    rmse: float
    bias: float
    bound: float
    within: float
    runs: int

    def document(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return asdict(self)


def delay_spreads(
    outcomes: Sequence[Outcome], truth: float, near: float, bound: Callable[[float], float]
) -> list[DelaySpread]:
    """Return how the delay came out at each time, `near` [s] to its truth or not."""
    t = max((outcome.t for outcome in outcomes), key=len)
    found = []
    for m, now in enumerate(t):
        away = np.array([outcome.delay[m] - truth for outcome in outcomes if len(outcome.t) > m])
        away = away[np.isfinite(away)]
        n = away.size
        found.append(
            DelaySpread(
                t=float(now),
                rmse=float(np.sqrt(np.mean(away**2))) if n else math.nan,
                bias=float(away.mean()) if n else math.nan,
                bound=bound(float(now)),
                within=float((np.abs(away) <= near).sum() / len(outcomes)),
                runs=len(outcomes),
            )
        )
    return found


def relative_errors(outcomes: Sequence[Outcome]) -> tuple[Array, Array, Array]:
    """Return times (m,), errors and stated deviations (runs, m, k), relative; NaN where not identified or failed."""
    full = max(outcomes, key=lambda outcome: len(outcome.t))
    truth = experiment(full.trial.experiment).true_quantities
    shape = (len(outcomes), len(full.t), truth.size)
    errors, std = np.full(shape, np.nan), np.full(shape, np.nan)
    for i, outcome in enumerate(outcomes):
        m = len(outcome.t)
        errors[i, :m] = outcome.values / truth - 1.0
        std[i, :m] = outcome.std / np.abs(truth)
    return full.t, errors, std


def spreads(outcomes: Sequence[Outcome], bound: Callable[[float], Array] | None) -> list[Spread]:
    """Return one Spread for each time and free coefficient.

    Args:
        bound: from a time [s] to the least relative deviations (k,).
    """
    if not outcomes:
        return []
    t, errors, std = relative_errors(outcomes)
    names = experiment(outcomes[0].trial.experiment).free
    found = []
    for m, now in enumerate(t):
        least = np.full(len(names), np.nan) if bound is None else np.asarray(bound(float(now)))[: len(names)]
        for i, name in enumerate(names):
            known = np.isfinite(errors[:, m, i])
            e, s = errors[known, m, i], std[known, m, i]
            n = int(known.sum())
            found.append(
                Spread(
                    name=judged(name),
                    t=float(now),
                    rmse=float(np.sqrt(np.mean(e**2))) if n else math.nan,
                    bias=float(e.mean()) if n else math.nan,
                    bias_std=float(e.std() / math.sqrt(n)) if n else math.nan,
                    stated=float(np.sqrt(np.mean(s**2))) if n else math.nan,
                    bound=float(least[i]),
                    coverage=float(np.mean(np.abs(e) <= _INTERVAL * s)) if n else math.nan,
                    identified=n,
                    runs=len(outcomes),
                )
            )
    return found


def course(outcomes: Sequence[Outcome], bound: Callable[[float], Array] | None) -> dict[str, Any]:
    """Return what figures are drawn from: t (m,) and, each (m, k), rmse, bound, stated, bias, coverage, identified."""
    if not outcomes:
        return {}
    names = [judged(name) for name in experiment(outcomes[0].trial.experiment).free]
    found = spreads(outcomes, bound)
    t = np.array([each.t for each in found])[:: len(names)]
    fields = ("rmse", "bound", "stated", "bias", "coverage", "identified")
    table = {f: np.array([getattr(each, f) for each in found]).reshape(-1, len(names)) for f in fields}
    return {"names": names, "runs": len(outcomes), "t": t, **table}


def settling(t: Array, errors: Array) -> float:
    """Return the time [s] since the manoeuvre began from which on all errors (m, k) stay within 5 %, to the end.

    Infinite if they are not within it at the last reading; NaN counts as outside.
    """
    outside = ~(np.abs(errors) <= ERROR).all(axis=1)
    last = int(np.flatnonzero(outside)[-1]) if outside.any() else -1
    if last + 1 >= len(t):
        return math.inf
    return max(float(t[last + 1]) - REST, 0.0)


def percentile(times: Sequence[float] | Array, q: float) -> float:
    """Return the q-th percentile without interpolation, so that infinity stays apart from the rest."""
    values = np.asarray(times, dtype=np.float64)
    return float(np.percentile(values, q, method="higher")) if values.size else math.nan


def failures(outcomes: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Return what went wrong, run by run."""
    return [
        {
            "experiment": outcome.trial.experiment,
            "seed": outcome.trial.seed,
            "mode": outcome.trial.mode,
            "failure": outcome.failure,
        }
        for outcome in outcomes
        if outcome.failure is not None
    ]


def judged(name: str) -> str:
    """Return the name of what is judged: an added mass stands for the total inertia."""
    return next((axis.sum_name for axis in AXES if axis.added_mass == name), name)
