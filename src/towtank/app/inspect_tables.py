"""An inspection as tables."""

from __future__ import annotations

from towtank.app.channel_facts import ChannelFacts
from towtank.app.inspection import Inspection
from towtank.app.numbers import short
from towtank.app.output import Output

__all__ = ["show_inspection"]


def show_inspection(found: Inspection, output: Output) -> None:
    """Print an inspection."""
    recording = found.recording
    output.line(found.log, "bold")
    output.line(f"{short(recording.duration, 5)} s, {len(found.channels)} channels")
    _show_channels(found.channels, output)
    lines = (*found.grid.repairs.lines, *recording.notes)
    output.heading("Clock and samples")
    for line in lines or ("nothing to repair",):
        output.item(line)
    output.heading("Delay from command to motion")
    output.line(_delay(found))
    _show_axes(found, output)
    if found.warnings:
        output.heading("Warnings")
        for text in found.warnings:
            output.item(text)
    if found.delay_from == "correlation":
        output.line()
        output.line("With --vehicle VEHICLE the verdict is given coefficient by coefficient.", "dim")


def _show_channels(channels: list[ChannelFacts], output: Output) -> None:
    output.line()
    table = output.table(
        "Channel", "Unit", "Frame", ">Hz", ">From s", ">To s", ">Missing", ">Gaps", ">Min", ">Max", wrap="Channel"
    )
    for each in channels:
        held = each.changes is not None
        gaps = "held" if held else str(each.gaps) if not each.gaps else f"{each.gaps}, {short(each.longest_gap_s, 2)} s"
        table.add_row(
            each.name,
            each.unit,
            each.frame,
            short(each.rate_hz, 3),
            short(each.start_s, 4),
            short(each.end_s, 4),
            "-" if held else str(each.missing),
            gaps,
            short(each.min, 3),
            short(each.max, 3),
        )
    output.show(table)


def _delay(found: Inspection) -> str:
    if found.delay is None:
        return "unknown: no axis follows the inputs" if found.grid.command_t.size else "unknown: no commands"
    spread = found.delay_std
    around = f" ± {1e3 * spread:.1f}" if spread is not None and spread == spread else ""
    how = "by the vehicle's model" if found.delay_from == "vehicle" else "by correlation, without a vehicle"
    return f"{1e3 * found.delay:.1f}{around} ms ({how})"


def _show_axes(found: Inspection, output: Output) -> None:
    output.heading("What can be identified")
    table = output.table("Axis", "Speed", "Verdict", wrap="Verdict")
    for name, verdict in found.axes.items():
        speed = f"{verdict.velocity} {verdict.source}"
        table.add_row(name, speed, _verdict(verdict.identifiable, verdict.reason, verdict.explained, verdict.coefficients))
    output.show(table)
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


def _verdict(yes: bool, reason: str | None, explained: float | None, coefficients: object) -> str:
    if not yes:
        return f"no: {reason}"
    if explained is not None:
        return f"follows the inputs: they explain {explained:.0%} of its acceleration"
    names = [name for name, why in dict(coefficients).items() if why is None]  # type: ignore[call-overload]
    return f"yes: {', '.join(names)}"
