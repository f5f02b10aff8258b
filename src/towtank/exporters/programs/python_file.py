"""Target `python`: the model as one file that needs NumPy alone, with the class of the Python Vehicle Simulator.

The code is a template (`templates/model.py.in`); here stand the numbers that go into it. Curves of thrusters are put
into plain words and numbers here (`curves_of`) for all targets whose language has no such records.
"""

from __future__ import annotations

import keyword
import math
import re
import textwrap
from collections.abc import Iterable, Mapping

import numpy as np

from towtank.core.arrays import Array
from towtank.exporters.heading import Heading
from towtank.exporters.programs.c99 import prefix_of, unit_of_field, values_of
from towtank.exporters.request import Kept, Request, speed_range
from towtank.exporters.templates import filled, template
from towtank.vehicle import (
    Curve,
    PolynomialCurve,
    QuadraticCurve,
    TableCurve,
    Vehicle,
    allocatable_axes,
    allocate,
    configuration_matrix,
    force_range,
    forward_dynamics,
    thruster_wrench,
)

__all__ = ["Entry", "cases", "commands_ahead", "curves_of", "kept", "name_beside", "python_text", "written"]

Entry = dict[str, str | float | tuple[float, ...] | None]
_CASES = 4
_SHARE = 0.2  # of the full thrust ahead, in the step: more of it turns some ROVs over in pitch


def kept(request: Request) -> Kept:
    """Return what the file keeps: all but the delay of the commands."""
    return Kept(request.vehicle.model_copy(update={"command_delay": 0.0}))


def written(request: Request, heading: Heading) -> dict[str, bytes]:
    """Return the file."""
    return {"model.py": (heading.commented("# ") + python_text(request.vehicle)).encode()}


def python_text(vehicle: Vehicle) -> str:
    """Return the file without its opening comment."""
    text = template("model.py.in")
    name = name_beside(text, vehicle)
    rest, ahead = (_wrapped(repr([float(each) + 0.0 for each in row])).lstrip() for row in commands_ahead(vehicle))
    values = {
        "title": name,
        "class": name,
        "name": ascii(vehicle.name),
        "parameters": "\n".join(_parameters(values_of(vehicle))),
        "curves": "\n".join(_curves(vehicle)),
        "thrusters": "\n".join(_thrusters(vehicle)),
        "axes": repr(sorted(allocatable_axes(vehicle)) if vehicle.thrusters else []),
        "delay": repr(vehicle.command_delay),
        "weight": repr(vehicle.weight),
        "length": repr(_length(vehicle)),
        "ahead": ahead,
        "rest": rest,
        "cases": "\n".join(_case_lines(vehicle)),
    }
    return filled(text, values)


def name_beside(text: str, vehicle: Vehicle) -> str:
    """Return the vehicle's name as an identifier that is no word of a program's text."""
    name = prefix_of(vehicle)
    return f"{name}_vehicle" if keyword.iskeyword(name) or re.search(rf"\b{name}\b", text) else name


def _parameters(values: Mapping[str, float]) -> Iterable[str]:
    for name, value in values.items():
        if value != 0.0:
            yield f'    "{name}": {value!r},  # {unit_of_field(name)}'


def _length(vehicle: Vehicle) -> float:
    """Return the length [m] of the homogeneous box that has the vehicle's mass and moments of inertia."""
    I = vehicle.rigid_body.tensor
    square = 6.0 * float(I[1, 1] + I[2, 2] - I[0, 0]) / vehicle.rigid_body.mass
    return round(math.sqrt(max(square, 0.0)), 3)


def _curve_entry(curve: Curve) -> Entry:
    """Return a curve as words and numbers: its kind, what belongs to the kind, and what all kinds have.

    Kinds are "polynomial", "branches" (one polynomial ahead of neutral, one astern), "table" and "quadratic".
    """
    entry: Entry = {"kind": "table", "neutral": curve.rest}
    if isinstance(curve, PolynomialCurve) and not curve.odd:
        entry |= {"kind": "polynomial", "coefficients": curve.coefficients, "scale": curve.scale}
    elif isinstance(curve, PolynomialCurve):
        signs = curve.branch_signs
        astern = curve.coefficients if curve.reverse is None else curve.reverse
        entry |= {"kind": "branches", "ahead": curve.coefficients, "astern": astern, "scale": curve.scale}
        entry |= {"sign_ahead": signs[0], "sign_astern": signs[1]}
    elif isinstance(curve, TableCurve):
        entry |= {"command": curve.command, "force": curve.force}
    elif isinstance(curve, QuadraticCurve):
        entry |= {"kind": "quadratic", "ahead": curve.forward}
        entry["astern"] = curve.forward if curve.reverse is None else curve.reverse
    entry |= {"dead_band": curve.dead_band, "limits": curve.limits, "voltage": None}
    if (voltage := curve.voltage) is not None:
        reverse = voltage.exponent if voltage.reverse_exponent is None else voltage.reverse_exponent
        entry["voltage"] = (voltage.nominal, voltage.exponent, reverse)
    return entry


def curves_of(vehicle: Vehicle) -> tuple[list[Entry], list[int]]:
    """Return the vehicle's curves, each once, and which of them each thruster has."""
    each = [_curve_entry(thruster.curve) for thruster in vehicle.thrusters]
    once = [entry for k, entry in enumerate(each) if entry not in each[:k]]
    return once, [once.index(entry) for entry in each]


def _curves(vehicle: Vehicle) -> Iterable[str]:
    for entry in curves_of(vehicle)[0]:
        yield "    {"
        for key, value in entry.items():
            yield _wrapped(f'"{key}": {value!r},'.replace("'", '"'))
        yield "    },"


def _wrapped(text: str) -> str:
    return textwrap.fill(text, 106, initial_indent=" " * 8, subsequent_indent=" " * 12)


def _thrusters(vehicle: Vehicle) -> Iterable[str]:
    for each, curve in zip(vehicle.thrusters, curves_of(vehicle)[1], strict=True):
        place, way = ([float(x) + 0.0 for x in vector] for vector in (each.position, each.direction))
        yield "    {"
        yield f'        "name": "{each.name}",'
        yield f'        "position": {place},'
        yield f'        "direction": {way},'
        yield f'        "curve": {curve},'
        yield f'        "gain": {each.gain!r},'
        yield f'        "time_constant": {each.time_constant!r},'
        yield "    },"


def commands_ahead(vehicle: Vehicle) -> tuple[Array, Array]:
    """Return commands (n,) at rest, and such as push ahead with a fifth of what the thrusters can do.

    Where they cannot push ahead it is along the first axis that they can. Without thrusters both are wrenches.
    """
    wrench = np.zeros(6)
    if not vehicle.thrusters:
        wrench[0] = 0.1 * vehicle.weight
        return np.zeros(6), wrench
    ends = np.array([force_range(each.curve) for each in vehicle.thrusters])
    ends = np.abs(np.where(np.isfinite(ends), ends, 1.0)).min(axis=1) * [each.gain for each in vehicle.thrusters]
    axis = min(allocatable_axes(vehicle), key=lambda i: i > 0)
    wrench[axis] = _SHARE * float(np.abs(configuration_matrix(vehicle)[axis]) @ ends)
    return np.array([each.curve.rest for each in vehicle.thrusters]), allocate(vehicle, wrench)


def cases(vehicle: Vehicle) -> list[tuple[Array, ...]]:
    """Return states, wrenches, accelerations; commands and their wrench, for a program that tests itself."""
    rng = np.random.default_rng(1)
    speeds = speed_range(vehicle)
    scale = np.abs(vehicle.mass_matrix @ speeds) + 1.0
    found: list[tuple[Array, ...]] = []
    rest, ahead = commands_ahead(vehicle)
    for _ in range(_CASES):
        eta = rng.uniform(-1.0, 1.0, 6) * [5.0, 5.0, 5.0, 3.0, 1.5, 3.0]
        nu, tau = rng.uniform(-1.0, 1.0, 6) * speeds, rng.uniform(-1.0, 1.0, 6) * scale
        commands = rest + rng.uniform(-1.2, 1.2, len(rest)) * np.maximum(np.abs(ahead - rest), 1.0)
        wrench = thruster_wrench(vehicle, commands) if vehicle.thrusters else commands
        found.append((eta, nu, tau, forward_dynamics(vehicle, eta, nu, tau), commands, wrench))
    return found


def _case_lines(vehicle: Vehicle) -> Iterable[str]:
    for case in cases(vehicle):
        yield "    ("
        for row in case:
            yield _wrapped(f"{[float(each) for each in row]},")
        yield "    ),"
