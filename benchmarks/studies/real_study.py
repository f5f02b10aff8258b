"""Real recordings: models learned on some runs, judged on others by free-running prediction.

    python benchmarks/studies/real_study.py [--streamed] [--output real.json]

Nothing is tuned: vehicles from the catalog, the default method. Recordings from `$TOWTANK_DATA`, else `shared/data`
beside the repository; without them nothing is shown. The fit is 100 (1 - error / deviation) [%]. --streamed: by the
streaming filter alone, sample by sample, for which no limits are set.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from real_cases import (
    BOAT_HALVES,
    POOL,
    SPINS,
    boat,
    data_folder,
    model_fit,
    pool,
    real_fit,
    sea,
    streamed,
    wrongly_wired,
)
from report import checks_table, show
from rich.table import Table
from runner import write_json
from summary import Check

from towtank.identification import LogLearning, learn_recordings


def pool_checks(data: Path) -> list[Check]:
    """Yaw; roll and pitch; all thrusters, tumbling."""
    runs, out = pool(data), []
    for case in POOL:
        learning = runs.learn(*case.learned)
        fit = real_fit(learning, runs.read(case.judged), case.horizon)
        out += [Check(f"pool {case.name}: {name} %", fit[name], low=least) for name, least in case.least]
        if case.horizon is None and case.judged != "all_3":
            show(f"pool {' + '.join(case.learned)}: {said(learning)}")
    return out


def sea_checks(data: Path) -> list[Check]:
    """Surge by halves; what cannot be known is said."""
    vehicle, halves = sea(data)
    out = []
    for k, (here, there) in enumerate((halves, halves[::-1]), 1):
        learning = learn_recordings(vehicle, [here])
        out.append(Check(f"sea half {k} -> the other: u %", real_fit(learning, there)["u"], low=71.0))
        known = {name: learning.estimate[name].identified for name in ("X_udot", "K_pdot", "M_qdot")}
        out.append(Check(f"sea half {k}: unknowable inertias found", sum(known.values()), high=0.0))
        show(f"sea half {k}: {said(learning)}")
    return out


def boat_checks(data: Path) -> list[Check]:
    """Surge on logs that were not learned from, by halves; left and right swapped."""
    runs, out = boat(data), []
    fits: dict[str, float] = {}
    for learned, judged in (BOAT_HALVES, BOAT_HALVES[::-1]):
        learning = runs.learn(*learned)
        fits |= {name: real_fit(learning, runs.read(name))["u"] for name in judged}
        show(f"boat {' + '.join(learned)}: {said(learning)}")
    straight = [value for name, value in fits.items() if name not in SPINS]
    note = " ".join(f"{name}:{value:.0f}" for name, value in fits.items())
    out.append(Check("boat by halves: median u %", float(np.median(straight)), low=68.0))
    out.append(Check("boat by halves: least u %", min(straight), low=50.0, note=note))
    alone = {}
    names = [name for half in BOAT_HALVES for name in half]
    for name in (name for name in names if name not in SPINS):
        alone[name] = real_fit(runs.learn(*(other for other in names if other != name)), runs.read(name))["u"]
    note = " ".join(f"{name}:{value:.0f}" for name, value in alone.items())
    out.append(Check("boat, one left out: median u %", float(np.median(list(alone.values()))), low=68.0))
    out.append(Check("boat, one left out: least u %", min(alone.values()), low=50.0, note=note))
    found = learn_recordings(wrongly_wired(runs.vehicle), [runs.read(name) for name in BOAT_HALVES[0]])
    told = sum("(left) and 2 (right) are swapped" in each.text for each in found.findings)
    out.append(Check("boat: swapped outputs reported", told, low=1.0))
    return out


def streamed_table(data: Path) -> Table:
    """The same by the streaming filter alone."""
    table = Table(title="streamed, the filter alone", title_justify="left")
    for name in ("learned from -> judged by", "fit %"):
        table.add_column(name)

    def row(name: str, fit: dict[str, float], channels: Sequence[str]) -> None:
        table.add_row(name, ", ".join(f"{channel} {fit[channel]:.0f}" for channel in channels))

    runs = pool(data)
    for case in POOL:
        model = streamed(runs.vehicle, [runs.read(name) for name in case.learned])
        row(f"pool {case.name}", model_fit(model, runs.read(case.judged), case.horizon), [n for n, _ in case.least])
    vehicle, halves = sea(data)
    for k, (here, there) in enumerate((halves, halves[::-1]), 1):
        row(f"sea half {k} -> the other", model_fit(streamed(vehicle, [here]), there), "u")
    boats = boat(data)
    for learned, judged in (BOAT_HALVES, BOAT_HALVES[::-1]):
        model = streamed(boats.vehicle, [boats.read(name) for name in learned])
        for name in judged:
            row(f"boat {' + '.join(learned)} -> {name}", model_fit(model, boats.read(name)), "u")
    return table


def said(learning: LogLearning) -> str:
    """What is worth reading of a learning."""
    sums = ", ".join(f"{total.name} {total.value:.3g} ± {total.std:.2g}" for total in learning.estimate.sums)
    return "; ".join([f"method {learning.method}", sums or "no inertia", *learning.remarks])


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where everything that must hold holds, or where there are no recordings."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=None)
    parser.add_argument("--streamed", action="store_true", help="by the streaming filter alone")
    options = parser.parse_args(argv)
    data = data_folder()
    if data is None:
        show("no real recordings here: set TOWTANK_DATA to where they are")
        return 0
    if options.streamed:
        show(streamed_table(data))
        return 0
    held = pool_checks(data) + sea_checks(data) + boat_checks(data)
    show(checks_table("must hold", held))
    write_json(options.output, {"study": "real", "checks": [check.document() for check in held]})
    return 0 if all(check.met for check in held) else 1


if __name__ == "__main__":
    sys.exit(main())
