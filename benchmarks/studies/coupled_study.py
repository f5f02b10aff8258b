"""Thirteen coefficients at once from one run of 60 s on all axes, cold start, beside the Cramer-Rao bound.

    python benchmarks/studies/coupled_study.py [--runs 50] [--only pose] [--output coupled.json]

The vLBV300 with six inertias, six quadratic drags and the righting moment unknown, under a random wrench of 0.5 N and
0.05 N m, 2 s. coupled-pose: motion capture of 1 mm and 1 mrad with marker jumps. coupled-dvl: DVL, gyro and depth
instead. coupled-gyro: gyro and depth alone; which coefficients the learner calls unidentifiable is shown beside what
the bound says. Learned from the first 20, 40 and 60 s; streamed and read every second.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from experiments import COUPLED, chosen, experiment
from kalman_bound import kalman_bound
from report import checks_table, failures_text, show, spreads_table
from runner import arguments, run, write_json
from summary import Check, Spread, course, failures, spreads
from trial import Outcome, Trial

from towtank.core.arrays import Array

TIMES = (20.0, 40.0, 60.0)  # s
READ_EVERY = 1.0  # s
BOUND_RUNS = 6  # whose motion and hidden samples the bound is averaged over
INERTIA, DRAG, YAW_DRAG = 0.005, 0.05, 0.10  # relative
COVERAGE = (0.85, 0.99)


@dataclass(frozen=True, eq=False)
class Part:
    """One coupled experiment: spreads of the batches, course of the streams, and the bound (m, k) at times t (m,)."""

    name: str
    batch: list[Spread]
    stream: dict[str, Any]
    t: Array
    bound: Array

    def document(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        batch = [{**asdict(each), "ratio": each.ratio} for each in self.batch]
        bound = {"unknowns": experiment(self.name).free, "t": self.t, "std": self.bound}
        return {"experiment": self.name, "batch": batch, "stream": self.stream, "bound": bound}


def part(name: str, outcomes: Sequence[Outcome], seeds: Sequence[int]) -> Part:
    """Put the outcomes of one experiment together with its bound."""
    bounds = [kalman_bound(experiment(name), seed=seed) for seed in list(seeds)[:BOUND_RUNS]]
    t, std = bounds[0].t, np.sqrt(np.mean([each.std**2 for each in bounds], axis=0))

    def least(now: float) -> Array:
        return np.asarray(std[int(np.searchsorted(t, now + 1e-9)) - 1])

    own = [outcome for outcome in outcomes if outcome.trial.experiment == name]
    batch, stream = ([o for o in own if o.trial.mode == mode] for mode in ("batch", "stream"))
    return Part(name, spreads(batch, least), course(stream, least), t, std)


def checks(found: Part) -> list[Check]:
    """Return what must hold of one experiment at the end: all that is known of gyro and depth is its coverage."""
    end = [s for s in found.batch if s.t == TIMES[-1]]
    out = []
    for s in end if found.name != "coupled-gyro" else []:
        limit = INERTIA if " - " in s.name else YAW_DRAG if s.name == "N_rr" else DRAG
        value = s.rmse if s.identified == s.runs else np.nan
        note = f"bound {100.0 * s.bound:.2g} %, RMSE/bound {s.ratio:.2f}"
        out.append(Check(f"{found.name} {s.name}: RMSE", value, high=limit, note=note))
    count = sum(s.identified for s in end)
    held = sum(s.coverage * s.identified for s in end if s.identified) / count if count else np.nan
    note = f"all coefficients of {end[0].runs} runs together"
    return [*out, Check(f"{found.name}: coverage of 95 %", held, *COVERAGE, note=note)]


def unidentified(found: Part) -> str:
    """Say which coefficients the learner leaves open at the end, and how well the bound knows them."""
    end = [s for s in found.batch if s.t == TIMES[-1]]
    left = [
        f"{s.name} in {s.runs - s.identified} runs (bound {100.0 * s.bound:.2g} %)"
        for s in end
        if s.identified < s.runs
    ]
    return f"{found.name}: not identified: {', '.join(left)}" if left else f"{found.name}: everything identified"


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where everything that must hold holds."""
    options = arguments(__doc__ or "", 50, argv)
    names = chosen(COUPLED, options.only)
    seeds = range(options.seed, options.seed + options.runs)
    trials = []
    for name in names:
        for seed in seeds:
            trials.append(Trial(name, seed, "batch", TIMES, options.method))
            trials.append(Trial(name, seed, "stream", (READ_EVERY,), options.method))
    outcomes = run("coupled", trials, options.workers)
    parts = [part(name, outcomes, seeds) for name in names]
    failed = failures(outcomes)
    held = [check for each in parts for check in checks(each)]
    for each in parts:
        end = [s for s in each.batch if s.t == TIMES[-1]]
        show(spreads_table(f"{each.name}, {options.runs} runs, method {options.method}", end), unidentified(each))
    show(checks_table("must hold", held), failures_text(failed, len(outcomes)))
    write_json(
        options.output,
        {
            "study": "coupled",
            "method": options.method,
            "runs": options.runs,
            "seed": options.seed,
            "parts": [each.document() for each in parts],
            "checks": [check.document() for check in held],
            "failures": failed,
        },
    )
    return 0 if not failed and all(check.met for check in held) else 1


if __name__ == "__main__":
    sys.exit(main())
