"""The report on what was learned, as one HTML page."""

from __future__ import annotations

from dataclasses import replace

from towtank.digits import short
from towtank.report.elements import bullets, number, section
from towtank.report.facts import LearnFacts
from towtank.report.page import page
from towtank.report.sections.coefficients import coefficient_section, held_section
from towtank.report.sections.convergence import convergence_section
from towtank.report.sections.events import event_section
from towtank.report.sections.identifiability import identifiability_section
from towtank.report.sections.logs import log_section
from towtank.report.sections.origin import footer, origin_section
from towtank.report.sections.prediction import fit_tiles, prediction_section
from towtank.report.sections.residuals import residual_section
from towtank.report.sections.thrusters import input_section
from towtank.report.sections.vehicle import vehicle_section
from towtank.report.verdict import learn_verdict

__all__ = ["report_html"]

METHODS = {
    "joint": "joint filter",
    "output-error": "output error",
    "paper": "filtered regressors",
}


def report_html(facts: LearnFacts) -> str:
    """Return the report; parts that there is nothing to say of are left out. Pure: the same facts, the same text."""
    sections = [
        section("findings", "What cannot be right", bullets([each.text for each in facts.findings], "warnings")),
        section("warnings", "Warnings", bullets(facts.warnings, "warnings")),
        coefficient_section(facts),
        held_section(facts),
        event_section(facts.events, facts.epoch),
        prediction_section(facts.predictions, facts.fit, facts.rmse, facts.predicted),
        residual_section(facts.residuals),
        convergence_section(facts),
        identifiability_section(facts.estimate),
        input_section(facts),
        log_section(facts.recordings, facts.noise, facts.disturbance, facts.left_out),
        vehicle_section(facts.vehicle),
        section("how", "How it was learned", bullets(facts.remarks)),
        origin_section(facts.origin),
    ]
    verdict = learn_verdict(facts.estimate, facts.fit, facts.predicted, facts.findings, facts.driven, facts.use)
    verdict = replace(verdict, text=facts.verdict) if facts.verdict else verdict
    return page(
        "What was learned", facts.title or facts.vehicle.name, verdict, _sums(facts), sections, footer(facts.origin)
    )


def _sums(facts: LearnFacts) -> list[tuple[str, str]]:
    estimate = facts.estimate
    identified = sum(estimate.identified)
    delay = "" if facts.delay != facts.delay else f"{number(facts.delay, f'{1e3 * facts.delay:.1f}', key='delay_s')} ms"
    return [
        ("Coefficients learned", f"{identified} of {len(estimate.names)}"),
        ("Learned from", f"{number(estimate.duration, short(estimate.duration, 5), key='duration_s')} s"),
        ("Samples", number(estimate.samples, f"{estimate.samples}", key="samples")),
        ("Delay", delay),
        *fit_tiles(facts.fit, facts.use),
        ("Method", METHODS.get(facts.method, facts.method)),
    ]
