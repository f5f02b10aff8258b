"""What is to be exported: a vehicle with where it comes from, what a target keeps of it, and what it loses.

A target that cannot say everything is described by the vehicle that it does say (`Kept.vehicle`): what was lost is the
difference of the two, in words and as the largest error of the wrench.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import short
from towtank.errors import InputError
from towtank.vehicle import (
    COEFFICIENTS,
    Buoyancy,
    Restoring,
    Vehicle,
    configuration_matrix,
    force_range,
    index,
    inverse_dynamics,
    unit,
)
from towtank.vehicle.matrices import GRAVITY
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = [
    "Kept",
    "Request",
    "differing",
    "is_definite",
    "require_exportable",
    "rounded",
    "speed_range",
    "stem_of",
    "with_plain_buoyancy",
    "wrench_error",
]

_NARROWED = 0.5  # share of the prior's deviation up to which a coefficient counts as identified, as `learn` says it
_DEFINITE = 1e-9  # smallest eigenvalue of the mass matrix scaled to a unit diagonal, as in the physical checks
_USUAL, _MOST = 1.0, 5.0  # m/s, rad/s: where nothing says how fast it goes, and in any case
_STATES = 2000  # random attitudes and velocities for the largest error of the wrench
_UPRIGHT = np.array(list(itertools.product(0.5 * math.pi * np.arange(-1, 3), 0.5 * math.pi * np.arange(-1, 2))))
_LONGEST = 60  # letters of a name that becomes a file's or a function's; MATLAB takes 63


@dataclass(frozen=True)
class Request:
    """A vehicle that is to be exported.

    Attributes:
        vehicle: the vehicle. source: the file or the name in the catalog that it comes from.
        sha256: of the bytes of that source, hexadecimal.
        version: of the target's format, one that the target lists.
        at_speed: surge [m/s] at which what depends on speed is taken, where the target has no such term.
        options: switches of single targets by name, such as `engine` of gz-sim.
    """

    vehicle: Vehicle
    source: str
    sha256: str
    version: str
    at_speed: float | None = None
    options: Mapping[str, str | bool] = field(default_factory=dict)


class Kept(NamedTuple):
    """What a target keeps: the vehicle as the target's simulator moves it, and remarks on what it cannot say."""

    vehicle: Vehicle
    remarks: tuple[str, ...] = ()


def require_exportable(vehicle: Vehicle, place: str, *, allow_unidentified: bool) -> None:
    """Refuse what a simulator had better not get.

    Raises:
        InputError: the total mass matrix is not positive definite; or a coefficient was learned and the data did not
            narrow it, unless that is allowed.
    """
    if not is_definite(vehicle.mass_matrix):
        raise InputError(
            f"{place}: the total mass matrix M_RB + M_A is not positive definite, so that any engine would gain energy"
            " from it; mend the file (towtank vehicle check names what is wrong) or learn it anew"
        )
    unknown = [] if allow_unidentified else _unidentified(vehicle)
    if unknown:
        raise InputError(
            f"{place}: not identified by the data: {', '.join(unknown)}; learn from a log that drives these axes,"
            " or export what was supposed before the data with --allow-unidentified"
        )


def is_definite(mass: Array) -> bool:
    """Return whether a mass matrix (6, 6) is positive definite."""
    diagonal = np.diag(mass)
    scale = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    return bool(np.all(diagonal > 0.0) and np.linalg.eigvalsh(mass / np.outer(scale, scale))[0] > _DEFINITE)


def _unidentified(vehicle: Vehicle) -> list[str]:
    """Return the coefficients of the posterior that the data narrowed to more than half of the prior's deviation."""
    posterior = vehicle.posterior
    if posterior is None:
        return []
    each = zip(posterior.names, posterior.std, posterior.prior_std, strict=True)
    return [name for name, std, before in each if name in COEFFICIENTS and std > _NARROWED * before]


def with_plain_buoyancy(vehicle: Vehicle) -> Vehicle:
    """Return the same vehicle whose restoring forces stand in [buoyancy] alone: force and centre.

    What was measured of them (W_minus_B, BG_x ..) becomes a buoyant force B = W - (W - B) and a centre
    r_B = (r_G W - BG) / B. Raises InputError where nothing is left to lift it, and no centre could do.
    """
    B, weight = vehicle.weight - vehicle.weight_minus_buoyancy, vehicle.weight
    moment, r_G = np.array(vehicle.restoring_moment), np.array(vehicle.rigid_body.centre_of_gravity)
    measured = any(getattr(vehicle.restoring, name) is not None for name in ("BG_x", "BG_y", "BG_z"))
    if B < 0.0 or (B == 0.0 and np.any(moment != r_G * weight)):
        raise InputError(f"{vehicle.name}: the buoyant force comes out as {B:g} N, expected one above 0")
    centre = (r_G * weight - moment) / B if measured else np.array(vehicle.buoyancy.centre)
    x, y, z = (float(each) + 0.0 for each in centre)
    plain = Buoyancy(force=B, centre=(x, y, z), source=vehicle.buoyancy.source)
    return vehicle.model_copy(update={"buoyancy": plain, "restoring": Restoring()})


def rounded(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with mass, inertia, centres and buoyant force of twelve digits.

    Simulators' files have them in other shapes (about another point, parts of it in other links, as a volume). What was
    computed back from there and rounded the same way is the same number again, so that an import can be exported.
    """
    body, buoyancy = vehicle.rigid_body, vehicle.buoyancy
    mass = float(f"{body.mass:.12g}")
    tensor = body.tensor
    tensor = np.round(tensor, 11 - math.floor(math.log10(float(np.trace(tensor))))) + 0.0
    inertia: object = tuple(np.diag(tensor).tolist())
    if np.any(tensor != np.diag(np.diag(tensor))):
        inertia = tuple(tuple(row) for row in tensor.tolist())
    centre, lift = (tuple((np.round(each, 12) + 0.0).tolist()) for each in (body.centre_of_gravity, buoyancy.centre))
    force = buoyancy.force
    if force is not None:
        force = None if abs(force - mass * GRAVITY) <= 1e-11 * force else float(f"{force:.12g}")
    solid = body.model_copy(update={"mass": mass, "inertia": inertia, "centre_of_gravity": centre})
    return vehicle.model_copy(
        update={"rigid_body": solid, "buoyancy": buoyancy.model_copy(update={"force": force, "centre": lift})}
    )


def stem_of(vehicle: Vehicle) -> str:
    """Return the vehicle's name as the beginning of a file's name, or as the name of a simulator's model."""
    plain = re.sub(r"(?<![A-Za-z0-9])-|-(?![A-Za-z0-9])", " ", vehicle.name)  # a dash joins two words or goes
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", plain).strip("._")[:_LONGEST].rstrip("._-") or "vehicle"


def speed_range(vehicle: Vehicle) -> Array:
    """Return the speeds (6,) [m/s, rad/s] that the thrusters reach on each axis, between which errors are taken.

    Where full thrust on an axis meets its drag on the diagonal; 1 where the file has no thrusters or no drag that
    says so, and never above 5. Of two digits, as they are stated.
    """
    speeds = np.full(6, _USUAL)
    if not vehicle.thrusters:
        return speeds
    ends = np.array([np.abs(force_range(each.curve)) * each.gain for each in vehicle.thrusters])
    B = np.abs(configuration_matrix(vehicle))
    with np.errstate(invalid="ignore"):  # one without limits that does not push along an axis
        full = np.where(B > 0.0, B * ends.max(axis=1), 0.0).sum(axis=1)
    for i in range(6):
        linear = -vehicle.coefficient(f"{ROWS[i]}_{COLUMNS[i]}")
        quadratic = -vehicle.coefficient(f"{ROWS[i]}_{COLUMNS[i] * 2}")
        force = float(full[i])
        if not math.isfinite(force) or force <= 0.0 or (linear <= 0.0 and quadratic <= 0.0):
            continue
        linear, quadratic = max(linear, 0.0), max(quadratic, 0.0)
        root = math.sqrt(linear * linear + 4.0 * quadratic * force)
        speeds[i] = min(2.0 * force / (linear + root), _MOST)
    return np.array([float(f"{each:.2g}") for each in speeds])


def wrench_error(vehicle: Vehicle, kept: Vehicle) -> Array:
    """Return the largest error (6,) [N, N m] of the wrench that moves `kept` as `vehicle` is to be moved.

    Over all attitudes, velocities up to `speed_range` and accelerations up to the same number per second: the wrench is
    a sum of what each of the three makes of it, so that its extremes are sums of theirs. Those of velocities are looked
    for at the corners of the range, on its edges and within. Thrusters that lose thrust with inflow are taken at full
    thrust.
    """
    rng = np.random.default_rng(0)
    speeds = speed_range(vehicle)
    eta = np.zeros((_STATES, 6))
    eta[:, 3:] = rng.uniform(-1.0, 1.0, (_STATES, 3)) * np.array([math.pi, 0.5 * math.pi, math.pi])
    eta[: len(_UPRIGHT), 3:5] = _UPRIGHT
    corners = np.array(list(itertools.product((-1.0, 0.0, 1.0), repeat=6)))
    within = rng.uniform(-1.0, 1.0, (_STATES, 6))
    edges = np.where(rng.random((_STATES, 6)) < 0.5, np.sign(within), within)
    nu = np.concatenate([corners, edges, within]) * speeds

    def away(eta: Array, nu: Array) -> Array:
        still = np.zeros(6)
        return np.asarray(inverse_dynamics(kept, eta, nu, still) - inverse_dynamics(vehicle, eta, nu, still))

    statics = away(eta, np.zeros(6))
    motion = away(np.zeros(6), nu) - away(np.zeros(6), np.zeros(6))
    motion += nu @ (_inflow_damping(kept) - _inflow_damping(vehicle)).T
    inertia = np.abs(kept.mass_matrix - vehicle.mass_matrix) @ speeds
    above = statics.max(axis=0) + motion.max(axis=0)
    below = statics.min(axis=0) + motion.min(axis=0)
    return np.asarray(np.maximum(np.abs(above), np.abs(below)) + inertia)


def _inflow_damping(vehicle: Vehicle) -> Array:
    """Return the linear damping (6, 6) that loss of thrust comes to at full thrust; zero without one."""
    loss = vehicle.coefficient("inflow_loss")
    if loss == 0.0 or not vehicle.thrusters:
        return np.zeros((6, 6))
    ends = np.array([np.abs(force_range(each.curve)) * each.gain for each in vehicle.thrusters]).max(axis=1)
    B = configuration_matrix(vehicle)
    return np.asarray(loss * (B * np.where(np.isfinite(ends), ends, 0.0)) @ B.T)


def differing(vehicle: Vehicle, kept: Vehicle) -> list[str]:
    """Return a line for everything of a vehicle that stands otherwise in what a target keeps of it."""
    lines = []
    for name in COEFFICIENTS:
        kind, i, j = index(name)
        if kind in ("weight", "moment") or (kind == "mass" and i > j):
            continue
        wanted, found = vehicle.coefficient(name), kept.coefficient(name)
        if wanted != found:
            there = f"{short(found, 6)} there" if found else "absent"
            lines.append(f"{name} = {short(wanted, 6)} {unit(name)}: {there}")
    rounding = 1e-9 * vehicle.weight
    weights = vehicle.weight_minus_buoyancy, kept.weight_minus_buoyancy
    if abs(weights[0] - weights[1]) > rounding:
        lines.append(f"W - B = {short(weights[0], 6)} N: {short(weights[1], 6)} there")
    moments = vehicle.restoring_moment, kept.restoring_moment
    if np.abs(np.subtract(*moments)).max() > rounding:
        wanted_text, found_text = (" ".join(short(each, 6) for each in moment) for moment in moments)
        lines.append(f"BG_x, BG_y, BG_z = {wanted_text} N m/rad: {found_text} there")
    if vehicle.command_delay != kept.command_delay:
        lines.append(f"delay of the commands, {short(vehicle.command_delay)} s: absent")
    if vehicle.thrusters and not kept.thrusters:
        return [*lines, f"the {len(vehicle.thrusters)} thrusters: absent, it is driven by the wrench"]
    lags = [
        here.time_constant
        for here, there in zip(vehicle.thrusters, kept.thrusters, strict=True)
        if here.time_constant != there.time_constant
    ]
    if lags:
        lines.append(f"lag of the thrusters, up to {short(max(lags))} s: absent")
    return lines
