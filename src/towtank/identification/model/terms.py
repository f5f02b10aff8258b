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
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.core.layout import ASYMMETRY, CONSTANT, FORWARD, INFLOW, LINEAR, MASS, MOMENT, N_KINDS, QUADRATIC, WEIGHT
from towtank.errors import InputError, nearest
from towtank.vehicle import COEFFICIENTS, Vehicle, index
from towtank.vehicle.matrices import GRAVITY
from towtank.vehicle.names import KINDS

__all__ = [
    "AHEAD",
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
    "Body",
    "Candidates",
    "Line",
    "Term",
    "candidates",
    "paper_names",
    "term_of",
]

IN_DELAY, IN_LAG, IN_GAIN, IN_LATENCY, IN_PLACE = range(
    N_KINDS, N_KINDS + 5
)  # of inputs and sensors, behind the coefficients
Codes = NDArray[np.int64]  # (n, 4) kind, row, column and transform of each free coefficient
N_MOVING = 12  # errors of position, attitude and velocity
N_FIXED = 21  # and of disturbance 6 and current 3; those of the free coefficients follow
UNTRANSFORMED, LOG = range(2)
DISTURBANCE = (0.006,) * 3 + (0.015,) * 3  # m/s^2, rad/s^2: what one does to a vehicle, to begin with

_WATER = 1000.0  # kg/m^3
_ARM = 1.7  # times the gyradius: where the force of a hull that turns acts
_FELT_WITH = 0.6  # of the rigid body: added inertia beside which a vehicle feels a disturbance
_LINEAR_SPEED = (0.3, 0.5)  # m/s, rad/s at which a guessed linear damping equals the quadratic one
_INFLOW_LOSS = 0.3  # s/m: thrust gone at 3 m/s

_ADDED = (1.7, 1.6)  # total inertia, of the rigid body's: translation, rotation
_INERTIA_STD = 0.5  # of ln total inertia
_COUPLING_STD, _TILT_STD = 0.24, 0.1  # of sqrt(M_i M_j): between a force and a rotation; between two of a kind
_SPREAD = 2.0  # of damping, as a share of its mean
_NET_WEIGHT, _RIGHTING, _RIGHTING_STD, _TRIM_STD = 0.01, 0.02, 0.1, 0.02  # of W, W L
_CONSTANT = (0.005, 0.01)  # m/s^2, rad/s^2
_ASYMMETRY_STD = (0.3, 0.03)  # of the quadratic damping; between port and starboard
_INFLOW_STD = 0.15  # s/m

C_LINEAR, C_QUADRATIC, C_RESTORING, C_CONSTANT, C_FORCE, C_LHS = range(6)
C_MASS = C_FORCE  # among an axis' coefficients, the inertia has the place of the force among its columns
N_COLUMNS = 6


class Body:
    """The sizes that physics gives a vehicle's coefficients.

    Attributes:
        rigid: diagonal (6,) of the rigid body's mass matrix [kg, kg m^2]; m: its mass [kg]. length: edge of a cube of
            water of this mass [m]. weight: [N]. gyradii: (3,) [m]. arm: 1 for a translation, the lever arm [m] of hull
            and fins for a rotation (6,). Supposed before any data (6,): total inertia [kg, kg m^2]; quadratic damping
            [kg/m, kg m^2/rad^2] and linear [N s/m, N m s/rad], both positive. disturbance: a usual one (6,) [N, N m].
    """

    def __init__(self, vehicle: Vehicle) -> None:
        rigid = np.diag(vehicle.rigid_body_matrix)
        self.vehicle, self.rigid, self.m = vehicle, rigid, float(rigid[0])
        self.length = (self.m / _WATER) ** (1.0 / 3.0)
        self.weight = self.m * GRAVITY
        self.total = rigid * np.array([_ADDED[0]] * 3 + [_ADDED[1]] * 3)
        self.gyradii = np.sqrt(rigid[3:] / self.m)
        self.arm = np.concatenate([np.ones(3), _ARM * self.gyradii])
        area = _WATER * self.length**2
        self.quadratic = area * self.arm**3
        self.linear = 0.1 * area * self.arm**2
        self.disturbance = rigid * (1.0 + _FELT_WITH) * np.array(DISTURBANCE)

    def drag(self, axis: int) -> float:
        """Return the typical size of the quadratic damping of an axis [kg/m, kg m^2/rad^2]."""
        return float(0.5 * _WATER * self.length**2 if axis < 3 else 0.05 * _WATER * self.length**5)

    def reach(self, axis: int) -> float:
        """Return 1 for a translation, for a rotation the lever arm [m], at least as long as the body."""
        return 1.0 if axis < 3 else max(float(self.arm[axis]), self.length)


@dataclass(frozen=True)
class Line:
    """Mean and deviation of one unknown, in its own unit; of one that is log-normal the deviation of the logarithm."""

    mean: float
    std: float
    source: str


def _linear_size(body: Body, i: int, j: int) -> float:
    a, b = (float(body.drag(axis) * _LINEAR_SPEED[axis > 2]) for axis in (i, j))
    return 0.5 * math.sqrt(a * b)


def _lift_size(body: Body, i: int, j: int) -> float:
    """Return half the density times an area times the lever arms: lift whose slope by the angle is about 1."""
    return float(0.5 * _WATER * body.length**2 * body.reach(i) * body.reach(j))


_DIAGONAL = tuple((i, i) for i in range(6))
_INERTIAS = ((0, 2), (0, 4), (2, 4), (1, 3), (1, 5), (3, 5))  # couplings of a body that is the same to both sides
_DAMPINGS = ((1, 5), (5, 1), (2, 4), (4, 2), (1, 3), (3, 1), (0, 4), (4, 0))
_ALIKE = "a hull that is the same to port and starboard"


def _inertia(body: Body, i: int, j: int) -> Line:
    if i == j:
        kind = "mass" if i < 3 else "inertia about this axis"
        added = float(body.rigid[i] - body.total[i])
        return Line(added, _INERTIA_STD, f"{_ADDED[i > 2]:g} times the rigid body's {kind}")
    share = _TILT_STD if (i < 3) == (j < 3) else _COUPLING_STD
    return Line(0.0, share * math.sqrt(body.total[i] * body.total[j]), _ALIKE)


def _damping(size: Array, i: int, j: int) -> Line:
    if i == j:
        source = "displaced volume" if i < 3 else "displaced volume and radius of gyration"
        return Line(-size[i], _SPREAD * size[i], source)
    return Line(0.0, math.sqrt(size[i] * size[j]), _ALIKE)


def _lift(body: Body, i: int, j: int) -> Line:
    std = _WATER * body.length**2 * float(body.arm[i] * body.arm[j])
    return Line(0.0, std, "lift of a hull of this volume")


def _asymmetry(body: Body, i: int, j: int) -> Line:
    sideways = i in (1, 3, 5)
    source = _ALIKE if sideways else "a hull that is not the same ahead and astern"
    return Line(0.0, _ASYMMETRY_STD[sideways] * body.quadratic[i], source)


def _moment(body: Body, axis: int, _: int) -> Line:
    arm = body.weight * body.length
    if axis == 2:
        return Line(_RIGHTING * arm, _RIGHTING_STD * arm, "weight and displaced volume")
    return Line(0.0, _TRIM_STD * arm, "a vehicle that floats level")


def _constant(body: Body, i: int, _: int) -> Line:
    return Line(0.0, _CONSTANT[i > 2] * float(body.rigid[i]), "thrusters that differ, a tether")


def _drag_both_ways(axis: int, named: str) -> str:
    ways = "ahead and astern" if axis == 0 else "one way and the other"
    return f"{AXES[axis].name} drag differs by {named} {ways}"


Part = Literal["inertia", "drag", "weight", "righting"]


@dataclass(frozen=True)
class Term:
    """What an estimator needs of a kind of coefficient.

    Attributes:
        diagonal: how an element on the diagonal is written, `LOG` or `UNTRANSFORMED`; all others are untransformed.
        size: of an element (row, column) of either sign.
        plausible: elements that a body of this kind may have. supposed: what is supposed of one before any data.
        role: kind, row and column of an element's part in the model (`posterior.wording.Role`), -1 for no axis.
        part: of the body, that changes with it. size_step, log_step: deviation of such a change, as a share of `size`
            where it is untransformed, of its logarithm where it is one.
        where: all vehicles have it, those that go ahead (its force is in proportion to u), or those whose commands to
            thrusters are known.
        noun: what one is called that is no inertia, damping, constant force or restoring term.
        apart: what tells such a one from another coefficient.
        beyond: such a one that cannot be right, in words, by its row and its name with value and unit.
        check: what to check then.
    """

    diagonal: int
    size: Callable[[Body, int, int], float]
    plausible: tuple[tuple[int, int], ...]
    supposed: Callable[[Body, int, int], Line]
    role: Callable[[int, int], tuple[str, int, int]]
    part: Part
    size_step: float
    log_step: float = 0.0
    where: Literal["all", "ahead", "commanded"] = "all"
    noun: str = "coupling"
    apart: str = "motion in which these axes do not move together would tell them apart"
    beyond: Callable[[int, str], str] | None = None
    check: str = "check units, signs and the model"


def _on_diagonal(kind: str) -> Callable[[int, int], tuple[str, int, int]]:
    return lambda i, j: (kind if i == j else "coupling", i, j)


TERMS: dict[int, Term] = {
    MASS: Term(
        LOG,
        lambda body, i, j: 0.3 * math.sqrt(body.rigid[i] * body.rigid[j]),
        (*_DIAGONAL, *_INERTIAS),
        _inertia,
        _on_diagonal("inertia"),
        "inertia",
        size_step=0.3,
        log_step=0.10,
    ),
    LINEAR: Term(
        UNTRANSFORMED,
        _linear_size,
        (*_DIAGONAL, *_DAMPINGS),
        lambda body, i, j: _damping(body.linear, i, j),
        _on_diagonal("linear"),
        "drag",
        size_step=0.5,
        log_step=0.25,
    ),
    QUADRATIC: Term(
        UNTRANSFORMED,
        lambda body, i, j: 0.5 * math.sqrt(body.drag(i) * body.drag(j)),
        _DIAGONAL,
        lambda body, i, j: _damping(body.quadratic, i, j),
        _on_diagonal("quadratic"),
        "drag",
        size_step=0.5,
        log_step=0.25,
    ),
    FORWARD: Term(
        UNTRANSFORMED,  # it damps ahead and drives astern: of either sign
        _lift_size,
        KINDS["forward"].elements,
        _lift,
        lambda i, j: ("coupling", i, j),
        "drag",
        size_step=0.5,
        where="ahead",
        noun="forward-speed term",
        apart="stretches at several speeds ahead would tell them apart",
    ),
    ASYMMETRY: Term(
        UNTRANSFORMED,  # whichever way has more drag
        lambda body, i, _: 0.5 * body.drag(i),
        _DIAGONAL,
        _asymmetry,
        lambda i, j: ("coupling", i, j),
        "drag",
        size_step=0.5,
        noun="asymmetric drag",
        apart="motion both ways along this axis would tell them apart",
        beyond=_drag_both_ways,
        check="check the thruster curves, which may differ by direction themselves",
    ),
    INFLOW: Term(
        UNTRANSFORMED,  # what data say of one that is nearly nothing may be below it
        lambda *_: _INFLOW_LOSS,
        ((0, 0),),
        lambda *_: Line(0.0, _INFLOW_STD, "propellers as they usually are"),
        lambda *_: ("coupling", -1, -1),
        "drag",
        size_step=0.5,
        where="commanded",
        noun="loss of thrust with inflow",
        apart="the same thrust at several speeds would tell them apart",
    ),
    WEIGHT: Term(
        UNTRANSFORMED,
        lambda body, *_: 0.05 * body.weight,
        ((0, 0),),
        lambda body, *_: Line(0.0, _NET_WEIGHT * body.weight, "a vehicle trimmed to 1 % of its weight"),
        lambda *_: ("restoring", 2, -1),
        "weight",
        size_step=0.2,
    ),
    MOMENT: Term(
        UNTRANSFORMED,
        lambda body, *_: 0.1 * body.weight * body.length,
        ((2, 0), (0, 0), (1, 0)),
        _moment,
        lambda axis, _: ("restoring", (4, 3, 3)[axis], -1),
        "righting",
        size_step=0.2,
    ),
    CONSTANT: Term(
        UNTRANSFORMED,
        lambda body, i, _: 3.0 * body.disturbance[i],
        tuple((i, 0) for i in (0, 1, 3, 4, 5)),  # in heave it is W - B
        _constant,
        lambda i, _: ("constant", i, -1),
        "weight",
        size_step=0.5,
    ),
}


def term_of(name: str) -> Term:
    """Return the row of a coefficient's kind."""
    return TERMS[KINDS[index(name)[0]].code]


AHEAD = tuple(name for name in COEFFICIENTS if term_of(name).where == "ahead")


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
