"""What an estimator must know of a coefficient: a row per kind, and the axes and columns of the paper's method.

Name, place, unit and words of a coefficient are the vehicle's knowledge (`towtank.vehicle.names`); its force, that per
unit of it and its derivative by the velocity are the core's (`towtank.core.rk4`, `regressor`, `forces`). `TERMS` adds
how it is written as an unconstrained number, how large it is on a body of this size, what it does beside the others,
and by how much a change of the vehicle moves it. Whatever depends on the kind of a coefficient reads it here.

One axis obeys M nu_dot = c_lin nu + c_quad |nu| nu + c_rest r(k) + c_0 + F, where F is everything known: the
thrusters' wrench, C(nu) nu and off-diagonal damping. Divided by M it is the paper's regression,

    nu_dot = [nu, |nu| nu, r, 1, F] Theta,   Theta = [c_lin/M, c_quad/M, c_rest/M, c_0/M, 1/M],

(47)-(57) with the missing velocity factor put in and the restoring terms' sign mended. k is the direction of gravity in
the body. r is -k_y (roll) and k_x (pitch), whose coefficient is BG_z, and k_z (heave), whose coefficient is W - B. c_0
is a constant force fixed in the body (thrusters that differ, a tether); left out, it falls upon the other coefficients.
In heave it cannot be told from W - B and is left to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.layout import (
    ASYMMETRY,
    CONSTANT,
    FORWARD,
    INFLOW,
    LINEAR,
    MASS,
    MOMENT,
    N_KINDS,
    QUADRATIC,
    WEIGHT,
)
from towtank.errors import InputError, nearest
from towtank.vehicle import Vehicle

__all__ = [
    "AXES",
    "C_CONSTANT",
    "C_FORCE",
    "C_LHS",
    "C_LINEAR",
    "C_MASS",
    "C_QUADRATIC",
    "C_RESTORING",
    "N_COLUMNS",
    "N_FIXED",
    "TERMS",
    "Axis",
    "Candidates",
    "Term",
    "candidates",
    "paper_names",
]

IN_DELAY, IN_LAG, IN_GAIN, IN_LATENCY, IN_PLACE = range(
    N_KINDS, N_KINDS + 5
)  # of inputs and sensors, behind the coefficients
Codes = NDArray[np.int64]  # (n, 4) kind, row, column and transform of each free coefficient
N_MOVING = 12  # errors of position, attitude and velocity
N_FIXED = 21  # and of disturbance 6 and current 3; those of the free coefficients follow
UNTRANSFORMED, LOG = range(2)
ADDED = 0.6  # of the rigid body's inertia
_WATER = 1000.0  # kg/m^3
_GRAVITY = 9.81  # m/s^2
DISTURBANCE = (0.006,) * 3 + (0.015,) * 3  # m/s^2, rad/s^2: what one does to a vehicle, to begin with
_LINEAR_SPEED = (0.3, 0.5)  # m/s, rad/s at which a guessed linear damping equals the quadratic one
_ARM = 1.7  # times the gyradius: where the force of a hull that turns acts
_INFLOW_LOSS = 0.3  # s/m: thrust gone at 3 m/s

C_LINEAR, C_QUADRATIC, C_RESTORING, C_CONSTANT, C_FORCE, C_LHS = range(6)
C_MASS = C_FORCE  # among an axis' coefficients, the inertia has the place of the force among its columns
N_COLUMNS = 6


class BodySize(NamedTuple):
    """What sets the size of a vehicle's coefficients.

    Attributes:
        rigid: diagonal of M_RB (6,). disturbance: a usual one (6,) [N, N m]. length: edge [m] of a cube of water of its
            mass. weight: [N].
    """

    rigid: Array
    disturbance: Array
    length: float
    weight: float

    def arm(self, axis: int) -> float:
        """Return 1 for a translation, the lever arm [m] of hull and fins for a rotation."""
        return 1.0 if axis < 3 else max(_ARM * math.sqrt(self.rigid[axis] / self.rigid[0]), self.length)


def body_size(vehicle: Vehicle) -> BodySize:
    """Return what sets the size of the coefficients of a vehicle: its rigid body."""
    rigid = np.diag(vehicle.rigid_body_matrix)
    length = (float(rigid[0]) / _WATER) ** (1.0 / 3.0)
    return BodySize(rigid, usual_disturbance(vehicle), length, _GRAVITY * float(rigid[0]))


def usual_disturbance(vehicle: Vehicle) -> Array:
    """Return levels (6,) [N, N m] of a disturbance that a vehicle of this inertia feels."""
    inertia = np.diag(vehicle.rigid_body_matrix) * (1.0 + ADDED)
    return np.asarray(inertia * np.array(DISTURBANCE), dtype=np.float64)


def damping_guess(body: BodySize, kind: int, axis: int) -> float:
    """Return the size of the linear or quadratic damping of an axis."""
    quadratic = 0.5 * _WATER * body.length**2 if axis < 3 else 0.05 * _WATER * body.length**5
    return float(quadratic * _LINEAR_SPEED[0 if axis < 3 else 1]) if kind == LINEAR else quadratic


def _damping_size(kind: int) -> Callable[[BodySize, int, int], float]:
    return lambda body, i, j: 0.5 * math.sqrt(damping_guess(body, kind, i) * damping_guess(body, kind, j))


def _lift_size(body: BodySize, i: int, j: int) -> float:
    """Return half the density times an area times the lever arms: lift whose slope by the angle is about 1."""
    return 0.5 * _WATER * body.length**2 * body.arm(i) * body.arm(j)


Part = Literal["inertia", "drag", "weight", "righting"]


@dataclass(frozen=True)
class Term:
    """What an estimator needs of a kind of coefficient.

    Attributes:
        diagonal: how an element on the diagonal is written, `LOG` or `UNTRANSFORMED`; all others are untransformed.
        size: of an element (row, column) of either sign.
        role: kind, row and column of an element's part in the model (`posterior.wording.Role`), -1 for no axis.
        part: of the body, that changes with it. size_step, log_step: deviation of such a change, as a share of `size`
            where it is untransformed, of its logarithm where it is one.
        by_motion: whether motion makes its force, along the axis of its row.
        noun: what one is called that is no inertia, damping, constant force or restoring term.
        apart: what tells such a one from another coefficient.
    """

    diagonal: int
    size: Callable[[BodySize, int, int], float]
    role: Callable[[int, int], tuple[str, int, int]]
    part: Part
    size_step: float
    log_step: float = 0.0
    by_motion: bool = False
    noun: str = "coupling"
    apart: str = "motion in which these axes do not move together would tell them apart"


def _on_diagonal(kind: str) -> Callable[[int, int], tuple[str, int, int]]:
    return lambda i, j: (kind if i == j else "coupling", i, j)


TERMS: dict[int, Term] = {
    MASS: Term(
        LOG,
        lambda body, i, j: 0.3 * math.sqrt(body.rigid[i] * body.rigid[j]),
        _on_diagonal("inertia"),
        "inertia",
        size_step=0.3,
        log_step=0.10,
        by_motion=True,
    ),
    LINEAR: Term(
        UNTRANSFORMED,
        _damping_size(LINEAR),
        _on_diagonal("linear"),
        "drag",
        size_step=0.5,
        log_step=0.25,
        by_motion=True,
    ),
    QUADRATIC: Term(
        UNTRANSFORMED,
        _damping_size(QUADRATIC),
        _on_diagonal("quadratic"),
        "drag",
        size_step=0.5,
        log_step=0.25,
        by_motion=True,
    ),
    WEIGHT: Term(
        UNTRANSFORMED,
        lambda body, *_: 0.05 * body.weight,
        lambda *_: ("restoring", 2, -1),
        "weight",
        size_step=0.2,
    ),
    MOMENT: Term(
        UNTRANSFORMED,
        lambda body, *_: 0.1 * body.weight * body.length,
        lambda axis, _: ("restoring", (4, 3, 3)[axis], -1),
        "righting",
        size_step=0.2,
    ),
    CONSTANT: Term(
        UNTRANSFORMED,
        lambda body, i, _: 3.0 * body.disturbance[i],
        lambda i, _: ("constant", i, -1),
        "weight",
        size_step=0.5,
    ),
    FORWARD: Term(
        UNTRANSFORMED,  # it damps ahead and drives astern: of either sign
        _lift_size,
        lambda i, j: ("coupling", i, j),
        "drag",
        size_step=0.5,
        by_motion=True,
        noun="forward-speed term",
        apart="stretches at several speeds ahead would tell them apart",
    ),
    ASYMMETRY: Term(
        UNTRANSFORMED,  # whichever way has more drag
        lambda body, i, _: 0.5 * damping_guess(body, QUADRATIC, i),
        lambda i, j: ("coupling", i, j),
        "drag",
        size_step=0.5,
        by_motion=True,
        noun="asymmetric drag",
        apart="motion both ways along this axis would tell them apart",
    ),
    INFLOW: Term(
        UNTRANSFORMED,  # what data say of one that is nearly nothing may be below it
        lambda *_: _INFLOW_LOSS,
        lambda *_: ("coupling", -1, -1),
        "drag",
        size_step=0.5,
        noun="loss of thrust with inflow",
        apart="the same thrust at several speeds would tell them apart",
    ),
}


@dataclass(frozen=True)
class Axis:
    """One axis: its place in nu and the names of its coefficients, "" where it has none."""

    index: int
    name: str
    velocity: str
    wrench: str
    added_mass: str
    linear: str
    quadratic: str
    restoring: str
    constant: str
    inertia_symbol: str
    unit: str

    @property
    def columns(self) -> tuple[str, str, str, str]:
        """Coefficient names of the columns linear, quadratic, restoring and constant."""
        return self.linear, self.quadratic, self.restoring, self.constant

    @property
    def sum_name(self) -> str:
        """What is really identified: rigid-body and added inertia appear only as this sum."""
        return f"{self.inertia_symbol} - {self.added_mass}"


AXES = (
    Axis(0, "surge", "u", "X", "X_udot", "X_u", "X_uu", "", "X_0", "m", "kg"),
    Axis(1, "sway", "v", "Y", "Y_vdot", "Y_v", "Y_vv", "", "Y_0", "m", "kg"),
    Axis(2, "heave", "w", "Z", "Z_wdot", "Z_w", "Z_ww", "W_minus_B", "", "m", "kg"),
    Axis(3, "roll", "p", "K", "K_pdot", "K_p", "K_pp", "BG_z", "K_0", "I_x", "kg m^2"),
    Axis(4, "pitch", "q", "M", "M_qdot", "M_q", "M_qq", "BG_z", "M_0", "I_y", "kg m^2"),
    Axis(5, "yaw", "r", "N", "N_rdot", "N_r", "N_rr", "", "N_0", "I_z", "kg m^2"),
)


@dataclass(frozen=True)
class Candidates:
    """Coefficients of one axis that may be free, (5,) in the order linear, quadratic, restoring, constant, mass.

    Attributes:
        wanted: may be free. asked: named by the user, so never dropped for another. known: the vehicle's values.
    """

    axis: Axis
    to_learn: tuple[bool, ...]
    requested: bool
    known: Array


def paper_names() -> tuple[str, ...]:
    """Names of all coefficients that the paper's method can identify."""
    names: list[str] = []
    for axis in AXES:
        names += [axis.added_mass, *(name for name in axis.columns if name and name not in names)]
    return tuple(names)


def candidates(vehicle: Vehicle, free: Collection[str] | None = None) -> tuple[Candidates, ...]:
    """Return what may be free on each axis.

    By default: every inertia, the damping terms that the vehicle's file has (both where it has none), righting
    moments, net weight and constant forces. With `free`, exactly those names.

    Raises:
        InputError: a name that the method cannot identify.
    """
    names = paper_names()
    for name in free or ():
        if name not in names:
            raise InputError(
                f'free: found "{name}", expected one of {", ".join(names)}{nearest(name, names)} '
                "(the paper's method takes one axis at a time and keeps off-diagonal, forward-speed "
                "and asymmetric coefficients at the vehicle's values; methods joint and output-error learn them)"
            )
    found = []
    for axis in AXES:
        i = axis.index
        known = np.array([vehicle.coefficient(name) if name else 0.0 for name in (*axis.columns, "")])
        known[C_MASS] = vehicle.mass_matrix[i, i]
        if free is None:
            terms = known[[C_LINEAR, C_QUADRATIC]] != 0.0
            damping = (True, True) if not terms.any() else (bool(terms[0]), bool(terms[1]))
            to_learn: tuple[bool, ...] = (*damping, bool(axis.restoring), bool(axis.constant), True)
        else:
            to_learn = (*(name in free for name in axis.columns), axis.added_mass in free)
        found.append(Candidates(axis, to_learn, free is not None, known))
    return tuple(found)
