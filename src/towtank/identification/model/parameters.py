"""The free coefficients as unconstrained numbers theta, and back into the kernel's vector of a vehicle.

Total inertias on the diagonal and thruster gains are written exp(theta): whatever an estimator does to theta, they
stay positive. Everything else (couplings, damping, restoring and forward-speed terms, constant forces, delay, lag) is
theta itself.

Where delay and lag of the inputs are both unknown, an estimator that is linearised has them in other coordinates. A lag
T behind a delay d makes a force later by d + T, and smears it by T^2:

    exp(-d s) / (1 + T s) = exp(-(d + T) s + T^2 s^2 / 2 - ...)

By d and T alike motion answers where T is small: neither can be told from the other to first order, and about a lag of
nothing none can be found. So below L, half a step of integration, the coordinate goes with the square, the sum is kept,
and what a motion is linearised about has a lag of L at least. Inputs less late than a step have both as they are.

    T' = T, (T^2 + L^2) / 2 L below L;   d' = d + T - T'
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array, kernel
from towtank.core.layout import I_MASS, I_MASS_INVERSE, INFLOW, MASS, N_KINDS, address
from towtank.errors import InputError, nearest
from towtank.identification.model.measurements import POSITION, SENSORS, SPECIFIC_FORCE, VELOCITY
from towtank.identification.model.terms import (
    AHEAD,
    IN_DELAY,
    IN_GAIN,
    IN_LAG,
    IN_LATENCY,
    IN_PLACE,
    LOG,
    N_FIXED,
    N_MOVING,
    TERMS,
    UNTRANSFORMED,
    Codes,
)
from towtank.vehicle import COEFFICIENTS, Vehicle, index
from towtank.vehicle.names import KINDS

__all__ = [
    "DELAY",
    "DVL_PLACE",
    "FURTHER",
    "GAIN_PREFIX",
    "IMU_PLACE",
    "IN_DELAY",
    "IN_GAIN",
    "IN_LAG",
    "IN_LATENCY",
    "IN_PLACE",
    "LAG",
    "LATENCIES",
    "MARKER_PLACE",
    "N_FIXED",
    "N_MOVING",
    "PLACED",
    "PLACES",
    "UNTRANSFORMED",
    "Codes",
    "FreeParameters",
    "free_parameters",
    "linearised_about",
    "put_parameters",
    "seen_about",
    "told",
    "unknowns_of",
]

DELAY, LAG, GAIN_PREFIX = "delay", "lag", "gain_"
# where accelerometer, DVL, and what gives the position are in the body [m]; by the number of the sensor
IMU_PLACE, DVL_PLACE, MARKER_PLACE = (
    tuple(f"{sensor}_{axis}" for axis in "xyz") for sensor in ("imu", "dvl", "marker")
)
PLACED = {SPECIFIC_FORCE: IMU_PLACE, VELOCITY: DVL_PLACE, POSITION: MARKER_PLACE}
PLACES = tuple(name for place in PLACED.values() for name in place)
_LAGS = (1e-3, 2.0)  # s: least and largest time constant of the thrusters
_SHOWS = 0.01  # s: half a step of integration, the least lag that shows
LATENCIES = tuple(f"latency_{sensor.name.replace(' ', '_')}" for sensor in SENSORS)  # [s], of each sensor
FURTHER = (*LATENCIES, *PLACES, *AHEAD)  # unknown only where data show them


@dataclass(frozen=True)
class FreeParameters:
    """Which coefficients are free, and where each goes.

    Attributes:
        names: SNAME names, `delay`, `lag`, `gain_<thruster>`.
        codes: (n, 4) kind, row, column, transform of each, as the kernels read them.
        rigid: (n,) what a coefficient's inertia has beside it: M_RB of that element for inertias, 0 for others.
    """

    names: tuple[str, ...]
    codes: Codes
    rigid: Array

    def __len__(self) -> int:
        return len(self.names)

    def theta(self, vehicle: Vehicle, *, delay: float, lag: float) -> Array:
        """Return theta (n,) of a vehicle's coefficients."""
        usual = {IN_DELAY: delay, IN_LAG: max(lag, 1e-3), IN_GAIN: 1.0, IN_LATENCY: 0.0, IN_PLACE: 0.0}
        kinds = zip(self.names, self.codes[:, 0].tolist(), strict=True)
        return self.thetas([usual[kind] if kind in usual else vehicle.coefficient(name) for name, kind in kinds])

    def _theta(self, k: int, value: float) -> float:
        transform = self.codes[k, 3]
        if self.codes[k, 0] == MASS:
            value = float(self.rigid[k]) - value
        if transform == LOG:
            return math.log(max(value, 1e-9))
        return value

    def thetas(self, values: Array | Sequence[float]) -> Array:
        """Return theta (n,) of coefficients (n,)."""
        return np.array([self._theta(k, float(value)) for k, value in enumerate(values)])

    def values(self, theta: Array) -> Array:
        """Return the coefficients (n,) of theta (n,): added inertias, not totals."""
        out = np.exp(theta, out=np.array(theta, dtype=np.float64), where=self.codes[:, 3] == LOG)
        return np.where(self.codes[:, 0] == MASS, self.rigid - out, out)

    @property
    def signs(self) -> Array:
        """(n,) -1 for couplings of inertia, whose theta is the rigid body's element less the coefficient, else 1."""
        return np.where((self.codes[:, 0] == MASS) & (self.codes[:, 3] == UNTRANSFORMED), -1.0, 1.0)

    def slopes(self, theta: Array) -> Array:
        """Return d coefficient / d theta (n,)."""
        out = np.exp(theta, out=np.ones(len(self)), where=self.codes[:, 3] == LOG)
        return np.where(self.codes[:, 0] == MASS, -out, out)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """The least and the largest theta (n,) that physics allows, as far as each can be told alone.

        Delay and loss by inflow are not negative, thrusters have a lag of 1 ms to 2 s, damping takes energy out, and
        water adds inertia.
        """
        kind, diagonal = self.codes[:, 0], self.codes[:, 1] == self.codes[:, 2]
        inertia = (kind == MASS) & diagonal
        low = np.select([(kind == IN_DELAY) | (kind == INFLOW), kind == IN_LAG], [0.0, _LAGS[0]], -np.inf)
        low[inertia] = np.log(self.rigid[inertia])
        damping = np.isin(kind, [row.code for row in KINDS.values() if row.damps]) & diagonal
        high = np.select([damping, kind == IN_LAG], [0.0, _LAGS[1]], np.inf)
        return low, high

    @property
    def forces(self) -> NDArray[np.bool_]:
        """Which (n,) are forces, or couplings of inertia, as they stand: in proportion to the scale of all forces."""
        kind = self.codes[:, 0]
        return np.asarray((kind < N_KINDS) & (kind != INFLOW) & (self.codes[:, 3] == UNTRANSFORMED))

    def felt(self, axes: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which (n,) make or feel motion along these axes (6,) alone: inputs and sensors in any case."""
        out = np.ones(len(self), dtype=np.bool_)
        for k, (kind, i, j, _) in enumerate(self.codes.tolist()):
            if kind == INFLOW:
                out[k] = axes[:3].any()
            elif kind in TERMS:
                _, row, column = TERMS[kind].role(i, j)
                felt = {row, column, 0 if TERMS[kind].where == "ahead" else -1} - {-1}
                out[k] = all(axes[axis] for axis in felt)
        return out

    def subset(self, keep: Sequence[str]) -> FreeParameters:
        """Return those of the names that are in `keep`, in the same order."""
        rows = [k for k, name in enumerate(self.names) if name in keep]
        return replace(self, names=tuple(self.names[k] for k in rows), codes=self.codes[rows], rigid=self.rigid[rows])


def unknowns_of(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the names of all that can be unknown about a vehicle, its thrusters and its sensors."""
    gains = (GAIN_PREFIX + thruster.name for thruster in vehicle.thrusters)
    return (*COEFFICIENTS, DELAY, LAG, *gains, *LATENCIES, *PLACES)


def free_parameters(vehicle: Vehicle, names: Sequence[str]) -> FreeParameters:
    """Return the description of the free coefficients `names`.

    A coupling has one number: of an added-mass element and its mirror the first one named is kept.

    Raises:
        InputError: an unknown name.
    """
    thrusters, known = [thruster.name for thruster in vehicle.thrusters], unknowns_of(vehicle)
    kept: list[str] = []
    codes: list[tuple[int, int, int, int]] = []
    rigid: list[float] = []
    for name in names:
        if name not in known:
            raise InputError(f'free: "{name}" is not a coefficient{nearest(name, known)}')
        code = _code(name, thrusters)
        if code in codes:
            continue
        kept.append(name)
        codes.append(code)
        rigid.append(float(vehicle.rigid_body_matrix[code[1], code[2]]) if code[0] == MASS else 0.0)
    return FreeParameters(tuple(kept), np.array(codes, dtype=np.int64).reshape(len(kept), 4), np.array(rigid))


def _code(name: str, thrusters: Sequence[str]) -> tuple[int, int, int, int]:
    if name in (DELAY, LAG):
        return IN_DELAY if name == DELAY else IN_LAG, 0, 0, UNTRANSFORMED
    for kind, known in ((IN_PLACE, PLACES), (IN_LATENCY, LATENCIES)):
        if name in known:
            return kind, known.index(name), 0, UNTRANSFORMED
    if name.startswith(GAIN_PREFIX):
        return IN_GAIN, thrusters.index(name.removeprefix(GAIN_PREFIX)), 0, LOG
    of, i, j = index(name)
    code = KINDS[of].code
    if code == MASS and j < i:
        i, j = j, i
    return code, i, j, TERMS[code].diagonal if i == j else UNTRANSFORMED


def _both(free: FreeParameters, *points: Array) -> tuple[int, int] | None:
    """Return where delay and lag stand; None where one is known, or both are as they are at one of some points (n,)."""
    kinds = free.codes[:, 0].tolist()
    if not {IN_DELAY, IN_LAG} <= set(kinds):
        return None
    d, T = kinds.index(IN_DELAY), kinds.index(IN_LAG)
    return (d, T) if min(point[d] + point[T] for point in points) >= 2.0 * _SHOWS else None


def linearised_about(free: FreeParameters, theta: Array) -> Array:
    """Return the point (n,) to linearise about for theta (n,): inputs as late on the whole, by a lag that shows [s]."""
    both, out = _both(free, theta), theta.copy()
    if both is not None:
        d, T = both
        out[T] = max(theta[T], _SHOWS)
        out[d] += theta[T] - out[T]
    return out


def seen_about(free: FreeParameters, about: Array, mean: Array, covariance: Array) -> tuple[Array, Array]:
    """Return mean (n,) and covariance (n, n) in the coordinates of an estimator that is linearised about (n,).

    Of delay and lag [s] that is d' and T' of the module; a deviation of T is as many of T'.
    """
    both = _both(free, about, mean)
    if both is None:
        return mean, covariance
    d, T = both
    out, lag, std = mean.copy(), float(mean[T]), math.sqrt(covariance[T, T])
    out[T] = _coordinate(lag)
    out[d] += lag - out[T]
    turn = _turn(len(out), both, (_coordinate(lag + std) - out[T]) / std if std > 0.0 else 1.0)
    return out, np.asarray(turn @ covariance @ turn.T)


def told(
    free: FreeParameters, about: Array, theta: Array, mean: Array, covariance: Array
) -> tuple[Array, Array, Array]:
    """Return theta, mean (n,) and covariance (n, n) of an estimator linearised about (n,) with d and T themselves [s].

    The mean lies as many deviations from theta as it did. Theta is physical if it was.
    """
    both = _both(free, about, theta)
    if both is None:
        return theta.copy(), mean.copy(), covariance
    d, T = both
    out, std = theta.copy(), math.sqrt(max(float(covariance[T, T]), 0.0))
    out[T] = min(max(_lag(float(theta[T])), _LAGS[0]), _LAGS[1])
    out[d] = max(float(theta[d] + theta[T] - out[T]), min(float(theta[d]), 0.0))
    turn = _turn(len(out), both, (_lag(_coordinate(float(out[T])) + std) - out[T]) / std if std > 0.0 else 1.0)
    return out, out + turn @ (mean - theta), np.asarray(turn @ covariance @ turn.T)


def _coordinate(lag: float) -> float:
    return lag if lag >= _SHOWS else (lag**2 + _SHOWS**2) / (2.0 * _SHOWS)


def _lag(coordinate: float) -> float:
    return coordinate if coordinate >= _SHOWS else math.sqrt(max(2.0 * _SHOWS * coordinate - _SHOWS**2, 0.0))


def _turn(n: int, both: tuple[int, int], share: float) -> Array:
    """Return the matrix (n, n) by which the lag moves by a share of what it did, and the sum as it did."""
    turn = np.eye(n)
    turn[both[1], both[1]], turn[both[0], both[1]] = share, 1.0 - share
    return turn


@kernel
def invert_mass(p: Array, work: Array) -> bool:
    """Write the inverse of the symmetric positive definite mass matrix in `p` (170,) beside it, by Cholesky.

    False, and the inverse unchanged, where the matrix is not positive definite. work: (6, 6).
    """
    for i in range(6):
        for j in range(i + 1):
            s = p[I_MASS + 6 * i + j]
            for k in range(j):
                s -= work[i, k] * work[j, k]
            if i == j:
                if not s > 0.0:
                    return False
                work[i, i] = math.sqrt(s)
            else:
                work[i, j] = s / work[j, j]
    for c in range(6):
        for i in range(6):  # forward: L y = e_c, y in the column of the result
            s = 1.0 if i == c else 0.0
            for k in range(i):
                s -= work[i, k] * p[I_MASS_INVERSE + 6 * k + c]
            p[I_MASS_INVERSE + 6 * i + c] = s / work[i, i]
        for back in range(6):
            i = 5 - back
            s = p[I_MASS_INVERSE + 6 * i + c]
            for k in range(i + 1, 6):
                s -= work[k, i] * p[I_MASS_INVERSE + 6 * k + c]
            p[I_MASS_INVERSE + 6 * i + c] = s / work[i, i]
    return True


@kernel
def put_parameters(p: Array, codes: Codes, theta: Array, work: Array) -> bool:
    """Write the coefficients of theta (n,) into `p` (170,); False where the mass matrix is not positive definite."""
    masses = False
    for k in range(theta.shape[0]):
        kind, i, j, transform = codes[k, 0], codes[k, 1], codes[k, 2], codes[k, 3]
        value = theta[k]
        if transform == LOG:
            value = math.exp(value)
        if kind == MASS:
            p[I_MASS + 6 * i + j] = value
            p[I_MASS + 6 * j + i] = value
            masses = True
        elif kind < N_KINDS:
            p[address(kind, i, j)] = value
    if masses:
        return invert_mass(p, work)
    return True
