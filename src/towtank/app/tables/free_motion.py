"""What of the logs does not count, and commands that were recorded too seldom: as lines and for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from towtank.app.files import LogParts
from towtank.app.terminal.output import Output
from towtank.digits import short
from towtank.recording import Recording
from towtank.recording.grids.free_motion import usual_interval
from towtank.recording.standard import is_command

__all__ = ["left_out_document", "left_out_lines", "rate_warnings", "show_left_out"]

_MOST = 12  # lines
_SELDOM = 15.0  # Hz: thrusters follow a new command within 0.1 s or so, which slower records do not see
_OUTPUTS = {
    "RCOU": "ArduPilot writes RCOU at 10 Hz at most, and only if bit 10 (1024) of LOG_BITMASK is set",
    "SERVO_OUTPUT_RAW": "Set SRn_RC_CHAN (in newer firmware MAVn_RC_CHAN) of that link to 50, or the interval of "
    "message 36 to 20000 us. The autopilot's own .BIN has 10 Hz",
}
_ASKED_FOR = "To record at 50 Hz: towtank live udpin:0.0.0.0:14550 --record FILE.mcap asks the autopilot for it"
_ELSEWHERE = "Record the thruster commands at 50 Hz, or whenever they change"


def left_out_lines(logs: Sequence[LogParts]) -> list[str]:
    """Return how much of each log counts, then a line for each stretch that does not; nothing where all of it does."""
    lines = []
    for each in logs:
        if each.left_out:
            name = f"{each.log.name} " if len(logs) > 1 else ""
            kept, cut = (sum(b - a for a, b in _spans(each, which)) for which in ("parts", "left_out"))
            lines.append(f"{name}{short(kept, 4)} of {short(kept + cut, 4)} s are used")
            lines += [f"left out {name}{cut.text}" for cut in each.left_out]
    return lines


def _spans(log: LogParts, which: str) -> list[tuple[float, float]]:
    return [(each.start, each.end) for each in getattr(log, which)]


def show_left_out(logs: Sequence[LogParts], output: Output) -> None:
    """Print what does not count; nothing where all of it does."""
    lines = left_out_lines(logs)
    if not lines:
        return
    output.heading("What is used of the log: the vehicle moving freely in water")
    for text in lines[:_MOST]:
        output.item(text)
    if len(lines) > _MOST:
        output.item(f"and {len(lines) - _MOST} further lines, see --json or the report")
    output.line("--keep-all uses the whole log.", "dim")


def left_out_document(logs: Sequence[LogParts]) -> dict[str, Any]:
    """Return what counts and what does not, for a JSON document."""
    return {
        "counted": [
            {"log": str(each.log), "start_s": part.start, "end_s": part.end} for each in logs for part in each.parts
        ],
        "left_out": [
            {"log": str(each.log), "start_s": cut.start, "end_s": cut.end, "kind": cut.kind, "reason": cut.reason}
            for each in logs
            for cut in each.left_out
        ],
    }


def rate_warnings(logs: Sequence[LogParts]) -> list[str]:
    """Return a warning for each log whose commands come so seldom that it matters: what it means, what to set."""
    out = []
    for each in logs:
        rate = _command_rate(each.recording)
        if rate is not None and rate < _SELDOM:
            table = _table_of_commands(each.recording)
            known = table in _OUTPUTS
            step = 1e3 / rate
            out.append(
                f"{each.log.name}: commands come at {short(rate, 2)} Hz{f' ({table})' if table else ''}. "
                f"{'What' if known else 'Unless every change of a command is recorded, what'} thrusters were asked for "
                f"in the {step:.0f} ms between two of them is not known: whichever is likelier, they are learned from "
                "as held or as going on smoothly. Motion faster "
                f"than {2e-3 * step:.2g} s, as when an autopilot steadies the vehicle, is learned poorly or not at "
                f"all; slow manoeuvres are learned well. {f'{_OUTPUTS[table]}. {_ASKED_FOR}' if known else _ELSEWHERE}"
            )
    return out


def _command_rate(recording: Recording) -> float | None:
    """Return how often commands come [Hz]; None where there are few, or recorded now and then."""
    channels = [channel.measured for name, channel in recording.channels.items() if is_command(name)]
    longest = max(channels, key=len, default=None)
    usual = None if longest is None else usual_interval(longest.t)
    return None if usual is None else 1.0 / usual


def _table_of_commands(recording: Recording) -> str:
    """Return the message that commands come from, "" for a plain table."""
    names = (each.name for each in recording.contents if any(is_command(name) for name in each.used))
    return next(names, "").partition("@")[0].partition("[")[0]
