"""The small records of a vehicle: coefficient, rigid body, buoyancy, restoring, thruster, provenance. SI, body FRD.

Units of coefficients as text, compared by meaning: `N s/m` and `kg/s` are one unit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from numbers import Real
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, BeforeValidator, PlainValidator, field_validator, model_validator

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.vehicle.base import Finite, NonNegative, Positive, Record, Vector, described, listed, misplaced
from towtank.vehicle.names import unit
from towtank.vehicle.thrusters.curves import AnyCurve

__all__ = ["Buoyancy", "Coefficient", "Provenance", "Restoring", "RigidBody", "Thruster", "dimensions"]

# kg, m, s; a radian counts nothing
_BASE = {
    "kg": (1, 0, 0),
    "m": (0, 1, 0),
    "s": (0, 0, 1),
    "N": (1, 1, -2),
    "Nm": (1, 2, -2),
    "rad": (0, 0, 0),
    "1": (0, 0, 0),
}
_TOKEN = re.compile(r"([A-Za-z]+|1)(?:\^?(-?\d+))?$")
_SUPERSCRIPTS = str.maketrans({"²": "^2", "³": "^3", "·": " ", "*": " ", "⋅": " ", "/": " / ", "(": " ( ", ")": " ) "})
_Row = tuple[float, float, float]
_INERTIA = "3 numbers [I_x, I_y, I_z] or 3 rows of 3 numbers"
_UNIT_VECTOR = 1e-12
_THRUSTER_NAME = re.compile(r"[A-Za-z0-9_.-]+")


def dimensions(unit: str) -> tuple[int, int, int]:
    """Return the exponents of (kg, m, s); all that follows a slash is below it. Raises InputError if not understood."""
    total = [0, 0, 0]
    sign, in_group, group_sign = 1, False, 1
    for token in unit.translate(_SUPERSCRIPTS).split():
        if token == "/":
            sign = -1
        elif token == "(":
            in_group, group_sign = True, sign
        elif token == ")":
            in_group = False
        else:
            match = _TOKEN.match(token)
            if match is None or match[1] not in _BASE:
                raise InputError(f'unit "{unit}" is not understood at "{token}"')
            power = int(match[2] or 1) * (group_sign if in_group else sign)
            for axis, exponent in enumerate(_BASE[match[1]]):
                total[axis] += power * exponent
    return total[0], total[1], total[2]


def same_unit(first: str, second: str) -> bool:
    """Return whether two units have the same dimensions (radians ignored); False where one is not understood.

    >>> same_unit("kg m^2/(s rad)", "N m s/rad")
    True
    """
    try:
        return dimensions(first) == dimensions(second)
    except InputError:
        return False


class Coefficient(Record):
    """A value with its standard deviation, unit and origin. A bare number stands for `value` alone."""

    value: Finite
    std: NonNegative | None = None
    unit: str = ""
    source: str = ""

    @model_validator(mode="before")
    @classmethod
    def _bare_number(cls, data: Any) -> Any:
        if isinstance(data, Real) and not isinstance(data, bool):
            return {"value": data}
        if not isinstance(data, Mapping | Coefficient):
            raise ValueError(f"found {described(data)}, expected a number or {{value, std, unit, source}}")
        return data

    @classmethod
    def of(cls, change: Any, name: str) -> Coefficient:
        """Return what is given for a coefficient, in the unit of its name. Raises ValueError where it is none."""
        if isinstance(change, float) and math.isfinite(change):  # a thousand vehicles drawn are nothing else
            fields: dict[str, Any] = {"value": float(change), "std": None, "unit": unit(name), "source": ""}
            return cls.model_construct(set(fields), **fields)
        return cls.model_validate(change).with_unit(name)

    def with_unit(self, name: str) -> Coefficient:
        """Return the coefficient with the unit that belongs to its name. Raises ValueError for another unit."""
        return self.in_unit(unit(name))

    def in_unit(self, expected: str) -> Coefficient:
        """Return the value in this very unit. Raises ValueError where it has another."""
        if self.unit == expected:
            return self
        if self.unit and not same_unit(self.unit, expected):
            raise misplaced("unit", f'found "{self.unit}", expected "{expected or 1}"; convert the value to SI')
        return Coefficient(value=self.value, std=self.std, unit=expected, source=self.source)


def _number(value: Any, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise misplaced(place, f"found {described(value)}, expected a finite number")
    return float(value)


def _inertia(value: Any) -> _Row | tuple[_Row, _Row, _Row]:
    items = listed(value, _INERTIA)
    if len(items) != 3:
        raise ValueError(f"found {len(items)} items, expected {_INERTIA}")
    if not any(isinstance(row, list | tuple) for row in items):
        x, y, z = (_number(item, f"[{i}]") for i, item in enumerate(items))
        return x, y, z
    rows = [listed(row, "a row of 3 numbers") for row in items]
    for i, row in enumerate(rows):
        if len(row) != 3:
            raise misplaced(f"[{i}]", f"found {len(row)} numbers, expected 3")
        rows[i] = [_number(item, f"[{i}][{j}]") for j, item in enumerate(row)]
    for i in range(3):
        for j in range(i):
            a, b = rows[i][j], rows[j][i]
            if abs(a - b) > 1e-9 * max(abs(a), abs(b)):
                raise misplaced(f"[{i}][{j}]", f"found {a:g}, expected {b:g} as at [{j}][{i}]; the tensor is symmetric")
    first, second, third = (tuple(row) for row in rows)
    return first, second, third


class RigidBody(Record):
    """Mass [kg], inertia [kg m^2] about the centre of gravity (3 moments or the tensor), centre of gravity [m]."""

    mass: Positive
    inertia: Annotated[_Row | tuple[_Row, _Row, _Row], PlainValidator(_inertia)]
    centre_of_gravity: Vector = (0.0, 0.0, 0.0)
    source: str = ""

    @property
    def tensor(self) -> Array:
        """The inertia tensor (3, 3) about the centre of gravity; products of inertia with the sign of the tensor."""
        inertia = np.array(self.inertia)
        return np.diag(inertia) if inertia.ndim == 1 else inertia


class Buoyancy(Record):
    """Buoyant force [N] (omitted: equal to the weight) and its centre [m]."""

    force: NonNegative | None = None
    centre: Vector = (0.0, 0.0, 0.0)
    source: str = ""


class Restoring(Record):
    """Measured restoring quantities; each that is given takes precedence over rigid body and buoyancy.

    W_minus_B [N]; BG_x, BG_y, BG_z = r_G W - r_B B [N m/rad].
    """

    W_minus_B: Coefficient | None = None
    BG_x: Coefficient | None = None
    BG_y: Coefficient | None = None
    BG_z: Coefficient | None = None

    @field_validator("W_minus_B", "BG_x", "BG_y", "BG_z", mode="after")
    @classmethod
    def _unit(cls, value: Coefficient | None, info: Any) -> Coefficient | None:
        return None if value is None else value.with_unit(info.field_name)


def _direction(value: _Row) -> _Row:
    """Return the unit vector; one that is a unit vector already stays bit for bit."""
    norm = math.hypot(*value)
    if norm == 0.0 or not math.isfinite(norm):
        raise ValueError("found the zero vector, expected the direction of the force at positive command")
    if abs(norm - 1.0) <= _UNIT_VECTOR:
        return value
    x, y, z = (component / norm for component in value)
    return x, y, z


def _thruster_name(value: Any) -> str:
    if not isinstance(value, str) or not _THRUSTER_NAME.fullmatch(value):
        raise ValueError(f"found {described(value)}, expected letters, digits, _ . - (it names the column cmd_<name>)")
    return value


class Thruster(Record):
    """A thruster: where it pushes [m], which way at positive command, its curve, what its force is of it, lag [s]."""

    name: Annotated[str, BeforeValidator(_thruster_name)]
    position: Vector
    direction: Annotated[Vector, AfterValidator(_direction)]
    curve: AnyCurve
    gain: Positive = 1.0
    time_constant: NonNegative = 0.0
    source: str = ""


class Provenance(Record):
    """Where the numbers come from, and what is doubtful about them."""

    source: str = ""
    notes: tuple[str, ...] = ()
