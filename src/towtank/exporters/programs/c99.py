"""Target `c`: the model as one C99 header that is C++ as well, with thrusters, allocation, a step and a self-test.

The code is a template (`templates/model.h`); here stand the numbers that go into it. Parameters are a struct of SNAME
names, so that a program can change any of them and have the model prepared anew.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from towtank.core.arrays import Array
from towtank.core.attitude import eulers_from_quaternions
from towtank.core.rk4 import simulate_run
from towtank.exporters.heading import Heading
from towtank.exporters.request import Kept, Request, speed_range
from towtank.exporters.templates import filled, template
from towtank.vehicle import (
    COEFFICIENTS,
    Curve,
    PolynomialCurve,
    QuadraticCurve,
    TableCurve,
    Thruster,
    Vehicle,
    allocatable_axes,
    allocate,
    configuration_matrix,
    curve_force,
    force_range,
    forward_dynamics,
    index,
    thruster_forces,
    unit,
)
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = ["FIELDS", "header_text", "kept", "prefix_of", "unit_of_field", "values_of", "written"]

_CASES, _CASE_STEP = 8, 0.01  # s
_KINDS = {"odd": 0, "polynomial": 1, "table": 2, "quadratic": 3}
_FUNCTIONS = ("fabs", "sqrt", "cos", "sin", "atan2", "asin", "pow", "exp")
_RIGID = ("m", "I_x", "I_y", "I_z", "I_xy", "I_xz", "I_yz", "x_G", "y_G", "z_G")
_RIGID_UNITS = ("kg", *("kg m^2",) * 6, *("m",) * 3)
_LONGEST = 40  # letters of the vehicle's name in an identifier
_SAMPLES = 513  # of a branch, to see whether it falls in between
_DIGITS = {  # of double and of float: tolerance of the self-test and of allocation in it, bisections, largest number
    False: {"tolerance": "1e-11", "allocated": "1e-7", "bisections": "80", "largest": "1e300", "nothing": "1e-12"},
    True: {"tolerance": "2e-4", "allocated": "2e-3", "bisections": "32", "largest": "1e37f", "nothing": "1e-6f"},
}


def _upper_mass(name: str) -> bool:
    kind, i, j = index(name)
    return kind != "mass" or i <= j


FIELDS: tuple[str, ...] = (*_RIGID, *(name for name in COEFFICIENTS if _upper_mass(name)))  # of the struct, in order


def kept(request: Request) -> Kept:
    """Return what the header keeps: all but the delay of the commands."""
    vehicle = request.vehicle
    return Kept(vehicle.model_copy(update={"command_delay": 0.0}))


def written(request: Request, heading: Heading) -> dict[str, bytes]:
    """Return the header."""
    text = header_text(request.vehicle, single="float" in request.options)
    return {"model.h": ("/*\n" + heading.commented(" * ") + " */\n" + text).encode()}


def prefix_of(vehicle: Vehicle) -> str:
    """Return the vehicle's name as the beginning of a C identifier."""
    name = re.sub(r"[^a-z0-9]+", "_", vehicle.name.lower()).strip("_")[:_LONGEST].rstrip("_") or "vehicle"
    return name if name[0].isalpha() else f"v_{name}"


def header_text(vehicle: Vehicle, *, single: bool = False, prefix: str | None = None) -> str:
    """Return the header without its opening comment.

    Args:
        single: in single precision. prefix: of every name; default: the vehicle's own.
    """
    text = template("model.h")
    if not vehicle.thrusters:
        text = re.sub(r"/\* BEGIN THRUSTERS \*/\n.*?/\* END THRUSTERS \*/\n", "", text, flags=re.DOTALL)
    text = re.sub(r"/\* (BEGIN|END) THRUSTERS \*/\n", "", text)
    number = _Number(single)
    values = {
        "real": "float" if single else "double",
        "thrusters": str(len(vehicle.thrusters)),
        "columns": str(max(len(vehicle.thrusters), 1)),
        "fields": "\n".join(_field(name) for name in FIELDS),
        "values": "\n".join(f"    p.{name} = {number(value)};" for name, value in values_of(vehicle).items()),
        "added": _names(lambda i, j: f"{ROWS[i]}_{COLUMNS[j]}dot" if i <= j else ""),
        "linear": _names(lambda i, j: f"{ROWS[i]}_{COLUMNS[j]}"),
        "quadratic": _names(lambda i, j: f"{ROWS[i]}_{COLUMNS[j] * 2}"),
        "even": "\n".join(_even()),
        "configuration": number.rows(configuration_matrix(vehicle) if vehicle.thrusters else np.zeros((6, 1))),
        **({f: f + "f" if single else f for f in _FUNCTIONS}),
        **_DIGITS[single],
        **(_thrusters(vehicle, number) if vehicle.thrusters else {}),
        **_vectors(vehicle, number),
    }
    text = filled(text, values)
    name = prefix or prefix_of(vehicle)
    return re.sub(r"\bTT_", f"{name.upper()}_", re.sub(r"\btt_", f"{name}_", text))


class _Number:
    """Numbers as C writes them."""

    def __init__(self, single: bool) -> None:
        self._single = single

    def __call__(self, value: float) -> str:
        value = float(value) + 0.0
        return f"{np.format_float_scientific(np.float32(value), trim='0')}f" if self._single else repr(value)

    def row(self, values: ArrayLike) -> str:
        """Return numbers with commas between."""
        return ", ".join(self(each) for each in np.asarray(values, dtype=np.float64).ravel())

    def rows(self, matrix: Array) -> str:
        """Return the rows of a matrix in braces, one on each line."""
        return ",\n".join(f"        {{ {self.row(row)} }}" for row in matrix)


def unit_of_field(name: str) -> str:
    """Return the unit of a field of the struct."""
    return _RIGID_UNITS[_RIGID.index(name)] if name in _RIGID else unit(name)


def _field(name: str) -> str:
    return f"    tt_real {name};{' ' * max(14 - len(name), 1)}/* {unit_of_field(name)} */"


def values_of(vehicle: Vehicle) -> dict[str, float]:
    """Return the fields of the struct."""
    body = vehicle.rigid_body
    I = body.tensor
    rigid = (body.mass, I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2], *body.centre_of_gravity)
    each = dict(zip(_RIGID, (float(value) for value in rigid), strict=True))
    return {name: each[name] if name in each else vehicle.coefficient(name) for name in FIELDS}


def _names(name: object) -> str:
    rows = []
    for i in range(6):
        row = [name(i, j) for j in range(6)]  # type: ignore[operator]
        rows.append("        { " + ", ".join(f"p->{each}" if each else "zero" for each in row) + " }")
    return ",\n".join(rows)


def _even() -> Iterable[str]:
    """Yield the lines that put terms even in the velocity in their places."""
    for name in COEFFICIENTS:
        kind, i, j = index(name)
        if kind == "forward":
            yield f"    out.forward[{i}][{j}] = p->{name};"
    for name in COEFFICIENTS:
        kind, i, _ = index(name)
        if kind == "asymmetric":
            yield f"    out.asymmetry[{i}] = p->{name};"


# -- thrusters


def _thrusters(vehicle: Vehicle, number: _Number) -> dict[str, str]:
    arrays: dict[str, str] = {}
    entries = [_curve(thruster, number, arrays) for thruster in vehicle.thrusters]
    numbers = [f"    static const tt_real {name}[] = {{ {text} }};" for text, name in arrays.items()]
    table = ["    static const tt_curve curves[] = {", ",\n".join(entries), "    };"]
    T = configuration_matrix(vehicle)
    axes = list(allocatable_axes(vehicle))
    inverse = np.zeros((len(vehicle.thrusters), 6))
    inverse[:, axes] = np.linalg.pinv(T[axes])
    return {"curves": "\n".join([*numbers, *table]), "allocation": number.rows(inverse)}


def _curve(thruster: Thruster, number: _Number, arrays: dict[str, str]) -> str:
    """Return the entry of a thruster; its arrays are added to `arrays`, each once."""

    def array(values: Sequence[float]) -> str:
        return arrays.setdefault(number.row(values), f"c{len(arrays)}")

    curve = thruster.curve
    kind = "quadratic"
    a: tuple[float, ...] = (0.0,)
    b: tuple[float, ...] = (0.0,)
    signs, scale = (1.0, 1.0), 1.0
    if isinstance(curve, PolynomialCurve):
        kind, scale = ("odd" if curve.odd else "polynomial"), curve.scale
        a, b = curve.coefficients, curve.coefficients if curve.reverse is None else curve.reverse
        signs = curve.branch_signs
    elif isinstance(curve, TableCurve):
        kind, a, b = "table", curve.command, curve.force
    elif isinstance(curve, QuadraticCurve):
        a = b = (curve.forward, curve.forward if curve.reverse is None else curve.reverse)
    low, high = (0.0, 0.0) if curve.limits is None else curve.limits
    voltage = curve.voltage
    nominal, exponent, reverse = 0.0, 0.0, 0.0
    if voltage is not None:
        nominal, exponent = voltage.nominal, voltage.exponent
        reverse = exponent if voltage.reverse_exponent is None else voltage.reverse_exponent
    least, most = (each if np.isfinite(each) else 0.0 for each in force_range(curve))
    branches = [_branch(curve, sign) for sign in (-1, 1)]
    head = (_KINDS[kind], int(curve.limits is not None), len(a), len(b), array(a), array(b))
    floats = (
        *(curve.rest, curve.dead_band, low, high, scale, thruster.gain, thruster.time_constant),
        *(*signs, nominal, exponent, reverse, least, most),
    )
    pairs = [[f"{each[k]:d}" for each in branches] for k in (0, 1)]
    pairs += [[number(each[k]) for each in branches] for k in (2, 3)]
    braces = ", ".join(f"{{ {', '.join(pair)} }}" for pair in pairs)
    return f"        {{ {', '.join(map(str, head))}, {', '.join(number(each) for each in floats)}, {braces} }}"


def _branch(curve: Curve, sign: int) -> tuple[int, bool, float, float]:
    """Return the side of neutral that makes a sign of force, whether it falls in between, its end, its largest force.

    Ends and places are distances from neutral; an end of 0 is none.
    """
    for side in (1, -1):
        ends = []
        if curve.limits is not None:
            ends.append(side * (curve.limits[(side + 1) // 2] - curve.rest))
        if isinstance(curve, TableCurve):
            ends.append(side * (curve.command[-1 if side > 0 else 0] - curve.rest))
        end = max(min(ends), 0.0) if ends else None
        if end is not None and end <= curve.dead_band:
            continue
        a = np.linspace(curve.dead_band, max(2.0 * curve.dead_band, 1.0) if end is None else end, _SAMPLES)
        if isinstance(curve, TableCurve):
            knots = side * (np.array(curve.command) - curve.rest)
            a = np.unique(np.concatenate([a, knots[(knots > a[0]) & (knots < a[-1])]]))
        f = curve.static(curve.rest + side * a)
        of = 1 if f[np.argmax(np.abs(f))] > 0.0 else -1
        if of != sign or not np.any(of * f > 0.0):
            continue
        reached = np.maximum.accumulate(np.maximum(of * f, 0.0))
        falls = bool(np.any(reached - of * f > 1e-12 * reached[-1]))
        full = float(a[np.searchsorted(reached, reached[-1])])
        return side, falls, 0.0 if end is None else end, 0.0 if end is None else full
    return 0, False, 0.0, 0.0


# -- what the self-test knows


def _vectors(vehicle: Vehicle, number: _Number) -> dict[str, str]:
    """Return cases: state, wrench, current; acceleration and state after a step; commands, their wrench, allocation."""
    rng = np.random.default_rng(1)
    speeds, p = speed_range(vehicle), np.array(vehicle.parameters)
    scale = np.abs(vehicle.mass_matrix @ speeds) + 1.0
    rows = []
    for _ in range(_CASES):
        q = rng.standard_normal(4)
        q /= np.linalg.norm(q)
        nu, tau = rng.uniform(-1.0, 1.0, 6) * speeds, rng.uniform(-1.0, 1.0, 6) * scale
        current = rng.uniform(-0.5, 0.5, 3)
        x = np.concatenate([rng.uniform(-5.0, 5.0, 3), q, nu])
        eta = np.concatenate([np.zeros(3), eulers_from_quaternions(q[None, :])[0]])
        after = simulate_run(p, x, tau[None, None, :], _CASE_STEP, np.zeros(3))[1]  # as the water sees it
        after[:3] += _CASE_STEP * current
        row = [x, tau, current, forward_dynamics(vehicle, eta, nu, tau), after]
        if vehicle.thrusters:
            commands = np.array([_command(each.curve, rng.uniform(-1.0, 1.0)) for each in vehicle.thrusters])
            wrench = thruster_forces(vehicle, commands) @ configuration_matrix(vehicle).T
            row += [commands, wrench]
        rows.append(np.concatenate(row))
    table = np.array(rows)
    if vehicle.thrusters:
        table = np.hstack([table, allocate(vehicle, table[:, -6:])])
    return {"cases": str(_CASES), "case_numbers": str(table.shape[1]), "vectors": number.rows(table)}


def _command(curve: Curve, share: float) -> float:
    """Return a command at a share -1 .. 1 of what the thruster takes."""
    low, high = (curve.rest - 1.0, curve.rest + 1.0) if curve.limits is None else curve.limits
    if isinstance(curve, TableCurve) and curve.limits is None:
        low, high = curve.command[0], curve.command[-1]
    command = curve.rest + share * ((high - curve.rest) if share > 0.0 else (curve.rest - low))
    return float(command) if float(curve_force(curve, command)) != 0.0 else curve.rest
