"""A study that learns the same seeds in several cases: a table of each case, one of what must hold, a document."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import TypeVar

from report import checks_table, show
from rich.table import Table
from runner import arguments, over, write_json
from summary import Check

__all__ = ["by_case"]

T = TypeVar("T")


def by_case(
    study: str,
    description: str,
    cases: Collection[str],
    learned: Callable[[str, int], T],
    row: Callable[[T], dict[str, str]],
    checks: Callable[[str, Sequence[T]], list[Check]],
    argv: Sequence[str] | None = None,
) -> int:
    """Run a study of 20 seeds, unless its options say otherwise; 0 where everything that must hold holds.

    Args:
        learned: what comes of a case and a seed. row: of that, by the names of columns. checks: of a case's seeds.
    """
    options = arguments(description, 20, argv)
    chosen = [name for name in cases if not options.only or any(each in name for each in options.only.split(","))]
    seeds = range(options.seed, options.seed + options.runs)
    held: list[Check] = []
    documents = {}
    for case in chosen:
        found = over(f"{study}, {case}", learned, [(case, seed) for seed in seeds], options.workers)
        rows = [row(each) for each in found]
        table = Table("seed", *rows[0], title=f"{case}, {len(seeds)} runs", title_justify="left")
        for seed, cells in zip(seeds, rows, strict=True):
            table.add_row(str(seed), *cells.values())
        show(table)
        held += checks(case, found)
        documents[case] = found
    show(checks_table("must hold", held))
    write_json(options.output, {"study": study, "cases": documents, "checks": [each.document() for each in held]})
    return 0 if all(check.met for check in held) else 1
