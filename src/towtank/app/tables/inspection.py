"""An inspection as tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from towtank.app.inspection import AxisVerdict, Inspection
from towtank.app.tables.free_motion import show_left_out
from towtank.app.tables.learning import disturbance_cells, show_findings
from towtank.app.tables.repairs import show_contents
from towtank.app.terminal.output import Output
from towtank.digits import short
from towtank.identification.model.terms import AXES
from towtank.identification.posterior.wording import surer_together
from towtank.recording.facts import ChannelFacts
from towtank.recording.noise import NoiseLevel
from towtank.recording.standard import EULER

__all__ = ["show_inspection"]

_OUTLIERS = 1e-3


def show_inspection(found: Inspection, output: Output) -> None:
    """Print an inspection."""
    recording = found.recording
    output.line(found.log, "bold")
    output.line(f"{short(recording.duration, 5)} s, {len(found.channels)} channels")
    show_findings(found.findings, output)
    _show_channels(found.channels, found.noise, output)
    show_contents(recording, output)
    show_left_out([found.parts], output)
    lines = (*found.repairs.lines, *recording.notes)
    output.heading("Clock and samples")
    for line in lines or ("nothing to repair",):
        output.item(line)
    output.heading("Delay from command to motion")
    output.line(_delay(found))
    _show_axes(found, output)
    _show_forecast(found, output)
    _show_disturbance(found, output)
    if found.warnings:
        output.heading("Warnings")
        for text in found.warnings:
            output.item(text)
    if found.delay_from == "correlation":
        output.line()
        output.line("With --vehicle VEHICLE the result is by coefficient, and says how well each will be known.", "dim")


def _show_channels(channels: Sequence[ChannelFacts], noise: Mapping[str, NoiseLevel], output: Output) -> None:
    output.line()
    table = output.table("Channel", "Unit", ">Hz", ">Span s", ">Lost", ">Gaps", ">Noise", ">Range", wrap="Range")
    for each in channels:
        held = each.changes is not None
        table.add_row(
            each.name,
            each.unit,
            short(each.rate_hz, 3),
            f"{_seconds(each.start_s)} .. {_seconds(each.end_s)}",
            "held" if held else str(each.missing),
            "-" if held else str(each.gaps),
            _noise(noise.get(each.name)),
            f"{short(each.min, 3)} .. {short(each.max, 3)}",
        )
    output.show(table)
    for line in _about_noise(noise):
        output.item(line)


def _noise(level: NoiseLevel | None) -> str:
    if level is None or not math.isfinite(level.std):
        return "-"
    if level.dead:
        return "still"
    return f"{'' if level.white else '< '}{level.std:.2g}"


def _about_noise(noise: Mapping[str, NoiseLevel]) -> list[str]:
    """Return what else there is to say of the channels' samples."""
    lines: list[str] = []
    attitude = [f"{name} {_noise(noise[name])}" for name in EULER if name in noise]
    if attitude and "qw" in noise:
        lines.append(f"noise of the attitude in rad: {', '.join(attitude)}")
    wild = [f"{name} {100.0 * each.share_of_outliers:.2g} %" for name, each in noise.items() if _wild(each)]
    if wild:
        lines.append(f"outliers (spikes, hidden markers): {', '.join(wild)}")
    coarse = [f"{name} {each.quantum:.2g}" for name, each in noise.items() if each.quantum > 0.0]
    if coarse:
        lines.append(f"coarse steps: {', '.join(coarse)}")
    dead = [name for name, each in noise.items() if each.dead]
    if dead:
        lines.append(f"never changes: {', '.join(dead)}")
    return lines


def _wild(level: NoiseLevel) -> bool:
    return level.white and level.share_of_outliers > _OUTLIERS


def _seconds(t: float) -> str:
    return f"{round(t, 2) + 0.0:.12g}"


def _delay(found: Inspection) -> str:
    if found.delay is None:
        commanded = found.grid is not None and found.grid.command_t.size
        return "unknown: no axis follows the inputs" if commanded else "unknown: no commands, or no motion"
    spread = found.delay_std
    around = f" ± {1e3 * spread:.1f}" if spread is not None and spread == spread else ""
    if found.delay_from == "correlation":
        around = f" ± {1e3 * spread:.0f}" if spread is not None and spread == spread else ""
        return f"about {1e3 * found.delay:.0f}{around} ms, by correlation; --vehicle tells it better"
    together = surer_together(spread, found.together)
    also = "" if together is None else f", with the lag of the thrusters {' ± '.join(together)} ms"
    return f"{1e3 * found.delay:.1f}{around} ms{also}"


def _show_disturbance(found: Inspection, output: Output) -> None:
    if found.levels is None:
        return
    output.heading("Disturbance (standard deviation of the unexplained force)")
    table = output.table(*(f">{axis.name}" for axis in AXES), "Unit")
    table.add_row(*disturbance_cells(found.levels, [] if found.grid is None else [found.grid]), "N, N m")
    output.show(table)


def _show_axes(found: Inspection, output: Output) -> None:
    output.heading("What can be identified")
    whole = {verdict.reason for verdict in found.axes.values()}
    common = next(iter(whole)) if len(whole) == 1 else None
    table = output.table("Axis", "Known by", "Verdict", wrap="Verdict")
    for name, verdict in found.axes.items():
        told = [each.text for each in verdict.known_by] or ["other axes" if verdict.identifiable else "nothing"]
        table.add_row(name, "\n".join(told), "no" if common else _verdict(verdict))
    output.show(table)
    if common:
        output.line()
        output.item(f"no axis: {common}")
        if any(note.startswith("ignored columns") for note in found.recording.notes):
            output.item(
                f"ignored columns need a mapping: towtank inspect {found.log} --map-skeleton writes a first draft"
            )
    reasons: dict[str, list[str]] = {}
    for verdict in found.axes.values():
        if verdict.identifiable:
            for coefficient, reason in verdict.coefficients.items():
                if reason:
                    reasons.setdefault(reason, []).append(coefficient)
    if reasons:
        output.line()
        for reason, names in reasons.items():
            output.item(f"not {', '.join(dict.fromkeys(names))}: {reason}")


def _show_forecast(found: Inspection, output: Output) -> None:
    if not any(verdict.prospects for verdict in found.axes.values()):
        return
    output.heading("How well they will be known (standard deviation after learning)")
    shown: set[str] = set()
    for verdict in found.axes.values():
        lines = [predicted_accuracy.text for name, predicted_accuracy in verdict.prospects.items() if name not in shown]
        shown.update(verdict.prospects)
        if lines:
            output.item(", ".join([lines[0], *(line.replace(" will be known to", " to") for line in lines[1:])]))
    if not found.whole:
        stretches = ", ".join(f"{start:.0f} .. {end:.0f}" for start, end in found.windows)
        output.line(
            f"Computed from the stretches with the most thrust, {stretches} s; the whole log tells more.", "dim"
        )


def _verdict(verdict: AxisVerdict) -> str:
    if not verdict.identifiable:
        return f"no: {verdict.reason}"
    if verdict.explained is not None:
        return f"follows the inputs: they explain {verdict.explained:.0%} of its acceleration"
    return f"yes: {', '.join(name for name, why in verdict.coefficients.items() if why is None)}"
