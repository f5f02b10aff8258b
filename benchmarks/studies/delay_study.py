"""A command delay of 0.15 s and a thruster lag of 0.10 s that nobody tells the learner.

    python benchmarks/studies/delay_study.py [--runs 100] [--only square] [--output delay.json]

Surge under motion capture of 1 mm with marker jumps, stairs and square wave, without (s1) and with (s2) a random force
of 0.5 N, 2 s. Learned anew from the first 5, 10, 20 s: the delay within 0.02 s, the bias of mass and drag at most 1 %
after 10 s. The Cramer-Rao bound is that of mass, drag, delay and lag together; where it is above what must hold, as
with the random force, the figure is only shown.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from experiments import DELAY, DELAYED, LAG, chosen
from report import checks_table, delays_table, failures_text, show, spreads_table, times_table
from runner import arguments, run, write_json
from summary import Check, DelaySpread, delay_spreads, failures
from surge_part import Part, part, trials_of

TIMES = (5.0, 10.0, 20.0)  # s
JUDGED = 10.0  # s
NEAR, BIAS = 0.02, 0.01  # s, relative


def delays(found: Part) -> list[DelaySpread]:
    """Return how the delay came out of the batches, beside its bound."""
    column = found.least.unknowns.index("delay")
    batch = [outcome for outcome in found.outcomes if outcome.trial.mode == "batch"]
    return delay_spreads(batch, DELAY, NEAR, lambda t: float(found.least.at(t)[column]))


def checks(found: Part, delayed: Sequence[DelaySpread]) -> list[Check]:
    """Return what must hold of one experiment after 10 s; nothing of what the bound already forbids."""
    least = found.least.at(JUDGED)
    out = []
    for s in found.batch:
        if s.t == JUDGED and found.name.startswith("delay-s1"):
            note = f"± {100.0 * s.bias_std:.2g} %, bound of one run {100.0 * s.bound:.2g} %"
            value = abs(s.bias) if s.identified == s.runs else np.nan
            out.append(Check(f"{found.name} {s.name} {s.t:g} s: |bias|", value, high=BIAS, note=note))
    for d in delayed:
        if d.t == JUDGED and 3.0 * least[found.least.unknowns.index("delay")] < NEAR:
            note = f"bound {1e3 * d.bound:.2g} ms; {100.0 * d.within:.0f} % of the runs within {NEAR:g} s"
            out.append(Check(f"{found.name} delay {d.t:g} s: RMSE, s", d.rmse, high=NEAR, note=note))
    return out


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where everything that must hold holds."""
    options = arguments(__doc__ or "", 100, argv)
    names = chosen(DELAYED, options.only)
    seeds = range(options.seed, options.seed + options.runs)
    outcomes = run("delay", trials_of(names, seeds, options.method, TIMES), options.workers)
    parts = [part(name, outcomes, seeds) for name in names]
    delayed = [delays(each) for each in parts]
    failed = failures(outcomes)
    held = [check for each, its in zip(parts, delayed, strict=True) for check in checks(each, its)]
    for each, its in zip(parts, delayed, strict=True):
        show(spreads_table(f"{each.name}, {options.runs} runs, method {options.method}: first seconds", each.batch))
        show(delays_table(f"{each.name}: delay, truth {DELAY:g} s beside a lag of {LAG:g} s", its))
    show(times_table("t5, streamed, since the manoeuvre began", [each.times_row for each in parts]))
    show(checks_table("must hold", held), failures_text(failed, len(outcomes)))
    documents = [
        {**each.document(), "delay": [d.document() for d in its]} for each, its in zip(parts, delayed, strict=True)
    ]
    write_json(
        options.output,
        {
            "study": "delay",
            "method": options.method,
            "runs": options.runs,
            "seed": options.seed,
            "parts": documents,
            "checks": [check.document() for check in held],
            "failures": failed,
        },
    )
    return 0 if not failed and all(check.met for check in held) else 1


if __name__ == "__main__":
    sys.exit(main())
