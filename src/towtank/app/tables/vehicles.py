"""Vehicles as tables and as documents."""

from __future__ import annotations

import warnings
from typing import Any

from towtank.app.terminal.output import Output
from towtank.digits import measured, short, signed_list
from towtank.vehicle import (
    RESTORING,
    Thruster,
    Vehicle,
    VehicleWarning,
    catalog_names,
    describe,
    force_range,
    load_vehicle,
    unit,
)

__all__ = ["catalog", "show_catalog", "show_vehicle", "vehicle_document"]


def catalog() -> list[dict[str, Any]]:
    """Return one entry for each vehicle of the catalog."""
    entries = []
    for name in catalog_names():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VehicleWarning)
            vehicle = load_vehicle(name)
        entries.append(
            {
                "name": name,
                "description": vehicle.description,
                "mass": vehicle.rigid_body.mass,
                "thrusters": len(vehicle.thrusters),
                "coefficients": len(vehicle.hydrodynamics),
                "warnings": list(vehicle.warnings),
            }
        )
    return entries


def show_catalog(entries: list[dict[str, Any]], output: Output) -> None:
    """Print the catalog."""
    table = output.table("Vehicle", ">kg", ">Thrusters", "Description", wrap="Description")
    for entry in entries:
        table.add_row(entry["name"], short(entry["mass"]), str(entry["thrusters"]), entry["description"])
    output.show(table)
    output.line()
    output.line("Next: towtank vehicle show NAME", "dim")


def show_vehicle(vehicle: Vehicle, output: Output) -> None:
    """Print everything about a vehicle."""
    output.line(vehicle.name, "bold")
    if vehicle.description:
        output.line(vehicle.description)
    _show_body(vehicle, output)
    _show_coefficients(vehicle, output)
    _show_posterior(vehicle, output)
    _show_thrusters(vehicle, output)
    if vehicle.provenance.source or vehicle.provenance.notes:
        output.heading("Where it comes from")
        if vehicle.provenance.source:
            output.line(vehicle.provenance.source)
        for note in vehicle.provenance.notes:
            output.item(note)
    if vehicle.warnings:
        output.heading("Warnings")
        for text in vehicle.warnings:
            output.item(text)


def _show_body(vehicle: Vehicle, output: Output) -> None:
    body, tensor = vehicle.rigid_body, vehicle.rigid_body.tensor
    products = (float(tensor[0, 1]), float(tensor[0, 2]), float(tensor[1, 2]))
    rows = [
        ("mass", short(body.mass, 6), "kg"),
        ("moments of inertia", signed_list(tuple(float(tensor[i, i]) for i in range(3))), "kg m^2"),
        ("centre of gravity", signed_list(body.centre_of_gravity), "m"),
        ("centre of buoyancy", signed_list(vehicle.buoyancy.centre), "m"),
        ("weight W", short(vehicle.weight, 5), "N"),
        ("buoyancy B", short(vehicle.buoyant_force, 5), "N"),
        ("command delay", short(vehicle.command_delay), "s"),
    ]
    if vehicle.scale_std is not None:
        rows.append(("scale of thrust known to", f"{100.0 * vehicle.scale_std:.3g}", "%"))
    if any(products):
        rows.insert(2, ("products xy xz yz", signed_list(products), "kg m^2"))
    output.heading("Rigid body and buoyancy (about the body origin, x forward, y starboard, z down)")
    table = output.table("Quantity", ">Value", "Unit")
    for row in rows:
        table.add_row(*row)
    output.show(table)


def _coefficients(vehicle: Vehicle) -> dict[str, dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for name, coefficient in vehicle.hydrodynamics.items():
        found[name] = {**coefficient.model_dump(), "description": describe(name)}
    for name in RESTORING:
        given = getattr(vehicle.restoring, name)
        value = vehicle.coefficient(name)
        if given is not None:
            found[name] = {**given.model_dump(), "description": describe(name)}
        else:
            source = "from rigid body and buoyancy"
            found[name] = {"value": value, "std": None, "unit": unit(name), "source": source}
            found[name]["description"] = describe(name)
    return found


def _show_coefficients(vehicle: Vehicle, output: Output) -> None:
    output.heading("Coefficients")
    table = output.table("Name", ">Value", ">± std", "Unit", "Source")
    sources: dict[str, int] = {}
    for name, entry in _coefficients(vehicle).items():
        value, spread = measured(entry["value"], entry["std"])
        number = sources.setdefault(entry["source"], len(sources) + 1) if entry["source"] else ""
        table.add_row(name, value, spread, entry["unit"], f"[{number}]" if number else "-")
    output.show(table)
    for source, number in sources.items():
        output.item(source, mark=f"[{number}]")


def _show_posterior(vehicle: Vehicle, output: Output) -> None:
    if vehicle.prior:
        output.heading("Stated of single unknowns before any data (all: towtank vehicle prior)")
        output.line(", ".join(vehicle.prior))
    if vehicle.posterior is not None:
        count = len(vehicle.posterior.names)
        output.heading(f"Posterior with its covariance, over {count} unknown{'s' if count > 1 else ''}")
        output.line(", ".join(vehicle.posterior.names))


def _show_thrusters(vehicle: Vehicle, output: Output) -> None:
    if not vehicle.thrusters:
        output.heading("No thrusters")
        return
    output.heading("Thrusters (position in m, direction of the force at positive command)")
    table = output.table("Name", "Position", "Direction", ">Force N", ">Lag s", wrap="Position")
    for thruster in vehicle.thrusters:
        lowest, highest = _forces(thruster)
        table.add_row(
            thruster.name,
            signed_list(thruster.position),
            " ".join(f"{x:.3g}" for x in thruster.direction),
            f"{short(lowest, 3)} .. {short(highest, 3)}",
            short(thruster.time_constant),
        )
    output.show(table)
    kinds: dict[str, list[str]] = {}
    for thruster in vehicle.thrusters:
        kinds.setdefault(thruster.curve.kind, []).append(thruster.name)
    groups = [kind if len(kinds) == 1 else f"{kind} for {', '.join(names)}" for kind, names in kinds.items()]
    output.line(f"Curves from command to force: {'; '.join(groups)}")


def _forces(thruster: Thruster) -> tuple[float | None, float | None]:
    try:
        lowest, highest = force_range(thruster.curve)
    except (ValueError, OverflowError):
        return None, None
    return thruster.gain * float(lowest), thruster.gain * float(highest)


def vehicle_document(vehicle: Vehicle) -> dict[str, Any]:
    """Return the JSON document of a vehicle."""
    body = vehicle.rigid_body
    return {
        "name": vehicle.name,
        "description": vehicle.description,
        "rigid_body": {
            "mass": body.mass,
            "inertia": body.tensor,
            "centre_of_gravity": body.centre_of_gravity,
            "source": body.source,
        },
        "buoyancy": {"force": vehicle.buoyant_force, "centre": vehicle.buoyancy.centre},
        "weight": vehicle.weight,
        "mass_matrix": vehicle.mass_matrix,
        "coefficients": _coefficients(vehicle),
        "thrusters": [
            {**thruster.model_dump(exclude_none=True), "force_range": _forces(thruster)}
            for thruster in vehicle.thrusters
        ],
        "command_delay": vehicle.command_delay,
        "scale_std": vehicle.scale_std,
        "prior": vehicle.prior,
        "posterior": None if vehicle.posterior is None else vehicle.posterior.model_dump(),
        "provenance": vehicle.provenance,
        "warnings": vehicle.warnings,
    }
