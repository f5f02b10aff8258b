"""Bench measurements of a thruster: a CSV of commands and forces, perhaps at several supply voltages."""

from __future__ import annotations

import csv
import math
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError

__all__ = ["Bench", "read_bench"]

_COMMANDS = ("pwm_us", "pwm", "command", "cmd", "command_us", "command_V", "command_pct", "throttle", "u", "input")
_FORCES = {
    "force_N": 1.0,
    "thrust_N": 1.0,
    "force": 1.0,
    "thrust": 1.0,
    "force_kgf": 9.80665,
    "thrust_kgf": 9.80665,
    "force_lbf": 4.4482216152605,
    "thrust_lbf": 4.4482216152605,
}
_VOLTAGES = ("supply_V", "voltage_V", "voltage", "supply")
_ONE_SUPPLY = 0.04  # voltages closer than this (relative) are one supply that sags


@dataclass(frozen=True)
class Bench:
    """Steady measurements: command (n,), force (n,) [N], supply voltage (n,) [V] or None, all sorted as read."""

    command: Array
    force: Array
    voltage: Array | None
    command_name: str
    source: str

    def groups(self) -> list[tuple[float | None, Array, Array]]:
        """Return (voltage, command, force) for each supply voltage, commands rising, repeats averaged."""
        if self.voltage is None:
            return [(None, *_rising(self.command, self.force))]
        levels = np.unique(self.voltage)
        cuts = np.flatnonzero(np.diff(levels) > _ONE_SUPPLY * levels[:-1])
        groups: list[tuple[float | None, Array, Array]] = []
        for level in np.split(levels, cuts + 1):
            rows = (self.voltage >= level[0]) & (self.voltage <= level[-1])
            groups.append((float(np.mean(self.voltage[rows])), *_rising(self.command[rows], self.force[rows])))
        return groups


def _rising(command: Array, force: Array) -> tuple[Array, Array]:
    commands, inverse, counts = np.unique(command, return_inverse=True, return_counts=True)
    return commands, np.bincount(inverse.ravel(), weights=force) / counts


def read_bench(
    path: str | os.PathLike[str],
    *,
    command: str | None = None,
    force: str | None = None,
    voltage: str | None = None,
) -> Bench:
    """Return the bench data of a CSV with a header line.

    Columns are found by their names (case does not matter), or given by name: the command (pwm_us, command, u, ...),
    the force (force_N, thrust_N, force_kgf, ...; kgf and lbf become N) and, where present, the supply voltage
    (supply_V, voltage_V). Rows in which one of them is empty are left out.

    Raises:
        InputError: no such file or column, text where a number belongs, or nothing left.
    """
    path = Path(path)
    header, lines = _lines(path)
    at_command = _find(path, header, _COMMANDS, command, "the command")
    at_force = _find(path, header, tuple(_FORCES), force, "the force")
    wanted = [at_command, at_force]
    if voltage is not None or any(name.lower() in map(str.lower, header) for name in _VOLTAGES):
        wanted.append(_find(path, header, _VOLTAGES, voltage, "the supply voltage"))
    rows = []
    for number, cells in lines:
        if not any(cell.strip() for cell in cells):
            continue
        values = [_cell(path, number, cells, header, at) for at in wanted]
        if all(math.isfinite(value) for value in values):
            rows.append(values)
    if not rows:
        raise InputError(f"{path}: no rows with a command and a force; expected one measurement per line")
    table = np.array(rows)
    folded = {name.lower(): factor for name, factor in _FORCES.items()}
    factor = folded.get(header[at_force].lower(), 1.0)
    supply = table[:, 2] if len(wanted) == 3 else None
    if supply is not None and np.any(supply <= 0.0):
        raise InputError(f"{path}: column {header[wanted[2]]}: found {supply.min():g} V, expected voltages above 0")
    return Bench(table[:, 0], factor * table[:, 1], supply, header[at_command], path.name)


def _lines(path: Path) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the header and the numbered lines of a CSV."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            lines = [(reader.line_num, cells) for cells in reader]
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; give a CSV with a column of commands and one of forces") from None
    except IsADirectoryError:
        raise InputError(f"{path}: this is a folder, expected a CSV file") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: not a CSV text file ({error})") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from error
    if not lines:
        raise InputError(f"{path}: the file is empty; expected a header line and one measurement per line")
    return [cell.strip() for cell in lines[0][1]], lines[1:]


def _find(path: Path, header: list[str], names: tuple[str, ...], given: str | None, what: str) -> int:
    folded = [name.lower() for name in header]
    for name in names if given is None else (given,):
        if name.lower() in folded:
            return folded.index(name.lower())
    expected = ", ".join(names) if given is None else given
    raise InputError(f"{path}:1: no column for {what}: found {', '.join(header)}; expected {expected}")


def _cell(path: Path, number: int, cells: list[str], header: list[str], at: int) -> float:
    if at >= len(cells):
        raise InputError(f"{path}:{number}: found {len(cells)} columns, expected {len(header)}")
    text = cells[at].strip()
    if not text:
        return math.nan
    try:
        return float(text)
    except ValueError:
        place = f"{path}:{number}:{at + 1}"
        raise InputError(f'{place}: found "{text}" in column {header[at]}, expected a number') from None
