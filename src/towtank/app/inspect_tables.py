"""An inspection as tables."""

from __future__ import annotations

from towtank.app.channel_facts import ChannelFacts
from towtank.app.digits import short
from towtank.app.inspection import AxisVerdict, Inspection
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
    table = output.table("Channel", "Unit", ">Hz", ">Span s", ">Missing", ">Gaps", ">Range", wrap="Range")
    for each in channels:
        held = each.changes is not None
        table.add_row(
            each.name,
            f"{each.unit} {each.frame}".strip(),
            short(each.rate_hz, 3),
            f"{_seconds(each.start_s)} .. {_seconds(each.end_s)}",
            "held" if held else str(each.missing),
            "-" if held else str(each.gaps),
            f"{short(each.min, 3)} .. {short(each.max, 3)}",
        )
    output.show(table)


def _seconds(t: float) -> str:
    return f"{round(t, 2):.12g}"


def _delay(found: Inspection) -> str:
    if found.delay is None:
        return "unknown: no axis follows the inputs" if found.grid.command_t.size else "unknown: no commands"
    spread = found.delay_std
    around = f" ± {1e3 * spread:.1f}" if spread is not None and spread == spread else ""
    if found.delay_from == "correlation":
        return f"about {1e3 * found.delay:.0f} ms, by correlation; --vehicle tells it better"
    return f"{1e3 * found.delay:.1f}{around} ms"


def _show_axes(found: Inspection, output: Output) -> None:
    output.heading("What can be identified")
    table = output.table("Axis", "Speed", "Verdict", wrap="Verdict")
    for name, verdict in found.axes.items():
        speed = f"{verdict.velocity} {verdict.source}"
        table.add_row(name, speed, _verdict(verdict))
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


def _verdict(verdict: AxisVerdict) -> str:
    if not verdict.identifiable:
        return f"no: {verdict.reason}"
    if verdict.explained is not None:
        return f"follows the inputs: they explain {verdict.explained:.0%} of its acceleration"
    return f"yes: {', '.join(name for name, why in verdict.coefficients.items() if why is None)}"
