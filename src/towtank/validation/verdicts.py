"""What the errors of a prediction say about the model, in plain words."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from towtank.recording import STANDARD
from towtank.validation.autocorrelation import Portmanteau
from towtank.validation.command_trace import CommandTrace
from towtank.validation.error_memory import Memory
from towtank.validation.error_series import AXIS, ErrorSeries

__all__ = ["CHANCE", "Kind", "Verdict", "follows", "verdict_of"]

Kind = Literal["white", "nearly white", "disturbed", "drifting", "follows the command", "none", "diverged", "unknown"]
CHANCE = 0.01  # probability below which a trace of the command is believed,
_WORTH = 0.02  # and the least share of the error's power that is worth a word
_SMALL = 0.1  # share of the slow part in the power, below which errors are mostly noise
_LONG = 0.2  # share of the recording, above which a correlation time is not one


@dataclass(frozen=True)
class Verdict:
    """A finding as one of few kinds, and as a sentence."""

    kind: Kind
    text: str


def follows(command: CommandTrace) -> bool:
    """Whether errors follow the command: more than by chance, and by enough to be worth a word."""
    return command.p < CHANCE and command.share >= _WORTH


def verdict_of(
    series: ErrorSeries,
    memory: Memory | None,
    free: Portmanteau | None,
    command: CommandTrace | None,
    *,
    finite: bool,
    negligible: bool,
) -> Verdict:
    """Return the verdict on one channel.

    Args:
        finite: the prediction did not diverge. negligible: the error is too small to be worth a word.
    """
    axis, unit = AXIS[series.name], STANDARD[series.name].unit
    if not finite:
        return Verdict("diverged", f"{axis}: the prediction diverged")
    if negligible:
        return Verdict("none", f"{axis}: no error to speak of")
    if memory is None:
        return Verdict("unknown", f"{axis}: too few samples ({series.samples}) to tell what the errors are")
    if command is not None and follows(command):
        return Verdict(
            "follows the command",
            f"{axis} errors follow the command ({100.0 * command.share:.0f} % of their power): "
            "the model lacks something",
        )
    noise = f"{memory.white:.2g} {unit}"
    offset = _offset(series, memory, unit)
    if not memory.believable:
        if free is None or free.p >= CHANCE:
            return Verdict("white", f"{axis} errors are as white as the sensor's noise ({noise}){offset}")
        return Verdict(
            "nearly white", f"{axis} errors are noise, coloured within {20.0 * series.step:.2g} s only{offset}"
        )
    slow = f"{memory.slow:.2g} {unit}"
    if memory.slow**2 < _SMALL * (memory.slow**2 + memory.white**2):
        return Verdict(
            "nearly white", f"{axis} errors are mostly the sensor's noise ({noise}), with little slow ({slow})"
        )
    if memory.time > _LONG * series.duration:
        return Verdict(
            "drifting", f"{axis} errors drift: {series.duration:.3g} s are too short to tell how long they last"
        )
    return Verdict("disturbed", f"{axis} errors are slow disturbances, correlation time {memory.time:.2g} s{offset}")


def _offset(series: ErrorSeries, memory: Memory, unit: str) -> str:
    """Return a word about a constant error, where it is larger than the rest and three times its deviation."""
    remembered = 2.0 * memory.time / series.duration if memory.believable else 0.0
    std = math.sqrt(memory.slow**2 * min(remembered, 1.0) + memory.white**2 / series.samples)
    rest = math.hypot(memory.slow, memory.white)
    return f", about a constant {memory.bias:+.2g} {unit}" if abs(memory.bias) > max(rest, 3.0 * std) else ""
