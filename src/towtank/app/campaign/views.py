"""What a campaign did, how far it is, and what came of it: as tables, documents and files."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from towtank.app.terminal.output import Output
from towtank.campaigns.run import Summary
from towtank.campaigns.store import CHANNELS, Failure, Store
from towtank.digits import short
from towtank.outputs import write_atomically

if TYPE_CHECKING:
    import pyarrow as pa

    from towtank.campaigns.fleet import Fleet

__all__ = [
    "show_fleet",
    "show_status",
    "show_summary",
    "show_table",
    "status_document",
    "summary_document",
    "table_document",
    "write_table",
]

_FLEET = ("Coefficient", ">Class", ">±", "Unit", ">Vehicles", ">Runs", ">New", ">Before", ">Known")
_LISTED = 20  # failures that are shown


def show_summary(done: Summary, store: str, output: Output) -> None:
    """Print what a run did, what failed, and what comes next."""
    failed = f", {len(done.failures)} failed" if done.failures else ""
    output.line(f"{done.performed} of {done.total} tasks done now in {short(done.seconds, 3)} s{failed}", "bold")
    if done.before:
        output.line(f"{done.before} were done before")
    if done.left:
        output.line(f"{done.left} are left; the same command does them")
    _list(done.failures, output)
    output.line()
    output.line(f"Next: towtank campaign table {store} -o table.parquet", "dim")


def summary_document(done: Summary, store: str, kind: str) -> dict[str, Any]:
    """Return what a run did as a document."""
    return {
        "store": store,
        "kind": kind,
        "tasks": done.total,
        "done_before": done.before,
        "performed": done.performed,
        "left": done.left,
        "seconds": done.seconds,
        "failed": [asdict(each) for each in done.failures],
    }


def status_document(store: Store) -> dict[str, Any]:
    """Return how far a campaign is. Raises InputError where there is none."""
    head, planned = store.head, {each.id: each for each in store.plan}
    done = store.done()
    failures = [each for each in store.failures(done) if each.id in planned]
    settings = head["settings"]
    return {
        "store": store.place.name,
        "kind": settings["kind"],
        "method": None if settings["kind"] == "validate" else settings["method"],
        "version": head["version"],
        "tasks": len(planned),
        "done": len(done & planned.keys()),
        "failed": [asdict(each) for each in failures],
        "left": len(planned.keys() - done) - len(failures),
        "of_earlier_plans": len(done - planned.keys()),
    }


def show_status(found: dict[str, Any], output: Output) -> None:
    """Print how far a campaign is."""
    method = f", method {found['method']}" if found["method"] else ""
    output.line(f"{found['store']}: {found['kind']}{method}, towtank {found['version']}", "bold")
    failed = f", {len(found['failed'])} failed" if found["failed"] else ""
    output.line(f"{found['done']} of {found['tasks']} tasks done{failed}, {found['left']} left")
    if found["of_earlier_plans"]:
        output.line(
            f"{found['of_earlier_plans']} more are of logs that the last run did not name, or that changed since; the "
            "table leaves them out"
        )
    _list([Failure(**each) for each in found["failed"]], output)


def _list(failures: Sequence[Failure], output: Output) -> None:
    if not failures:
        return
    output.heading("Failed")
    for each in failures[:_LISTED]:
        line = each.line.removeprefix("towtank: ")
        output.item(line if each.label in line else f"{each.label}: {line}")
    if len(failures) > _LISTED:
        output.item(f"and {len(failures) - _LISTED} more: --json lists all")
    output.line("Once they are mended, --retry-failed tries them again.", "dim")


def show_fleet(fleet: Fleet, output: Output) -> None:
    """Print what each class is, how its vehicles and runs spread, and which runs stand apart."""
    for each in fleet.classes:
        output.heading(f"{each.name}: {len(each.runs)} runs of {len(each.vehicles)} vehicles")
        table = output.table(*_FLEET)
        for row in each.rows():
            table.add_row(*row)
        output.show(table)
        for outlier in each.outliers:
            output.item(outlier.text)
    output.line(
        "Vehicles, Runs: how they spread. New: deviation of what a new vehicle is supposed to have; Before: without "
        "any run. Known: by how many runs/vehicles alone.",
        "dim",
    )


def write_table(rows: pa.Table, path: Path) -> None:
    """Write all rows, `.parquet` or `.csv`, whole or not at all. Raises InputError."""
    import pyarrow.csv as pc
    import pyarrow.parquet as pq

    if path.suffix.lower() == ".csv":
        write_atomically(path, lambda stream: pc.write_csv(rows, stream))
    else:
        write_atomically(path, lambda stream: pq.write_table(rows, stream, compression="zstd"))


def summaries(rows: pa.Table) -> list[dict[str, Any]]:
    """Return of each class and coefficient: of how many runs, in how many it is identified, and their values."""
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    columns = rows.select(["class", "coefficient", "unit", "value", "identified"])
    for row in columns.to_pylist():
        if row["coefficient"] is not None:
            found.setdefault((row["class"], row["coefficient"]), []).append(row)
    out = []
    for (klass, name), each in found.items():
        values = [row["value"] for row in each if row["identified"] and row["value"] is not None]
        spread = (min(values), max(values)) if values else (None, None)
        out.append(
            {
                "class": klass,
                "coefficient": name,
                "unit": each[0]["unit"],
                "runs": len(each),
                "identified": len(values),
                "median": statistics.median(values) if values else None,
                "lowest": spread[0],
                "highest": spread[1],
            }
        )
    return out


def fits(rows: pa.Table) -> dict[str, float | None]:
    """Return the median of each fit [%] over all runs, None where none was measured."""
    runs: dict[str, dict[str, Any]] = {}
    for row in rows.select(["id", *(f"fit_{name}" for name in CHANNELS)]).to_pylist():
        runs[row["id"]] = row
    out: dict[str, float | None] = {}
    for name in CHANNELS:
        values = [row[f"fit_{name}"] for row in runs.values() if row[f"fit_{name}"] is not None]
        out[name] = statistics.median(values) if values else None
    return out


def table_document(rows: pa.Table, file: Path | None) -> dict[str, Any]:
    """Return the summary of a table as a document."""
    return {
        "rows": rows.num_rows,
        "runs": len(set(rows["id"].to_pylist())),
        "vehicles": len({*zip(rows["class"].to_pylist(), rows["vehicle"].to_pylist(), strict=True)}),
        "columns": rows.schema.names,
        "file": file,
        "coefficients": summaries(rows),
        "fit": fits(rows),
    }


def show_table(rows: pa.Table, output: Output) -> None:
    """Print the summary of a table."""
    document = table_document(rows, None)
    runs, vehicles = document["runs"], document["vehicles"]
    output.line(f"{runs} run{'s' * (runs != 1)} of {vehicles} vehicle{'s' * (vehicles != 1)}", "bold")
    if not document["runs"]:
        output.line("Nothing is done yet; towtank campaign status says what failed, and why.")
        return
    every: list[dict[str, Any]] = document["coefficients"]
    for klass in dict.fromkeys(each["class"] for each in every):
        output.heading(klass)
        table = output.table("Coefficient", ">Runs", ">Known", ">Median", ">Lowest", ">Highest", "Unit")
        for each in (one for one in every if one["class"] == klass):
            values = [short(each[key]) for key in ("median", "lowest", "highest")]
            table.add_row(each["coefficient"], str(each["runs"]), str(each["identified"]), *values, each["unit"])
        output.show(table)
    known = {name: value for name, value in document["fit"].items() if value is not None}
    if known:
        output.line("median fit: " + ", ".join(f"{name} {value:.0f} %" for name, value in known.items()))
