"""ArduPilot DataFlash logs: .BIN as the autopilot writes them, .log where a tool turned them into text."""

from __future__ import annotations

from pathlib import Path

from towtank.readers.ardupilot.dvl import at_the_origin
from towtank.readers.ardupilot.states import dataflash_states, with_states
from towtank.readers.common.interpretation import recording_of
from towtank.readers.common.mapped_tables import mapped_recording
from towtank.readers.common.tables import Tables
from towtank.readers.dataflash.meaning import DVL, dataflash_reasons, dataflash_sources
from towtank.readers.dataflash.records import decode_binary
from towtank.readers.dataflash.text import decode_text
from towtank.readers.recognition import HEAD, is_dataflash_text
from towtank.readers.registry import AnyMapping
from towtank.recording.recording import Recording

__all__ = ["read", "tables_of"]


def tables_of(path: Path) -> Tables:
    """Return the tables of a log, binary or text."""
    data = path.read_bytes()
    if is_dataflash_text(data[:HEAD]):
        return decode_text(data, str(path))
    return decode_binary(data, str(path))


def read(path: Path, mapping: AnyMapping) -> Recording:
    """Return the recording of a log; with a mapping, of what it names. The autopilot's states are always in it."""
    tables = tables_of(path)
    states = dataflash_states(tables)
    if mapping is not None:
        return with_states(mapped_recording(tables, mapping), *states)
    recording = recording_of(tables, dataflash_sources(tables), reasons=dataflash_reasons(tables))
    return at_the_origin(with_states(recording, *states), tables.parameters, (DVL,))
