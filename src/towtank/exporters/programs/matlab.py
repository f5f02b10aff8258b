"""Target `matlab`: the model as data, a .mat file of version 5 with matrices, coefficients, covariance and trim.

The file is written by SciPy; its header has a text of ours where SciPy puts the time, so that the same model gives the
same bytes.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from scipy.io import savemat

from towtank.exporters.heading import Heading
from towtank.exporters.programs.c99 import unit_of_field, values_of
from towtank.exporters.programs.matrices import STATE_UNITS, STATES, Linear, linearised, remarks
from towtank.exporters.programs.mss import matrices_of
from towtank.exporters.programs.python_file import curves_of
from towtank.exporters.request import Kept, Request
from towtank.vehicle import COEFFICIENTS, Vehicle, configuration_matrix
from towtank.vehicle.names import ROWS

__all__ = ["contents", "kept", "written"]

_HEADER = 116  # bytes of text at the start of the file
_TEXT = b"MATLAB 5.0 MAT-file, a vehicle model written by towtank"


def kept(request: Request) -> Kept:
    """Return what the file keeps: everything, and the model to first order beside it."""
    linear = linearised(request.vehicle, request.at_speed or 0.0)
    return Kept(request.vehicle, remarks(linear))


def written(request: Request, heading: Heading) -> dict[str, bytes]:
    """Return the file."""
    stream = io.BytesIO()
    savemat(stream, contents(request, heading), format="5", long_field_names=True, oned_as="column")
    return {"model.mat": _TEXT.ljust(_HEADER) + stream.getvalue()[_HEADER:]}


def contents(request: Request, heading: Heading) -> dict[str, Any]:
    """Return the variables of the file by their names."""
    vehicle = request.vehicle
    of = matrices_of(vehicle)
    values = values_of(vehicle)
    stds = {name: vehicle.deviation(name) if name in COEFFICIENTS else None for name in values}
    return {
        "heading": "\n".join(heading.lines),
        "name": vehicle.name,
        "model": {**of, "M": vehicle.mass_matrix, "B": configuration_matrix(vehicle), "weight": vehicle.weight},
        "coefficients": values,
        "std": {name: np.nan if std is None else std for name, std in stds.items()},
        "units": {name: unit_of_field(name) for name in values},
        "posterior": _posterior(vehicle),
        "thrusters": _thrusters(vehicle),
        "command_delay": vehicle.command_delay,
        "linear": _linear(vehicle, linearised(vehicle, request.at_speed or 0.0)),
    }


def _cell(values: Any) -> Any:
    """Return values as a row of cells."""
    cells = np.empty((1, len(values)), dtype=object)
    for k, value in enumerate(values):
        cells[0, k] = value
    return cells


def _posterior(vehicle: Vehicle) -> dict[str, Any]:
    """Return names, mean and covariance of what was learned; empty where nothing was."""
    found = vehicle.posterior
    if found is None:
        empty = np.zeros((0, 0))
        return {"names": _cell(()), "mean": empty, "std": empty, "prior_std": empty, "covariance": empty}
    return {
        "names": _cell(found.names),
        "mean": np.array(found.mean),
        "std": np.array(found.std),
        "prior_std": np.array(found.prior_std),
        "covariance": found.covariance,
    }


def _thrusters(vehicle: Vehicle) -> Any:
    once, which = curves_of(vehicle)
    found = []
    for each, k in zip(vehicle.thrusters, which, strict=True):
        curve = {
            key: np.array(value, ndmin=2) if isinstance(value, tuple) else np.zeros((0, 0)) if value is None else value
            for key, value in once[k].items()
        }
        vectors = {"position": np.array(each.position), "direction": np.array(each.direction)}
        numbers = {"gain": each.gain, "time_constant": each.time_constant}
        found.append({"name": each.name, **vectors, **numbers, "curve": curve})
    return _cell(found)


def _linear(vehicle: Vehicle, linear: Linear) -> dict[str, Any]:
    """Return A, B, C, D for the thrusters' forces (without thrusters: the wrench), names, units, and the trim."""
    wrench_units = ("N",) * 3 + ("N m",) * 3
    forces = tuple(each.name for each in vehicle.thrusters)
    B = linear.B if forces else linear.B_wrench
    return {
        "A": linear.A,
        "B": B,
        "C": np.eye(12),
        "D": np.zeros((12, B.shape[1])),
        "A_wrench": linear.A_wrench,
        "B_wrench": linear.B_wrench,
        "states": _cell(STATES),
        "state_units": _cell(STATE_UNITS),
        "outputs": _cell(STATES),
        "output_units": _cell(STATE_UNITS),
        "inputs": _cell([f"force_{name}" for name in forces] or list(ROWS)),
        "input_units": _cell(["N"] * len(forces) or wrench_units),
        "speed": linear.speed,
        "trim_wrench": linear.wrench,
        "trim_forces": linear.forces,
        "trim_commands": linear.commands,
        "trim_rest": linear.rest,
    }
