"""The six axes of the paper's method and the columns of their regressions.

One axis obeys M nu_dot = c_lin nu + c_quad |nu| nu + c_rest r(k) + c_0 + F, where F is everything known: the
thrusters' wrench, C(nu) nu and off-diagonal damping. Divided by M it is the paper's regression,

    nu_dot = [nu, |nu| nu, r, 1, F] Theta,   Theta = [c_lin/M, c_quad/M, c_rest/M, c_0/M, 1/M],

(47)-(57) with the missing velocity factor put in and the restoring terms' sign mended. k is the direction of gravity in
the body. r is -k_y (roll) and k_x (pitch), whose coefficient is BG_z, and k_z (heave), whose coefficient is W - B. c_0
is a constant force fixed in the body (thrusters that differ, a tether); left out, it falls upon the other coefficients.
In heave it cannot be told from W - B and is left to it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
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
    "Axis",
    "Candidates",
    "candidates",
    "paper_names",
]

C_LINEAR, C_QUADRATIC, C_RESTORING, C_CONSTANT, C_FORCE, C_LHS = range(6)
C_MASS = C_FORCE  # among an axis' coefficients, the inertia has the place of the force among its columns
N_COLUMNS = 6


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
                "(the paper's method takes one axis at a time, so no off-diagonal coefficients)"
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
