"""What is in a log and what can be learned from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from towtank.app.channel_facts import ChannelFacts, channel_facts
from towtank.app.first_look import DRIVEN, first_look
from towtank.app.output import Teller
from towtank.app.repairs_text import learning_warnings
from towtank.identification import LogLearning, learn_paper
from towtank.identification.axes import AXES
from towtank.identification.chain import Sources, uses_commands
from towtank.recording import Grid, Recording, align, bind_thrusters
from towtank.vehicle import Vehicle

__all__ = ["AxisVerdict", "Inspection", "inspect_recording"]


@dataclass(frozen=True)
class AxisVerdict:
    """One axis: where its speed comes from, whether it can be identified, why not.

    Attributes:
        source: "measured", "derived" (from the pose) or "absent". explained: share of the acceleration that the inputs
            explain, None where a vehicle was given. coefficients: name -> reason, None where it is identified.
    """

    velocity: str
    source: str
    identifiable: bool
    reason: str | None
    explained: float | None
    coefficients: Mapping[str, str | None]


@dataclass(frozen=True)
class Inspection:
    """Everything about one log; `delay_from` is "vehicle", "correlation" or None."""

    log: str
    recording: Recording
    grid: Grid
    channels: list[ChannelFacts]
    delay: float | None
    delay_std: float | None
    delay_from: str | None
    axes: dict[str, AxisVerdict]
    warnings: list[str]

    def document(self) -> dict[str, Any]:
        """Return the JSON document."""
        repairs = self.grid.repairs
        return {
            "log": self.log,
            "start_s": self.recording.start,
            "end_s": self.recording.end,
            "duration_s": self.recording.duration,
            "channels": [asdict(facts) for facts in self.channels],
            "repairs": {**asdict(repairs), "lines": repairs.lines},
            "notes": self.recording.notes,
            "delay_s": self.delay,
            "delay_std_s": self.delay_std,
            "delay_from": self.delay_from,
            "axes": {name: asdict(verdict) for name, verdict in self.axes.items()},
            "warnings": self.warnings,
        }


def inspect_recording(log: str, recording: Recording, vehicle: Vehicle | None, tell: Teller) -> Inspection:
    """Inspect a recording, with the vehicle that made it or without.

    Raises:
        InputError: no motion, fewer than 4 samples, or thrusters that the vehicle lacks.
    """
    facts = channel_facts(recording)
    if vehicle is not None:
        recording = bind_thrusters(recording, [thruster.name for thruster in vehicle.thrusters])
    grid = align(recording)
    sources = Sources.of(grid.pose, grid.velocity, grid.acceleration)
    commanded = grid.command_t.size > 0 if vehicle is None else uses_commands(vehicle, grid)
    if not commanded and not grid.wrench_t.size:
        reason = "no inputs recorded: neither thruster commands (cmd_...) nor a wrench (X Y Z K M N)"
        axes = {axis.name: _no(axis.velocity, kind, reason) for axis, kind in _axes(sources)}
        return Inspection(log, recording, grid, facts, None, None, None, axes, [])
    if vehicle is None:
        look = first_look(grid)
        axes = {
            axis.name: _by_explained(axis.velocity, kind, share)
            for (axis, kind), share in zip(_axes(sources), look.explained, strict=True)
        }
        origin = None if look.delay is None else "correlation"
        return Inspection(log, recording, grid, facts, look.delay, None, origin, axes, [])
    learning = learn_paper(vehicle, [recording], progress=tell)
    std = None if learning.delay_scan is None else learning.delay_scan.std
    axes = {axis.name: _by_learning(axis, kind, learning) for axis, kind in _axes(sources)}
    warnings = learning_warnings(learning, [recording], repairs=False)
    return Inspection(log, recording, grid, facts, learning.delay, std, "vehicle", axes, warnings)


def _axes(sources: Sources) -> list[tuple[Any, str]]:
    return list(zip(AXES, sources.velocity, strict=True))


def _no(velocity: str, source: str, reason: str, explained: float | None = None) -> AxisVerdict:
    return AxisVerdict(velocity, source, False, reason, explained, {})


def _by_explained(velocity: str, source: str, share: float) -> AxisVerdict:
    if source == "absent" or share != share:  # NaN: nothing to look at
        return _no(velocity, source, f"{velocity} is not measured and there is no pose to derive it from")
    if share < DRIVEN:
        return _no(velocity, source, f"hardly follows the inputs: they explain {share:.0%} of its acceleration", share)
    return AxisVerdict(velocity, source, True, None, share, {})


def _by_learning(axis: Any, source: str, learning: LogLearning) -> AxisVerdict:
    estimate = learning.estimate
    names = [name for name in (axis.added_mass, *axis.columns) if name and name in estimate]
    reasons = {name: estimate[name].reason for name in names}
    learned = [name for name in names if estimate[name].identified and name not in ("BG_z",)]
    why = next((reason for name, reason in reasons.items() if reason and name not in learned), None)
    return AxisVerdict(axis.velocity, source, bool(learned), None if learned else why, None, reasons)
