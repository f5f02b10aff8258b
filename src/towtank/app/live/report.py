"""How a live session ended, as tables and as a document; and one line of JSON a second while it runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from towtank.app.live.coaching import plan_document
from towtank.app.live.facts import LiveFit
from towtank.app.live.readings import Reading
from towtank.app.live.view import coefficient_rows, event_line, likely_line, link_lines, measures
from towtank.app.tables.fits import show_own_fits
from towtank.app.tables.learning import estimate_document
from towtank.app.terminal.output import Output
from towtank.app.terminal.wrap import wrapped
from towtank.dashboard.prediction import SECONDS
from towtank.identification import Learner
from towtank.live.status import Status
from towtank.recording import STANDARD
from towtank.recording.event import Event
from towtank.recording.grids.free_motion import LeftOut
from towtank.recording.standard import VELOCITIES, WRENCH
from towtank.vehicle import Vehicle

__all__ = ["events_document", "live_document", "live_line", "show_end"]

_MOST_CUTS = 12  # lines


def live_document(
    status: Status,
    learner: Learner,
    sources: Sequence[str],
    prior: str | None,
    method: str,
    warnings: Sequence[str],
    judged: LiveFit,
) -> dict[str, Any]:
    """Return the document of `learn --json`, with what only a live session can say under "live".

    "fit" is that of a free run over the recording, else over the last minute: "fit_of" says which, "fit_reason" why
    there is none.
    """
    learnt = status.learnt
    level = learner.disturbance
    return {
        "vehicle": learner.vehicle.name,
        "logs": list(sources),
        "prior": prior,
        "method": method,
        "remarks": ["learned sample by sample while it came", *learnt.remarks],
        "duration_s": learnt.estimate.duration,
        "samples": learnt.estimate.samples,
        "delay_s": learnt.delay,
        "delay_std_s": None,
        "lag_s": learnt.lag,
        "lag_std_s": None,
        "scale_std": learner.vehicle.scale_std,
        **estimate_document(learnt.estimate),
        "disturbance": {}
        if level is None
        else {name: {"std": float(x), "unit": STANDARD[name].unit} for name, x in zip(WRENCH, level, strict=True) if x},
        "noise": judged.noise,
        "fit": judged.fit,
        "fit_of": judged.of,
        "fit_reason": judged.reason or None,
        "warnings": [*warnings, *status.warnings],
        "events": events_document(status.events),
        "live": live_part(status),
    }


def events_document(events: Sequence[Event]) -> list[dict[str, Any]]:
    """Return events, the one noticed first before."""
    return [{"t": each.t, "kind": each.kind, "text": each.text, "details": dict(each.details)} for each in events]


def live_part(status: Status) -> dict[str, Any]:
    """Return how the session fared."""
    recording = status.recording
    return {
        "elapsed_s": status.elapsed,
        "samples": status.samples,
        "instants": status.learnt.instants,
        "latency_ms": status.learnt.latency,
        "processing_ms": status.learnt.processing,
        "dropped": status.dropped,
        "late": status.late,
        "bad": status.bad,
        "waiting": status.waiting,
        "left_out": [_cut_document(each) for each in _cuts(status)],
        "likely": dict(status.learnt.likely),
        "excitation": dict(zip(WRENCH, status.learnt.excitation, strict=False)),
        "sources": {
            each.text: {
                "samples": each.samples,
                "rates_hz": each.state.rates,
                "asked_hz": each.state.asked,
                "bad": each.state.bad,
                "late": each.state.late,
                "dropped_by_system": each.state.dropped,
                "foreign": each.state.foreign,
                "strange_stamps": each.strange,
                "clock_offset_s": each.offset,
                "clock_drift": each.drift,
                "senders": each.state.senders,
                "said": each.state.said,
            }
            for each in status.sources
        },
        "recording": None
        if recording is None
        else {
            "file": recording.path,
            "bytes": recording.size,
            "count": recording.count,
            "lost": recording.lost,
            "trouble": recording.trouble,
        },
        "doubled": status.doubled,
    }


def _cuts(status: Status) -> list[LeftOut]:
    """Return what was not learned from, up to now."""
    learnt = status.learnt
    return [*learnt.cuts, *([learnt.left_out] if learnt.left_out is not None else [])]


def _cut_document(cut: LeftOut) -> dict[str, Any]:
    return {"start_s": cut.start, "end_s": cut.end, "kind": cut.kind, "reason": cut.reason}


def live_line(status: Status, reading: Reading, events: Sequence[Event] = ()) -> dict[str, Any]:
    """Return where a session stands, short enough for one line a second; events: that are new, or have changed."""
    learnt = status.learnt
    known: Mapping[str, Any] = {
        each.name: {"value": each.value, "std": each.std} for each in learnt.estimate.coefficients if each.identified
    }
    recording = status.recording
    return {
        "elapsed_s": round(status.elapsed, 3),
        "state": reading.state,
        "no_data_s": status.silent,
        "left_out": None if learnt.left_out is None else _cut_document(learnt.left_out),
        "verdict": reading.verdict,
        "prediction": {
            "seconds": SECONDS,
            "text": reading.prediction,
            "rms": dict(zip(VELOCITIES, reading.rms, strict=False)),
        },
        "notes": reading.notes,
        "t": learnt.t if math.isfinite(learnt.t) else None,
        "samples": status.samples,
        "delay_s": learnt.delay,
        "coefficients": known,
        "latency_ms": learnt.latency,
        "processing_ms": learnt.processing,
        "dropped": status.dropped,
        "late": status.late,
        "bad": status.bad,
        "recorded_bytes": None if recording is None else recording.size,
        "lost": None if recording is None else recording.lost,
        "events": events_document(events),
        "warnings": status.warnings,
        **({} if reading.plan is None else {"plan": plan_document(reading.plan)}),
    }


def show_end(status: Status, vehicle: Vehicle, method: str, judged: LiveFit, output: Output) -> None:
    """Print how a session ended."""
    learnt = status.learnt
    output.line()
    output.line(f"{vehicle.name}, learned live, method {method}", "bold")
    rows, rest = coefficient_rows(learnt, ascii_only=output.ascii)
    if rows:
        table = output.table("Coefficient", ">Estimate +- std" if output.ascii else ">Estimate ± std", ">Rel.", "Unit")
        for row in rows:
            table.add_row(*row)
        output.show(table)
    if rest:
        output.heading("Not identified, and why")
        for reason, names in rest.items():
            output.item(f"{', '.join(names)}: {reason}")
    if judged.of is not None:
        output.heading(f"Fit of the free-running prediction on {judged.of}")
        show_own_fits(judged.fit, output)
    cuts = _cuts(status)
    if cuts:
        output.heading("What was not learned from: the vehicle was not moving freely in water")
        for cut in cuts[-_MOST_CUTS:]:
            output.item(cut.text)
        if len(cuts) > _MOST_CUTS:
            output.item(f"and {len(cuts) - _MOST_CUTS} stretches before, which --json has")
        output.line("--keep-all learns from all of it.", "dim")
    happened = [event for event in status.events if event.kind != "left out"]
    if happened:
        output.heading("What happened")
        for event in happened:
            output.item(event_line(event, status.epoch, ascii_only=output.ascii))
    if learnt.likely:
        output.line(likely_line(learnt.likely))
    for text in learnt.remarks:
        output.item(text)
    output.line()
    for line in (*measures(status), *link_lines(status)):
        for part in wrapped(line, output.console.width, indent="  "):
            output.line(part)
    for text in status.warnings:
        output.item(text, style="yellow", mark="!")
