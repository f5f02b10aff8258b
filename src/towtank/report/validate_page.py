"""The report on how well a model predicts, as one HTML page."""

from __future__ import annotations

from towtank.digits import short
from towtank.report.elements import bullets, number, paragraph, section
from towtank.report.facts import ValidateFacts
from towtank.report.page import page
from towtank.report.sections.comparison import comparison_section, fold_section
from towtank.report.sections.logs import log_section
from towtank.report.sections.origin import footer, origin_section
from towtank.report.sections.prediction import error_section, fit_table, fit_tiles, prediction_figures
from towtank.report.sections.residuals import residual_section
from towtank.report.sections.vehicle import vehicle_section
from towtank.report.verdict import validate_verdict

__all__ = ["validate_html"]


def validate_html(facts: ValidateFacts) -> str:
    """Return the report. Pure: the same facts, the same text."""
    judged = facts.judged
    sections = [
        section("warnings", "Warnings", bullets(facts.warnings, "warnings")),
        section(
            "prediction",
            "Prediction against measurement",
            paragraph(_how(facts), "note"),
            fit_table(judged.fit, judged.rmse),
            prediction_figures(judged.predictions, judged.fit, most=4),
        )
        if any(value is not None for value in judged.fit.values())
        else "",
        comparison_section(facts.comparison),
        fold_section(facts.folds),
        error_section(judged.predictions, facts.horizon),
        residual_section(facts.residuals, "residuals"),
        log_section(facts.recordings, {}, {}, facts.left_out),
        vehicle_section(facts.model),
        origin_section(facts.origin),
    ]
    kinds = [one.verdict.kind for one in facts.residuals.values()]
    verdict = validate_verdict(facts.name, judged.fit, kinds, facts.use, facts.findings)
    return page("How well a model predicts", facts.model.name, verdict, _sums(facts), sections, footer(facts.origin))


def _how(facts: ValidateFacts) -> str:
    if facts.horizon is None:
        restart = "from one measured state on, never corrected"
    else:
        restart = f"set back to the measured state every {short(facts.horizon)} s"
    late = "" if facts.delay is None else f", commands taken to act {1e3 * facts.delay:.4g} ms late"
    whose = "each window by a model that has not seen it" if facts.folds is not None else "the model alone"
    return (
        f"{whose[0].upper()}{whose[1:]}, driven by the commands, {restart}{late}. A fit of 100 % is perfect, 0 % no "
        "better than the mean of the measurement. Measured: grey; predicted: blue."
    )


def _sums(facts: ValidateFacts) -> list[tuple[str, str]]:
    judged = facts.judged
    start, end = judged.window
    window = f"{number(start, short(start, 5), key='window/0')} to {number(end, short(end, 5), key='window/1')} s"
    restart = "none" if facts.horizon is None else f"every {number(facts.horizon, key='horizon_s')} s"
    return [("Window", window), ("Restarts", restart), *fit_tiles(judged.fit, facts.use)]
