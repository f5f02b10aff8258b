"""Thruster curves: command -> force.

Three kinds share the keys of `Curve`. The command is first clamped to `limits`; within `dead_band` of the neutral
command (|command - neutral| < dead_band) the force is zero; `voltage` scales the force with the supply,
F = F_nominal (V / V_nominal)^exponent, with an exponent of its own for negative force where given.
NaN in, NaN out.

Thruster curves backwards: force -> command.

Each side of the neutral command is one branch. On a branch the smallest command that reaches the force is taken, so a
polynomial that dips is no trouble. A force beyond the end saturates at the command of the largest force. Within the
dead band nothing can be had: a force smaller than half of the first step gives the neutral command, a larger one the
edge of the dead band.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from towtank.core.arrays import Array
from towtank.vehicle.base import Finite, NonNegative, Numbers, Pair, Positive, Record, misplaced

__all__ = [
    "AnyCurve",
    "Curve",
    "PolynomialCurve",
    "QuadraticCurve",
    "TableCurve",
    "Voltage",
    "command",
    "force",
    "force_range",
    "is_of_unit_scale",
]

_SAMPLES = 1025
_BISECTIONS = 56
_DOUBLINGS = 60


class Voltage(Record):
    """How force grows with supply voltage: (V / nominal)^exponent; `reverse_exponent` for negative force."""

    nominal: Positive
    exponent: Finite
    reverse_exponent: Finite | None = None


class Curve(Record):
    """What all kinds of curves share. Commands are in whatever unit the vehicle takes (PWM us, per cent, rad/s)."""

    neutral: Finite | None = None
    dead_band: NonNegative = 0.0
    limits: Pair | None = None
    fitted_range: Pair | None = None
    voltage: Voltage | None = None
    source: str = ""

    @property
    def rest(self) -> float:
        """The command at which the thruster rests: `neutral`, or 0 where it is not given."""
        return 0.0 if self.neutral is None else self.neutral

    def static(self, command: Array) -> Array:
        """Return the force [N] at nominal voltage, without limits and dead band."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _ordered(self) -> Curve:
        if self.limits is not None:
            low, high = self.limits
            if not low < high:
                raise misplaced("limits", f"found [{low:g}, {high:g}], expected [lowest, highest]")
            if not low <= self.rest <= high:
                raise misplaced(
                    "limits",
                    f"found [{low:g}, {high:g}], expected them to enclose the neutral command {self.rest:g}"
                    "; set neutral",
                )
        if self.fitted_range is not None and not self.fitted_range[0] < self.fitted_range[1]:
            raise misplaced("fitted_range", "expected [lowest, highest] of |command - neutral|")
        return self


class PolynomialCurve(Curve):
    """Polynomial in a = |command - neutral| / scale with `coefficients` in rising powers.

    `odd` (default): above neutral F = P(a), below F = -P(a). With `reverse` the second branch has its own polynomial,
    F = -R(a). A branch never pushes against the sign it has at its end: there the force is zero (a fitted
    polynomial is often slightly negative just above the dead band). `odd = false`: F = P((command - neutral) / scale)
    as it stands.
    """

    kind: Literal["polynomial"] = "polynomial"
    coefficients: Annotated[Numbers, Field(min_length=1)]
    reverse: Annotated[Numbers, Field(min_length=1)] | None = None
    odd: bool = True
    scale: Positive = 1.0

    @model_validator(mode="after")
    def _one_meaning(self) -> PolynomialCurve:
        if self.reverse is not None and not self.odd:
            raise misplaced("reverse", "has no meaning with odd = false; drop one of the two")
        return self

    def static(self, command: Array) -> Array:
        """Return the force [N] at nominal voltage, without limits and dead band."""
        x = np.asarray((command - self.rest) / self.scale)
        if not self.odd:
            return np.asarray(polyval(x, np.array(self.coefficients)))
        force = np.where(np.isnan(x), np.nan, 0.0)
        branches = (self.coefficients, self.coefficients if self.reverse is None else self.reverse)
        for side, coefficients, sign in zip((1.0, -1.0), branches, self.branch_signs, strict=True):
            there = side * x > 0.0
            if there.any():
                f = polyval(side * x[there], np.array(coefficients))
                force[there] = side * (np.maximum(f, 0.0) if sign > 0.0 else np.minimum(f, 0.0))  # no wrong sign
        return force

    @property
    def branch_signs(self) -> tuple[float, float]:
        """The sign, +1 or -1, that the polynomial has at the end of the branch above neutral, and of the one below."""
        low, high = (0.0, 0.0) if self.limits is None else (abs(each - self.rest) / self.scale for each in self.limits)
        reverse = self.coefficients if self.reverse is None else self.reverse
        return _sign_at(self.coefficients, high), _sign_at(reverse, low)


@lru_cache(4096)
def _sign_at(coefficients: tuple[float, ...], end: float) -> float:
    """Return the sign of a polynomial at its end, +1 or -1; that of its highest power where the end is 0."""
    value = float(polyval(end, np.array(coefficients))) if end else 0.0
    if value == 0.0:
        value = next((c for c in reversed(coefficients) if c != 0.0), 0.0)
    return 1.0 if value >= 0.0 else -1.0


class TableCurve(Curve):
    """Linear interpolation between rising `command` values; beyond the ends the end values hold.

    The neutral command, where not given, is where the force passes zero (the middle of a stretch of zeros).
    """

    kind: Literal["table"] = "table"
    command: Annotated[Numbers, Field(min_length=2)]
    force: Annotated[Numbers, Field(min_length=2)]

    @model_validator(mode="after")
    def _rising(self) -> TableCurve:
        if len(self.command) != len(self.force):
            raise misplaced("force", f"found {len(self.force)} values, expected {len(self.command)}, one per command")
        for k in range(1, len(self.command)):
            if not self.command[k] > self.command[k - 1]:
                raise misplaced(
                    f"command[{k}]",
                    f"found {self.command[k]:g} after {self.command[k - 1]:g}, expected rising commands",
                )
        return self

    @property
    def rest(self) -> float:
        """The command at which the thruster rests."""
        if self.neutral is not None:
            return self.neutral
        f, c = np.array(self.force), np.array(self.command)
        zeros = c[f == 0.0]
        if zeros.size:
            return float(0.5 * (zeros[0] + zeros[-1]))
        crossing = np.flatnonzero(f[:-1] * f[1:] < 0.0)
        if crossing.size:
            k = crossing[0]
            return float(c[k] - f[k] * (c[k + 1] - c[k]) / (f[k + 1] - f[k]))
        return float(c[np.argmin(np.abs(f))])

    def static(self, command: Array) -> Array:
        """Return the force [N] at nominal voltage, without limits and dead band."""
        return np.asarray(np.interp(command, self.command, self.force))


class QuadraticCurve(Curve):
    """F = `forward` d|d| above neutral and `reverse` d|d| below, d = command - neutral; reverse = forward if absent."""

    kind: Literal["quadratic"] = "quadratic"
    forward: Finite
    reverse: Finite | None = None

    def static(self, command: Array) -> Array:
        """Return the force [N] at nominal voltage, without limits and dead band."""
        d = command - self.rest
        reverse = self.forward if self.reverse is None else self.reverse
        return np.where(d >= 0.0, self.forward, reverse) * d * np.abs(d)


AnyCurve = Annotated[PolynomialCurve | TableCurve | QuadraticCurve, Field(discriminator="kind")]


def voltage_factor(curve: Curve, force: Array, voltage: ArrayLike | None) -> Array:
    """Return (V / V_nominal)^exponent by the sign of `force`; 1 where the curve or the voltage is not given."""
    if voltage is None or curve.voltage is None:
        return np.ones_like(force)
    ratio = np.asarray(voltage, dtype=np.float64) / curve.voltage.nominal
    ratio = np.where(ratio >= 0.0, ratio, np.nan)
    reverse = curve.voltage.exponent if curve.voltage.reverse_exponent is None else curve.voltage.reverse_exponent
    return np.where(force < 0.0, ratio**reverse, ratio**curve.voltage.exponent)


def force(curve: Curve, command: ArrayLike, voltage: ArrayLike | None = None) -> Array:
    """Return the force [N] of a thruster at steady state.

    Args:
        command: any shape, in the unit of the curve; clamped to the limits; NaN gives NaN.
        voltage: supply voltage [V], broadcast against `command`; ignored by a curve without `voltage`.
    """
    c = np.asarray(command, dtype=np.float64)
    if curve.limits is not None:
        c = np.clip(c, *curve.limits)
    f = curve.static(c)
    if curve.dead_band > 0.0:
        f = np.where(np.abs(c - curve.rest) < curve.dead_band, 0.0, f)
    factor = voltage_factor(curve, f, voltage)
    with np.errstate(invalid="ignore"):
        return np.asarray(f * factor)


@dataclass(frozen=True)
class _Branch:
    """One side of a curve: distances a from the neutral command, and the largest |force| up to each."""

    side: int  # +1 above the neutral command, -1 below
    sign: int  # of the force
    a: Array
    reached: Array
    bounded: bool


@lru_cache(64)
def _branch(curve: Curve, side: int, demand: float) -> _Branch | None:
    """Return the branch on one side, long enough for `demand` [N]; None where it has no length or no force."""
    start = curve.dead_band
    end = _end(curve, side)
    bounded = end is not None
    if end is None:
        end = max(2.0 * start, 1.0)
        for _ in range(_DOUBLINGS):
            if abs(float(curve.static(np.array(curve.rest + side * end)))) >= demand:
                break
            end *= 2.0
    if end <= start:
        return None
    a = np.linspace(start, end, _SAMPLES)
    if isinstance(curve, TableCurve):
        knots = side * (np.array(curve.command) - curve.rest)
        a = np.unique(np.concatenate(([start, end], knots[(knots > start) & (knots < end)])))
    f = curve.static(curve.rest + side * a)
    sign = 1 if f[np.argmax(np.abs(f))] > 0.0 else -1
    reached = np.maximum.accumulate(np.maximum(sign * f, 0.0))
    return _Branch(side, sign, a, reached, bounded) if reached[-1] > 0.0 else None


def _end(curve: Curve, side: int) -> float | None:
    """Return how far from neutral the commands go on one side; None without limits."""
    ends = []
    if curve.limits is not None:
        ends.append(side * (curve.limits[(side + 1) // 2] - curve.rest))
    if isinstance(curve, TableCurve):
        ends.append(side * (curve.command[-1 if side > 0 else 0] - curve.rest))
    return max(min(ends), 0.0) if ends else None


def _branches(curve: Curve, demand: float) -> dict[int, _Branch]:
    """Return the branch that serves each sign of force (above the neutral command first)."""
    found: dict[int, _Branch] = {}
    for side in (1, -1):
        branch = _branch(curve, side, demand if _end(curve, side) is None else 0.0)
        if branch is not None:
            found.setdefault(branch.sign, branch)
    return found


def force_range(curve: Curve, voltage: float | None = None) -> tuple[float, float]:
    """Return the most negative and the most positive force [N] of a curve; infinite without limits."""
    ends = {-1: 0.0, 1: 0.0}
    for sign, branch in _branches(curve, 0.0).items():
        reach = float(branch.reached[-1]) if branch.bounded else np.inf
        ends[sign] = sign * reach * float(voltage_factor(curve, np.array(float(sign)), voltage))
    return ends[-1], ends[1]


def command(curve: Curve, force: ArrayLike, voltage: ArrayLike | None = None) -> Array:
    """Return the command that makes `force` [N], nearest where it cannot be had.

    Args:
        force: any shape; NaN gives NaN.
        voltage: supply voltage [V], broadcast against `force`; ignored by a curve without `voltage`.
    """
    f = np.asarray(force, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.where(f == 0.0, f, f / voltage_factor(curve, f, voltage))
    out = np.where(np.isnan(f), np.nan, curve.rest)
    finite = np.abs(f[np.isfinite(f)])
    for sign, branch in _branches(curve, float(finite.max(initial=0.0))).items():
        wanted = (sign * f) > 0.0
        if np.any(wanted):
            demands, places = np.unique(np.abs(f[wanted]), return_inverse=True)
            out[wanted] = curve.rest + branch.side * _distance(curve, branch, demands)[places]
    return np.asarray(out)


def _distance(curve: Curve, branch: _Branch, demand: Array) -> Array:
    """Return how far from neutral to go for each |force| in `demand` (k,)."""
    k = np.searchsorted(branch.reached, demand, side="left")
    saturated = k == branch.a.size
    below = k == 0
    full = branch.a[np.searchsorted(branch.reached, branch.reached[-1])]
    k = np.clip(k, 1, branch.a.size - 1)
    low, high = branch.a[k - 1], branch.a[k]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        if np.all((middle == low) | (middle == high)):
            break  # neighbours
        enough = branch.sign * curve.static(curve.rest + branch.side * middle) >= demand
        low, high = np.where(enough, low, middle), np.where(enough, middle, high)
    step = np.where(demand > 0.5 * branch.reached[0], branch.a[0], 0.0)
    return np.where(saturated, full, np.where(below, step, high))


def is_of_unit_scale(curve: Curve) -> bool:
    """Whether a curve only says that force grows with the command: nobody measured it."""
    if curve.source:
        return False
    match curve:
        case QuadraticCurve():
            return abs(curve.forward) == 1.0 and (curve.reverse is None or abs(curve.reverse) == 1.0)
        case PolynomialCurve():
            return _is_one(curve.coefficients) and (curve.reverse is None or _is_one(curve.reverse))
        case TableCurve():
            return max(abs(force) for force in curve.force) == 1.0
    return False


def _is_one(coefficients: tuple[float, ...]) -> bool:
    return [abs(c) for c in coefficients if c != 0.0] == [1.0]
