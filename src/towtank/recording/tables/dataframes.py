"""A recording as one table over all of its times: for Arrow, for pandas and for xarray; its channels for notebooks."""

from __future__ import annotations

from typing import Any

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import short
from towtank.notebook import html_table, library, spark_svg
from towtank.recording.channel import Channel
from towtank.recording.facts import ChannelFacts, channel_facts
from towtank.recording.recording import Recording
from towtank.recording.standard import is_standard, standard_of

__all__ = ["on_all_times", "recording_html", "to_pandas", "to_xarray"]

_POINTS = 160  # of a small plot
_NOTES = 6  # that are shown


def on_all_times(recording: Recording) -> tuple[Array, dict[str, Array]]:
    """Return all times (n,) [s] of a recording and its channels on them, (n,) by name, NaN where not measured."""
    stamps = {id(channel.t): channel.t for channel in recording.channels.values()}
    times = np.unique(np.concatenate(list(stamps.values()))) if len(stamps) > 1 else next(iter(stamps.values()))
    rows = {key: None if t.size == times.size else np.searchsorted(times, t) for key, t in stamps.items()}
    columns = {}
    for name, channel in recording.channels.items():
        place = rows[id(channel.t)]
        if place is None:
            columns[name] = channel.values
        else:
            columns[name] = np.full(times.size, np.nan)
            columns[name][place] = channel.values
    return times, columns


def to_pandas(recording: Recording) -> Any:
    """Return a `pandas.DataFrame`; see `Recording.to_pandas`."""
    pandas = library("pandas", "to_pandas")
    times, columns = on_all_times(recording)
    frame = pandas.DataFrame({name: np.array(values) for name, values in columns.items()})
    frame.index = pandas.Index(np.array(times), name="t")
    channels = recording.channels
    frame.attrs = {
        "source": recording.source,
        "units": {name: channel.unit for name, channel in channels.items()},
        "frames": {name: channel.frame for name, channel in channels.items()},
    }
    return frame


def to_xarray(recording: Recording) -> Any:
    """Return an `xarray.Dataset`; see `Recording.to_xarray`."""
    xarray = library("xarray", "to_xarray")
    times, columns = on_all_times(recording)
    data = {}
    for name, values in columns.items():
        channel = recording.channels[name]
        about = {"units": channel.unit, "frame": channel.frame}
        if is_standard(name):
            about["long_name"] = standard_of(name).description
        data[name] = ("t", np.array(values), about)
    time = ("t", np.array(times), {"units": "s", "long_name": "time"})
    return xarray.Dataset(data, coords={"t": time}, attrs={"source": recording.source, **recording.attributes})


def recording_html(recording: Recording) -> str:
    """Return the channels of a recording as an HTML table: rate, samples, span, holes, range, and a small plot."""
    rows = [_row(facts, recording.channels[facts.name]) for facts in channel_facts(recording)]
    head = ("Channel", "Unit", "Frame", ">Hz", ">Samples", ">Span s", ">Gaps", ">Range", "Over time")
    title = f"{recording.source or 'recording'}: {recording.duration:.3f} s, {len(rows)} channels"
    notes = [*recording.repairs.lines, *recording.notes]
    more = [f"and {len(notes) - _NOTES} further notes"] if len(notes) > _NOTES else []
    return html_table(title, head, rows, [*notes[:_NOTES], *more])


def _row(facts: ChannelFacts, channel: Channel) -> tuple[str, ...]:
    span, between = f"{short(facts.start_s, 5)} .. {short(facts.end_s, 5)}", f"{short(facts.min)} .. {short(facts.max)}"
    gaps = "held" if facts.changes is not None else str(facts.gaps)
    plot = spark_svg(_thinned(channel), f"{facts.name} over time")
    return facts.name, facts.unit, facts.frame, short(facts.rate_hz), str(facts.samples), span, gaps, between, plot


def _thinned(channel: Channel) -> list[float]:
    """Return what a small plot shows: of each of its columns the value that stands off the middle the most."""
    known = channel.measured
    if len(known) <= _POINTS:
        return [float(value) for value in known.values]
    middle = float(np.median(known.values))
    edges = np.linspace(known.t[0], known.t[-1], _POINTS + 1)
    starts = np.searchsorted(known.t, edges[:-1])
    ends = np.append(starts[1:], len(known))
    parts = [known.values[a:b] for a, b in zip(starts, ends, strict=True)]
    return [float(part[np.argmax(np.abs(part - middle))]) if part.size else float("nan") for part in parts]
