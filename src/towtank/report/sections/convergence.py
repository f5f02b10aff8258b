"""How each coefficient and its band settled over the log."""

from __future__ import annotations

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import measured
from towtank.identification.posterior.estimate import Learned
from towtank.report.chart import Band, Chart, Line, Point, chart_svg
from towtank.report.elements import figure, grid, paragraph, section, unit_text
from towtank.report.facts import LearnFacts

__all__ = ["convergence_section"]

_WIDTH = 1.959963984540054  # of the 95 % band, in deviations
_SETTLING = 0.25  # share of the log that may lie outside the picture
_METHODS = {
    "joint": "the joint filter's",
    "output-error": "the joint filter's; the result comes from free runs and may lie beside it",
    "paper": "that of plain least squares at the delay found; in the result, instruments have removed its bias, "
    "and the interval includes the uncertainty of the delay",
}


def convergence_section(facts: LearnFacts) -> str:
    """Return a chart for each coefficient; nothing where its course is not known."""
    curve = facts.convergence
    if curve is None or curve.t.size < 2:
        return ""
    figures = [_figure(facts, facts.estimate[name], k) for k, name in enumerate(curve.names)]
    cuts = " Vertical lines: from one log to the next." if curve.ends else ""
    cuts += " Vertical lines: the vehicle changed." if _changes(facts) else ""
    note = (
        f"Estimate and 95 % band over the time of the log, wide at the start. The course is "
        f"{_METHODS.get(facts.method, 'the filter’s')}. The dot at the right is the result in the table with its 95 % "
        f"interval. Where the band still narrows at the end, a longer log would tell more.{cuts}"
    )
    legend = (
        '<div class="legend"><span><i class="estimate"></i>estimate</span><span><i class="band"></i>95 % band</span>'
    )
    legend += '<span><i class="result"></i>result</span>'
    legend += '<span><i class="truth"></i>truth</span>' if facts.truth is not None else ""
    legend += '<span><i class="before"></i>before</span></div>'
    return section("convergence", "How the estimates settled", paragraph(note, "note"), legend, grid(figures, "small"))


def _changes(facts: LearnFacts) -> list[float]:
    """Return when the vehicle became another one [s]."""
    return [event.t for event in facts.events if event.kind in ("change", "thruster")]


def _figure(facts: LearnFacts, result: Learned, k: int) -> str:
    curve = facts.convergence
    if curve is None:
        return ""
    value, std = curve.values[:, k], curve.std[:, k]
    low, high = value - _WIDTH * std, value + _WIDTH * std
    end = float(curve.t[-1])
    levels = [(facts.vehicle.coefficient(result.name), "before")]
    truth, steps = None if facts.truth is None else facts.truth.coefficient(result.name), []
    if truth is not None and facts.truth_before is not None:
        when, earlier = facts.truth_before
        first = earlier.coefficient(result.name)
        x, y = np.array([curve.t[0], when, when, end]), np.array([first, first, truth, truth])
        steps = [Line(x, y, "truth")]
    elif truth is not None:
        levels.append((truth, "truth"))
    spread = _WIDTH * result.std
    chart = Chart(
        label=f"{result.name} over time",
        parts=[
            Band(curve.t, low, high),
            *steps,
            Line(curve.t, value, "estimate"),
            Point(end, result.value, result.value - spread, result.value + spread),
        ],
        x_name="s",
        x_range=(0.0, 1.02 * end),
        y_range=_range(curve.t, low, high, result, [] if truth is None else [truth]),
        levels=levels,
        cuts=(*curve.ends, *_changes(facts)),
        width=330,
        height=180,
    )
    number, deviation = measured(result.value, result.std)
    right = f"{number} ± {deviation}".replace("-", "−") + f" {unit_text(result.unit)}"
    return figure(chart_svg(chart), result.name, right=right)


def _range(t: Array, low: Array, high: Array, result: Learned, levels: list[float]) -> tuple[float, float]:
    """Return what to show: the settled part of the course, the result, and the truth."""
    late = t >= _SETTLING * float(t[-1])
    spread = _WIDTH * result.std
    shown = np.concatenate([low[late], high[late], [result.value - spread, result.value + spread], levels])
    shown = shown[np.isfinite(shown)]
    a, b = float(shown.min()), float(shown.max())
    room = 0.12 * (b - a) or 0.1 * abs(a) or 1.0
    return a - room, b + room
