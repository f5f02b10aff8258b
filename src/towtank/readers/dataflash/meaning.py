"""What ArduPilot's DataFlash messages mean as channels."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from towtank.core.arrays import Array
from towtank.readers.ardupilot.aiding import Aiding, Evidence, aided, aiding_of
from towtank.readers.ardupilot.dvl import displacement_source
from towtank.readers.ardupilot.thruster_outputs import command_sources
from towtank.readers.ardupilot.water_pressure import Pressure, depth_sources
from towtank.readers.common.interpretation import DEGREE, Reading, in_order, sources_of_table
from towtank.readers.common.sources import Source
from towtank.readers.common.tables import Table, Tables
from towtank.recording.standard import ACCELERATIONS, RATES

__all__ = ["DVL", "dataflash_reasons", "dataflash_sources", "sources_of_messages"]

_XYZ = ("X", "Y", "Z")
_GYRO = dict(zip(RATES, (f"Gyr{axis}" for axis in _XYZ), strict=True))
_ACCELEROMETER = dict(zip(ACCELERATIONS, (f"Acc{axis}" for axis in _XYZ), strict=True))
_EULER = {"phi": ("Roll", DEGREE), "theta": ("Pitch", DEGREE), "psi": ("Yaw", DEGREE)}
_QUATERNION = {"qw": "Q1", "qx": "Q2", "qy": "Q3", "qz": "Q4"}
_IMU = ("IMU", "IMU2", "IMU3")
_FILTERS = ("XKF", "NKF")
# Of equals the first one is used. Accelerometers tell specific force in FRD: about -9.8 m/s^2 along z at rest.
_READINGS: tuple[Reading, ...] = (
    *(Reading(name, "rates", _GYRO) for name in _IMU),
    Reading("GYR", "rates", _GYRO),
    Reading("RATE", "rates", {"p": ("R", DEGREE), "q": ("P", DEGREE), "r": ("Y", DEGREE)}, 1),
    *(Reading(name, "specific force", _ACCELEROMETER) for name in _IMU),
    Reading("ACC", "specific force", _ACCELEROMETER),
    Reading("VISP", "attitude", _EULER, 1),
    Reading("ATT", "attitude", _EULER, 2),
    *(Reading(f"{name}Q", "attitude", _QUATERNION, 2) for name in ("XK", "NK")),
    *(Reading(f"{name}1", "attitude", _EULER, 2) for name in _FILTERS),
    Reading("AHR2", "attitude", _EULER, 3),
    Reading("DCM", "attitude", _EULER, 3),
    Reading("VISV", "velocity", {"vn": "VX", "ve": "VY", "vd": "VZ"}),
    Reading("VISP", "position", {"x": "PX", "y": "PY"}, 1),
    Reading("VISP", "depth", {"z": "PZ"}, 1),
    *(Reading(f"{name}1", "velocity", {"vn": "VN", "ve": "VE", "vd": "VD"}, 2) for name in _FILTERS),
    *(Reading(f"{name}1", "position", {"x": "PN", "y": "PE"}, 2) for name in _FILTERS),
    *(Reading(f"{name}1", "depth", {"z": "PD"}, 2) for name in _FILTERS),
    Reading("BAT", "voltage", {"voltage": "Volt"}, positive="Volt"),
    Reading("CURR", "voltage", {"voltage": "Volt"}, positive="Volt"),
)
DVL = "VISO"
_FILTERED = tuple(f"{name}1" for name in _FILTERS)
_FIX = 3.0
_REASONS = {
    "RCIN": "what the pilot asked for, not what the thrusters got",
    "GPS": "the filter (XKF1) uses it",
    "PARM": "parameters: they tell which output drives which thruster",
    "RFND": "a range to the bottom is no depth",
}


def dataflash_sources(tables: Tables) -> list[Source]:
    """Return what the messages of a log tell, with what they tell of the filter judged by what aids it."""
    sources = _depths(tables) + _commands(tables)
    aiding = aiding_of(_evidence(tables, sources))
    for table in _primary_first(tables):
        sources += sources_of_messages(table, aiding)
    return in_order(sources, _READINGS, _kind)


def dataflash_reasons(tables: Tables) -> dict[str, str]:
    """Return why nothing is taken from tables of which one might expect it."""
    return {name: _REASONS[kind] for name in tables.tables if (kind := _kind(name)) in _REASONS}


def sources_of_messages(table: Table, aiding: Aiding) -> list[Source]:
    """Return what some messages of one table tell, row by row; commands and pressures apart."""
    kind = _kind(table.name)
    found = sources_of_table(_sampled(table), kind, _READINGS)
    if kind == DVL and all(f"PosD{axis}" in table for axis in _XYZ) and "dt" in table:
        found.append(_displacement(table))
    return [
        aided(source, aiding, position=source.quantity == "position")
        if kind in _FILTERED and source.quantity in ("velocity", "position")
        else source
        for source in found
    ]


def _kind(name: str) -> str:
    return name.partition("[")[0]


def _sampled(table: Table) -> Table:
    """Return a table of raw samples at the times at which they were sampled, not logged."""
    if "SampleUS" not in table or "TimeUS" not in table:
        return table
    stamp = table.t + 1e-6 * (table["SampleUS"] - table["TimeUS"])
    return Table(table.name, table.t, table.columns, table.kind, table.frame, table.text, stamp)


def _displacement(table: Table) -> Source:
    """Return the velocity of a DVL."""
    moved = [table[f"PosD{axis}"] for axis in _XYZ]
    return displacement_source(table.name, table.t, moved, table["dt"], table.get("conf"))


def _commands(tables: Tables) -> list[Source]:
    """Return the thruster commands; which outputs drive thrusters is chosen over the whole log."""
    parts = [
        (table.name, table.t, {int(name[1:]): table[name] for name in table.columns if re.fullmatch(r"C\d+", name)})
        for kind in ("RCOU", "RCO2", "RCO3")
        for table in tables.named(kind)
    ]
    return command_sources(parts, tables.parameters)


def _depths(tables: Tables) -> list[Source]:
    """Return the depth by each pressure sensor: ArduPilot logs its height above where it was calibrated."""
    sensors: list[Pressure] = []
    for number, kind in ((None, "BARO"), (1, "BAR2"), (2, "BAR3")):
        for table in tables.named(kind):
            if "Alt" in table and "Press" in table:
                own = _usual(table.get("I")) if number is None else number
                sensors.append(Pressure(own, table.name, table.t, table["Press"], -table["Alt"]))
    return depth_sources(sensors, tables.parameters)


def _evidence(tables: Tables, sources: Iterable[Source]) -> Evidence:
    reports = next((table for name in ("XKF4", "NKF4") for table in _first(tables, name) if "SS" in table), None)
    depth = next((source for source in sources if source.quantity == "depth" and not source.refused), None)
    fixes = [table["Status"] for table in tables.named("GPS") if "Status" in table]
    acoustic = tables.parameters.get("GPS_TYPE", tables.parameters.get("GPS1_TYPE")) == 14.0
    fixed = any(bool((status >= _FIX).any()) for status in fixes)
    return Evidence(
        t=None if reports is None else reports.t,
        flags=None if reports is None else reports["SS"],
        velocity=tuple(name for name in ("VISO", "VISV", "XKFD") if tables.named(name)),
        position=tuple(name for name in ("VISP",) if tables.named(name)) + (("GPS",) if fixed and acoustic else ()),
        satellites=fixed and not acoustic,
        depth_t=None if depth is None else depth.t,
        depth=None if depth is None else depth.channels["z"],
    )


def _first(tables: Tables, kind: str) -> list[Table]:
    """Return the tables of a type, that of the filter's primary core first."""
    found = tables.named(kind)
    primary = _primary(tables)
    return sorted(found, key=lambda table: not table.name.endswith(f"[{primary}]"))


def _primary(tables: Tables) -> int:
    """Return the number of the core of the filter that was primary most of the time."""
    for table in (*tables.named("XKF4"), *tables.named("NKF4")):
        if "PI" in table:
            return _usual(table["PI"])
    return 0


def _usual(numbers: Array | None) -> int:
    """Return the commonest of some whole numbers (n,), 0 where there is none."""
    known = np.empty(0) if numbers is None else numbers[np.isfinite(numbers)]
    values, counts = np.unique(known, return_counts=True)
    return int(values[np.argmax(counts)]) if values.size else 0


def _primary_first(tables: Tables) -> list[Table]:
    """Return all tables, those of the filter's primary core before those of the others."""
    primary = f"[{_primary(tables)}]"
    return sorted(
        tables.tables.values(),
        key=lambda table: table.name.startswith(("XK", "NK")) and not table.name.endswith(primary),
    )
