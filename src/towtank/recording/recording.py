"""The one record that simulator, log readers and live links all yield: named channels at their own times."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.recording.channel import Channel, read_only, standard_channel
from towtank.recording.repairs import Content, Repairs
from towtank.recording.standard import is_held

__all__ = ["Recording"]


@dataclass(frozen=True, eq=False)
class Recording:
    """Channels by name, each with its own times. Immutable.

    Attributes:
        channels: name -> Channel (read-only mapping), each under its own name.
        source: where it came from: a file name, "simulation", ...
        notes: remarks for a person (ignored columns, conversions, doubts).
        attributes: free text by key, kept in Parquet.
        repairs: what was mended when it was read.
        contents: what the log held, table by table, where it is made of several.

    Raises:
        InputError: there is no channel, or a channel stands under another name than its own.
    """

    channels: Mapping[str, Channel]
    source: str = ""
    notes: tuple[str, ...] = ()
    attributes: Mapping[str, str] = field(default_factory=dict)
    repairs: Repairs = Repairs()
    contents: tuple[Content, ...] = ()

    def __post_init__(self) -> None:
        prefix = f"{self.source}: " if self.source else ""
        for name, channel in self.channels.items():
            if name != channel.name:
                raise InputError(f'{prefix}channel "{channel.name}" stands under the name "{name}"')
        if not any(len(channel) for channel in self.channels.values()):
            raise InputError(f"{prefix}a recording needs at least one channel with a sample")
        object.__setattr__(self, "channels", MappingProxyType(dict(self.channels)))
        object.__setattr__(self, "attributes", MappingProxyType(dict(self.attributes)))
        object.__setattr__(self, "notes", tuple(self.notes))
        object.__setattr__(self, "contents", tuple(self.contents))

    @classmethod
    def from_table(
        cls, t: ArrayLike, columns: Mapping[str, ArrayLike], *, source: str = "", notes: Iterable[str] = ()
    ) -> Recording:
        """Build from times (n,) [s], strictly increasing, and standard columns (n,), NaN = not measured.

        A channel keeps only its measured samples, so that columns of several rates become channels of their
        own rates; columns without any NaN share one array of times. A column without any value is left out,
        with a note.
        """
        times = read_only(t)
        channels: dict[str, Channel] = {}
        remarks = list(notes)
        stamps: dict[bytes, Array] = {}
        for name, column in columns.items():
            channel = standard_channel(name, times, column)
            known = ~np.isnan(channel.values)
            if not known.any():
                remarks.append(f'channel "{name}" holds no value; left out')
                continue
            if not known.all():
                own = stamps.setdefault(np.packbits(known).tobytes(), read_only(times[known]))
                channel = standard_channel(name, own, channel.values[known])
            channels[name] = channel
        return cls(channels, source=source, notes=tuple(remarks))

    def __getitem__(self, name: str) -> Channel:
        try:
            return self.channels[name]
        except KeyError:
            raise KeyError(f'no channel "{name}"{nearest(name, self.channels)}; there are {" ".join(self)}') from None

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    def __iter__(self) -> Iterator[str]:
        return iter(self.channels)

    def __len__(self) -> int:
        return len(self.channels)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Recording):
            return NotImplemented
        return self._state() == other._state()

    __hash__ = None  # type: ignore[assignment]

    def __reduce__(self) -> tuple[Any, ...]:
        return Recording, self._state()

    def _state(self) -> tuple[Any, ...]:
        return dict(self.channels), self.source, self.notes, dict(self.attributes), self.repairs, self.contents

    def __repr__(self) -> str:
        origin = f"{self.source}: " if self.source else ""
        return f"<Recording {origin}{self.duration:.3f} s, {' '.join(self.names)}>"

    def _repr_html_(self) -> str:
        """Return the channels as a table with rates, ranges and small plots, for notebooks."""
        from towtank.recording.tables.dataframes import recording_html

        return recording_html(self)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels, in their order."""
        return tuple(self.channels)

    @property
    def start(self) -> float:
        """Earliest time of any channel [s]."""
        return min(float(channel.t[0]) for channel in self.channels.values() if len(channel))

    @property
    def end(self) -> float:
        """Latest time of any channel [s]."""
        return max(float(channel.t[-1]) for channel in self.channels.values() if len(channel))

    @property
    def duration(self) -> float:
        """`end - start` [s]."""
        return self.end - self.start

    def replace(self, channels: Mapping[str, Channel] | Iterable[Channel]) -> Recording:
        """The same recording with these channels put in place of those of the same name, or added."""
        new = list(channels.values()) if isinstance(channels, Mapping) else list(channels)
        merged = {**self.channels, **{channel.name: channel for channel in new}}
        return self.with_channels(merged.values())

    def without(self, *names: str) -> Recording:
        """The same recording without the channels of these names."""
        return self.with_channels(channel for name, channel in self.channels.items() if name not in names)

    def with_channels(self, channels: Iterable[Channel]) -> Recording:
        """The same source, notes, attributes, repairs and contents with exactly these channels."""
        by_name = {channel.name: channel for channel in channels}
        return Recording(by_name, self.source, self.notes, self.attributes, self.repairs, self.contents)

    def with_notes(self, *notes: str, repairs: Repairs | None = None) -> Recording:
        """The same recording with further notes and, if given, further repairs."""
        total = self.repairs if repairs is None else self.repairs + repairs
        return Recording(self.channels, self.source, self.notes + notes, self.attributes, total, self.contents)

    def window(self, start: float, end: float) -> Recording:
        """The samples with start <= t <= end [s]; an input that is in force at `start` is restated there.

        Raises:
            InputError: no sample lies in the window, or it ends before it starts.
        """
        prefix = f"{self.source}: " if self.source else ""
        if not end > start:
            raise InputError(f"{prefix}window {start:g},{end:g}: found an end before the start")
        cut: dict[str, Channel] = {}
        shared: dict[tuple[int, bool], tuple[slice, Array]] = {}
        inside = 0
        for name, channel in self.channels.items():
            key = (id(channel.t), is_held(name))
            if key not in shared:
                shared[key] = _cut(channel.t, start, end, is_held(name))
            rows, times = shared[key]
            if len(times):
                inside += int(channel.t[rows][-1] >= start)
                cut[name] = Channel(name, times, channel.values[rows], channel.unit, channel.frame)
        if not inside:
            raise InputError(
                f"{prefix}window {start:g},{end:g}: no sample in it; "
                f"the recording goes from {self.start:g} to {self.end:g} s"
            )
        lost = [name for name in self.channels if name not in cut]
        notes = (f"no samples within {start:g}..{end:g} s: {', '.join(lost)}",) if lost else ()
        return self.with_channels(cut.values()).with_notes(*notes)

    def to_pandas(self) -> Any:
        """Return a `pandas.DataFrame`: index `t` [s], a column for each channel, NaN where not measured.

        Units and frames by channel, and the source, stand in its `attrs`.

        Raises:
            InputError: pandas is not installed.
        """
        from towtank.recording.tables.dataframes import to_pandas

        return to_pandas(self)

    def to_xarray(self) -> Any:
        """Return an `xarray.Dataset` over `t` [s], NaN where not measured, with units, frames and meanings.

        Raises:
            InputError: xarray is not installed.
        """
        from towtank.recording.tables.dataframes import to_xarray

        return to_xarray(self)

    def merge(self, other: Recording, offset: float | None = None) -> Recording:
        """The same run with the channels of a second file of it, on this one's clock; see `merging.merge.merge`.

        Args:
            offset: what to add to the times of `other` [s]; found from the motion that both saw where omitted.

        Raises:
            InputError: the offset cannot be told, or with it the two have no time in common.
        """
        from towtank.recording.merging.merge import merge

        return merge(self, other, offset)

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write as `.csv`, `.parquet` or `.mcap`, by the suffix, whole or not at all; else raise InputError.

        CSV holds the channels alone; Parquet and MCAP keep units, frames, source, notes, attributes, repairs and
        contents.
        """
        from towtank.recording.tables.writing import write_recording

        write_recording(self, path)


def _cut(t: Array, start: float, end: float, held: bool) -> tuple[slice, Array]:
    """Rows of [start, end] and their times; a held channel restates at `start` what is in force there."""
    first, last = int(np.searchsorted(t, start, "left")), int(np.searchsorted(t, end, "right"))
    restate = held and first > 0 and (first == t.size or t[first] > start)
    rows = slice(first - 1 if restate else first, last)
    times = t[rows].copy()
    if restate and times.size:
        times[0] = start
    return rows, read_only(times)
