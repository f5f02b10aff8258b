"""The one record of motion and commands, its files, and its alignment to a common grid.

Everything is in SI, NED (world) and FRD (body); files in other frames are converted once, when they are read.
"""

from towtank.recording.alignment import align
from towtank.recording.binding import bind_thrusters
from towtank.recording.channel import Channel, standard_channel
from towtank.recording.cleaning import dead_channels, find_spikes
from towtank.recording.contents import Content
from towtank.recording.conversion import to_ned_frd
from towtank.recording.csv_read import read_csv
from towtank.recording.csv_write import write_csv
from towtank.recording.grid import Grid
from towtank.recording.held import held_at, held_mean
from towtank.recording.lever_arm import marker_to_origin
from towtank.recording.mapping import Column, ColumnMapping, Marker, load_mapping
from towtank.recording.parquet import read_parquet, write_parquet
from towtank.recording.recording import Recording
from towtank.recording.repairs import Repairs
from towtank.recording.standard import STANDARD
from towtank.recording.timing import find_gaps, gap_limit, median_step, sampling_rate
from towtank.recording.world_velocity import with_body_velocity

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
