"""What is supposed of every plausible coefficient before any data: the vehicle's file where it speaks, else physics.

Nothing is chosen: every coefficient that a body of this kind may have is free, with a mean and a deviation. The data
narrow them. Where the file has a value, that is the mean, with its deviation, or half of it where none is stated. Where
it is silent, the size of the body says what is plausible. With m and I_i the rigid body, L = (m/rho)^(1/3) the edge of
a cube of water of its mass, a_i = 1.7 sqrt(I_i/m) the arm of hull and fins, W = m g:

    total inertia        1.7 m, 1.6 I_i, a factor of exp(0.5) either way
    its couplings        0 +- 0.24 sqrt(M_i M_j), of a body that is the same to port and starboard
    quadratic damping    -g +- 2 g, g = rho L^2, rotation rho L^2 a_i^3
    linear damping       -l +- 2 l, l = 0.1 rho L^2 (1 m/s), rotation 0.1 rho L^2 a_i^2; couplings 0 +- sqrt(l_i l_j)
    drag ahead, astern   0 +- 0.3 of the quadratic damping
    thrust, inflow       0 +- 0.2 of the thrust lost per m/s of water through the thruster
    net weight, BG       0 +- 0.01 W; BG_z 0.02 W L +- 0.1 W L, BG_x and BG_y 0 +- 0.02 W L
    constant wrench      0 +- 0.005 m/s^2 m, 0.01 rad/s^2 I_i
    inputs               delay 0.08 +- 0.06 s, lag 0.1 s and a factor of exp(0.8), gains 1 +- 8 %

Inertias, lag and gains are positive and are supposed log-normal; all else is normal. Damping is a plain number: as a
logarithm that starts far too small it has no gradient and stays there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.core.layout import INFLOW, N_KINDS
from towtank.identification.model.parameters import (
    DELAY,
    GAIN_PREFIX,
    IN_GAIN,
    LAG,
    UNTRANSFORMED,
    FreeParameters,
    free_parameters,
)
from towtank.vehicle import COEFFICIENTS, Vehicle
from towtank.vehicle.matrices import GRAVITY
from towtank.vehicle.names import COLUMNS, ROWS
from towtank.vehicle.posterior import Posterior
from towtank.vehicle.thrusters.curves import is_of_unit_scale

__all__ = ["Belief", "belief"]

_WATER = 1000.0  # kg/m^3
_ADDED = (1.7, 1.6)  # total inertia, of the rigid body's: translation, rotation
_INERTIA_STD = 0.5  # of ln total inertia
_COUPLING_STD = 0.24  # of sqrt(M_i M_j)
_ARM = 1.7  # of the gyradius
_SPREAD = 2.0  # of damping, as a share of its mean
_NET_WEIGHT, _RIGHTING, _RIGHTING_STD, _TRIM_STD = 0.01, 0.02, 0.1, 0.02  # of W, W L
_CONSTANT = (0.005, 0.01)  # m/s^2, rad/s^2
_ASYMMETRY_STD = 0.3  # of the quadratic damping
_STATED = 0.5  # deviation of what the file states without one, as a share of it
_DELAY, _LAG, _LAG_STD, _GAIN_STD = (0.08, 0.06), 0.1, 0.8, 0.08
_LATENCY = (0.05, 0.1)  # s
_INFLOW = (0.0, 0.2)  # s/m
_NO_SCALE = 1.0  # deviation of the logarithm of a scale of force that nobody measured
_INERTIAS = ((0, 2), (0, 4), (2, 4), (1, 3), (1, 5), (3, 5))  # couplings of a body that is the same to both sides
_OTHER_DAMPING = {f"{r}_{c}": f"{r}_{c * 2}" for r, c in zip(ROWS, COLUMNS, strict=True)}
_OTHER_DAMPING |= {quadratic: linear for linear, quadratic in _OTHER_DAMPING.items()}
_DAMPINGS = ((1, 5), (5, 1), (2, 4), (4, 2), (1, 3), (3, 1), (0, 4), (4, 0))


@dataclass(frozen=True, eq=False)
class Belief:
    """What is supposed of all unknowns.

    Attributes:
        mean, covariance: (n,), (n, n) in the coordinates of `free`. sources: where each comes from.
        reference: deviations (n,) before any data were seen at all; a learned file knows more than that.
    """

    free: FreeParameters
    mean: Array
    covariance: Array
    sources: tuple[str, ...]
    reference: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns."""
        return self.free.names

    @property
    def std(self) -> Array:
        """Deviations (n,) in the coordinates of `free`."""
        return np.sqrt(np.diag(self.covariance))

    def only(self, names: Sequence[str]) -> Belief:
        """Return what is supposed of these names alone."""
        rows = [k for k, name in enumerate(self.names) if name in names]
        return Belief(
            self.free.subset(names),
            self.mean[rows],
            self.covariance[np.ix_(rows, rows)],
            tuple(self.sources[k] for k in rows),
            self.reference[rows],
        )

    def seen_from(self, theta: Array) -> tuple[Array, Array]:
        """Return mean (n,) and covariance (n, n) as they are close to theta (n,).

        Data tell forces in proportion to the common scale g of the thrusters, the mean of their gains: c / g, however
        uncertain c and g are. As a Gaussian in c that is so about its mean only; elsewhere two views that differ by
        little would agree best where all forces are small (Peelle's puzzle). So c / g is what is kept, and c about
        theta is c_0 g / g_0 (1 + d ln g) to first order.
        """
        kind, gains = self.free.codes[:, 0], self.free.codes[:, 0] == IN_GAIN
        if not gains.any():
            return self.mean, self.covariance
        forces = (kind < N_KINDS) & (kind != INFLOW) & (self.free.codes[:, 3] == UNTRANSFORMED)
        share = gains / gains.sum()
        away = float(share @ (theta - self.mean))
        grown = np.where(forces, np.exp(away), 1.0)
        turn = np.diag(grown) + np.outer(np.where(forces, theta - grown * self.mean, 0.0), share)
        mean = grown * self.mean - np.where(forces, theta, 0.0) * away
        return mean, np.asarray(turn @ self.covariance @ turn.T)

    @property
    def vehicle_values(self) -> dict[str, float]:
        """The coefficients among the means, by name, in their own units."""
        values = self.free.values(self.mean)
        return {name: float(v) for name, v in zip(self.names, values, strict=True) if name in COEFFICIENTS}


@dataclass(frozen=True)
class Line:
    """Mean and deviation of one unknown, in its own unit; of one that is log-normal the deviation of the logarithm."""

    mean: float
    std: float
    source: str


class _Body:
    """The sizes that physics gives a vehicle's coefficients."""

    def __init__(self, vehicle: Vehicle) -> None:
        rigid = np.diag(vehicle.rigid_body_matrix)
        self.vehicle, self.rigid, self.m = vehicle, rigid, float(rigid[0])
        self.length = (self.m / _WATER) ** (1.0 / 3.0)
        self.weight = self.m * GRAVITY
        self.total = rigid * np.array([_ADDED[0]] * 3 + [_ADDED[1]] * 3)
        arm = np.concatenate([np.ones(3), _ARM * np.sqrt(rigid[3:] / self.m)])
        area = _WATER * self.length**2
        self.quadratic = area * arm**3
        self.linear = 0.1 * area * arm**2

    def lines(self, *, commands: bool) -> dict[str, Line]:
        """Return the line of every plausible coefficient."""
        out: dict[str, Line] = {}
        for i in range(6):
            row, column = ROWS[i], COLUMNS[i]
            kind = "mass" if i < 3 else "inertia about this axis"
            added = self.rigid[i] - self.total[i]
            out[f"{row}_{column}dot"] = Line(added, _INERTIA_STD, f"{_ADDED[i > 2]:g} times the rigid body's {kind}")
        for i in range(6):
            g, l = self.quadratic[i], self.linear[i]
            size = "displaced volume" if i < 3 else "displaced volume and radius of gyration"
            out[f"{ROWS[i]}_{COLUMNS[i]}"] = Line(-l, _SPREAD * l, size)
            out[f"{ROWS[i]}_{COLUMNS[i] * 2}"] = Line(-g, _SPREAD * g, size)
        for i, j in _INERTIAS:
            std = _COUPLING_STD * math.sqrt(self.total[i] * self.total[j])
            out[f"{ROWS[i]}_{COLUMNS[j]}dot"] = Line(0.0, std, "a hull that is the same to port and starboard")
        for i, j in _DAMPINGS:
            std = math.sqrt(self.linear[i] * self.linear[j])
            out[f"{ROWS[i]}_{COLUMNS[j]}"] = Line(0.0, std, "a hull that is the same to port and starboard")
        for i in range(6):
            std = _ASYMMETRY_STD * self.quadratic[i]
            out[f"{ROWS[i]}_{COLUMNS[i]}2"] = Line(0.0, std, "drag that differs one way and the other")
        if self.vehicle.thrusters and commands:
            out["inflow_loss"] = Line(*_INFLOW, "propellers as they usually are")
        out["W_minus_B"] = Line(0.0, _NET_WEIGHT * self.weight, "a vehicle trimmed to 1 % of its weight")
        arm = self.weight * self.length
        out["BG_z"] = Line(_RIGHTING * arm, _RIGHTING_STD * arm, "weight and displaced volume")
        for name in ("BG_x", "BG_y"):
            out[name] = Line(0.0, _TRIM_STD * arm, "a vehicle that floats level")
        for i in (0, 1, 3, 4, 5):
            std = _CONSTANT[i > 2] * float(self.rigid[i])
            out[f"{ROWS[i]}_0"] = Line(0.0, std, "thrusters that differ, a tether")
        return out


def belief(
    vehicle: Vehicle,
    *,
    commands: bool = True,
    late: Sequence[str] = (),
    beside: Vehicle | None = None,
) -> Belief:
    """Return what is supposed of a vehicle.

    Args:
        commands: it is driven by thruster commands, so that delay, lag and gains are unknown; by a wrench that was
            measured or computed, only a delay is.
        late: `latency_<sensor>` of the sensors whose clock is not that of the others.
        beside: another vehicle, which counts where it says something: one whose coefficients bear deviations, or that
            was learned.
    """
    lines = {name: _stated(vehicle, name, line) for name, line in _Body(vehicle).lines(commands=commands).items()}
    for name in vehicle.hydrodynamics:
        if name not in lines and not _mirrored(name, lines):
            lines[name] = _stated(vehicle, name, Line(0.0, 0.0, ""))
    if beside is not None:
        lines = {name: _stated(beside, name, line, "the prior's file") for name, line in lines.items()}
    lines |= _inputs(vehicle, commands=commands)
    lines |= {name: Line(*_LATENCY, "what sensors need to compute and send") for name in late}
    plain = [name for name in lines if name in COEFFICIENTS and not name.endswith("dot")]
    free = free_parameters(vehicle, tuple(lines)).untransformed(plain)
    kept = [lines[name] for name in free.names]
    mean, std = free.thetas(np.array([line.mean for line in kept])), np.array([line.std for line in kept])
    covariance = np.diag(std**2)
    gains = [k for k, name in enumerate(free.names) if name.startswith(GAIN_PREFIX)]
    covariance[np.ix_(gains, gains)] = _gain_covariance(vehicle, len(gains))
    physics = Belief(free, mean, covariance, tuple(line.source for line in kept), np.sqrt(np.diag(covariance)))
    learned = vehicle.posterior if beside is None or beside.posterior is None else beside.posterior
    return physics if learned is None else _gone_on(physics, learned)


def _gain_covariance(vehicle: Vehicle, n: int) -> Array:
    """Return the covariance (n, n) of the logarithms of thrusters' gains.

    Each differs from its curve by itself; what all have in common is as sure as `scale_std` says where the file has it,
    and nearly unknown where curves are of unit scale, which nobody measured.
    """
    own = _GAIN_STD**2 * np.eye(n)
    scale = vehicle.scale_std
    if scale is None and n and all(is_of_unit_scale(thruster.curve) for thruster in vehicle.thrusters):
        scale = _NO_SCALE
    if scale is None or not n:
        return own
    common = np.full((n, n), 1.0 / n)
    return np.asarray(own - _GAIN_STD**2 * common + n * max(scale, 1e-4) ** 2 * common)


def _gone_on(physics: Belief, learned: Posterior) -> Belief:
    """Return what was learned before, of all unknowns that it knows of, and physics of the others."""
    rows = [physics.names.index(name) for name in learned.names if name in physics.names]
    known = [k for k, name in enumerate(learned.names) if name in physics.names]
    mean, covariance, reference = physics.mean.copy(), physics.covariance.copy(), physics.reference.copy()
    mean[rows] = np.array(learned.mean)[known]
    covariance[rows] = 0.0
    covariance[:, rows] = 0.0
    covariance[np.ix_(rows, rows)] = learned.covariance[np.ix_(known, known)]
    reference[rows] = np.array(learned.prior_std)[known]
    sources = list(physics.sources)
    for k in rows:
        sources[k] = "learned before"
    return Belief(physics.free, mean, covariance, tuple(sources), reference)


def _mirrored(name: str, lines: Mapping[str, Line]) -> bool:
    return name.endswith("dot") and any(other.endswith("dot") and {*other} == {*name} for other in lines)


def _stated(vehicle: Vehicle, name: str, line: Line, source: str = "the vehicle's file") -> Line:
    """Return the line with what a vehicle's file says of it.

    A file that has one damping term of an axis says that the other is nothing, or little.
    """
    value, std = vehicle.coefficient(name), vehicle.deviation(name)
    if value == 0.0 and std is None:
        if vehicle.coefficient(_OTHER_DAMPING.get(name, name)) != 0.0:
            return Line(0.0, 0.5 * line.std, f"{source}, which has {_OTHER_DAMPING[name]} alone")
        return line
    if std is None:
        std, source = _STATED * abs(value), f"{source}, which states no deviation: half of it"
    if name.endswith("dot") and ROWS.index(name[0]) == COLUMNS.index(name[2]):
        i = ROWS.index(name[0])
        total = float(vehicle.rigid_body_matrix[i, i]) - value
        return Line(value, max(std / total, 1e-6), source)
    return Line(value, max(std, 1e-9), source)


def _inputs(vehicle: Vehicle, *, commands: bool) -> dict[str, Line]:
    delay = vehicle.command_delay or _DELAY[0]
    out = {DELAY: Line(delay, _DELAY[1], "autopilots and thrusters as they usually are")}
    if commands:
        known = [thruster.time_constant for thruster in vehicle.thrusters if thruster.time_constant > 0.0]
        lag, std = (float(np.mean(known)), _STATED) if known else (_LAG, _LAG_STD)
        out[LAG] = Line(lag, std, "the vehicle's file" if known else "thrusters as they usually are")
        for thruster in vehicle.thrusters:
            out[GAIN_PREFIX + thruster.name] = Line(1.0, _GAIN_STD, "thrusters differ by a few percent")
    return out
