"""A thruster curve from bench measurements, with a report of how well it fits.

The curve is fitted at one supply voltage, the nominal one: a polynomial of the distance from neutral per direction
(degree 2, as in the paper), or the measured points as a table. The dead band is where the bench shows no force. The
exponents of the supply voltage, one per direction, come from the largest forces at each voltage,
F = F_nominal (V / V_nominal)^exponent.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.polynomial.polynomial import polyfit, polyval

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.vehicle.thrusters.bench import Bench, read_bench
from towtank.vehicle.thrusters.curves import Curve, PolynomialCurve, TableCurve, Voltage, force

__all__ = ["DirectionFit", "ThrusterFit", "VoltageFit", "fit_bench", "fit_thruster"]

_NO_FORCE = 0.002  # of the largest force
_PWM_NEUTRAL = 1500.0


@dataclass(frozen=True)
class DirectionFit:
    """One direction at the nominal voltage. R^2 and rmse [N] over the samples outside the dead band."""

    samples: int
    r_squared: float
    rmse: float
    largest_force: float


@dataclass(frozen=True)
class VoltageFit:
    """One supply voltage: its data, and how the curve (with its voltage exponents) predicts it."""

    voltage: float | None
    command: Array
    force: Array
    predicted: Array
    dead_band: tuple[float, float] | None
    largest_forward: float
    largest_reverse: float
    rmse: float


@dataclass(frozen=True)
class ThrusterFit:
    """A fitted curve and its report. `forward` is the direction of commands above neutral."""

    curve: Curve
    command_name: str
    source: str
    nominal_voltage: float | None
    dead_band: tuple[float, float] | None
    forward: DirectionFit | None
    reverse: DirectionFit | None
    asymmetry: float | None
    rmse: float
    voltages: tuple[VoltageFit, ...]


def fit_thruster(
    path: str | os.PathLike[str],
    *,
    kind: Literal["polynomial", "table"] = "polynomial",
    degree: int = 2,
    nominal_voltage: float | None = None,
    command: str | None = None,
    force: str | None = None,
    voltage: str | None = None,
) -> ThrusterFit:
    """Fit the bench data of a CSV; columns are found by name or given by `command`, `force`, `voltage`.

    Raises:
        InputError: the file cannot be read, or does not determine the curve.
    """
    bench = read_bench(path, command=command, force=force, voltage=voltage)
    return fit_bench(bench, kind=kind, degree=degree, nominal_voltage=nominal_voltage)


def fit_bench(
    bench: Bench,
    *,
    kind: Literal["polynomial", "table"] = "polynomial",
    degree: int = 2,
    nominal_voltage: float | None = None,
) -> ThrusterFit:
    """Fit bench data at the nominal voltage (default: the middle one of those measured, of two the higher).

    Raises:
        InputError: an unknown kind, a degree below 1, a voltage that was not measured, or too few samples.
    """
    if kind not in ("polynomial", "table"):
        raise InputError(f'kind: found "{kind}", expected polynomial or table')
    if degree < 1:
        raise InputError(f"degree: found {degree}, expected 1 or more")
    groups = bench.groups()
    nominal = _nominal(bench, groups, nominal_voltage)
    supply, c, f = groups[nominal]
    if not np.any(f != 0.0):
        raise InputError(f"{bench.source}: all forces are zero; expected measured forces")
    dead = _dead_band(c, f)
    neutral = _neutral(c, f, dead)
    half_band = 0.5 * (dead[1] - dead[0]) if dead else 0.0
    outside = np.abs(c - neutral) > half_band
    up, down = outside & (c > neutral), outside & (c < neutral)
    limits = (min(float(c[0]), neutral), max(float(c[-1]), neutral))
    law = _voltage_law(groups, nominal)
    source = f"fit to {bench.source}" + ("" if supply is None else f" at {supply:g} V")
    curve: Curve
    if kind == "table":
        if c.size < 2:
            raise InputError(f"{bench.source}: found {c.size} different commands, expected at least 2")
        curve = TableCurve(
            command=tuple(c), force=tuple(np.where(outside, f, 0.0)), neutral=neutral, voltage=law, source=source
        )
    else:
        scale = float(np.max(np.abs(c - neutral)))
        forward = _polynomial(bench, (c[up] - neutral) / scale, f[up], degree, "above")
        reverse = _polynomial(bench, (neutral - c[down]) / scale, -f[down], degree, "below")
        curve = PolynomialCurve(
            coefficients=forward or (0.0,),
            reverse=reverse or (0.0,),
            scale=scale,
            neutral=neutral,
            dead_band=half_band,
            limits=limits,
            voltage=law,
            source=source,
        )
    fits = tuple(_voltage_fit(curve, *group) for group in groups)
    directions = [_direction(c[rows], f[rows], curve) for rows in (up, down)]
    top, bottom = fits[nominal].largest_forward, fits[nominal].largest_reverse
    errors = np.concatenate([fit.predicted - fit.force for fit in fits])
    return ThrusterFit(
        curve=curve,
        command_name=bench.command_name,
        source=bench.source,
        nominal_voltage=supply,
        dead_band=dead,
        forward=directions[0],
        reverse=directions[1],
        asymmetry=top / bottom if bottom > 0.0 and top > 0.0 else None,
        rmse=_rms(errors),
        voltages=fits,
    )


def _nominal(bench: Bench, groups: list[tuple[float | None, Array, Array]], wanted: float | None) -> int:
    if wanted is None:
        return len(groups) // 2
    supplies = [supply for supply, _, _ in groups if supply is not None]
    if not supplies:
        raise InputError(f"{bench.source}: no column of supply voltages, so nominal_voltage cannot be chosen")
    nearest = int(np.argmin(np.abs(np.array(supplies) - wanted)))
    if abs(supplies[nearest] - wanted) > 0.05 * wanted:
        raise InputError(
            f"{bench.source}: nominal voltage {wanted:g} V was not measured"
            f"; found {', '.join(f'{s:g}' for s in supplies)} V"
        )
    return nearest


def _dead_band(c: Array, f: Array) -> tuple[float, float] | None:
    """Return the first and last command of the stretch without force; None where the bench shows none."""
    quiet = np.abs(f) <= _NO_FORCE * np.max(np.abs(f))
    quiet &= ~((c == c[0]) | (c == c[-1]))
    if not np.any(quiet):
        return None
    middle = int(np.flatnonzero(quiet)[np.argmin(np.abs(f[quiet]))])
    first = last = middle
    while first > 0 and quiet[first - 1]:
        first -= 1
    while last < c.size - 1 and quiet[last + 1]:
        last += 1
    return (float(c[first]), float(c[last])) if last > first else None


def _neutral(c: Array, f: Array, dead: tuple[float, float] | None) -> float:
    """Return the middle of the dead band, else the round zero of the command's unit where the force changes sign."""
    if dead is not None:
        return 0.5 * (dead[0] + dead[1])
    change = np.flatnonzero(np.sign(f[:-1]) * np.sign(f[1:]) <= 0.0)
    for usual in (0.0, _PWM_NEUTRAL):
        if c[0] <= usual <= c[-1]:
            near = any(c[k] <= usual <= c[k + 1] for k in change)
            if near or change.size == 0:
                return usual
    if change.size:
        k = int(change[0])
        return float(c[k] - f[k] * (c[k + 1] - c[k]) / (f[k + 1] - f[k])) if f[k] != f[k + 1] else float(c[k])
    return _PWM_NEUTRAL if c[0] > 0.5 * _PWM_NEUTRAL else 0.0


def _polynomial(bench: Bench, a: Array, f: Array, degree: int, side: str) -> tuple[float, ...] | None:
    if a.size == 0:
        return None
    if a.size < degree + 1:
        raise InputError(
            f"{bench.source}: found {a.size} commands {side} neutral with force"
            f", expected at least {degree + 1} for degree {degree}"
        )
    return tuple(_readable(value) for value in polyfit(a, f, degree))


def _readable(value: float) -> float:
    """Return a fitted number with the seven digits that are worth a place in a vehicle file."""
    return float(f"{value:.7g}")


def _voltage_law(groups: list[tuple[float | None, Array, Array]], nominal: int) -> Voltage | None:
    """Return the exponents from the largest force at each voltage; None with fewer than two voltages."""
    supply = groups[nominal][0]
    if supply is None or len(groups) < 2:
        return None
    volts = np.log([voltage for voltage, _, _ in groups if voltage is not None])
    exponents = []
    for sign in (1.0, -1.0):
        largest = np.array([np.max(sign * f) for _, _, f in groups])
        exponents.append(_readable(polyfit(volts, np.log(largest), 1)[1]) if np.all(largest > 0.0) else None)
    forward, reverse = exponents
    if forward is None:
        return None if reverse is None else Voltage(nominal=supply, exponent=reverse)
    return Voltage(nominal=supply, exponent=forward, reverse_exponent=reverse)


def _direction(c: Array, f: Array, curve: Curve) -> DirectionFit | None:
    if c.size == 0:
        return None
    shape = _unclamped(curve, c) if isinstance(curve, PolynomialCurve) else curve.static(c)
    errors = f - shape
    spread = float(np.sum((f - f.mean()) ** 2))
    r_squared = 1.0 - float(np.sum(errors**2)) / spread if spread > 0.0 else 1.0
    return DirectionFit(int(c.size), r_squared, _rms(errors), float(np.max(np.abs(f))))


def _unclamped(curve: PolynomialCurve, c: Array) -> Array:
    """Return the fitted polynomial itself, without the part that the curve cuts off near the dead band."""
    x = (c - curve.rest) / curve.scale
    reverse = polyval(np.abs(x), np.array(curve.reverse or (0.0,)))
    return np.asarray(np.where(x > 0.0, polyval(np.abs(x), np.array(curve.coefficients)), -reverse))


def _voltage_fit(curve: Curve, supply: float | None, c: Array, f: Array) -> VoltageFit:
    predicted = force(curve, c, supply)
    return VoltageFit(
        voltage=supply,
        command=c,
        force=f,
        predicted=predicted,
        dead_band=_dead_band(c, f),
        largest_forward=float(np.max(f, initial=0.0)),
        largest_reverse=float(np.max(-f, initial=0.0)),
        rmse=_rms(predicted - f),
    )


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2)))
