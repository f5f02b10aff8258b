"""The report on a plan: what will be known, what to drive, where it leads, and what cannot be had, as one HTML page."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import joined
from towtank.identification.model.terms import AXES
from towtank.planning import INSTRUMENTS, Accuracy, Forecast, Plan
from towtank.printable import escaped
from towtank.report.chart import Chart, Line, chart_svg
from towtank.report.elements import Cell, bullets, cell, facts, figure, grid, number, paragraph, section, table
from towtank.report.facts import PlanFacts
from towtank.report.page import page
from towtank.report.plan_drawings import Ellipse, TankView, ellipse_svg, tank_svg, time_line_svg
from towtank.report.sections.origin import footer, origin_section
from towtank.report.sections.vehicle import vehicle_section
from towtank.report.verdict import plan_notes, plan_verdict
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = ["plan_html"]

_PATHS = (
    '<div class="legend"><span><i class="predicted"></i>the middle vehicle, from the ring to the dot</span>'
    '<span><i class="cloud"></i>vehicles that yours may be, pushed about by the water</span>'
    '<span><i class="touch"></i>a wall is touched, by the circle about the vehicle</span>'
    '<span><i class="margin"></i>margin</span></div>'
)
_BLOCKS = (
    '<div class="legend"><span><i class="plus"></i>ahead, to starboard, down; roll to starboard, bow up, turn to '
    'starboard</span><span><i class="minus"></i>the other way</span></div>'
)
_KNOWN = (
    '<div class="legend"><span><i class="bound"></i>before</span><span><i class="estimate"></i>after each segment, the '
    'last one filled</span><span><i class="truth"></i>what is asked</span></div>'
)
_FALLS = (
    '<div class="legend"><span><i class="estimate"></i>total inertia</span><span><i class="error"></i>drag</span>'
    '<span><i class="before"></i>what is asked</span></div>'
)


def plan_html(found: PlanFacts) -> str:
    """Return the report. Pure: the same facts, the same text."""
    made = found.plan
    notes = plan_notes(made)
    sections = [
        section("missing", "What to know before", bullets(notes, "warnings")),
        section("accuracy", "What will be known", paragraph(_TABLE_NOTE, "note"), _table(made)),
        _segment_section(found),
        _known_section(found),
        vehicle_section(found.vehicle),
        origin_section(found.origin),
    ]
    title = found.vehicle.name
    return page("What to drive", title, plan_verdict(made), _sums(made), sections, footer(found.origin))


_TABLE_NOTE = (
    "Deviations, as shares of the coefficient; of an added mass, of the total inertia. Nobody can do better with these "
    "segments. The band holds nine in ten of the vehicles that yours may be."
)


def _sums(made: Plan) -> list[tuple[str, str]]:
    many = len(made.segments)
    pauses = f" and {made.pause * (many - 1):g} s of pauses" if many > 1 else ""
    size = "" if made.space is None else " × ".join(f"{each:g}" for each in made.space.size) + " m"
    return [
        ("Manoeuvring", f"{number(made.manoeuvring, f'{made.manoeuvring:g}', key='manoeuvring_s')} s{pauses}"),
        ("Water", size or "open water"),
        ("Ends at a wall, if nobody steers", _share(made.leaves, "leaves", 0) if made.space is not None else ""),
        ("Measured by", escaped(INSTRUMENTS[made.sensors].summary)),
    ]


def _share(value: float, key: str, places: int = 1) -> str:
    return f"{number(value, f'{100.0 * value:.{places}f}', key=key)} %"


def _table(made: Plan) -> str:
    rows: list[Sequence[Cell]] = []
    for each in made.expected:
        place = f"expected/{each.name}"
        band = f"{_share(each.low, f'{place}/low').removesuffix(' %')} to {_share(each.high, f'{place}/high')}"
        rows.append(
            [
                cell(escaped(each.name), "name"),
                cell(_share(each.before, f"{place}/before", 0), "n"),
                cell(f"<b>{_share(each.after, f'{place}/after')}</b>", "n"),
                cell(band, "n"),
                cell(_bar(each, made.accuracy)),
                cell(_outcome(each)),
            ]
        )
    return table(["Coefficient", ">Now", ">Then", ">Nine in ten", "", "Known well enough"], rows)


def _bar(each: Accuracy, accuracy: float) -> str:
    """Return the band and the deviation on a scale of twice what is asked, with a mark at what is asked."""
    low, high, then = (50.0 * min(value / accuracy, 2.0) for value in (each.low, each.high, each.after))
    return (
        f'<svg viewBox="0 0 100 10" class="reach" preserveAspectRatio="none" aria-hidden="true">'
        '<rect class="back" width="100" height="10"/>'
        f'<rect class="range" x="{low:.1f}" width="{max(high - low, 1.0):.1f}" height="10"/>'
        f'<rect class="then" x="{min(then, 98.5):.1f}" width="1.5" height="10"/>'
        '<rect class="limit" x="49.5" width="1" height="10"/></svg>'
    )


def _outcome(each: Accuracy) -> str:
    if not each.reason:
        return '<span class="tag good">yes</span>'
    kind = "fair" if np.isfinite(each.needs) else "poor"
    return f'<span class="tag {kind}">no</span> <small class="why">{escaped(each.reason)}</small>'


def _segment_section(page: PlanFacts) -> str:
    made = page.plan
    parts = [paragraph(_driving(made), "note"), _PATHS, _BLOCKS]
    for k, each in enumerate(made.segments):
        segment = each.segment
        view = TankView(page.steps[k].eta[:, :3], page.drawn.paths[k], made.space, page.drawn.radius)
        paths = figure(
            tank_svg(view, f"Paths of segment {k + 1} from above and from the side"),
            "Where it leads <small>from above, and from the side</small>",
        )
        line = figure(time_line_svg(segment, f"What each axis is asked in segment {k + 1}"), "What each axis is asked")
        title = f"Segment {k + 1}: {segment.axes}, {segment.duration:g} s"
        parts += [f"<h3>{escaped(title)}</h3>", grid([paths, f"<div>{line}{_facts(page, k)}</div>"], "pair")]
        if k < len(made.segments) - 1:
            parts.append(f'<p class="pause">{escaped(_bring(made))}</p>')
    return section("segments", "What to drive", *parts)


def _facts(page: PlanFacts, k: int) -> str:
    """Return what a segment is, and what is known after it."""
    made, each = page.plan, page.plan.segments[k]
    names = [one.name for one in made.expected]
    known = int((page.steps[k].relative(names) <= made.accuracy).sum())
    reached = ", ".join(
        f"{number(value, f'{value:.1f}', key=f'segments/{k}/reached_m/{i}')} m {way}"
        for i, (value, way) in enumerate(zip(each.reached, ("along x", "along y", "in depth"), strict=True))
    )
    leaves = _share(each.leaves, f"segments/{k}/leaves", 0)
    return facts(
        [
            ("Form", escaped(each.segment.form)),
            ("Moves off its start", reached),
            ("Ends at a wall", f"in {leaves} of cases, if nobody steers" if made.space is not None else ""),
            ("Known after it", f"{known} of {len(names)} to {100.0 * made.accuracy:g} %"),
        ]
    )


def _driving(made: Plan) -> str:
    where = "where you like" if made.space is None else "at the start"
    rest = f"Each segment begins at rest, level, {where}."
    if made.space is None:
        return f"{rest} Axes are those of the body."
    if not made.pose:
        return (
            f"{rest} Nobody knows where the vehicle is while it is driven, so nothing keeps it off the walls but you: "
            f"segments are short and gentle, and {made.pause:g} s are planned to bring it back."
        )
    return f"{rest} The pilot, or the guard of a program, keeps it off the walls; the paths are of nobody steering."


def _bring(made: Plan) -> str:
    back = "" if made.space is None else " to the start"
    return f"Then {made.pause:g} s: bring it back{back}, level and at rest."


def _known_section(found: PlanFacts) -> str:
    """Return ellipses and how deviations fall, axis by axis."""
    names = [each.name for each in found.plan.expected]
    ellipses, falls = [], []
    stages = [found.before, *found.steps]
    seconds = np.cumsum([0.0, *(each.segment.duration for each in found.plan.segments)])
    for axis in AXES:
        row, column = ROWS[axis.index], COLUMNS[axis.index]
        inertia = f"{row}_{column}dot"
        drag = next((name for name in (f"{row}_{column * 2}", f"{row}_{column}") if name in names), "")
        if inertia in names and drag:
            pairs = [_pair(each, (inertia, drag)) for each in stages]
            styles = ["bound", *["after"] * (len(pairs) - 2), "last"]
            drawn = [Ellipse(pair, style) for pair, style in zip(pairs, styles, strict=True)]
            label = f"What is known of {inertia} and {drag} before and after each segment"
            svg = ellipse_svg(drawn, found.plan.accuracy, ("total inertia", drag), label)
            ellipses.append(figure(svg, f"{axis.name.capitalize()} <small>{inertia} and {drag}</small>"))
        own = [(name, style) for name, style in ((inertia, "estimate"), (drag, "error")) if name in names]
        if own and len(stages) > 2:
            lines = [Line(seconds, _fall(stages, name), style) for name, style in own]
            asked = 100.0 * found.plan.accuracy
            chart = Chart(
                f"How the deviations of {joined([name for name, _ in own])} fall",
                lines,
                "s",
                y_range=(0.0, 1.08 * max(float(line.y.max()) for line in lines)),
                levels=[(asked, "before")],
                cuts=seconds[1:-1].tolist(),
            )
            falls.append(figure(chart_svg(chart), f"{axis.name.capitalize()}, deviations in %"))
    note = (
        "Ellipses hold 95 % of what is possible of an axis' total inertia and drag, in percent of them. A narrow one "
        "that leans tells a combination better than each by itself. Where less was known before than the frame shows, "
        "grey fills it."
    )
    return section(
        "known",
        "How well it will be known",
        paragraph(note, "note") if ellipses else "",
        _KNOWN if ellipses else "",
        grid(ellipses, "small"),
        "<h3>Segment by segment</h3>" if falls else "",
        _FALLS if falls else "",
        grid(falls, "small"),
    )


def _pair(found: Forecast, names: tuple[str, str]) -> Array:
    """Return the covariance (2, 2) of two coefficients as shares of their size."""
    rows = [found.names.index(name) for name in names]
    scale = np.array([found.quantities[name] for name in names])
    return np.asarray(found.covariance[np.ix_(rows, rows)] / np.outer(scale, scale))


def _fall(stages: Sequence[Forecast], name: str) -> Array:
    return np.array([100.0 * float(each.relative([name])[0]) for each in stages])
