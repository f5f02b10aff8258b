"""What `inspect` promises of a recording, beside what `learn` then knows of it: deviations of every coefficient.

    python benchmarks/studies/promise_study.py [--only pool,boat] [--output promise.json]

Every real recording at hand. A coefficient that both know counts; its ratio is the larger deviation by the smaller one.
Also told: what only one of them calls known.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from real_cases import BOAT_HALVES, POOL_RUNS, boat, data_folder, pool, sea
from report import checks_table, show
from rich.table import Table
from runner import arguments, over, write_json
from summary import Check

import towtank as tt
from towtank.errors import InputError
from towtank.recording import Recording
from towtank.vehicle import Vehicle

WITHIN = 1.5  # times


@dataclass(frozen=True)
class Promise:
    """Of one recording: deviations promised and reached by name, and what only one side calls known."""

    name: str
    promised: dict[str, float]
    reached: dict[str, float]
    why: str = ""

    @property
    def ratios(self) -> list[float]:
        """The larger deviation by the smaller one, of what both know."""
        both = self.promised.keys() & self.reached.keys()
        pairs = [(self.promised[name], self.reached[name]) for name in sorted(both)]
        return [max(a, b) / min(a, b) for a, b in pairs if min(a, b) > 0.0]


@cache
def recordings() -> dict[str, tuple[Vehicle, Recording]]:
    """Return every recording at hand with the vehicle that made it."""
    data = data_folder()
    if data is None:
        raise SystemExit("there are no recordings: set TOWTANK_DATA to their folder")
    tank, surface = pool(data), boat(data)
    out = {f"pool {name}": (tank.vehicle, tank.read(name)) for name in POOL_RUNS}
    out |= {f"boat {name}": (surface.vehicle, surface.read(name)) for half in BOAT_HALVES for name in half}
    vehicle, halves = sea(data)
    out |= {f"sea, half {k}": (vehicle, half) for k, half in enumerate(halves, 1)}
    return out


def case(name: str) -> Promise:
    """Inspect a recording, and learn from it."""
    vehicle, recording = recordings()[name]
    try:
        inspected, learned = tt.inspect(recording, vehicle), tt.learn(recording, vehicle)
    except InputError as error:
        return Promise(name, {}, {}, str(error))
    promised = {key: each.std for axis in inspected.axes.values() for key, each in axis.prospects.items()}
    reached = {each.name: each.std for each in learned.estimate.coefficients if each.identified}
    return Promise(name, promised, reached)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where everything that must hold holds."""
    options = arguments(__doc__ or "", 1, argv)
    parts = options.only.split(",") if options.only else [""]
    names = [name for name in recordings() if any(part in name for part in parts)]
    found = over("promises", case, [(name,) for name in names], options.workers)
    table = Table(title="deviations promised by inspect and reached by learn", title_justify="left")
    for head in ("recording", "both know", f"within {WITHIN}", "median ratio", "largest", "only inspect", "only learn"):
        table.add_column(head)
    for each in found:
        ratios = each.ratios
        near = sum(ratio <= WITHIN for ratio in ratios)
        cells = (f"{near}", f"{np.median(ratios):.2f}", f"{max(ratios):.2f}") if ratios else ("-", "-", each.why or "-")
        only = [", ".join(sorted(a - b)) for a, b in _both_ways(each)]
        table.add_row(each.name, f"{len(ratios)}", *cells, *only)
    ratios = [ratio for each in found for ratio in each.ratios]
    share = float(np.mean([ratio <= WITHIN for ratio in ratios])) if ratios else 0.0
    checks = [Check(f"share of deviations within a factor of {WITHIN}", share, low=1.0)]
    show(table)
    show(checks_table("must hold", checks))
    rows = [{"name": each.name, "promised": each.promised, "reached": each.reached} for each in found]
    write_json(options.output, {"study": "promise", "recordings": rows, "checks": [each.document() for each in checks]})
    return 0 if all(check.met for check in checks) else 1


def _both_ways(each: Promise) -> tuple[tuple[set[str], set[str]], tuple[set[str], set[str]]]:
    promised, reached = set(each.promised), set(each.reached)
    return (promised, reached), (reached, promised)


if __name__ == "__main__":
    sys.exit(main())
