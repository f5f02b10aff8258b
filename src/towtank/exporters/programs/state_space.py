"""Target `state-space`: the model to first order as one Python file, for python-control or for NumPy alone.

The code is a template (`templates/linear.py.in`); here stand the numbers that go into it.
"""

from __future__ import annotations

import re
import textwrap

import numpy as np

from towtank.core.arrays import Array
from towtank.exporters.heading import Heading
from towtank.exporters.programs.c99 import prefix_of
from towtank.exporters.programs.matrices import linearised, remarks, tangent
from towtank.exporters.request import Kept, Request
from towtank.exporters.templates import filled, template

__all__ = ["kept", "linear_text", "written"]

_CURVES = "curves, limits and dead bands of the thrusters: the inputs are their forces"


def kept(request: Request) -> Kept:
    """Return what is left: damping by its tangent at the trim, thrusters by their forces."""
    said = remarks(linearised(request.vehicle, request.at_speed or 0.0))
    return Kept(tangent(request), (*said, _CURVES) if request.vehicle.thrusters else said)


def written(request: Request, heading: Heading) -> dict[str, bytes]:
    """Return the file."""
    return {"linear.py": (heading.commented("# ") + linear_text(request)).encode()}


def linear_text(request: Request) -> str:
    """Return the file without its opening comment."""
    vehicle = request.vehicle
    linear = linearised(vehicle, request.at_speed or 0.0)
    names = ["force_" + re.sub(r"\W", "_", each.name) for each in vehicle.thrusters]
    values = {
        "title": prefix_of(vehicle),
        "speed": repr(linear.speed),
        "names": _wrapped(repr(names).replace("'", '"')),
        "commanded": _wrapped(repr([each.name for each in vehicle.thrusters]).replace("'", '"')),
        "nu_by_nu": _rows(linear.A_wrench[6:, 6:]),
        "nu_by_angles": _rows(linear.A_wrench[6:, 3:5]),
        "nu_by_wrench": _rows(linear.B_wrench[6:]),
        "nu_by_forces": _rows(linear.B[6:]),
        "inflow": _rows(linear.A[6:, 6:] - linear.A_wrench[6:, 6:]),
        "wrench": _row(linear.wrench),
        "forces": _row(linear.forces),
        "commands": _row(linear.commands),
        "rest": _row(linear.rest),
    }
    return filled(template("linear.py.in"), values)


def _wrapped(text: str, indent: str = "") -> str:
    return textwrap.fill(
        text,
        104,
        initial_indent=indent,
        subsequent_indent=indent + "    ",
        break_long_words=False,
        break_on_hyphens=False,
    )


def _row(values: Array) -> str:
    return _wrapped(repr([float(each) + 0.0 for each in values]))


def _rows(matrix: Array) -> str:
    return "\n".join(_wrapped(f"{[float(each) + 0.0 for each in row]},", "        ") for row in np.atleast_2d(matrix))
