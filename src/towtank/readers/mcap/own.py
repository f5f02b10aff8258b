"""Our own recordings in MCAP, read back to the bit; their format is that of `recording.mcap.format`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.readers.ardupilot.states import with_depth_by_pressure
from towtank.readers.common.raw_messages import Topic
from towtank.readers.common.tables import Table, Tables
from towtank.readers.mcap.scan import McapContent
from towtank.recording.channel import Channel, read_only
from towtank.recording.columns import MINIMUM_SAMPLES, assemble
from towtank.recording.grids.timing import sampling_rate
from towtank.recording.mcap.format import ABOUT, RAW_ENCODING, About, SourceFormat, decode_samples
from towtank.recording.recording import Recording
from towtank.recording.repairs import Content, Repairs
from towtank.recording.tables.gate import admitted

__all__ = ["own_recording", "own_tables"]


@dataclass(frozen=True)
class _Source:
    """One of our sources: times (n,) [s] and values (n, m) as they stand in the file."""

    topic: Topic
    form: SourceFormat
    t: Array
    values: Array
    damaged: int = 0

    @classmethod
    def of(cls, topic: Topic, form: SourceFormat) -> _Source:
        raw = topic.raw
        if raw is None:
            return cls(topic, form, np.empty(0), np.empty((0, len(form.quantities))))
        rows = np.flatnonzero(raw.size == form.message_size)
        if not rows.size:
            return cls(topic, form, np.empty(0), np.empty((0, len(form.quantities))), len(raw))
        t, values = decode_samples(raw.matrix(rows))
        return cls(topic, form, t, values, len(raw) - rows.size)

    def as_written(self, place: str) -> bool:
        """Whether the samples can be taken as they are: in order, none twice, nothing that the gate keeps out."""
        t = self.t
        if not (np.isfinite(t).all() and (t[1:] > t[:-1]).all()):
            return False
        passed = admitted(t, self.columns, place=place)
        return not (passed.untimed or passed.infinities or passed.beyond) and bool((passed.t == t).all())

    @property
    def columns(self) -> dict[str, Array]:
        """The values (n,) by name."""
        return {each.name: self.values[:, k] for k, each in enumerate(self.form.quantities)}


def own_recording(path: Path, content: McapContent) -> Recording:
    """Return the recording that `write_mcap` or `McapLog` wrote.

    Raises:
        InputError: no sample in it; a clock that restarts; a unit that is not the standard one.
    """
    sources, repairs = _sources(path, content)
    about, notes = _about(content)
    channels: dict[str, Channel] = {}
    for source in sorted(sources, key=lambda each: -len(each.t)):
        mine, repaired, remarks = _channels(path, source)
        repairs += repaired
        notes += remarks
        for channel in mine:
            if channel.name in channels:
                notes.append(f'{source.topic.name}: "{channel.name}" is recorded with more samples elsewhere; left out')
            else:
                channels[channel.name] = channel
    if not any(len(channel) for channel in channels.values()):
        lost = "; ".join(repairs.lines)
        raise InputError(f"{path}: no sample in it{f' ({lost})' if lost else ''}, expected a recording of towtank")
    recorded = [each.name for source in sources for each in source.form.quantities]
    order = dict.fromkeys([*about.order, *recorded])
    contents = _contents(content, sources, channels) if about.contents is None else about.contents
    try:
        recording = Recording(
            {name: channels[name] for name in order if name in channels},
            about.source,
            tuple(notes),
            about.attributes or {},
            about.repairs + repairs,
            contents,
        )
        return with_depth_by_pressure(recording)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def own_tables(path: Path, content: McapContent) -> Tables:
    """Return our sources as tables, for a mapping."""
    sources, repairs = _sources(path, content)
    about, notes = _about(content)
    tables = {
        source.topic.name: Table(
            source.topic.name,
            source.t,
            source.columns,
            kind="towtank",
        )
        for source in sources
    }
    attributes = dict(about.attributes or {})
    return Tables(str(path), tables, notes=tuple(notes), repairs=about.repairs + repairs, attributes=attributes)


def _sources(path: Path, content: McapContent) -> tuple[list[_Source], Repairs]:
    """Return our sources, and what was damaged in them or around them."""
    sources = []
    repairs = content.repairs
    for topic in content.topics:
        try:
            form = SourceFormat.of_metadata(topic.name, topic.metadata)
        except ValueError as error:
            raise InputError(f"{path}: {error}") from error
        if form is None:
            continue
        source = _Source.of(topic, form)
        repairs += Repairs(damaged=source.damaged)
        sources.append(source)
    return sources, repairs


def _about(content: McapContent) -> tuple[About, list[str]]:
    """Return what is known of the recording, and the notes so far."""
    if ABOUT not in content.metadata:
        return About(), ["the record about the recording is missing"]
    try:
        about = About.of_metadata(content.metadata[ABOUT])
    except ValueError as error:
        return About(), [str(error)]
    return about, list(about.notes)


def _channels(path: Path, source: _Source) -> tuple[list[Channel], Repairs, list[str]]:
    """Return the channels of a source, what was repaired, and notes."""
    quantities = source.form.quantities
    place = f"{path}: {source.topic.name}"
    if source.as_written(place):
        t = read_only(source.t)
        columns = np.ascontiguousarray(source.values.T)
        columns.flags.writeable = False
        try:
            return [Channel(each.name, t, columns[k], *each[1:]) for k, each in enumerate(quantities)], Repairs(), []
        except InputError as error:
            raise InputError(f"{place}: {error}") from error
    if len(source.t) < MINIMUM_SAMPLES:
        return [], Repairs(), [f"{source.topic.name}: {len(source.t)} samples, out of order; left out"]
    units = {each.name: (each.unit, each.frame) for each in quantities}
    piece = assemble(source.t, source.columns, place=place, source=str(path), units=units)
    return list(piece.channels.values()), piece.repairs, [f"{source.topic.name}: {note}" for note in piece.notes]


def _contents(content: McapContent, sources: list[_Source], channels: dict[str, Channel]) -> tuple[Content, ...]:
    """Return a line for each channel of the file, where the recording brought none."""
    ours = {source.topic.name: source for source in sources}
    lines = []
    for topic in content.topics:
        rate = sampling_rate(np.unique(topic.log_time) / 1e9) if len(topic) > 1 else None
        if topic.name in ours:
            source = ours[topic.name]
            used = tuple(each.name for each in source.form.quantities if each.name in channels)
            lines.append(Content(topic.name, "towtank", len(topic), rate, used, "" if used else "no sample"))
        else:
            raw = topic.encoding == RAW_ENCODING
            viewed = topic.name.startswith("/towtank/")
            reason = "bytes as they were received" if raw else "kept for viewers" if viewed else "not among the samples"
            lines.append(Content(topic.name, topic.kind or topic.encoding, len(topic), rate, (), reason))
    return tuple(lines)
