"""What is in a log and what can be learned from it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from towtank.app.files import LogParts
from towtank.app.tables.free_motion import left_out_document, rate_warnings
from towtank.app.tables.learning import delay_deviation, disturbance_document, findings_document, pair_document
from towtank.app.tables.repairs import contents_document, learning_warnings
from towtank.app.terminal.output import Progress
from towtank.digits import joined, short
from towtank.identification import LogLearning, learn_recordings
from towtank.identification.data.samples import NoiseLevels
from towtank.identification.least_squares.chain import uses_commands
from towtank.identification.logs import findings_before
from towtank.identification.model.terms import AXES
from towtank.identification.offline.first_look import (
    DRIVEN,
    MOST_ROWS,
    PredictedAccuracy,
    best_excited,
    first_look,
    predicted_accuracies,
)
from towtank.notebook import html_table
from towtank.recording import Grid, Recording, align, bind_thrusters
from towtank.recording.axes import CHANNELS_OF, Witness, known_by
from towtank.recording.consistency import Finding
from towtank.recording.facts import ChannelFacts, channel_facts
from towtank.recording.merging.merge import merges_of
from towtank.recording.noise import NoiseLevel, noise_levels
from towtank.recording.repairs import Repairs
from towtank.recording.standard import MEASURED, QUATERNION, WORLD_VELOCITY
from towtank.recording.tables.dataframes import recording_html
from towtank.vehicle import Vehicle

__all__ = ["AxisVerdict", "Inspection", "inspect_recording"]

_FEWEST_ROWS = 600  # of one part among many
_SPEEDS = ("speed", "rate")  # begin the words of a witness that is the speed itself


@dataclass(frozen=True)
class AxisVerdict:
    """One axis: by what it is known, whether it can be identified, why not.

    Attributes:
        explained: share of the acceleration that the inputs explain, None where a vehicle was given.
        coefficients: name -> reason, None where it is identified.
        prospects: name -> how well a learning will know it. known_by: channels that tell of it.
    """

    velocity: str
    known_by: tuple[Witness, ...]
    identifiable: bool
    reason: str | None
    explained: float | None
    coefficients: Mapping[str, str | None]
    prospects: Mapping[str, PredictedAccuracy]

    @property
    def source(self) -> str:
        """Where its speed comes from: "measured", "derived" (from the pose) or "absent"."""
        if any(each.by.startswith(_SPEEDS) for each in self.known_by):
            return "measured"
        return "derived" if any(each.by != "acceleration" for each in self.known_by) else "absent"

    def document(self) -> dict[str, Any]:
        """Return the JSON document."""
        return {"source": self.source, **asdict(self)}


@dataclass(frozen=True)
class Inspection:
    """Everything about one log.

    Attributes:
        parts: of the log, what counts. grids: of these, none where no motion is recorded.
        noise: of each motion channel. delay_from: "vehicle", "correlation" or None.
        together: delay and lag of the thrusters, and the deviation of their sum [s], where both were found.
        levels: of noise and disturbance, as the joint filter finds them; None without a vehicle.
        windows: stretches [s] that this was read from. whole: these are all that counts.
        findings: what in it cannot be right, gravest first.
    """

    parts: LogParts
    grids: Sequence[Grid]
    channels: list[ChannelFacts]
    noise: Mapping[str, NoiseLevel]
    delay: float | None
    delay_std: float | None
    delay_from: str | None
    axes: dict[str, AxisVerdict]
    warnings: list[str]
    levels: NoiseLevels | None = None
    windows: tuple[tuple[float, float], ...] = ()
    whole: bool = True
    findings: tuple[Finding, ...] = ()
    together: tuple[float, float] | None = None

    def __repr__(self) -> str:
        axes = [f"{name} {'yes' if verdict.identifiable else 'no'}" for name, verdict in self.axes.items()]
        return f"<Inspection of {self.log}: {self._in_short}\n can be identified: {', '.join(axes)}>"

    @property
    def _in_short(self) -> str:
        many = len(self.findings)
        wrong = f", {many} finding{'' if many == 1 else 's'}" if many else ""
        return f"{short(self.recording.duration, 5)} s, {len(self.channels)} channels{wrong}"

    def _repr_html_(self) -> str:
        """Return the channels and what can be identified as tables, for notebooks."""
        rows = [
            (name, verdict.velocity, verdict.source, "yes" if verdict.identifiable else "no", verdict.reason or "")
            for name, verdict in self.axes.items()
        ]
        head = ("Axis", "Speed", "Where it comes from", "Can be identified", "Why not")
        said = [*(each.text for each in self.findings), *self.warnings]
        table = html_table(f"{self.log}: {self._in_short}", head, rows, said)
        return table + recording_html(self.recording)

    @property
    def log(self) -> str:
        """The file."""
        return str(self.parts.log)

    @property
    def recording(self) -> Recording:
        """All of the log that was asked for."""
        return self.parts.recording

    @property
    def grid(self) -> Grid | None:
        """The longest stretch that counts; None where no motion is recorded."""
        return max(self.grids, key=len, default=None)

    @property
    def repairs(self) -> Repairs:
        """What was mended in reading and in putting on grids."""
        return sum((grid.repairs for grid in self.grids), Repairs()) if self.grids else self.recording.repairs

    def document(self) -> dict[str, Any]:
        """Return the JSON document."""
        repairs = self.repairs
        return {
            "log": self.log,
            "findings": findings_document(self.findings),
            "start_s": self.recording.start,
            "end_s": self.recording.end,
            "duration_s": self.recording.duration,
            "channels": [asdict(facts) for facts in self.channels],
            "repairs": {**asdict(repairs), "lines": repairs.lines},
            "notes": self.recording.notes,
            "attributes": self.recording.attributes,
            "merged": merges_of(self.recording),
            "contents": contents_document(self.recording),
            "noise": {name: asdict(level) for name, level in self.noise.items()},
            "delay_s": self.delay,
            "delay_std_s": self.delay_std,
            "delay_from": self.delay_from,
            "delay_and_lag_s": pair_document(self.together),
            "axes": {name: verdict.document() for name, verdict in self.axes.items()},
            "disturbance": disturbance_document(self.levels, [] if self.grid is None else [self.grid]),
            "excitation": _excitation(self),
            **left_out_document([self.parts]),
            "warnings": self.warnings,
        }


def inspect_recording(log: LogParts, vehicle: Vehicle | None, progress: Progress) -> Inspection:
    """Inspect a log, with the vehicle that made it or without: its channels, and what can be learned from what counts.

    Raises:
        InputError: fewer than 4 samples, or thrusters that the vehicle lacks.
    """
    found = _inspected(log, vehicle, progress)
    found = replace(found, warnings=[*rate_warnings([log]), *found.warnings])
    if found.levels is not None:
        return found
    if not log.parts:
        return replace(found, findings=findings_before(None, log.recording))
    return replace(found, findings=findings_before(vehicle, max(log.parts, key=lambda part: part.duration)))


def _inspected(log: LogParts, vehicle: Vehicle | None, progress: Progress) -> Inspection:
    recording = log.recording
    facts, noise = channel_facts(recording), noise_levels(recording)
    if recording.contents and not any(name in (*MEASURED, *QUATERNION, *WORLD_VELOCITY) for name in recording):
        reason = "no motion recorded: neither pose nor velocity, rates or specific force"
        axes = {axis.name: _no(axis.velocity, (), reason) for axis in AXES}
        return Inspection(log, (), facts, noise, None, None, None, axes, [])
    parts = list(log.parts) or [recording]
    if vehicle is not None:
        parts = [bind_thrusters(part, [thruster.name for thruster in vehicle.thrusters]) for part in parts]
    grids = [align(part) for part in parts]
    grid = max(grids, key=len)
    told = [(axis, each.witnesses) for axis, each in zip(AXES, known_by(*parts), strict=True)]
    commanded = grid.command_t.size > 0 if vehicle is None else uses_commands(vehicle, grid)
    reason = "" if log.parts else "no part of the log shows the vehicle moving freely (--keep-all uses it all the same)"
    if not commanded and not grid.wrench_t.size:
        reason = "no inputs recorded: neither thruster commands (cmd_...) nor a wrench (X Y Z K M N)"
    if reason:
        axes = {axis.name: _no(axis.velocity, witnesses, reason) for axis, witnesses in told}
        return Inspection(log, grids, facts, noise, None, None, None, axes, [])
    if vehicle is None:
        look = first_look(grid)
        axes = {
            axis.name: _by_explained(axis, witnesses, share)
            for (axis, witnesses), share in zip(told, look.explained, strict=True)
        }
        origin = None if look.delay is None else "correlation"
        return Inspection(log, grids, facts, noise, look.delay, look.delay_std, origin, axes, [])
    windows, stretches = _best(parts, grids, vehicle)
    learning = learn_recordings(vehicle, stretches, progress=progress)
    axes = {axis.name: _by_learning(axis, witnesses, learning) for axis, witnesses in told}
    warnings, std = learning_warnings(learning, stretches, repairs=False), delay_deviation(learning)
    return Inspection(
        *(log, grids, facts, noise, learning.delay, std, "vehicle", axes, warnings),
        levels=learning.levels,
        windows=windows,
        whole=len(windows) == len(parts),
        findings=learning.findings,
        together=learning.together,
    )


def _best(
    parts: Sequence[Recording], grids: Sequence[Grid], vehicle: Vehicle
) -> tuple[tuple[tuple[float, float], ...], list[Recording]]:
    """Return where most happens in parts, as windows [s] and as recordings: all of them where they are not long."""
    total = sum(map(len, grids))
    windows: list[tuple[float, float]] = []
    stretches: list[Recording] = []
    for part, grid in zip(parts, grids, strict=True):
        own = best_excited(grid, vehicle, max(_FEWEST_ROWS, MOST_ROWS * len(grid) // total))
        windows += own
        stretches += [part] if len(own) == 1 else [part.window(*window) for window in own]
    return tuple(windows), stretches


def _excitation(found: Inspection) -> dict[str, Any]:
    """Return what a learning will know, and from which stretches of the log that is read."""
    known = {name: asdict(each) for verdict in found.axes.values() for name, each in verdict.prospects.items()}
    if not known:
        return {}
    return {"windows": found.windows, "whole": found.whole, "coefficients": known}


def _no(velocity: str, told: tuple[Witness, ...], reason: str, explained: float | None = None) -> AxisVerdict:
    return AxisVerdict(velocity, told, False, reason, explained, {}, {})


def _by_explained(axis: Any, told: tuple[Witness, ...], share: float) -> AxisVerdict:
    if not told:
        ways = list(dict.fromkeys(CHANNELS_OF[axis.name].values()))
        return _no(axis.velocity, told, f"not measured: neither {', '.join(ways[:-1])} nor {ways[-1]}")
    if share != share:  # NaN: nothing to look at
        return _no(
            axis.velocity,
            told,
            f"its speed is not measured; what {joined([each.by for each in told])} shows of it needs --vehicle",
        )
    if share < DRIVEN:
        return _no(
            axis.velocity, told, f"hardly follows the inputs: they explain {share:.0%} of its acceleration", share
        )
    return AxisVerdict(axis.velocity, told, True, None, share, {}, {})


def _by_learning(axis: Any, told: tuple[Witness, ...], learning: LogLearning) -> AxisVerdict:
    estimate, accuracies = learning.estimate, predicted_accuracies(learning)
    names = [name for name in (axis.added_mass, *axis.columns) if name and name in estimate]
    reasons = {name: estimate[name].reason for name in names}
    learned = [name for name in names if estimate[name].identified]
    moved = any(name in learned for name in (axis.added_mass, axis.linear, axis.quadratic))
    why = next((reason for name, reason in reasons.items() if reason and name not in learned), None)
    known = {name: accuracies[name] for name in names if name in accuracies}
    return AxisVerdict(axis.velocity, told, moved, None if moved else why, None, reasons, known)
