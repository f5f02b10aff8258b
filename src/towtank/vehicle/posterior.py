"""What was learned together: a Gaussian over a vehicle's unknowns, its table [posterior], and vehicles drawn from it.

And what a person knows of single unknowns before any data, the table [prior], each in its own unit.

Unknowns are coefficients by their SNAME names, the `delay` [s] of the commands, the `lag` [s] of the thrusters,
`gain_<thruster>`, `latency_<sensor>` [s] and the places [m] of the accelerometer, `imu_x`, `imu_y` and
`imu_z`, of the DVL, `dvl_x` ..., and of what gives the position, `marker_x` .... Each
has a coordinate in which it is Gaussian: the natural logarithm of the total inertia M_ii (rigid body and added mass,
kg or kg m^2) for the six added masses on the diagonal, and of a gain as a multiple of the gain that the file gives
the thruster; the quantity itself, in SI, for all others.

The covariance is kept as deviations and the lower Cholesky factor of the correlations, in whole numbers: whatever
digits are left out, it stays positive definite, and deviations of single unknowns stay as they are. How many digits
the factor takes depends on it. The deviation of a direction v is |L^T v|; an error of e of each row's length changes
it by about e, and where the direction is known r times better than its parts, by r e of itself. Four digits are
enough for r up to 10. With r = 100, as for the ratio of two coefficients that a common scale of force makes
uncertain, they are wrong by a third of a percent, and with r = 10,000 by a fifth or more. So digits are added until
no direction is wrong by more than a thousandth, and that is checked, not estimated: by the singular values of L^-1 (L
rounded).
"""

from __future__ import annotations

import math
import re
from collections.abc import Container, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, ValidationError, model_validator

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.vehicle.base import Numbers, Positive, Record, described, first_line, listed, misplaced, unknown_key
from towtank.vehicle.names import COEFFICIENTS, KINDS, ROWS, index, mirror, unit
from towtank.vehicle.records import Coefficient, Thruster

if TYPE_CHECKING:
    from towtank.vehicle.vehicle import Vehicle

__all__ = [
    "DELAY",
    "GAIN_PREFIX",
    "LAG",
    "LATENCY_PREFIX",
    "Posterior",
    "coordinate",
    "drawn",
    "known_unknowns",
    "named",
    "stated_before",
    "stated_coordinate",
    "surely_placed",
    "twin",
    "unit_of_unknown",
    "with_coordinates",
]

DELAY, LAG, GAIN_PREFIX, LATENCY_PREFIX, PLACE_PREFIXES = (
    "delay",
    "lag",
    "gain_",
    "latency_",
    ("imu_", "dvl_", "marker_"),
)
_NAMED = re.compile(rf"{GAIN_PREFIX}[A-Za-z0-9_.-]+|{LATENCY_PREFIX}[A-Za-z0-9_]+|({'|'.join(PLACE_PREFIXES)})[xyz]")
_DIGITS = range(4, 16)  # of the length of a row; a double has no more than 15
_KEPT = 1e-3  # relative error of the deviation of any direction; with 1000 samples it is itself known to 2e-2
_MATTERS = 0.02  # m
_TRIES = 100  # draws in a row; one in twenty that can move fails to be found once in 170 times
_DEFINITE = 1e-9  # smallest eigenvalue of the mass matrix scaled to a unit diagonal, as in the physical checks
_LARGEST_LOG = 300.0  # of what is the exponential of a coordinate: within the range of a double


def _is_unknown(value: Any) -> bool:
    return isinstance(value, str) and (value in (*COEFFICIENTS, DELAY, LAG) or bool(_NAMED.fullmatch(value)))


def _unknown(value: Any) -> str:
    if _is_unknown(value):
        return str(value)
    hint = nearest(value, (*COEFFICIENTS, DELAY, LAG)) if isinstance(value, str) else ""
    raise ValueError(
        f"found {described(value)}, expected a coefficient, {DELAY}, {LAG}, {GAIN_PREFIX}<thruster>,"
        f" {LATENCY_PREFIX}<sensor> or a place as imu_x, dvl_x, marker_x{hint}"
    )


_Names = Annotated[
    tuple[Annotated[str, BeforeValidator(_unknown)], ...],
    BeforeValidator(lambda value: listed(value, "a list of names")),
]
_Deviations = Annotated[tuple[Positive, ...], BeforeValidator(lambda value: listed(value, "a list of numbers"))]
_Rows = Annotated[tuple[Numbers, ...], BeforeValidator(lambda value: listed(value, "a list of rows"))]


class Posterior(Record):
    """A Gaussian over the coordinates of n unknowns (see the module), as `[posterior]` of a vehicle file has it.

    Attributes:
        names: of the unknowns (n,). mean: of their coordinates (n,). std: their deviations (n,).
        prior_std: deviations before the data (n,).
        cholesky: lower factor of the correlations, row i has i + 1 numbers, the last above 0. Only the direction of a
            row counts, since its length is 1: whole numbers do.
    """

    names: _Names
    mean: Numbers
    std: _Deviations
    prior_std: _Deviations
    cholesky: _Rows

    @model_validator(mode="after")
    def _shapes(self) -> Posterior:
        n = len(self.names)
        if n == 0:
            raise misplaced("names", "found an empty list, expected one unknown at least")
        for k, name in enumerate(self.names):
            for other in {name, twin(name)} & set(self.names[:k]):
                raise misplaced(f"names[{k}]", f'"{name}" stands there already as "{other}"')
        for field in ("mean", "std", "prior_std", "cholesky"):
            count = len(getattr(self, field))
            if count != n:
                items = "rows" if field == "cholesky" else "numbers"
                raise misplaced(field, f"found {count} {items}, expected {n}, one for each name")
        for i, row in enumerate(self.cholesky):
            if len(row) != i + 1:
                where = f"row {i + 1} of the lower triangle, {self.names[i]}"
                raise misplaced(f"cholesky[{i}]", f"found {len(row)} numbers, expected {i + 1}: {where}")
            if row[i] <= 0.0:
                raise misplaced(f"cholesky[{i}][{i}]", f"found {row[i]:g}, expected a number above 0 on the diagonal")
        return self

    @classmethod
    def from_covariance(
        cls, names: Sequence[str], mean: ArrayLike, covariance: ArrayLike, prior_std: ArrayLike
    ) -> Posterior:
        """Return the posterior with this covariance (n, n), each direction's deviation within a thousandth.

        Raises:
            InputError: a name that is no unknown, a wrong shape, a covariance that is not positive definite.
        """
        wanted = np.asarray(covariance, dtype=np.float64)
        n = len(names)
        if wanted.shape != (n, n):
            raise InputError(f"posterior: found a covariance of shape {wanted.shape}, expected {(n, n)}")
        std, rows = _digested(wanted)
        try:
            return cls.model_validate(
                {"names": list(names), "mean": mean, "std": std, "prior_std": prior_std, "cholesky": rows}
            )
        except ValidationError as error:
            raise InputError(f"posterior.{first_line(error)}") from None

    @property
    def factor(self) -> Array:
        """Lower Cholesky factor L (n, n) of the covariance."""
        return np.asarray(np.array(self.std)[:, None] * _unit_rows(self.cholesky))

    @property
    def covariance(self) -> Array:
        """Covariance (n, n) of the coordinates."""
        factor = self.factor
        return np.asarray(factor @ factor.T)


# -- single unknowns before any data


def known_unknowns(value: Any) -> Any:
    """Return a table whose every key is the name of an unknown, each once. Raises ValueError for another key."""
    if isinstance(value, Mapping):
        for key in value:
            if not _is_unknown(key):
                raise unknown_key(str(key), [*COEFFICIENTS, DELAY, LAG])
            if twin(key) != key and twin(key) in value:
                raise misplaced(str(key), f'stands there already as "{twin(key)}"')
    return value


def unit_of_unknown(name: str) -> str:
    """Return the unit of an unknown: of inputs and latencies seconds, of places metres, of gains none."""
    if name in COEFFICIENTS:
        return unit(name)
    return "" if name.startswith(GAIN_PREFIX) else "m" if name.startswith(PLACE_PREFIXES) else "s"


def surely_placed(names: Iterable[str], mean: Iterable[float], std: Iterable[float]) -> dict[str, tuple[float, float]]:
    """Return the places of sensors, value and deviation [m], body, that are surely not the origin.

    Beyond three deviations, and by so much that it matters.

    >>> surely_placed(("delay", "dvl_x", "dvl_y", "imu_z"), (0.1, 0.2, 0.3, 0.01), (0.01, 0.05, 0.2, 0.001))
    {'dvl_x': (0.2, 0.05)}
    """
    found = {name: (float(m), float(s)) for name, m, s in zip(names, mean, std, strict=True)}
    places = {name: each for name, each in found.items() if name.startswith(PLACE_PREFIXES)}
    return {name: (m, s) for name, (m, s) in places.items() if abs(m) > max(_MATTERS, 3.0 * s)}


def stated_before(name: str, line: Coefficient) -> Coefficient:
    """Return a line of the table [prior] with its unit. Raises ValueError where it is none."""
    if line.std is None:
        raise misplaced("std", f"missing, expected a number above 0, as {{ value = {line.value:g}, std = ... }}")
    if line.std <= 0.0:
        raise misplaced("std", f"found {line.std:g}, expected a number above 0")
    if (name == LAG or name.startswith(GAIN_PREFIX)) and line.value <= 0.0:
        raise misplaced("value", f"found {line.value:g}, expected a number above 0")
    if name == DELAY and line.value < 0.0:
        raise misplaced("value", f"found {line.value:g}, expected 0 or more")
    return line.in_unit(unit_of_unknown(name))


def stated_coordinate(vehicle: Vehicle, name: str, line: Coefficient) -> tuple[float, float]:
    """Return mean and deviation of a vehicle's coordinate (see the module) by a line of a table [prior].

    Raises:
        InputError: an added mass with which the vehicle's total inertia is not above 0.
    """
    value, std = line.value, line.std or 0.0
    if not _logarithmic(name):
        return value, std
    if name.startswith(GAIN_PREFIX):
        before = next(each.gain for each in vehicle.thrusters if GAIN_PREFIX + each.name == name)
        return math.log(value / before), std / value
    i = index(name)[1]
    total = float(vehicle.rigid_body_matrix[i, i]) - value
    if total <= 0.0:
        raise InputError(f"prior.{name}: found {value:g}, with which {vehicle.name} has a total inertia of {total:g}")
    return math.log(total), std / total


def twin(name: str) -> str:
    """Return the other name of the same unknown, as `N_vdot` of the added mass `Y_rdot`; the name where it has one."""
    return mirror(name) if name in COEFFICIENTS and index(name)[0] == "mass" else name


def named(name: str, names: Container[str]) -> str:
    """Return the name that an unknown has among these: its own, or its twin."""
    return twin(name) if name not in names and twin(name) in names else name


def _unit_rows(rows: Sequence[Sequence[float]]) -> Array:
    """Return the lower triangle (n, n) of these rows, each scaled to the length 1."""
    triangle = np.zeros((len(rows), len(rows)))
    for i, row in enumerate(rows):
        triangle[i, : i + 1] = row
    return np.asarray(triangle / np.linalg.norm(triangle, axis=1, keepdims=True))


def _digested(covariance: Array) -> tuple[Array, list[list[float]]]:
    """Return deviations (n,) and the factor's rows with as few digits as keep every direction's deviation.

    Raises:
        InputError: the covariance is not finite and positive definite, or singular to working precision.
    """
    diagonal = np.diag(covariance)
    if not np.all(np.isfinite(covariance)) or not np.all(diagonal > 0.0):
        raise InputError("posterior: the covariance is not finite with variances above 0")
    std = np.sqrt(diagonal)
    try:
        factor = np.linalg.cholesky(0.5 * (covariance + covariance.T) / np.outer(std, std))
    except np.linalg.LinAlgError:
        cure = "where it was learned, check the units of the log with towtank inspect"
        raise InputError(f"posterior: the covariance is not positive definite; {cure}") from None
    for digits in _DIGITS:
        whole = np.rint(10.0**digits * factor) + 0.0  # no negative zeros
        if np.all(np.diag(whole) > 0.0):
            rows = [whole[i, : i + 1].tolist() for i in range(len(whole))]
            ratios = np.linalg.svd(np.linalg.solve(factor, _unit_rows(rows)), compute_uv=False)
            if np.max(np.abs(ratios - 1.0), initial=0.0) <= _KEPT:
                return std, rows
    raise InputError("posterior: the covariance is singular to working precision; leave an unknown out")


# -- coordinates and vehicles


def _logarithmic(name: str) -> bool:
    """Whether the coordinate of an unknown is a logarithm."""
    if name in COEFFICIENTS:
        kind, i, j = index(name)
        return kind == "mass" and i == j
    return name.startswith(GAIN_PREFIX)


def coordinate(vehicle: Vehicle, name: str) -> float:
    """Return the coordinate of a coefficient of a vehicle; NaN where a total inertia is not above 0."""
    if not _logarithmic(name):
        return vehicle.coefficient(name)
    i = index(name)[1]
    total = float(vehicle.mass_matrix[i, i])
    return math.log(total) if total > 0.0 else math.nan


def with_coordinates(vehicle: Vehicle, names: Sequence[str], coordinates: ArrayLike) -> Vehicle:
    """Return the vehicle with its unknowns at these coordinates (n,), and without a posterior.

    Latencies are the sensors': they change nothing here. Gains are multiples of those that the vehicle has.
    """
    at = dict(zip(names, np.asarray(coordinates, dtype=np.float64).tolist(), strict=True))
    values = {name: _coefficient(vehicle, name, x) for name, x in at.items() if name in COEFFICIENTS}
    update: dict[str, Any] = {"posterior": None}
    if DELAY in at:
        update["command_delay"] = at[DELAY]
    if LAG in at or any(name.startswith(GAIN_PREFIX) for name in at):
        update["thrusters"] = tuple(_thruster(each, at) for each in vehicle.thrusters)
    return vehicle.with_coefficients(values).model_copy(update=update)


def _coefficient(vehicle: Vehicle, name: str, x: float) -> float:
    if not _logarithmic(name):
        return x
    i = index(name)[1]
    return float(vehicle.rigid_body_matrix[i, i]) - math.exp(x)


def _thruster(thruster: Thruster, at: dict[str, float]) -> Thruster:
    gain = thruster.gain * math.exp(at.get(GAIN_PREFIX + thruster.name, 0.0))
    lag = max(at[LAG], 0.0) if LAG in at else thruster.time_constant
    return thruster.model_copy(update={"gain": gain, "time_constant": lag})


# -- drawing


def drawn(vehicle: Vehicle, count: int, seed: int) -> tuple[Vehicle, ...]:
    """Return vehicles drawn from a vehicle; see `Vehicle.sample`."""
    if count < 0:
        raise InputError(f"sample: found n = {count}, expected 0 or more")
    names, mean, factor = _gaussian(vehicle)
    lower, upper = _limits(names)
    rng = np.random.default_rng(seed)

    def one() -> Vehicle:
        for _ in range(_TRIES):
            coordinates = mean + factor @ rng.standard_normal(len(names))
            found = with_coordinates(vehicle, names, np.clip(coordinates, lower, upper))
            if _can_move(found.mass_matrix):
                return found
        raise InputError(
            f"{vehicle.name}: {_TRIES} draws in a row have a total mass matrix that is not positive definite; the"
            " deviations of its couplings are too large for its inertias"
        )

    return tuple(one() for _ in range(count))


def _gaussian(vehicle: Vehicle) -> tuple[tuple[str, ...], Array, Array]:
    """Return names, mean (n,) and factor (n, n): of the posterior, or of deviations that stand alone. InputError."""
    posterior = vehicle.posterior
    if posterior is not None:
        return posterior.names, np.array(posterior.mean), posterior.factor
    names: list[str] = []
    for name in COEFFICIENTS:
        if vehicle.deviation(name) and twin(name) not in names:
            names.append(name)
    if not names:
        raise InputError(
            f"{vehicle.name}: has neither a posterior nor a coefficient with std, so there is nothing to draw from"
            "; learn it from a log first (towtank learn)"
        )
    mean = np.array([coordinate(vehicle, name) for name in names])
    std = np.array([vehicle.deviation(name) or 0.0 for name in names])
    for k, name in enumerate(names):
        if _logarithmic(name):
            if math.isnan(mean[k]):
                row = index(name)[1]
                raise InputError(
                    f"{vehicle.name}: the total inertia in row {ROWS[row]} is not above 0, cannot be drawn"
                )
            std[k] /= math.exp(mean[k])
    return tuple(names), mean, np.diag(std)


def _limits(names: Sequence[str]) -> tuple[Array, Array]:
    """Return the lowest and the highest coordinate of each unknown that a drawn vehicle may have, (n,) each."""
    lower, upper = np.full(len(names), -np.inf), np.full(len(names), np.inf)
    for k, name in enumerate(names):
        if _logarithmic(name):
            lower[k], upper[k] = -_LARGEST_LOG, _LARGEST_LOG
        elif name in (DELAY, LAG):
            lower[k] = 0.0
        elif name in COEFFICIENTS:
            kind, i, j = index(name)
            if KINDS[kind].damps and i == j:
                upper[k] = 0.0
    return lower, upper


def _can_move(mass: Array) -> bool:
    """Whether a total mass matrix (6, 6) is positive definite."""
    diagonal = np.diag(mass)
    if np.any(diagonal <= 0.0):
        return False
    scale = np.sqrt(diagonal)
    return bool(np.linalg.eigvalsh(mass / np.outer(scale, scale))[0] > _DEFINITE)
