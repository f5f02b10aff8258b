"""The vehicle as it was known: body, buoyancy, thrusters drawn, source."""

from __future__ import annotations

from html import escape

from towtank.digits import short, signed_list
from towtank.report.elements import cell, facts, figure, grid, paragraph, section, table
from towtank.report.thruster_drawing import thrusters_svg
from towtank.vehicle import Thruster, Vehicle

__all__ = ["vehicle_section"]


def vehicle_section(vehicle: Vehicle) -> str:
    """Return what the vehicle file says of everything that was not learned."""
    body = vehicle.rigid_body
    inertia = body.inertia if isinstance(body.inertia[0], float) else tuple(body.tensor.diagonal())
    told = facts(
        [
            ("Description", escape(vehicle.description)),
            ("Mass", f"{short(body.mass)} kg (weight {short(vehicle.weight)} N)"),
            ("Inertia about the centre of gravity", f"{_row(inertia)} kg m²"),
            ("Centre of gravity", f"{_row(body.centre_of_gravity)} m"),
            ("Buoyancy", f"{short(vehicle.buoyant_force)} N at {_row(vehicle.buoyancy.centre)} m"),
            ("Source", escape(vehicle.provenance.source)),
            ("Notes", escape(" ".join(vehicle.provenance.notes))),
        ]
    )
    drawings = [figure(svg, escape(caption)) for caption, svg in thrusters_svg(vehicle)]
    note = (
        "An arrow is the push at positive command; a ring with a dot pushes towards the reader, one with a cross away. "
        "The cross in the middle is the centre of gravity; the outline is not the hull's. Axes: x forward, y "
        "starboard, z down."
    )
    thrusters = [
        [
            cell(f"{k}"),
            cell(escape(each.name), "name"),
            cell(_row(each.position), "n"),
            cell(_row(each.direction), "n"),
            cell(escape(_kind(each))),
            cell(short(1e3 * each.time_constant) if each.time_constant else "–", "n"),
        ]
        for k, each in enumerate(vehicle.thrusters, 1)
    ]
    heads = ["No.", "Thruster", ">Position m", ">Direction", "Curve", ">Lag ms"]
    return section(
        "vehicle",
        "The vehicle",
        told,
        grid(drawings, "plans"),
        paragraph(note, "note") if drawings else "",
        table(heads, thrusters)
        if thrusters
        else paragraph("No thrusters are described: forces were recorded.", "note"),
    )


def _row(values: tuple[float, ...]) -> str:
    return escape(signed_list(tuple(float(value) for value in values))).replace("-", "−")


def _kind(thruster: Thruster) -> str:
    return str(thruster.curve.kind)
