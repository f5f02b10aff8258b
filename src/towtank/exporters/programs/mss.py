"""Target `mss`: the model as one function file for MATLAB and GNU Octave, as the vehicles of MSS are.

The code is a template (`templates/model.m.in`, `templates/thrusters.m.in`); here stand the numbers that go into it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.exporters.heading import Heading
from towtank.exporters.programs.python_file import Entry, commands_ahead, curves_of, name_beside
from towtank.exporters.request import Kept, Request
from towtank.exporters.templates import filled, template
from towtank.vehicle import COEFFICIENTS, Vehicle, configuration_matrix, index

__all__ = ["function_text", "kept", "matrices_of", "written"]

_WORDS = (*("break", "catch", "classdef", "continue", "global", "otherwise", "parfor", "persistent"), "return", "while")
_LONGEST = 63  # characters of a name in MATLAB
_POWERS = ("coefficients", "ahead", "astern")  # of polynomials: MATLAB has the highest first


def kept(request: Request) -> Kept:
    """Return what the function keeps: all but the delay of the commands."""
    return Kept(request.vehicle.model_copy(update={"command_delay": 0.0}))


def written(request: Request, heading: Heading) -> dict[str, bytes]:
    """Return the function file."""
    return {"model.m": (heading.commented("% ") + "\n" + function_text(request.vehicle)).encode()}


def matrices_of(vehicle: Vehicle) -> dict[str, Array]:
    """Return what the model (8) is made of, by Fossen's symbols; damping and added mass positive.

    MRB, MA, D (linear), Dn (quadratic, for |nu| nu) and F (for u nu) are (6, 6), A (for nu^2) and tau_0 (6,), BG (3,),
    W_minus_B and inflow_loss (). Units: SI, body FRD about the origin.
    """
    of: dict[str, Array] = {"MRB": vehicle.rigid_body_matrix, "MA": vehicle.added_mass_matrix}
    of |= {name: np.zeros((6, 6)) for name in ("D", "Dn", "F")} | {name: np.zeros(6) for name in ("A", "tau_0")}
    places = {"linear": ("D", -1.0), "quadratic": ("Dn", -1.0), "forward": ("F", 1.0), "constant": ("tau_0", 1.0)}
    for name in COEFFICIENTS:
        kind, i, j = index(name)
        value = vehicle.coefficient(name)
        if kind == "asymmetric":
            of["A"][i] = value
        elif kind in places:
            symbol, sign = places[kind]
            of[symbol][(i, j) if of[symbol].ndim == 2 else i] = sign * value
    of["W_minus_B"] = np.array(vehicle.weight_minus_buoyancy)
    of["BG"] = np.array(vehicle.restoring_moment)
    of["inflow_loss"] = np.array(vehicle.coefficient("inflow_loss"))
    return of


def function_text(vehicle: Vehicle) -> str:
    """Return the file without its opening comment."""
    text, thrusters = template("model.m.in"), template("thrusters.m.in")
    names = ", ".join(each.name for each in vehicle.thrusters)
    count = len(vehicle.thrusters) or 6
    of = matrices_of(vehicle)
    values = {name: _rows(matrix) if matrix.ndim == 2 else _row(matrix) for name, matrix in of.items()}
    values |= {name: _number(float(of[name])) for name in ("W_minus_B", "inflow_loss")}
    values |= {
        "name": name_beside("\n".join((text, thrusters, *_WORDS)), vehicle)[:_LONGEST],
        "inputs": _wrapped(f"commands: {names}") if names else "wrench [ X Y Z K M N ]' (N, N m) about CO",
        "count": str(count),
        "rest": _row(commands_ahead(vehicle)[0]) + "'",
        "B": _rows(configuration_matrix(vehicle) if vehicle.thrusters else np.eye(6)),
        "lag": _row([each.time_constant for each in vehicle.thrusters]),
        "thrusters": filled(thrusters, _curves(vehicle)) if vehicle.thrusters else "",
    }
    return filled(text.replace("@@name@", "\x00@name@"), values).replace("\x00", "@").rstrip("\n") + "\n"


def _wrapped(text: str, width: int = 100) -> str:
    """Return a text in lines of a comment, below the word `ui`."""
    lines = [""]
    for word in text.split():
        if len(lines[-1]) + len(word) > width:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return "\n%             ".join(lines)


def _curves(vehicle: Vehicle) -> dict[str, str]:
    once, which = curves_of(vehicle)
    return {
        "curves": ", ...\n".join(f"    struct({_fields(entry)})" for entry in once),
        "curve_of": _row([k + 1 for k in which]),
        "gain": _row([each.gain for each in vehicle.thrusters]),
    }


def _fields(entry: Entry) -> str:
    fields = []
    for key, value in entry.items():
        if isinstance(value, str):
            text = f"'{value}'"
        elif isinstance(value, tuple):
            text = _row(value[::-1] if key in _POWERS else value)
        else:
            text = "[]" if value is None else _number(value)
        fields.append(f"'{key}', {text}")
    return ", ...\n           ".join(fields)


def _number(value: float) -> str:
    value = float(value) + 0.0
    return f"{value:.0f}" if value == int(value) and abs(value) < 1e15 else repr(value)


def _row(values: ArrayLike | Sequence[float]) -> str:
    return f"[{', '.join(_number(float(each)) for each in np.asarray(values, dtype=np.float64).ravel())}]"


def _rows(matrix: Array) -> str:
    return "\n".join("    " + ", ".join(_number(float(each)) for each in row) for row in matrix)
