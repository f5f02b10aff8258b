"""What was exported, and the targets, as tables and as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from towtank.app.terminal.output import Output
from towtank.exporters import TARGETS, Exported, Imported

__all__ = ["export_document", "import_document", "show_export", "show_import", "show_targets", "targets_document"]

_ROWS = "XYZKMN"


def show_targets(output: Output) -> None:
    """Show the targets."""
    what = "For, and what it writes"
    table = output.table("Target", what, wrap=what)
    for each in TARGETS:
        versions = f" ({', '.join(each.versions)})" if len(each.versions) > 1 else ""
        table.add_row(each.name, f"{each.summary}: {each.writes}{versions}")
    output.show(table)


def targets_document() -> dict[str, Any]:
    """Return the targets."""
    return {
        "targets": [
            {"name": each.name, "for": each.summary, "writes": each.writes, "versions": list(each.versions)}
            for each in TARGETS
        ]
    }


def show_export(done: Exported, output: Output) -> None:
    """Show what was written and what it cannot say."""
    for place in done.files:
        output.line(f"{done.vehicle.name} -> {place}", "bold")
    output.line(f"{len(done.heading.coefficients)} coefficients for {done.target} {done.version}")
    for line in done.heading.missing:
        output.item(line)
    output.line(done.heading.error)


def export_document(done: Exported) -> dict[str, Any]:
    """Return what was written and what it cannot say."""
    return {
        "model": done.heading.source,
        "vehicle": done.vehicle.name,
        "target": done.target,
        "version": done.version,
        "files": [str(place) for place in done.files],
        "missing": list(done.heading.missing),
        "wrench_error": {row: float(value) for row, value in zip(_ROWS, done.error, strict=True)},
    }


def show_import(found: Imported, place: Path, output: Output) -> None:
    """Show what was read, what is doubtful about it, and what is left of the file."""
    vehicle = found.vehicle
    output.line(f"{vehicle.name} -> {place}", "bold")
    output.line(
        f"{found.source}: {vehicle.rigid_body.mass:g} kg, {len(vehicle.hydrodynamics)} coefficients,"
        f" {len(vehicle.thrusters)} thruster{'' if len(vehicle.thrusters) == 1 else 's'}"
    )
    for each in found.doubts:
        output.warn(f"{vehicle.name}: {each}")
    if found.left:
        output.line("not imported:")
    for each in found.left:
        output.item(each)


def import_document(found: Imported, place: Path) -> dict[str, Any]:
    """Return what was read, what is doubtful about it, and what is left of the file."""
    return {
        "vehicle": found.vehicle.name,
        "source": found.source,
        "file": str(place),
        "mass": found.vehicle.rigid_body.mass,
        "coefficients": {name: each.value for name, each in found.vehicle.hydrodynamics.items()},
        "thrusters": [each.name for each in found.vehicle.thrusters],
        "doubts": list(found.doubts),
        "not_imported": list(found.left),
    }
