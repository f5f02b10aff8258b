"""What was learned that cannot be right, in physical words: righting arms, shares of the weight, drag coefficients.

An unknown is doubted where its posterior lies beyond three deviations of the prior, in the prior's own coordinates, and
more than three deviations of its own from there: the data leave no doubt, and what was supposed does. Either the prior
is wrong (units and signs in the vehicle's file), or the log is, or the model lacks something.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from towtank.digits import estimate_text, short
from towtank.identification.model.parameters import DELAY, GAIN_PREFIX, LAG, LATENCIES, PLACES
from towtank.identification.model.prior import Prior
from towtank.identification.model.terms import AXES, Body, term_of
from towtank.identification.posterior.assembly import LogLearning
from towtank.recording.consistency import Finding
from towtank.vehicle import COEFFICIENTS, index, unit
from towtank.vehicle.names import Kind

__all__ = ["implausible", "whose_place"]

_BEYOND = 3.0  # deviations: of the prior, and of the posterior beyond these
_INERTIA = (1.0, 5.0)  # times the rigid body's
_CURRENT = 1.0  # m/s
_SIGNS = "check units, signs and the model"
_PLACED = {"imu": "the accelerometer", "dvl": "the DVL", "marker": "the point whose position is measured"}


class _Doubt(NamedTuple):
    """An unknown beyond what was supposed of it: value and deviation in SI, prior deviations, whose prior it was."""

    name: str
    value: float
    std: float
    deviations: float
    source: str


def implausible(learning: LogLearning) -> tuple[Finding, ...]:
    """Return what of a finished learning cannot be right, what lies farthest from the prior first."""
    body = _Words(learning.vehicle)
    found = {each.name: body.said(each) for each in _doubts(learning)}
    for name, text in body.impossible_inertias(learning).items():
        found[name] = f"{text}: check mass, units, thruster curves and places"
    out = [Finding(name, text, of_model=True) for name, text in found.items()]
    current = learning.current
    if current is not None and current.speed - _BEYOND * float(current.std[:2].max()) > _CURRENT:
        text = f"the water flows with {current.said}: check position, heading and frames"
        out.append(Finding("current", text, of_model=True))
    return tuple(out)


def whose_place(name: str) -> str:
    """Return in words the sensor that an unknown is the place of: `imu_x` that of the accelerometer."""
    return _PLACED[name.partition("_")[0]]


def _doubts(learning: LogLearning) -> list[_Doubt]:
    """Return the unknowns beyond their prior, farthest first."""
    posterior = learning.model.posterior
    if learning.mode is None or posterior is None:
        return []
    prior, theta, std = learning.mode.prior, learning.mode.theta, np.array(posterior.std)
    mean, covariance = prior.seen_from(theta)
    away, before = np.abs(theta - mean), np.sqrt(np.diag(covariance))
    quick = np.array([name in (DELAY, LAG) for name in prior.names]) & (theta < mean)  # thrusters may be
    beyond = np.flatnonzero((away - _BEYOND * before > _BEYOND * std) & ~quick)
    values, slopes = prior.free.values(theta), prior.free.slopes(theta)
    doubts = [
        _Doubt(prior.names[k], float(values[k]), abs(float(slopes[k])) * float(std[k]), away[k] / before[k], source)
        for k, source in ((int(k), prior.sources[k]) for k in beyond)
    ]
    return sorted(doubts, key=lambda each: -each.deviations)


class _Words(Body):
    """What coefficients of a vehicle of this size amount to."""

    def said(self, doubt: _Doubt) -> str:
        """Return a doubt in words."""
        what, check = self._physical(doubt)
        whose = "what was supposed"
        if "file" in doubt.source:
            whose = "what the file says"
        elif doubt.source == "learned before":
            whose = "what was learned before"
        return f"{what}, {doubt.deviations:.0f} deviations from {whose}: {check}"

    def _physical(self, doubt: _Doubt) -> tuple[str, str]:
        """Return what an unknown amounts to, and what to check."""
        name, value, std = doubt.name, doubt.value, doubt.std
        if name in COEFFICIENTS:
            kind, i, j = index(name)
            return _OF_KIND.get(kind, _Words._other)(self, doubt, i, j)
        if name in (DELAY, LAG):
            what = "from command to thruster" if name == DELAY else "of the thrusters, first order"
            return f"a {name} of {_ms(value, std)} {what}", "check the stamps of the commands, and their rate"
        if name.startswith(GAIN_PREFIX):
            percent = estimate_text(100.0 * value, 100.0 * std)
            thruster = name.removeprefix(GAIN_PREFIX)
            return f"thruster {thruster} gives {percent} % of its curve", "check curve, voltage, order, weed and wear"
        if name in LATENCIES:
            sensor = name.removeprefix("latency_").replace("_", " ")
            return (
                f"{sensor} arrives {_ms(abs(value), std)} {'late' if value > 0.0 else 'early'}",
                "check its stamps and filters",
            )
        if name in PLACES:
            place, sensor = estimate_text(100.0 * value, 100.0 * std), whose_place(name)
            return (
                f"{sensor} is {place} cm from the origin along {name[-1]}",
                "check units, frame and gravity",
            )
        return f"{name} is {estimate_text(value, std)}", _SIGNS

    def _inertia(self, doubt: _Doubt, i: int, j: int) -> tuple[str, str]:
        if i != j:
            text = f"the inertia coupling {doubt.name} is {_with_unit(doubt)}"
            return text, "check the places of thrusters and sensors, and the symmetry of the vehicle"
        return self.inertia_text(
            i, float(self.rigid[i]) - doubt.value, doubt.std
        ), "check mass, units and thruster curves"

    def inertia_text(self, i: int, total: float, std: float) -> str:
        """Return the total inertia of an axis in words."""
        axis, noun = AXES[i], "mass" if i < 3 else "moment of inertia"
        number = f"{estimate_text(total, std)} {axis.unit}"
        times = short(total / float(self.rigid[i]), 2)
        return f"the total {axis.name} inertia of {number} is {times} times the body's own {noun}"

    def _drag(self, doubt: _Doubt, i: int, j: int) -> tuple[str, str]:
        if i != j:
            return (
                f"the damping {doubt.name} is {_with_unit(doubt)}",
                "check frames, and places of thrusters and sensors",
            )
        axis = AXES[i].name
        check = "check units, thruster curves, and speed over ground against that through the water"
        if doubt.value > 0.0:
            return f"{axis} drag {doubt.name} {_with_unit(doubt)} drives the vehicle on", "check signs and frames"
        size = short(-2.0 * doubt.value / float(self.quadratic[i]), 2)
        at = f" at 1 {'m' if i < 3 else 'rad'}/s" if index(doubt.name)[0] == "linear" else ""
        drag = f"{axis} drag {doubt.name} {_with_unit(doubt)}"
        return f"{drag} is a drag coefficient of {size}{at}, on the face of a cube of its volume", check

    def _constant(self, doubt: _Doubt, i: int, j: int) -> tuple[str, str]:
        share = 100.0 * doubt.value / (self.weight * (1.0 if i < 3 else self.length))
        what = f"the constant {AXES[i].name} {'force' if i < 3 else 'moment'} of {_with_unit(doubt)}"
        of = "of the weight" if i < 3 else "of the weight times its size"
        return f"{what} is {short(share, 2)} % {of}", "check tether, trim and the thrusters' neutral"

    def _weight(self, doubt: _Doubt, i: int, j: int) -> tuple[str, str]:
        share = short(100.0 * doubt.value / self.weight, 2)
        text = f"a net weight of {_with_unit(doubt)} is {share} % of the weight"
        return text, "check mass, ballast, and curves and signs of the vertical thrusters"

    def _moment(self, doubt: _Doubt, i: int, j: int) -> tuple[str, str]:
        arm = short(100.0 * doubt.value / self.weight, 2)
        if doubt.name == "BG_z":
            return f"BG_z {_with_unit(doubt)} is a righting arm of {arm} cm", _SIGNS
        arm = arm.removeprefix("-")
        along = "lengthways" if doubt.name == "BG_x" else "sideways"
        return (
            f"{doubt.name} {_with_unit(doubt)} puts weight and buoyancy {arm} cm apart {along}",
            f"{_SIGNS}, and trim",
        )

    def _inflow(self, doubt: _Doubt, i: int, j: int) -> tuple[str, str]:
        share = estimate_text(100.0 * abs(doubt.value), 100.0 * doubt.std)
        verb = "lose" if doubt.value > 0.0 else "gain"
        return f"thrusters {verb} {share} % of their thrust per m/s of inflow", "check curves, current and signs"

    def _other(self, doubt: _Doubt, i: int, j: int) -> tuple[str, str]:
        term = term_of(doubt.name)
        if term.beyond is None:
            return f"the {term.noun} {doubt.name} is {_with_unit(doubt)}", term.check
        return term.beyond(i, f"{doubt.name} {_with_unit(doubt)}"), term.check

    def impossible_inertias(self, learning: LogLearning) -> dict[str, str]:
        """Return the total inertias below the rigid body's own, or far above it, by the names of their added masses."""
        out = {}
        for axis in AXES:
            total, std = _total(learning, axis.index)
            low, high = (limit * float(self.rigid[axis.index]) for limit in _INERTIA)
            if total + _BEYOND * std < low or total - _BEYOND * std > high:
                out[axis.added_mass] = self.inertia_text(axis.index, total, std)
        return out


_OF_KIND: dict[Kind, Callable[[_Words, _Doubt, int, int], tuple[str, str]]] = {
    "mass": _Words._inertia,
    "linear": _Words._drag,
    "quadratic": _Words._drag,
    "constant": _Words._constant,
    "weight": _Words._weight,
    "moment": _Words._moment,
    "inflow": _Words._inflow,
}


def _total(learning: LogLearning, axis: int) -> tuple[float, float]:
    """Return the total inertia of an axis as the data have it, before it was made physical; NaN where unknown."""
    name = AXES[axis].added_mass
    prior, posterior = learning.prior, learning.model.posterior
    known = {each.name: each for each in learning.estimate.sums}
    if AXES[axis].sum_name not in known:
        return math.nan, math.nan
    if prior is None or posterior is None or name not in prior.names:
        each = known[AXES[axis].sum_name]
        return each.value, each.std
    return _of_logarithm(prior, posterior.mean, posterior.std, name)


def _of_logarithm(prior: Prior, mean: tuple[float, ...], std: tuple[float, ...], name: str) -> tuple[float, float]:
    k = prior.names.index(name)
    total = math.exp(mean[k])
    return total, total * std[k]


def _with_unit(doubt: _Doubt) -> str:
    return f"{estimate_text(doubt.value, doubt.std)} {unit(doubt.name)}"


def _ms(value: float, std: float) -> str:
    return f"{estimate_text(1e3 * value, 1e3 * std)} ms"
