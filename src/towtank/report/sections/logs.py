"""The quality of the logs: channels, rates, gaps, noise, repairs; and the disturbance that learning saw."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import PurePath

from towtank.digits import short
from towtank.identification.model.terms import AXES
from towtank.printable import escaped
from towtank.recording import Recording
from towtank.recording.axes import known_by, known_text
from towtank.recording.facts import ChannelFacts, channel_facts
from towtank.recording.noise import NoiseLevel, noise_levels
from towtank.report.elements import Cell, bullets, cell, number, paragraph, section, table, unit_text

__all__ = ["log_section"]

_MOST = 6  # logs that are shown in full


def log_section(
    recordings: Sequence[Recording],
    noise: Mapping[str, Mapping[str, object]],
    disturbance: Mapping[str, Mapping[str, object]],
    left_out: Sequence[str] = (),
) -> str:
    """Return what the logs hold and how good it is; first what of them does not count."""
    parts = ["<h3>What counts</h3>", bullets(left_out)] if left_out else []
    parts += [_log(recording) for recording in recordings[:_MOST]]
    if len(recordings) > _MOST:
        parts.append(paragraph(f"{len(recordings) - _MOST} further logs are left out here.", "note"))
    return section("log", "The log and its quality", *parts, _levels(noise, disturbance))


def _log(recording: Recording) -> str:
    name = PurePath(recording.source).name or "recording"
    noise = noise_levels(recording)
    facts = channel_facts(recording)
    rows = [_channel(each, noise.get(each.name)) for each in facts]
    lines = [*recording.repairs.lines, *recording.notes]
    mended = bullets(lines) if lines else paragraph("Nothing had to be repaired.", "note")
    return "".join(
        [
            f"<h3>{escaped(name)}</h3>",
            paragraph(
                f"{short(recording.duration, 5)} s, from {short(recording.start, 6)} to {short(recording.end, 6)} s of "
                f"its own clock; {len(facts)} channels.",
                "note",
            ),
            table(
                ["Channel", "Unit", ">Rate Hz", ">Samples", ">Missing", ">Gaps", ">Noise (std)", ">Least", ">Greatest"],
                rows,
            ),
            paragraph(f"Known: {known_text(known_by(recording))}."),
            mended,
        ]
    )


def _channel(each: ChannelFacts, level: NoiseLevel | None) -> list[Cell]:
    held = each.changes is not None
    return [
        cell(escaped(each.name), "name"),
        cell(unit_text(each.unit), "u"),
        cell(number(each.rate_hz, short(each.rate_hz, 3)), "n"),
        cell(number(each.samples, f"{each.samples}"), "n"),
        cell("held" if held else number(each.missing, f"{each.missing}"), "n"),
        cell("–" if held else number(each.gaps, f"{each.gaps}"), "n"),
        cell(_noise(level), "n"),
        cell(number(each.min, short(each.min, 3)), "n"),
        cell(number(each.max, short(each.max, 3)), "n"),
    ]


def _noise(level: NoiseLevel | None) -> str:
    if level is None or not math.isfinite(level.std):
        return "–"
    if level.dead:
        return "stands still"
    return f"{'' if level.white else '&lt; '}{number(level.std, f'{level.std:.2g}')}"


def _levels(noise: Mapping[str, Mapping[str, object]], disturbance: Mapping[str, Mapping[str, object]]) -> str:
    """Return what learning found of noise and of the force that nothing explains."""
    names = {axis.wrench: axis.name for axis in AXES}
    parts = []
    for title, levels, key, said in (
        ("Disturbance", disturbance, "disturbance", "The random force and moment that the model does not explain: "),
        ("Noise of the sensors, as estimated while learning", noise, "noise", "Standard deviation of one sample: "),
    ):
        items = []
        for name, level in levels.items():
            std = level.get("std")
            if isinstance(std, float) and math.isfinite(std):
                text = number(std, f"{std:.2g}", key=f"{key}/{name}/std")
                items.append(f"{names.get(name, name)} {text} {unit_text(str(level.get('unit', '')))}")
        if items:
            parts.append(f"<h3>{title}</h3><p>{said}{', '.join(items)}.</p>")
    return "".join(parts)
