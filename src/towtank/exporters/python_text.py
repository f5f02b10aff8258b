"""Numbers, matrices and thrusters as a generated Python program writes them: every digit, the same text each time."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from towtank.vehicle import PolynomialCurve, QuadraticCurve, TableCurve, Thruster, Vehicle

__all__ = ["matrix", "number", "row", "thrusters_text"]


def number(value: float) -> str:
    """Return a number in full, without negative zeros."""
    return repr(float(value) + 0.0)


def row(values: ArrayLike) -> str:
    """Return numbers with commas between, without brackets."""
    return ", ".join(number(each) for each in np.asarray(values, dtype=np.float64).ravel())


def matrix(values: ArrayLike) -> str:
    """Return the rows of a matrix, one on each line, indented by four."""
    return "\n".join(f"    [{row(each)}]," for each in np.asarray(values, dtype=np.float64))


def thrusters_text(vehicle: Vehicle) -> str:
    """Return the curves of all thrusters, a dictionary on each line, indented by four."""
    return "\n".join(f"    {{{', '.join(_entries(each))}}}," for each in vehicle.thrusters)


def _entries(thruster: Thruster) -> Iterable[str]:
    """Yield the keys and values of a thruster's dictionary."""
    curve = thruster.curve
    yield f'"name": "{thruster.name}"'
    yield f'"gain": {number(thruster.gain)}'
    yield f'"lag": {number(thruster.time_constant)}'
    yield f'"rest": {number(curve.rest)}'
    yield f'"dead_band": {number(curve.dead_band)}'
    yield f'"limits": {"None" if curve.limits is None else _tuple(curve.limits)}'
    voltage = curve.voltage
    if voltage is None:
        yield '"voltage": None'
    else:
        reverse = voltage.exponent if voltage.reverse_exponent is None else voltage.reverse_exponent
        yield f'"voltage": {_tuple((voltage.nominal, voltage.exponent, reverse))}'
    match curve:
        case PolynomialCurve(odd=False):
            yield f'"kind": "polynomial", "scale": {number(curve.scale)}, "coefficients": {_tuple(curve.coefficients)}'
        case PolynomialCurve():
            reverse_branch = curve.coefficients if curve.reverse is None else curve.reverse
            yield f'"kind": "branches", "scale": {number(curve.scale)}, "signs": {_tuple(curve.branch_signs)}'
            yield f'"ahead": {_tuple(curve.coefficients)}, "astern": {_tuple(reverse_branch)}'
        case TableCurve():
            yield f'"kind": "table", "command": {_tuple(curve.command)}, "force": {_tuple(curve.force)}'
        case QuadraticCurve():
            reverse_factor = curve.forward if curve.reverse is None else curve.reverse
            yield f'"kind": "quadratic", "ahead": {number(curve.forward)}, "astern": {number(reverse_factor)}'


def _tuple(values: Iterable[float]) -> str:
    numbers = [number(each) for each in values]
    return f"({', '.join(numbers)}{',' if len(numbers) == 1 else ''})"
