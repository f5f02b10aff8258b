"""Every experiment many times over: no exception, no NaN, no divergence.

    python benchmarks/studies/robustness_study.py [--runs 1000] [--only coupled] [--output robustness.json]

The runs are shared among all experiments in turn, each with a seed of its own. Each is streamed to its end and learned
as a whole. A run fails where an exception is raised, a value or a deviation is not finite though called identified, or
an identified coefficient is off by more than its own size at the end. The seeds of the failures are printed.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np
from experiments import EXPERIMENTS, chosen, experiment
from report import failures_text, show
from rich.table import Table
from runner import arguments, run, write_json
from summary import failures, percentile, relative_errors
from trial import Mode, Outcome, Trial

READ_EVERY = 1.0  # s
_MODES: tuple[Mode, ...] = ("batch", "stream")


def trials_of(names: Sequence[str], runs: int, seed: int, method: str) -> list[Trial]:
    """Return a batch and a stream for each run."""
    out = []
    for i in range(runs):
        name = names[i % len(names)]
        end = experiment(name).duration
        out.append(Trial(name, seed + i, "batch", (end,), method))
        out.append(Trial(name, seed + i, "stream", (READ_EVERY,), method))
    return out


def rows(names: Sequence[str], outcomes: Sequence[Outcome]) -> list[dict[str, object]]:
    """Return what to tell of each experiment and mode."""
    out: list[dict[str, object]] = []
    for name in names:
        for mode in _MODES:
            own = [each for each in outcomes if each.trial.experiment == name and each.trial.mode == mode]
            if not own:
                continue
            errors = relative_errors(own)[1][:, -1:]
            known = np.isfinite(errors)
            out.append(
                {
                    "experiment": name,
                    "mode": mode,
                    "runs": len(own),
                    "failed": len(failures(own)),
                    "worst_error": float(np.abs(errors[known]).max()) if known.any() else np.nan,
                    "not_identified": int((~known).sum()),
                    "median_seconds": percentile([each.seconds for each in own], 50.0),
                }
            )
    return out


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where no run failed."""
    options = arguments(__doc__ or "", 1000, argv)
    names = chosen(EXPERIMENTS, options.only)
    outcomes = run("robustness", trials_of(names, options.runs, options.seed, options.method), options.workers)
    found, failed = rows(names, outcomes), failures(outcomes)
    table = Table(title=f"{options.runs} runs, method {options.method}", title_justify="left")
    for name in ("experiment", "mode", "runs", "failed", "worst error %", "coefficients not identified", "median s"):
        table.add_column(name, justify="left" if name in ("experiment", "mode") else "right", no_wrap=True)
    for row in found:
        table.add_row(
            str(row["experiment"]), str(row["mode"]), str(row["runs"]), str(row["failed"]),
            f"{100.0 * float(str(row['worst_error'])):.3g}", str(row["not_identified"]), f"{row['median_seconds']:.2f}",
        )  # fmt: skip
    show(table, failures_text(failed, len(outcomes)))
    write_json(
        options.output,
        {
            "study": "robustness",
            "method": options.method,
            "runs": options.runs,
            "seed": options.seed,
            "parts": found,
            "failures": failed,
        },
    )
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
