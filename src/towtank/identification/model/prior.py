"""What is supposed of every plausible coefficient before any data: the vehicle's file where it speaks, else physics.

Nothing is chosen: every coefficient that a body of this kind may have is free, with a mean and a deviation. The data
narrow them. Where the file has a value, that is the mean, with its deviation, or half of it where none is stated. Where
it is silent, the size of the body says what is plausible. A line of the table [prior] stands above both, and what was
learned before above all: a learned file's posterior has taken the rest in. With m and I_i the rigid body,
L = (m/rho)^(1/3) the edge of a cube of water of its mass, a_i = 1.7 sqrt(I_i/m) the arm of hull and fins, W = m g:

    total inertia        1.7 m, 1.6 I_i, a factor of exp(0.5) either way
    its couplings        0 +- 0.24 sqrt(M_i M_j), of a body that is the same to port and starboard; X_wdot and K_rdot,
                         by which principal axes tilt, 0 +- 0.1 sqrt(M_i M_j)
    quadratic damping    -g +- 2 g, g = rho L^2, rotation rho L^2 a_i^3
    linear damping       -l +- 2 l, l = 0.1 rho L^2 (1 m/s), rotation 0.1 rho L^2 a_i^2; couplings 0 +- sqrt(l_i l_j)
    drag ahead, astern   0 +- 0.3 of the quadratic damping (surge, heave, pitch), 0.03 (sway, roll, yaw)
    thrust, inflow       0 +- 0.15 of the thrust lost per m/s of water through the thruster
    forward-speed terms  0 +- rho L^2 times the arms, of a vehicle that goes ahead
    net weight, BG       0 +- 0.01 W; BG_z 0.02 W L +- 0.1 W L, BG_x and BG_y 0 +- 0.02 W L
    constant wrench      0 +- 0.005 m/s^2 m, 0.01 rad/s^2 I_i
    sensors              latency 0.05 +- 0.1 s, place 0 +- 0.1 m (accelerometer), else the largest gyradius
    inputs               delay 0.08 +- 0.06 s, lag 0.1 +- 0.08 s, gains 1 +- 8 %

Inertias and gains are positive and are supposed log-normal; all else is normal. Damping is a plain number: as a
logarithm that starts far too small it has no gradient and stays there.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.errors import InputError, nearest
from towtank.identification.data.samples import Samples
from towtank.identification.model.measurements import ATTITUDE, RATES, SENSORS, SPECIFIC_FORCE
from towtank.identification.model.parameters import (
    DELAY,
    GAIN_PREFIX,
    IMU_PLACE,
    IN_GAIN,
    LAG,
    LATENCIES,
    PLACED,
    PLACES,
    FreeParameters,
    free_parameters,
    unknowns_of,
)
from towtank.identification.model.terms import AHEAD, TERMS, Body, Line, term_of
from towtank.recording.frames.rotations import conjugate, rotate
from towtank.vehicle import COEFFICIENTS, Vehicle
from towtank.vehicle.names import COLUMNS, KINDS, ROWS, index
from towtank.vehicle.posterior import named, stated_coordinate
from towtank.vehicle.thrusters.curves import is_of_unit_scale

__all__ = ["Prior", "further_unknowns", "prior_of"]

_PRIORS_FILE = "the prior's file"
_STATED = 0.5  # deviation of what the file states without one, as a share of it
_DELAY, _LAG, _GAIN_STD = (0.08, 0.06), (0.1, 0.08), 0.08
_PLACE = 0.1  # m
_PACE = 0.5  # s between two poses that give the speed ahead
_SAME_ROWS = 0.9  # of the rows of two sensors, from which they are one device
_SURER = 0.5  # times the deviation of the scale, below which a force is known by itself
_NO_SCALE = 1.0  # deviation of the logarithm of a scale of force that nobody measured
_OTHER_DAMPING = {f"{r}_{c}": f"{r}_{c * 2}" for r, c in zip(ROWS, COLUMNS, strict=True)}
_OTHER_DAMPING |= {quadratic: linear for linear, quadratic in _OTHER_DAMPING.items()}


@dataclass(frozen=True, eq=False)
class Prior:
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

    @property
    def values(self) -> Array:
        """Means (n,), each in its own unit: added inertias, not totals; gains as multiples of the file's."""
        return self.free.values(self.mean)

    @property
    def value_std(self) -> Array:
        """Deviations (n,) in these units; of what is log-normal to first order."""
        return np.asarray(np.abs(self.free.slopes(self.mean)) * self.std)

    def only(self, names: Sequence[str]) -> Prior:
        """Return what is supposed of these names alone."""
        rows = [k for k, name in enumerate(self.names) if name in names]
        return Prior(
            self.free.subset(names),
            self.mean[rows],
            self.covariance[np.ix_(rows, rows)],
            tuple(self.sources[k] for k in rows),
            self.reference[rows],
        )

    def narrowed_to(self, free: Collection[str] | None, *, delay_given: bool) -> Prior:
        """Return what is supposed of the names that are free where somebody named them, of the lag of the thrusters,
        and of the delay unless given: who names coefficients says nothing of when their forces act.

        The place of a sensor is free as a whole, where a part of it is named or somebody knows that it is elsewhere.

        Raises:
            InputError: a name that is no unknown.
        """
        for name in free or ():
            if name not in self.names:
                raise InputError(f'free: "{name}" is not a coefficient of the prior{nearest(name, self.names)}')
        names = self.names
        if free is not None:
            mean = dict(zip(self.names, self.mean, strict=True))
            known = [place for place in PLACED.values() if set(place) <= mean.keys()]
            placed = [place for place in known if any(name in free or mean[name] != 0.0 for name in place)]
            names = tuple(dict.fromkeys([*free, DELAY, LAG, *(name for place in placed for name in place)]))
        return self.only([name for name in names if not (delay_given and name == DELAY)])

    def with_rows(self, rows: Sequence[int], mean: Array, covariance: Array, reference: Array, source: str) -> Prior:
        """Return it with rows that owe nothing to the rest: mean and covariance as a vehicle's posterior has them."""
        means, block, before, sources = self.mean.copy(), self.covariance.copy(), self.reference.copy(), [*self.sources]
        signs = self.free.signs[rows]
        means[rows], before[rows] = np.where(signs < 0.0, self.free.rigid[rows] - mean, mean), reference
        block[rows] = 0.0
        block[:, rows] = 0.0
        block[np.ix_(rows, rows)] = covariance * np.outer(signs, signs)
        for k in rows:
            sources[k] = source
        return Prior(self.free, means, block, tuple(sources), before)

    def seen_from(self, theta: Array) -> tuple[Array, Array]:
        """Return mean (n,) and covariance (n, n) as they are close to theta (n,).

        Data tell forces in proportion to the common scale g of the thrusters, the mean of their gains: c / g, however
        uncertain c and g are. As a Gaussian in c that is so about its mean only; elsewhere two views that differ by
        little would agree best where all forces are small (Peelle's puzzle). So c / g is what is kept, and c about
        theta is c_0 g / g_0 (1 + d ln g) to first order; of a c that is far surer than g, c itself.
        """
        gains = self.free.codes[:, 0] == IN_GAIN
        if gains.sum() < 2:  # the gain of one thruster is not the scale of all
            return self.mean, self.covariance
        forces = self.free.forces
        share = gains / gains.sum()
        away = float(share @ (theta - self.mean))
        forces = forces & (self.std > _SURER * np.abs(self.mean) * np.sqrt(share @ self.covariance @ share))
        grown = np.where(forces, np.exp(away), 1.0)
        turn = np.diag(grown) + np.outer(np.where(forces, theta - grown * self.mean, 0.0), share)
        mean = grown * self.mean - np.where(forces, theta, 0.0) * away
        return mean, np.asarray(turn @ self.covariance @ turn.T)

    @property
    def vehicle_values(self) -> dict[str, float]:
        """The coefficients among the means, by name, in their own units."""
        values = self.free.values(self.mean)
        return {name: float(v) for name, v in zip(self.names, values, strict=True) if name in COEFFICIENTS}


def prior_of(
    vehicle: Vehicle, *, commands: bool = True, more: Sequence[str] = (), beside: Vehicle | None = None
) -> Prior:
    """Return what is supposed of a vehicle.

    Args:
        commands: it is driven by thruster commands, so that delay, lag and gains are unknown; by a wrench that was
            measured or computed, only a delay is.
        more: what these data make unknown besides: `latency_<sensor>` of sensors whose clock is not that of the
            others, the places of sensors, forward-speed terms.
        beside: another vehicle, which counts where it says something: one whose coefficients bear deviations, or that
            was learned, or that has a table [prior].

    Raises:
        InputError: a table [prior] names what is no unknown, or an inertia that is not above 0 on this vehicle.
    """
    lines = _plausible(vehicle, beside, commands=commands)
    lines |= _inputs(vehicle, beside, commands=commands)
    lines |= {name: _further(vehicle, name) for name in more if name not in lines}
    free = free_parameters(vehicle, tuple(lines))
    kept = [lines[name] for name in free.names]
    mean, std = free.thetas(np.array([line.mean for line in kept])), np.array([line.std for line in kept])
    covariance = np.diag(std**2)
    gains = [k for k, name in enumerate(free.names) if name.startswith(GAIN_PREFIX)]
    covariance[np.ix_(gains, gains)] = _gain_covariance(vehicle, len(gains))
    physics = Prior(free, mean, covariance, tuple(line.source for line in kept), np.sqrt(np.diag(covariance)))
    supposed = _with_tables(physics, vehicle, beside)
    if beside is None or beside.posterior is not None:
        return _gone_on(supposed, beside or vehicle, vehicle)
    told = [named(name, free.names) for name in beside.prior]
    told += [name for name in free.names if name in COEFFICIENTS and beside.deviation(name) is not None]
    return _gone_on(supposed, vehicle, vehicle, told)


def further_unknowns(samples: Sequence[Samples]) -> tuple[str, ...]:
    """Return what may be unknown beside any vehicle's coefficients: `latency_<sensor>` of the sensors that may be late,
    the places of accelerometer, DVL and marker where there are any, forward-speed terms of a vehicle that goes ahead.

    Late beside the one whose time is taken as it is: the gyro, else the attitude, else the position; and what comes in
    the same rows from the same device: the attitude beside the gyro, the pose of a camera.
    """
    measured = np.any([each.measured for each in samples], axis=0)
    there = [bool(measured[3 * s : 3 * s + 3].any()) for s in range(len(LATENCIES))]
    reference = next((s for s in (3, 1, 0, 2) if there[s]), 3)
    pairs = {(3, 1), (1, 0)}
    device = {reference}
    for s in (1, 0):
        if any((r, s) in pairs and _same_rows(samples, r, s) for r in device):
            device.add(s)
    late = [LATENCIES[s] for s, each in enumerate(SENSORS) if there[s] and s not in device and each.late]
    turning = there[ATTITUDE] or there[RATES]  # is shown; an accelerometer feels it in any case
    placed = [sensor for sensor in PLACED if there[sensor] and (turning or sensor == SPECIFIC_FORCE)]
    places = [name for sensor in placed for name in PLACED[sensor]]
    return (*late, *places, *(AHEAD if _goes_ahead(samples) else ()))


def _goes_ahead(samples: Sequence[Samples]) -> bool:
    """Whether the vehicle goes ahead, as forward-speed terms suppose: mean u exceeds its deviation and v, w."""
    speeds = []
    for each in samples:
        speed = each.values[:, 6:9]
        if not np.isfinite(speed).all(axis=1).any():
            posed = np.flatnonzero(np.isfinite(each.values[:, :6]).all(axis=1))
            apart = np.searchsorted(each.t[posed], np.arange(each.t[0], each.t[-1], _PACE))
            rows = np.unique(posed[apart[apart < posed.size]])
            q = quaternions_from_eulers(each.values[rows[:-1], 3:6])
            speed = rotate(conjugate(q), np.diff(each.values[rows, :3], axis=0)) / np.diff(each.t[rows])[:, None]
        speeds.append(speed[np.isfinite(speed).all(axis=1)])
    u, v, w = np.concatenate(speeds).T
    return bool(u.size and u.mean() > max(u.std(), math.sqrt(np.mean(v**2 + w**2))))


def _same_rows(samples: Sequence[Samples], one: int, other: int) -> bool:
    both = [[np.isfinite(each.values[:, 3 * s : 3 * s + 3]).any(axis=1) for s in (one, other)] for each in samples]
    common = sum(int((a & b).sum()) for a, b in both)
    return common >= _SAME_ROWS * sum(int(b.sum()) for _, b in both) > 0.0


def _plausible(vehicle: Vehicle, beside: Vehicle | None, *, commands: bool) -> dict[str, Line]:
    """Return the lines of the coefficients: those that a body of this kind may have, and what the files name besides.

    Raises:
        InputError: a table [prior] names what is no unknown of the vehicle.
    """
    lines = _of_size(vehicle, commands=commands)
    known = unknowns_of(vehicle)
    files = [vehicle] if beside is None else [vehicle, beside]
    for each in files:
        for name in each.prior:
            if name not in known:
                raise InputError(f'{each.name}: prior: "{name}" is no unknown of {vehicle.name}{nearest(name, known)}')
    stated = [name for each in files for name in each.prior if name in COEFFICIENTS]
    for name in (*(name for each in files for name in each.hydrodynamics), *stated):
        if term_of(name).where != "commanded":
            lines.setdefault(name, Line(0.0, 0.0, ""))
    lines = {name: _stated(vehicle, name, line) for name, line in lines.items()}
    if beside is not None:
        told = [name for name in lines if _says(beside, name) or not _says(vehicle, name)]
        lines |= {name: _stated(beside, name, lines[name], _PRIORS_FILE) for name in told}
    return {name: line for name, line in lines.items() if line.std > 0.0 or name in stated}


def _of_size(vehicle: Vehicle, *, commands: bool) -> dict[str, Line]:
    """Return what the size of the body says of every plausible coefficient: inertias, damping by axis, and the rest."""
    body, names = Body(vehicle), {row.code: row.name for row in KINDS.values()}
    there = {"all": True, "ahead": False, "commanded": commands and bool(vehicle.thrusters)}
    plausible = [names[kind](*at) for kind, term in TERMS.items() if there[term.where] for at in term.plausible]
    return {name: _physics(body, name) for name in sorted(plausible, key=_order)}


def _order(name: str) -> tuple[int, int]:
    """Return where a coefficient stands among the unknowns; those that are alike keep the order of `TERMS`."""
    kind, i, j = index(name)
    if i != j or not KINDS[kind].mirrored:
        return 2, 0
    return (0, 0) if kind == "mass" else (1, i)


def _physics(body: Body, name: str) -> Line:
    line = term_of(name).supposed(body, *index(name)[1:])
    return replace(line, source=f"physics: {line.source}")


def _further(vehicle: Vehicle, name: str) -> Line:
    if name in COEFFICIENTS:
        return _physics(Body(vehicle), name)
    if name in IMU_PLACE:
        return Line(0.0, _PLACE, "electronics near the body origin")
    if name in PLACES:  # a hull reaches sqrt(3) of its largest radius of gyration
        return Line(0.0, float(Body(vehicle).gyradii.max()), "anywhere at the hull")
    return Line(*SENSORS[LATENCIES.index(name)].latency, "what sensors need to compute and send")


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


def _gone_on(supposed: Prior, of: Vehicle, onto: Vehicle, but: Sequence[str] = ()) -> Prior:
    """Return what was learned of a vehicle, of all unknowns that it knows of `but` these, and of others the supposed.

    Gains are learned as multiples of those of the vehicle that they were learned of, and used as such of another's.
    """
    learned = of.posterior
    if learned is None:
        return supposed
    names = [named(name, supposed.names) for name in learned.names]
    known = [k for k, name in enumerate(names) if name in supposed.names and name not in but]
    rows = [supposed.names.index(names[k]) for k in known]
    gains = {GAIN_PREFIX + name: math.log(ratio) for name, ratio in _gains(of, onto).items()}
    mean = np.array([learned.mean[k] + gains.get(names[k], 0.0) for k in known])
    covariance, reference = learned.covariance[np.ix_(known, known)], np.array(learned.prior_std)[known]
    return supposed.with_rows(rows, mean, covariance, reference, "learned before")


def _says(vehicle: Vehicle, name: str) -> bool:
    """Whether a file says something of a coefficient."""
    return vehicle.coefficient(name) != 0.0 or vehicle.deviation(name) is not None


def _with_tables(supposed: Prior, vehicle: Vehicle, beside: Vehicle | None) -> Prior:
    """Return what is supposed with the lines of the tables [prior], those of the file beside last."""
    for each, source in ((vehicle, "the vehicle's file"), (beside, _PRIORS_FILE)):
        for name, line in {} if each is None else each.prior.items():
            row = [k for k, other in enumerate(supposed.names) if other == named(name, supposed.names)]
            if row:
                mean, std = stated_coordinate(vehicle, name, line)
                said = f"{source}, [prior]" + (f": {line.source}" if line.source else "")
                supposed = supposed.with_rows(row, np.array([mean]), np.array([[std**2]]), np.array([std]), said)
    return supposed


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


def _inputs(vehicle: Vehicle, beside: Vehicle | None, *, commands: bool) -> dict[str, Line]:
    out = {DELAY: Line(*_DELAY, "autopilots and thrusters as they usually are")}
    files = [(vehicle, "the vehicle's file")] + ([] if beside is None else [(beside, _PRIORS_FILE)])
    for each, source in files:
        if each.command_delay > 0.0:
            out[DELAY] = Line(each.command_delay, _DELAY[1], f"{source}, and delays as they usually differ")
    if not commands:
        return out
    out[LAG] = Line(*_LAG, "thrusters as they usually are")
    for each, source in files:
        known = [thruster.time_constant for thruster in each.thrusters if thruster.time_constant > 0.0]
        if known:
            lag = float(np.mean(known))
            out[LAG] = Line(lag, _STATED * lag, f"{source}, which states no deviation: half of it")
    gains = {} if beside is None else _gains(beside, vehicle)
    for thruster in vehicle.thrusters:
        ratio = gains.get(thruster.name, 1.0)
        out[GAIN_PREFIX + thruster.name] = Line(ratio, _GAIN_STD, "thrusters differ by a few percent")
    return out


def _gains(of: Vehicle, onto: Vehicle) -> dict[str, float]:
    """Return the gains of a vehicle's thrusters as multiples of those that another gives the same ones."""
    there = {each.name: each.gain for each in onto.thrusters}
    return {each.name: each.gain / there[each.name] for each in of.thrusters if each.name in there}
