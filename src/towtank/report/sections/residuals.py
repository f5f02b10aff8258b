"""What the errors of the prediction are: their autocorrelation within bounds, and a verdict in words."""

from __future__ import annotations

from collections.abc import Mapping

from towtank.digits import measured, short
from towtank.recording.standard import STANDARD
from towtank.report.chart import Band, Chart, Stem, chart_svg
from towtank.report.elements import Cell, bullets, cell, figure, grid, number, paragraph, section, table, unit_text
from towtank.report.verdict import NAMES
from towtank.validation import Residual
from towtank.validation.verdicts import CHANCE

__all__ = ["residual_section"]


def residual_section(residuals: Mapping[str, Residual], key: str = "") -> str:
    """Return it; nothing where there are no errors to look at. key: of the JSON document, where they stand in it."""
    if not residuals:
        return ""
    note = (
        "Autocorrelation of the errors one step ahead, that is of what is left when their slow part is taken out. "
        "Within the grey band they are white noise of the sensor; beyond it, at many lags, something is missing in the "
        "model of motion or noise. p: how probable so much is if they are white."
    )
    return section(
        "residuals",
        "What the errors are",
        bullets(one.verdict.text for one in residuals.values()),
        _table(residuals, key),
        paragraph(note, "note"),
        grid((_figure(one) for one in residuals.values()), "small"),
    )


def _table(residuals: Mapping[str, Residual], key: str) -> str:
    rows: list[list[Cell]] = []
    for name, one in residuals.items():
        place = f"{key}/{name}" if key else ""

        def shown(value: float | None, text: str | None = None, field: str = "", place: str = place) -> str:
            return number(value, text, key=f"{place}/{field}" if place and field else "")

        memory = one.memory
        time, spread = ("–", "") if one.time is None else measured(one.time, one.time_std)
        lasts = shown(one.time, time, "correlation_time_s")
        lasts += f" ± {shown(one.time_std, spread, 'correlation_time_std_s')}" if one.time is not None else ""
        slow = None if memory is None or one.time is None else memory.slow
        white = None if memory is None else memory.white
        bias = None if memory is None else memory.bias
        rows.append(
            [
                cell(f"{name}<small>{NAMES[name]}</small>", "name"),
                cell(shown(one.samples, f"{one.samples}", "samples"), "n"),
                cell(lasts, "n"),
                cell(shown(slow, short(slow, 2), "slow"), "n"),
                cell(shown(white, short(white, 2), "noise"), "n"),
                cell(shown(bias, short(bias, 2), "constant"), "n"),
                cell(unit_text(STANDARD[name].unit), "u"),
                cell(_white(one)),
            ]
        )
    heads = ["Channel", ">Errors", ">Last for s", ">Slow part", ">Noise", ">Constant", "Unit", "One step ahead"]
    return table(heads, rows, style="tight")


def _white(one: Residual) -> str:
    test = one.one_step_test
    if test is None:
        return "–"
    white = test.p >= CHANCE
    return f'<span class="tag {"good" if white else "fair"}">{"white" if white else "coloured"}</span>'


def _figure(one: Residual) -> str:
    found = one.one_step
    if not found.lag.size:
        return ""
    chart = Chart(
        label=f"Autocorrelation of the errors of {NAMES[one.channel]}",
        parts=[Band(found.lag, -found.band, found.band, "bound"), Stem(found.lag, found.value)],
        x_name="s",
        x_range=(0.0, float(found.lag[-1]) * 1.03),
        y_range=_range(one),
        width=330,
        height=150,
    )
    test = one.one_step_test
    p = "" if test is None else f"p {'&lt; 0.001' if test.p < 1e-3 else f'{test.p:.2g}'}"
    return figure(chart_svg(chart), f"{one.channel} <small>{NAMES[one.channel]}</small>", right=p)


def _range(one: Residual) -> tuple[float, float]:
    found = one.one_step
    values = [abs(float(v)) for v in (*found.value, *found.band) if v == v]
    most = max(0.2, min(1.0, 1.15 * max(values, default=1.0)))
    return -most, most
