"""Configurations and what differs between them, as tables, words and documents."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from towtank.app.terminal.output import Output
from towtank.digits import measured, short
from towtank.vehicle.configurations import Configuration
from towtank.vehicle.differences import Difference, Differences, differences

__all__ = [
    "comparison_document",
    "configuration_document",
    "in_words",
    "list_document",
    "show_comparison",
    "show_configuration",
    "show_list",
]

_NAMED = 3  # differences that the list names
_EDITED = "changed since it was saved"


def in_words(one: Difference) -> str:
    """Return a difference as `heave inertia +2.1 ± 0.3 kg (7 std)`."""
    if one.std is None or one.deviations is None:
        return f"{one.text} {_signed(one.difference)} {one.unit} (no std)"
    value, spread = measured(one.difference, one.std)
    sign = "" if value.startswith("-") else "+"
    return f"{one.text} {sign}{value} ± {spread} {one.unit} ({_deviations(one.deviations)} std)"


def _signed(value: float) -> str:
    return f"{'+' if value >= 0.0 else ''}{short(value)}"


def _deviations(value: float) -> str:
    return f"{value:.0f}" if value >= 9.5 else f"{value:.1f}"


def show_list(folder: Path, found: Sequence[Configuration], output: Output) -> None:
    """Print all configurations, then what differs most from the first."""
    if not found:
        output.line(f"no configurations in {folder}")
        output.line('Next: towtank config save MODEL.toml --name "with gripper"', "dim")
        return
    table = output.table("Name", "Vehicle", "Saved (UTC)", "Note", wrap="Note")
    for each in found:
        note = f"{each.note} [{_EDITED}]".strip() if each.changed else each.note
        table.add_row(_cut(each.name, 28), _cut(each.vehicle.name, 16), _when(each), note)
    output.show(table)
    if len(found) > 1:
        output.heading(f"What differs most from {found[0].name}")
        for each in found[1:]:
            output.item(f"{each.name}: {_largest(differences(found[0].vehicle, each.vehicle))}")


def _largest(found: Differences) -> str:
    phrases = [in_words(one) for one in found.largest[:_NAMED]]
    return "; ".join(phrases) if phrases else "nothing"


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else f"{text[: width - 1]}…"


def _when(each: Configuration) -> str:
    return "-" if each.saved is None else f"{each.saved:%Y-%m-%d %H:%M}"


def show_configuration(found: Configuration, output: Output) -> None:
    """Print what the index knows of one configuration."""
    output.line(f'Configuration "{found.name}"', "bold")
    if found.note:
        output.line(found.note)
    version = f" by towtank {found.version}" if found.version else ""
    saved = f"saved {_when(found)} UTC{version}" if found.saved else "not saved by towtank config"
    output.line(f"{found.path}, {saved}{f'; {_EDITED}' if found.changed else ''}")
    for log in found.logs:
        output.item(f"{log.name} (SHA-256 {log.sha256[:16]})")
    output.line()


def show_comparison(base: Configuration, other: Configuration, found: Differences, output: Output) -> None:
    """Print all quantities of two configurations and, in words, what really differs."""
    output.heading(f'"{other.name}" (B) beside "{base.name}" (A)')
    shown = [one for one in found.quantities if one.difference != 0.0 or one.std is not None]
    same = [one.name for one in found.quantities if one not in shown]
    if shown:
        table = output.table("Quantity", ">A", ">± std", ">B", ">± std", ">B - A", ">in std", "Unit")
        for one in shown:
            values = (*measured(one.base, one.base_std), *measured(one.other, one.other_std))
            away = "-" if one.deviations is None else f"{_deviations(one.deviations)}{'*' if one.significant else ' '}"
            table.add_row(one.name, *values, _signed(one.difference) if one.difference else "0", away, one.unit)
        output.show(table)
        if any(one.significant for one in shown):
            output.line("M_X .. M_N: total inertias; *: more than three standard deviations", "dim")
        output.line()
    if same:
        output.item(f"the same in both, without a std: {' '.join(same)}")
    for text in _verdict(found):
        output.item(text)


def _verdict(found: Differences) -> list[str]:
    sure = [one for one in found.largest if one.significant]
    lines = [in_words(one) for one in sure]
    unsure = [one.text for one in found.largest if one.significant is None]
    if found.p is None:
        lines.append("no coefficient bears a std, so that nothing can be said of significance")
    else:
        chance = f"p = {found.p:.2g}" if found.p >= 1e-6 else "p < 1e-6"
        statistics = f"chi-square {short(found.chi_square, 3)} on {found.degrees}, {chance}"
        verdict = (
            "all together they differ significantly" if found.significant else "all together no significant difference"
        )
        lines.append(f"{verdict} ({statistics})")
    if unsure and found.p is not None:
        lines.append(f"no std, so no verdict: {', '.join(unsure)}")
    return lines


def configuration_document(found: Configuration) -> dict[str, Any]:
    """Return what the index knows of one configuration."""
    return {
        "name": found.name,
        "file": found.path,
        "base": found.vehicle.name,
        "note": found.note,
        "saved": None if found.saved is None else found.saved.isoformat(),
        "sha256": found.sha256,
        "changed": found.changed,
        "logs": [log.model_dump() for log in found.logs],
        "towtank": found.version,
    }


def list_document(folder: Path, found: Sequence[Configuration]) -> dict[str, Any]:
    """Return the document of the list."""
    entries = []
    for each in found:
        entry = configuration_document(each)
        largest = differences(found[0].vehicle, each.vehicle).largest[:_NAMED]
        entries.append({**entry, "differs_most": [_difference_document(one) for one in largest]})
    return {"folder": folder, "configurations": entries}


def comparison_document(base: Configuration, found: Sequence[tuple[Configuration, Differences]]) -> dict[str, Any]:
    """Return the document of a comparison."""
    return {
        "base": configuration_document(base),
        "comparisons": [
            {
                "other": configuration_document(other),
                "quantities": {one.name: _difference_document(one) for one in each.quantities},
                "chi_square": each.chi_square,
                "degrees": each.degrees,
                "p": each.p,
                "significant": each.significant,
                "text": _verdict(each),
            }
            for other, each in found
        ],
    }


def _difference_document(one: Difference) -> dict[str, Any]:
    return {
        "name": one.name,
        "text": one.text,
        "unit": one.unit,
        "base": one.base,
        "base_std": one.base_std,
        "other": one.other,
        "other_std": one.other_std,
        "difference": one.difference,
        "std": one.std,
        "deviations": one.deviations,
        "significant": one.significant,
    }
