"""The one record of motion and commands, its files, and its alignment to a common grid.

Everything is in SI, NED (world) and FRD (body); files in other frames are converted once, when they are read.
"""

from towtank.recording.channel import Channel, standard_channel
from towtank.recording.cleaning import dead_channels, find_spikes
from towtank.recording.frames.conversion import to_ned_frd
from towtank.recording.frames.lever_arm import marker_to_origin
from towtank.recording.frames.world_velocity import with_body_velocity
from towtank.recording.grids.alignment import align
from towtank.recording.grids.grid import Grid, held_at, held_mean
from towtank.recording.grids.timing import find_gaps, gap_limit, median_step, sampling_rate
from towtank.recording.mapping import Column, ColumnMapping, Marker, bind_thrusters, load_mapping, mapping_of
from towtank.recording.recording import Recording
from towtank.recording.repairs import Content, Repairs
from towtank.recording.standard import STANDARD
from towtank.recording.tables.csv import read_csv, write_csv
from towtank.recording.tables.parquet import read_parquet, write_parquet

__all__ = [
    "STANDARD",
    "Channel",
    "Column",
    "ColumnMapping",
    "Content",
    "Grid",
    "Marker",
    "Recording",
    "Repairs",
    "align",
    "bind_thrusters",
    "dead_channels",
    "find_gaps",
    "find_spikes",
    "gap_limit",
    "held_at",
    "held_mean",
    "load_mapping",
    "mapping_of",
    "marker_to_origin",
    "median_step",
    "read_csv",
    "read_parquet",
    "sampling_rate",
    "standard_channel",
    "to_ned_frd",
    "with_body_velocity",
    "write_csv",
    "write_parquet",
]
