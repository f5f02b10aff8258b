"""The vehicle as it was known: body, buoyancy, source, and thrusters drawn from above and from the side."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import short, signed_list
from towtank.printable import escaped
from towtank.report.elements import cell, facts, figure, grid, paragraph, section, table
from towtank.vehicle import Thruster, Vehicle

__all__ = ["thrusters_svg", "vehicle_section"]

_SIZE, _MARGIN, _ARROW = 320, 70, 38


def thrusters_svg(vehicle: Vehicle) -> list[tuple[str, str]]:
    """Return pairs of a caption and an `<svg>`, one for each view; none where the vehicle has no thrusters."""
    if not vehicle.thrusters:
        return []
    position = np.array([thruster.position for thruster in vehicle.thrusters])
    direction = np.array([thruster.direction for thruster in vehicle.thrusters])
    centre = np.array(vehicle.rigid_body.centre_of_gravity)
    above = _view("from above", _above(position), _above(direction), -direction[:, 2], _above(centre), vehicle)
    side = _view("from starboard", _side(position), _side(direction), direction[:, 1], _side(centre), vehicle)
    return [("From above: bow up, starboard to the right", above), ("From starboard: bow to the right", side)]


def _above(vectors: Array) -> Array:
    """Return body vectors (.., 3) as the page has them from above: right, down."""
    return np.stack([vectors[..., 1], -vectors[..., 0]], axis=-1)


def _side(vectors: Array) -> Array:
    """Return them as seen from starboard."""
    return np.stack([vectors[..., 0], vectors[..., 2]], axis=-1)


def _view(name: str, position: Array, direction: Array, nearer: Array, centre: Array, vehicle: Vehicle) -> str:
    """Draw one view. nearer: share (n,) of each direction that points at the reader."""
    points = np.vstack([position, centre[None], np.zeros((1, 2))])
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    spread = np.ptp(points, axis=0)
    scale = (_SIZE - 2 * _MARGIN) / (float(spread.max()) or 0.1)
    width, height = _SIZE, max(2 * _MARGIN, float(spread[1]) * scale + 2 * _MARGIN)

    def place(point: Array) -> tuple[float, float]:
        x, y = (point - middle) * scale + 0.5 * np.array([width, height])
        return float(x), float(y)

    low, high = place(points.min(axis=0)), place(points.max(axis=0))
    out = [
        f'<svg class="plan" viewBox="0 0 {width} {height:.0f}" role="img" '
        f'aria-label="Thrusters of {escaped(vehicle.name)} {name}">',
        f'<rect class="hull" x="{low[0] - 22:.1f}" y="{low[1] - 22:.1f}" width="{high[0] - low[0] + 44:.1f}" '
        f'height="{high[1] - low[1] + 44:.1f}" rx="22"/>',
    ]
    x, y = place(centre)
    out.append(f'<path class="cg" d="M{x - 6:.1f} {y:.1f}h12M{x:.1f} {y - 6:.1f}v12"/>')
    seen: dict[tuple[int, int], list[int]] = {}
    for k, point in enumerate(position):
        seen.setdefault((round(place(point)[0] / 8), round(place(point)[1] / 8)), []).append(k)
    for group in seen.values():
        for k in group:
            out += _arrow(*place(position[k]), direction[k], float(nearer[k]), 3.5 * (2 * len(group) - 2))
        x, y = place(position[group[0]])
        numbers = ", ".join(str(k + 1) for k in group)
        hub = 14 + 7 * max(len(numbers) - 1, 0)
        out.append(f'<rect class="hub" x="{x - hub / 2:.1f}" y="{y - 8:.1f}" width="{hub}" height="16" rx="8"/>')
        names = ", ".join(f"{k + 1} {vehicle.thrusters[k].name}" for k in group)
        out.append(
            f'<text class="hubtext" x="{x:.1f}" y="{y + 3.5:.1f}">{numbers}<title>{escaped(names)}</title></text>'
        )
    return "".join([*out, "</svg>"])


def _arrow(x: float, y: float, direction: Array, nearer: float, wide: float) -> list[str]:
    """Draw the push; a ring where it goes along the line of sight, with a dot towards the reader, a cross away.

    wide: what the number in the middle takes more than one digit's room, to either side.
    """
    flat = float(np.hypot(*direction))
    if flat < 0.25:
        mark = (
            f'<circle class="dot" cx="{x + 15 + wide:.1f}" cy="{y - 15:.1f}" r="1.8"/>'
            if nearer > 0.0
            else f'<path class="away" d="M{x + 12 + wide:.1f} {y - 18:.1f}l6 6m0 -6l-6 6"/>'
        )
        return [f'<circle class="ring" cx="{x + 15 + wide:.1f}" cy="{y - 15:.1f}" r="6"/>', mark]
    dx, dy = float(direction[0]) * (_ARROW + wide), float(direction[1]) * _ARROW
    ux, uy = dx / np.hypot(dx, dy), dy / np.hypot(dx, dy)
    ex, ey = x + dx, y + dy
    head = f"M{ex - 7 * ux - 4 * uy:.1f} {ey - 7 * uy + 4 * ux:.1f}L{ex:.1f} {ey:.1f}"
    head += f"L{ex - 7 * ux + 4 * uy:.1f} {ey - 7 * uy - 4 * ux:.1f}"
    return [f'<path class="push" d="M{x:.1f} {y:.1f}L{ex:.1f} {ey:.1f}{head}"/>']


def vehicle_section(vehicle: Vehicle) -> str:
    """Return what the vehicle file says of everything that was not learned."""
    body = vehicle.rigid_body
    inertia = body.inertia if isinstance(body.inertia[0], float) else tuple(body.tensor.diagonal())
    properties = facts(
        [
            ("Description", escaped(vehicle.description)),
            ("Mass", f"{short(body.mass)} kg (weight {short(vehicle.weight)} N)"),
            ("Inertia about the centre of gravity", f"{_row(inertia)} kg m²"),
            ("Centre of gravity", f"{_row(body.centre_of_gravity)} m"),
            ("Buoyancy", f"{short(vehicle.buoyant_force)} N at {_row(vehicle.buoyancy.centre)} m"),
            ("Source", escaped(vehicle.provenance.source)),
            ("Notes", escaped(" ".join(vehicle.provenance.notes))),
        ]
    )
    drawings = [figure(svg, escaped(caption)) for caption, svg in thrusters_svg(vehicle)]
    note = (
        "An arrow is the push at positive command; a ring with a dot pushes towards the reader, one with a cross away. "
        "The cross in the middle is the centre of gravity; the outline is not the hull's. Axes: x forward, y "
        "starboard, z down."
    )
    thrusters = [
        [
            cell(f"{k}"),
            cell(escaped(each.name), "name"),
            cell(_row(each.position), "n"),
            cell(_row(each.direction), "n"),
            cell(escaped(_kind(each))),
            cell(short(1e3 * each.time_constant) if each.time_constant else "–", "n"),
        ]
        for k, each in enumerate(vehicle.thrusters, 1)
    ]
    heads = ["No.", "Thruster", ">Position m", ">Direction", "Curve", ">Lag ms"]
    return section(
        "vehicle",
        "The vehicle",
        properties,
        grid(drawings, "plans"),
        paragraph(note, "note") if drawings else "",
        table(heads, thrusters)
        if thrusters
        else paragraph("No thrusters are described: forces were recorded.", "note"),
    )


def _row(values: tuple[float, ...]) -> str:
    return escaped(signed_list(tuple(float(value) for value in values))).replace("-", "−")


def _kind(thruster: Thruster) -> str:
    return str(thruster.curve.kind)
