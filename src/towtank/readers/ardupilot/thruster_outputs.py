"""Which of an autopilot's outputs drive thrusters, and which way each turns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.common.sources import Source
from towtank.recording.standard import COMMAND_PREFIX

__all__ = ["ThrusterOutputs", "command_source", "command_sources", "thruster_outputs"]

_MOTORS = {**{32.0 + n: n for n in range(1, 9)}, **{73.0 + n: n for n in range(9, 13)}}  # SERVOn_FUNCTION -> motor
_THROTTLES = {73.0: 1, 74.0: 2}  # left and right, of a surface craft
_NEUTRAL = 1500.0  # us
_NO_OUTPUT = 65535.0
_OUTPUTS = 32


@dataclass(frozen=True)
class ThrusterOutputs:
    """Number of a thruster -> number of its output; the thrusters that turn the other way; a remark."""

    outputs: Mapping[int, int]
    mirrored: frozenset[int] = frozenset()
    note: str = ""


def thruster_outputs(parameters: Mapping[str, float], outputs: Mapping[int, Array]) -> ThrusterOutputs:
    """Return the thrusters by SERVOn_FUNCTION and MOT_n_DIRECTION, else the first outputs, those that move.

    Args:
        parameters: of the autopilot, as far as they are known.
        outputs: number of an output -> its pulses (n,) [us] over the whole log.
    """
    functions = {n: parameters.get(f"SERVO{n}_FUNCTION") for n in range(1, _OUTPUTS + 1)}
    moving = _moving(outputs)
    for known in (_MOTORS, _THROTTLES):
        found = {known[kind]: n for n, kind in functions.items() if kind is not None and kind in known}
        if found:
            unknown = [n for n in moving if functions[n] is None]
            return _by_function(dict(sorted(found.items())), parameters, unknown, throttles=known is _THROTTLES)
    if not moving:
        return ThrusterOutputs({})
    last = max(moving)
    which = "output 1, which moves, is" if last == 1 else f"outputs 1 to {last}, which move, are"
    note = f"no SERVOn_FUNCTION among the parameters: {which} taken for the thrusters in order, none mirrored"
    return ThrusterOutputs({n: n for n in range(1, last + 1)}, note=note)


def _by_function(
    found: dict[int, int], parameters: Mapping[str, float], unknown: Sequence[int], *, throttles: bool
) -> ThrusterOutputs:
    if throttles:
        reversed_ = frozenset(n for n, output in found.items() if parameters.get(f"SERVO{output}_REVERSED") == 1.0)
        note = "cmd_1 is the left throttle, cmd_2 the right one"
        if reversed_:
            sides = " and ".join(("left", "right")[n - 1] for n in sorted(reversed_))
            note += f"; {sides} with pulses mirrored about 1500 (SERVOn_REVERSED), so that more is ahead"
        return ThrusterOutputs(found, reversed_, note)
    directions = {n: parameters.get(f"MOT_{n}_DIRECTION") for n in found}
    mirrored = frozenset(n for n, direction in directions.items() if direction is not None and direction < 0)
    notes = []
    if mirrored:
        numbers = ", ".join(map(str, sorted(mirrored)))
        which = f"thruster {numbers} turns" if len(mirrored) == 1 else f"thrusters {numbers} turn"
        notes.append(f"{which} the other way (MOT_n_DIRECTION -1): pulses mirrored about 1500, as ArduPilot means them")
    if all(direction is None for direction in directions.values()):
        notes.append("no MOT_n_DIRECTION among the parameters: no thruster is mirrored")
    if unknown:
        notes.append(f"outputs {', '.join(map(str, unknown))} move, but SERVOn_FUNCTION does not say what they drive")
    return ThrusterOutputs(found, mirrored, "; ".join(notes))


def _moving(outputs: Mapping[int, Array]) -> Sequence[int]:
    """Return the outputs that move, up to the first one without any pulse."""
    moving = []
    for n in range(1, _OUTPUTS + 1):
        pulses = _pulses(outputs[n]) if n in outputs else np.empty(0)
        pulses = pulses[np.isfinite(pulses)]
        if not pulses.size:
            break
        if np.ptp(pulses) > 0.0:
            moving.append(n)
    return moving


def command_source(table: str, t: Array, outputs: Mapping[int, Array], thrusters: ThrusterOutputs) -> Source | None:
    """Return the commands cmd_1, cmd_2, ... [us] by number of the thruster, positive for a positive command."""
    channels: dict[str, Array] = {}
    for thruster, output in thrusters.outputs.items():
        if output in outputs:
            pulses = _pulses(outputs[output])
            mirrored = 2.0 * _NEUTRAL - pulses if thruster in thrusters.mirrored else pulses
            channels[f"{COMMAND_PREFIX}{thruster}"] = mirrored
    return Source(table, "commands", t, channels, note=thrusters.note) if channels else None


def command_sources(
    parts: Sequence[tuple[str, Array, Mapping[int, Array]]], parameters: Mapping[str, float]
) -> list[Source]:
    """Return the commands of a log whose outputs may stand in several tables; where they do, they are joined to one.

    Args:
        parts: name of a table, times (n,) [s], number of an output -> pulses (n,) [us].
        parameters: of the autopilot.
    """
    whole: dict[int, Array] = {}
    for _, _, outputs in parts:
        whole = {**outputs, **whole}
    thrusters = thruster_outputs(parameters, whole)
    found = [command_source(name, t, outputs, thrusters) for name, t, outputs in parts]
    sources = sorted((each for each in found if each is not None), key=lambda each: -len(each.channels))
    names = [name for each in sources for name in each.channels]
    ordered = all(np.isfinite(each.t).all() for each in sources)
    if len(sources) < 2 or len(set(names)) < len(names) or not ordered:
        return sources
    main, *others = sources
    t = np.unique(np.concatenate([each.t for each in sources]))
    channels = {}
    for each in sources:
        rows = np.searchsorted(t, each.t)
        for name, pulses in each.channels.items():
            channels[name] = np.full(t.size, np.nan)
            channels[name][rows] = pulses
    joined = ", ".join(each.table for each in others)
    note = "; ".join(filter(None, (main.note, f"thrusters of {joined} are joined to those of {main.table}")))
    return [
        Source(main.table, "commands", t, {name: channels[name] for name in sorted(channels, key=_number)}, note=note),
        *(replace(each, refused=f"joined to {main.table}", note="") for each in others),
    ]


def _number(channel: str) -> int:
    return int(channel.removeprefix(COMMAND_PREFIX))


def _pulses(values: Array) -> Array:
    """Return pulses [us], NaN where there is none: 0 and 65535."""
    return np.where((values > 0.0) & (values < _NO_OUTPUT), values, np.nan)
