"""Vehicles that change: how soon it is noticed, how rightly it is named, how often nothing is.

    python benchmarks/studies/change_study.py [--runs 200] [--only surge,thruster] [--output change.json]

The experiments are those of `change_cases`: surge, alarms (half an hour each, a tenth of the runs), ballast, righting,
payload, thruster, young, known, unknown, station (one run of eight hours). The seeds that the threshold was set by are
those below 1000; --seed 1001, the default, starts beyond them.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from change_cases import KINDS, SIX, Changed, alarms, all_axes, known, learned_base, surge, young
from change_station import station
from experiments import chosen
from report import checks_table, show
from rich.progress import track
from rich.text import Text
from runner import arguments, write_json
from summary import Check

CASES = ("surge", "alarms", *KINDS, "young", "known", "unknown", "station")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where everything that must hold holds."""
    arguments_given = list(sys.argv[1:] if argv is None else argv)
    if not any(each.startswith("--seed") for each in arguments_given):
        arguments_given += ["--seed", "1001"]
    options = arguments(__doc__ or "", 200, arguments_given)
    cases = chosen(CASES, options.only)
    seeds = range(options.seed, options.seed + options.runs)
    document: dict[str, Any] = {"study": "change", "runs": options.runs, "seed": options.seed}
    checks: list[Check] = []
    with tempfile.TemporaryDirectory() as folder, _pool(options.workers) as pool:
        place = Path(folder)
        if set(cases) & {*KINDS, "known", "unknown"}:
            list(track(pool.map(partial(learned_base, folder=place), range(4)), "bases", total=4))
        for case in cases:
            if case == "station":
                found = station(options.seed)
                checks += _station_checks(found)
                document[case] = found
                continue
            jobs = _jobs(case, list(seeds), place)
            outcomes = list(track(pool.map(_call, jobs), case, total=len(jobs)))
            checks += _checks(case, outcomes)
            document[case] = [asdict(each) for each in outcomes]
            wrong = [f"  seed {each.seed}: {'; '.join(each.texts)}" for each in outcomes if not each.right]
            show(checks_table(f"{case}, {len(outcomes)} runs", _checks(case, outcomes)), Text("\n".join(wrong[:5])))
    show(checks_table("must hold", checks))
    document["checks"] = [check.document() for check in checks]
    write_json(options.output, document)
    return 0 if all(check.met for check in checks) else 1


def _pool(workers: int) -> ProcessPoolExecutor:
    return ProcessPoolExecutor(workers, mp_context=get_context("spawn"))


def _call(job: Any) -> Changed:
    return job()  # type: ignore[no-any-return]


def _jobs(case: str, seeds: list[int], folder: Path) -> list[Any]:
    if case == "surge":
        return [partial(surge, seed) for seed in seeds]
    if case == "young":
        return [partial(young, seed) for seed in seeds]
    if case == "alarms":
        return [partial(alarms, seed) for seed in seeds[: max(len(seeds) // 10, 1)]]
    if case in KINDS:
        return [partial(all_axes, case, seed, folder) for seed in seeds]
    return [partial(known, seed % SIX if case == "known" else SIX, seed, folder) for seed in seeds]


def _checks(case: str, found: Sequence[Changed]) -> list[Check]:
    noticed = np.array([each.noticed for each in found])
    median, early = float(np.median(noticed)), sum(each.early for each in found)
    right = float(np.mean([each.right for each in found]))
    ninth = f"90th percentile {_quantile(noticed):.2f} s; {early} events before the change"
    if case == "alarms":
        hours = sum(each.seconds for each in found) / 3600.0
        return [Check(f"alarms: false ones an hour, over {hours:.3g} h", early / hours, high=1.0)]
    if case == "surge":
        before = np.sqrt(np.mean([np.square(each.before) for each in found], axis=0))
        within = np.array([each.within for each in found])
        return [
            Check("surge: noticed after, median [s]", median, high=3.0, note=ninth),
            Check("surge: within 10 % after, 90th percentile [s]", _quantile(within[:, 0]), high=5.0),
            Check("surge: within 5 % after, 90th percentile [s]", _quantile(within[:, 1]), high=6.5,
                  note=f"median {np.median(within[:, 1]):.2f} s"),
            Check("surge: RMS deviation of the inertia before [%]", float(before[0]), high=0.2),
            Check("surge: RMS deviation of the drag before [%]", float(before[1]), high=0.6),
        ]  # fmt: skip
    if case == "known":
        soon = float(np.mean([each.right and each.onset <= 5.0 for each in found]))
        note = f"at the end {100.0 * right:.1f} %; median {np.median([each.onset for each in found]):.2f} s"
        return [Check("known: recognised within 5 s, share", soon, low=0.90, note=note)]
    if case == "young":
        note = f"anything told within 15 s: {np.isfinite(noticed).sum()}; median {median:.2f} s, {ninth}"
        return [Check("young: told as a change of the vehicle, share", right, low=0.9, note=note)]
    if case == "unknown":
        return [Check("unknown: not taken for a known one, share", right, low=0.95)]
    out = [Check(f"{case}: noticed after, median [s]", median, high=2.0 if case != "payload" else 3.0, note=ninth)]
    if case == "righting":
        five = np.array([each.within[1] for each in found])
        out.append(Check("righting: within 5 % after, median [s]", float(np.median(five)), high=4.0,
                         note=f"90th percentile {_quantile(five):.2f} s"))  # fmt: skip
    low = 0.95 if case == "thruster" else 0.0
    out.append(Check(f"{case}: named rightly, share", right, low=low))
    if case == "thruster":
        wrongly = float(np.mean([each.wrongly_body for each in found]))
        out.append(Check("thruster: called a payload, share", wrongly, high=0.02))
    return out


def _station_checks(found: dict[str, Any]) -> list[Check]:
    hours = found["hours"]
    return [
        Check(f"station: false alarms an hour, over {hours:g} h", found["false"] / hours, high=1.0),
        Check("station: growth of a coefficient's error, at most [std]", found["drift"], high=1.0),
        Check("station: mean variance, times that at the start, at most", found["trace"], high=1.01),
        Check("station: payload noticed after motion began [s]", found["noticed"], high=10.0),
    ]


def _quantile(values: Any) -> float:
    return float(np.quantile(values, 0.9, method="higher"))


if __name__ == "__main__":
    sys.exit(main())
