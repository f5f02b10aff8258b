"""The coefficients: what was learned, how sure, what it was before; and what was not learned, and why."""

from __future__ import annotations

import math

from towtank.digits import measured, short
from towtank.identification.posterior.estimate import Learned
from towtank.intervals import interval
from towtank.printable import escaped
from towtank.report.elements import Cell, cell, number, number_and_std, paragraph, section, sentence, table, unit_text
from towtank.report.facts import LearnFacts
from towtank.report.verdict import state_of
from towtank.vehicle import Vehicle
from towtank.vehicle.names import describe

__all__ = ["coefficient_section", "held_section", "words_for"]

_INTERVAL = "Value ± one standard deviation; in 95 of 100 cases the interval holds the truth"
_KNOWN = "Known: to 10 % or better; roughly known: to 50 %."


def coefficient_section(facts: LearnFacts) -> str:
    """Return the table of what was learned, and of the inertias as they move the vehicle."""
    learned = [each for each in facts.estimate.coefficients if each.identified]
    if not learned:
        return section("coefficients", "Coefficients", paragraph("No coefficient could be identified from this log."))
    head = ["Coefficient", ">Value", ">± std", ">95 % interval"]
    before = ">Prior" if facts.supposed else ">Before"
    head += [before] if facts.truth is None else [">Truth", ">Off by"]
    rows = [_row(each, facts) for each in learned]
    return section(
        "coefficients",
        "Coefficients",
        table([*head, "Unit", "Verdict"], rows),
        paragraph(_caption(facts), "note"),
        _sums(facts),
    )


def _caption(facts: LearnFacts) -> str:
    if facts.truth is not None:
        return f"{_INTERVAL}, which is the simulator's here. Off by: the error in standard deviations. {_KNOWN}"
    before = (
        "“Prior” is what was supposed before any data, by the vehicle file or by the size of the body"
        if facts.supposed
        else "“Before” is what the vehicle file said"
    )
    return f"{_INTERVAL}. {before}. {_KNOWN}"


def words_for(name: str) -> str:
    """Return the physical meaning of a coefficient."""
    words = describe(name)
    return words[0].upper() + words[1:]


def _row(each: Learned, facts: LearnFacts) -> list[Cell]:
    key = f"coefficients/{each.name}"
    value, std = number_and_std(each.value, each.std, key)
    word, grade = state_of(each)
    if facts.truth is None:
        supposed = facts.supposed.get(each.name)
        before = _before(facts.vehicle, each.name) if supposed is None else _prior(*supposed, key)
        beside = [cell(before, "n")]
    else:
        true = facts.truth.coefficient(each.name)
        beside = [cell(number(true), "n"), cell(_off(each.value, true, each.std), "n")]
    return [
        _name(each.name),
        cell(value, "n"),
        cell(std, "n"),
        cell(_interval(each.value, each.std, key), "n"),
        *beside,
        cell(unit_text(each.unit), "u"),
        cell(f'<span class="tag {grade}">{word}</span>'),
    ]


def _name(name: str) -> Cell:
    return cell(f"{escaped(name)}<small>{escaped(words_for(name))}</small>", "name")


def _off(value: float, truth: float, std: float) -> str:
    away = f"{abs(value - truth) / std:.1f} std" if std > 0.0 else "–"
    return f"{escaped(away)}"


def _prior(value: float, std: float, key: str) -> str:
    mean = number(value, short(value, 2), key=f"{key}/prior/value")
    return f"{mean} ± {number(std, short(std, 2), key=f'{key}/prior/std')}"


def _before(vehicle: Vehicle, name: str) -> str:
    std = vehicle.deviation(name)
    if std:
        value, spread = measured(vehicle.coefficient(name), std)
        return f"{escaped(value)} ± {escaped(spread)}".replace("-", "−")
    return number(vehicle.coefficient(name))


def _interval(value: float, std: float, key: str) -> str:
    bounds = interval(value, std)
    if bounds is None:
        return number(None)
    low, high = (number(bound, measured(bound, std)[0], key=f"{key}/interval/{k}") for k, bound in enumerate(bounds))
    return f"{low} … {high}"


def _sums(facts: LearnFacts) -> str:
    if not facts.estimate.sums:
        return ""
    rows = []
    for total in facts.estimate.sums:
        key = f"sums/{total.name}"
        value, std = number_and_std(total.value, total.std, key)
        interval_html = _interval(total.value, total.std, key)
        rows.append(
            [
                cell(escaped(total.name.replace(" - ", " − ")), "name"),
                cell(value, "n"),
                cell(std, "n"),
                cell(interval_html, "n"),
                cell(unit_text(total.unit), "u"),
            ]
        )
    note = (
        "Body and surrounding water move as one, so motion tells only the sum of rigid-body and added inertia. The sum "
        "is what is known; the added part above is the sum less the vehicle file's rigid body."
    )
    return (
        "<h3>Inertias as they move the vehicle</h3>"
        + table(["Sum", ">Value", ">± std", ">95 % interval", "Unit"], rows)
        + paragraph(note, "note")
    )


def held_section(facts: LearnFacts) -> str:
    """Return what was not learned, by the reason, with the value that the model keeps."""
    groups: dict[str, list[Learned]] = {}
    for each in facts.estimate.coefficients:
        if not each.identified:
            groups.setdefault(each.reason or "no reason given", []).append(each)
    if not groups:
        return ""
    rows: list[list[Cell]] = []
    for reason, members in groups.items():
        rows.append([cell(sentence(reason))])
        for each in members:
            word, grade = state_of(each)
            value = each.value if math.isfinite(each.value) else None
            rows.append(
                [
                    _name(each.name),
                    cell(number(value, short(value), key=f"coefficients/{each.name}/value"), "n"),
                    cell(unit_text(each.unit), "u"),
                    cell(f'<span class="tag {grade}">{word}</span>'),
                ]
            )
    note = (
        "The log says little about these. The model has them all the same, with values near those of the prior."
        if facts.supposed
        else "The model keeps the vehicle file's values for these, or zero where another coefficient stands for them."
    )
    return section(
        "held",
        "Not learned, and why",
        paragraph(note, "note"),
        table(["Coefficient", ">In the model", "Unit", "Verdict"], rows),
    )
