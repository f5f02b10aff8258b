"""Thruster curves: command -> force.

Three kinds share the keys of `Curve`. The command is first clamped to `limits`; within `dead_band` of the neutral
command (|command - neutral| < dead_band) the force is zero; `voltage` scales the force with the supply,
F = F_nominal (V / V_nominal)^exponent, with an exponent of its own for negative force where given.
NaN in, NaN out.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from towtank.core.arrays import Array
from towtank.vehicle.base import Finite, NonNegative, Numbers, Pair, Positive, Record, misplaced

__all__ = ["AnyCurve", "Curve", "PolynomialCurve", "QuadraticCurve", "TableCurve", "Voltage", "force", "voltage_factor"]


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
        x = (command - self.rest) / self.scale
        if not self.odd:
            return np.asarray(polyval(x, np.array(self.coefficients)))
        a = np.abs(x)
        forward = self._branch(a, self.coefficients, 1)
        reverse = self._branch(a, self.coefficients if self.reverse is None else self.reverse, 0)
        return np.where(np.isnan(x), np.nan, np.where(x > 0.0, forward, np.where(x < 0.0, -reverse, 0.0)))

    def _branch(self, a: Array, coefficients: tuple[float, ...], side: int) -> Array:
        """Return the polynomial with the part of the wrong sign cut off."""
        end = None if self.limits is None else abs(self.limits[side] - self.rest) / self.scale
        value = float(polyval(end, np.array(coefficients))) if end else 0.0
        if value == 0.0:
            value = next((c for c in reversed(coefficients) if c != 0.0), 0.0)
        f = polyval(a, np.array(coefficients))
        return np.asarray(np.maximum(f, 0.0) if value >= 0.0 else np.minimum(f, 0.0))


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
