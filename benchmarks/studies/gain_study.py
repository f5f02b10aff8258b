"""Thrusters that give less than their curves say, which nobody tells the learner.

    python benchmarks/studies/gain_study.py [--runs 20] [--only weak] [--output gains.json]

A vehicle tumbles for 60 s under all its thrusters in water that stirs it (0.3 N m, 0.5 s), and only gyros measure.
`weak`: the two that turn it in yaw give 0.6 of their curves, which yaw alone cannot tell from more inertia and drag.
`right`: all give what they say. `lagging`: so they do, but 0.08 s late, so that the first model is wrong elsewhere. How
often gains are said to differ, how well those that do are known, and the error of the total inertias.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence

import numpy as np
from by_case import by_case
from summary import Check
from tumbling import INERTIAS, named, true_vehicle, tumble

from towtank.identification import learn_recordings

WEAK = {"f3": 0.6, "f4": 0.6}
BESIDE = ("f1", "f2")
CASES = {"weak": (WEAK, 0.0), "right": ({}, 0.0), "lagging": ({}, 0.08)}
Found = tuple[dict[str, tuple[float, float]], list[float]]


def learned(case: str, seed: int) -> Found:
    """Return the gains found and their deviations, and the relative errors of the total inertias."""
    gains, lag = CASES[case]
    truth = true_vehicle(lag=lag, **gains)
    learning = learn_recordings(named(), [tumble(truth, seed=seed)])
    rigid = named().rigid_body.inertia
    totals = [
        (own - learning.model.coefficient(name)) / (own - truth.coefficient(name)) - 1.0
        for own, name in zip(rigid, INERTIAS, strict=True)
    ]
    return {name: (float(gain), float(std)) for name, (gain, std) in learning.gains.items()}, totals


def checks(case: str, found: Sequence[Found]) -> list[Check]:
    """Return what must hold of one case."""
    weak = CASES[case][0]
    named_so = [gains for gains, _ in found if set(weak) <= set(gains)]
    others = [abs(gain - 1.0) for gains, _ in found for name, (gain, _) in gains.items() if name not in weak]
    out = [Check(f"{case}: largest error of a gain that is 1", max(others, default=0.0), high=0.1)]
    sure = [abs(x - 1.0) < 1.96 * std for gains, _ in found for name, (x, std) in gains.items() if name not in weak]
    out.append(Check(f"{case}: 95 % intervals of the others that hold 1", float(np.mean(sure)), low=0.8))
    if weak:
        # Gyros tell how much thrusters give beside each other; what all give together goes with what is supposed.
        beside = [_mean(gains, weak) / _mean(gains, BESIDE) for gains in named_so]
        out += [
            Check(f"{case}: least of the weak, beside those that turn it in roll", min(beside), low=0.54),
            Check(f"{case}: most of it", max(beside), high=0.66),
        ]
        off = [(gains[name][0] - true) / gains[name][1] for gains in named_so for name, true in weak.items()]
        out += [
            Check(f"{case}: runs in which both are found", len(named_so) / len(found), low=0.9),
            Check(f"{case}: 95 % intervals that hold the gain", float(np.mean(np.abs(off) < 1.96)), low=0.8),
        ]
    inertia = float(np.sqrt(np.mean([np.square(errors) for _, errors in found])))
    return [*out, Check(f"{case}: RMSE of the total inertias", inertia, high=0.1 if weak else 0.05)]


def _mean(gains: dict[str, tuple[float, float]], names: Iterable[str]) -> float:
    return float(np.mean([gains[name][0] for name in names]))


def row(found: Found) -> dict[str, str]:
    """Return a run as its table shows it."""
    gains, errors = found
    return {
        "gains": ", ".join(f"{name} {gain:.2f} ± {std:.2f}" for name, (gain, std) in gains.items()),
        "errors of the total inertias %": ", ".join(f"{100.0 * each:+.1f}" for each in errors),
    }


if __name__ == "__main__":
    sys.exit(by_case("gains", __doc__ or "", CASES, learned, row, checks))
