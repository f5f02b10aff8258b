"""Two files of one run as one recording: channels of both on the clock of the first, each quantity from one of them."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace

from towtank.digits import joined
from towtank.errors import InputError
from towtank.recording.channel import Channel
from towtank.recording.merging.offset import ClockOffset, clock_offset, file_of
from towtank.recording.noise import NoiseLevel, noise_levels
from towtank.recording.recording import Recording
from towtank.recording.standard import QUANTITIES, WORLD_VELOCITY, WRENCH, is_command, is_input, is_standard

__all__ = ["MERGED", "merge", "merges_of"]

_DEPTH = "depth"  # attribute that says from where a depth is told
MERGED = "merged "  # begins the attribute that says how a file was merged, before its name


def merge(first: Recording, second: Recording, offset: float | None = None) -> Recording:
    """Return the channels of two files of one run on the clock of the first.

    A quantity that both measure is taken from the better one: that which measures more of its axes, else that with
    more samples over the square of their noise (none is believed to be better than sensors usually are). An attitude
    comes from the file of the position, if that has a heading: each file has a north of its own. Commands,
    wrench and supply are the first file's where it has them. Motion outside of the time of the file that holds the
    inputs is left out. Notes, attributes, repairs and contents of both are kept, of attributes of one name the second's
    under the name with its file's behind.

    Args:
        offset: what to add to the times of `second` [s]; found from the motion in both where omitted.

    Raises:
        InputError: the offset cannot be told, or with it the two have no time in common.
    """
    if offset is not None and not math.isfinite(offset):
        raise InputError(f"--merge {file_of(second)}: found an offset of {offset}, expected a number of seconds")
    clock = clock_offset(first, second) if offset is None else ClockOffset(float(offset))
    names = file_of(first), file_of(second)
    moved = _on_clock(second, clock)
    if not (moved.start < first.end and moved.end > first.start):
        raise InputError(
            f"{second.source or names[1]}: on the clock of {names[0]} it goes from {moved.start:g} to {moved.end:g} s, "
            f"{names[0]} from {first.start:g} to {first.end:g} s; expected some time in common: check --merge's offset"
        )
    kept, added, notes = _chosen(first, moved, names)
    kept, added, cut = _while_driven(kept, added, names)
    notes = [clock.text(*names), *notes, *cut]
    channels = {name: channel for part in (kept, added) for name, channel in part.items()}
    return Recording(
        channels,
        first.source,
        (*first.notes, *notes, *(f"{names[1]}: {note}" for note in second.notes)),
        _attributes(first, second, clock, depth_of=first if "z" in kept else second),
        first.repairs + replace(second.repairs, details=tuple(f"{names[1]}: {x}" for x in second.repairs.details)),
        (*first.contents, *(replace(each, name=f"{names[1]}: {each.name}") for each in second.contents)),
    )


def merges_of(recording: Recording) -> list[dict[str, object]]:
    """Return how files were merged into a recording: file, offset_s, offset_std_s, drift_ppm, drift_std_ppm, by, text.

    An offset that was said has no deviation: None.
    """
    return [json.loads(text) for key, text in recording.attributes.items() if key.startswith(MERGED)]


def _on_clock(recording: Recording, clock: ClockOffset) -> Recording:
    times = {id(channel.t): clock.times(channel.t) for channel in recording.channels.values()}
    return recording.with_channels(
        Channel(name, times[id(channel.t)], channel.values, channel.unit, channel.frame)
        for name, channel in recording.channels.items()
    )


_Channels = dict[str, Channel]


def _chosen(first: Recording, second: Recording, names: tuple[str, str]) -> tuple[_Channels, _Channels, list[str]]:
    """Return the channels to take from each, and what was decided."""
    kept, added = ({name: each for name, each in run.channels.items() if len(each)} for run in (first, second))
    notes: list[str] = []
    noise = noise_levels(first), noise_levels(second)
    for quantity in sorted(QUANTITIES, key=lambda each: each.name == "attitude"):  # it last, once the others are placed
        names_of = (*quantity.channels, *quantity.instead)
        mine, theirs = (_names_in(each, names_of) for each in (first, second))
        if not mine or not theirs:
            continue
        worth = [
            _worth(each, found, levels, quantity.noise)
            for each, found, levels in zip((first, second), (mine, theirs), noise, strict=True)
        ]
        better = int(worth[1] > worth[0])
        if quantity.name == "attitude":
            better = _of_one_north(kept, added, (mine, theirs), better)
        for name in names_of:
            (kept, added)[1 - better].pop(name, None)
        notes.append(f"{quantity.name}: from {names[better]}, which tells more of it than {names[1 - better]}")
    inputs = [name for name in added if is_input(name) or name == "voltage"]
    for kind in (is_command, WRENCH.__contains__, "voltage".__eq__):
        if any(map(kind, kept)) and any(map(kind, inputs)):
            dropped = [name for name in inputs if kind(name)]
            added = {name: channel for name, channel in added.items() if name not in dropped}
            notes.append(f"{joined(dropped)}: from {names[0]}, not from {names[1]}")
    for name in [name for name in added if not is_standard(name) and name in kept]:
        other = f"{name} ({names[1]})"
        added[other] = added.pop(name).renamed(other)
    return kept, added, notes


def _of_one_north(kept: _Channels, added: _Channels, names: tuple[Sequence[str], Sequence[str]], better: int) -> int:
    """Return whose attitude to take (0, 1): of the file that position or velocity in the world are from."""
    placed = [any(name in part for name in ("x", "y", *WORLD_VELOCITY[:2])) for part in (kept, added)]
    heads = ["psi" in each or "qw" in each for each in names]
    return int(placed[1]) if placed[0] != placed[1] and heads[placed[1]] else better


def _names_in(recording: Recording, names: Sequence[str]) -> tuple[str, ...]:
    return tuple(name for name in names if name in recording and len(recording[name].measured))


def _worth(
    recording: Recording, names: Sequence[str], levels: dict[str, NoiseLevel], usual: float
) -> tuple[int, float]:
    """Return how many axes are told, and samples over the square of their noise, of the axis that is known least."""
    measured = [name for name in names if name in levels] or list(names)
    axes = 3 if len(names) >= 3 else len(names)
    return axes, min(_samples_over_noise(recording, name, levels.get(name), usual) for name in measured)


def _samples_over_noise(recording: Recording, name: str, level: NoiseLevel | None, usual: float) -> float:
    if level is not None and level.dead:
        return 0.0
    std = max(usual, level.std) if level is not None and math.isfinite(level.std) else usual
    t = recording[name].measured.t
    rate = level.rate if level is not None and math.isfinite(level.rate) else 0.0
    fresh = min(float(t.size), rate * float(t[-1] - t[0]) + 1.0) if rate > 0.0 else float(t.size)
    return fresh / std**2


def _while_driven(kept: _Channels, added: _Channels, names: tuple[str, str]) -> tuple[_Channels, _Channels, list[str]]:
    """Return the channels, those of the file without inputs only while the other one lasts; and what was left out."""
    driven = [any(map(is_input, part)) for part in (kept, added)]
    if driven[0] == driven[1]:
        return kept, added, []
    lead, follow = (kept, added) if driven[0] else (added, kept)
    start = min(float(channel.t[0]) for channel in lead.values())
    end = max(float(channel.t[-1]) for channel in lead.values())
    cut: _Channels = {}
    lost = 0.0
    for name, channel in follow.items():
        inside = (channel.t >= start) & (channel.t <= end)
        if inside.any():
            cut[name] = Channel(name, channel.t[inside], channel.values[inside], channel.unit, channel.frame)
        outside = channel.t[~inside]
        if outside.size:
            lost = max(lost, max(0.0, start - float(outside[0])) + max(0.0, float(outside[-1]) - end))
    which = names if driven[0] else names[::-1]
    notes = [f"{lost:.1f} s of {which[1]} left out, for which {which[0]} tells no inputs"] if lost >= 0.05 else []
    return (lead, cut, notes) if driven[0] else (cut, lead, notes)


def _attributes(first: Recording, second: Recording, clock: ClockOffset, depth_of: Recording) -> dict[str, str]:
    """Return the attributes of both; what is said of a depth, only of the file that it is from."""
    name = file_of(second)
    out = dict(first.attributes)
    for key, text in second.attributes.items():
        if out.get(key, text) != text:
            key = f"{key} ({name})"
        out[key] = text
    said = depth_of.attributes.get(_DEPTH)
    out = {key: text for key, text in out.items() if not key.startswith(_DEPTH)}
    out |= {} if said is None else {_DEPTH: said}
    how = {
        "file": name,
        "offset_s": clock.offset,
        "offset_std_s": clock.std if clock.by else None,
        "drift_ppm": 1e6 * clock.drift,
        "drift_std_ppm": 1e6 * clock.drift_std,
        "by": list(clock.by),
        "text": clock.text(file_of(first), name),
    }
    key, count = f"{MERGED}{name}", 1
    while key in out:
        count += 1
        key = f"{MERGED}{name} ({count})"
    return {**out, key: json.dumps(how)}
