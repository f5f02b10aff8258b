"""The SNAME names of hydrodynamic coefficients: which matrix element each is, its unit and its meaning.

Rows are forces and moments X Y Z K M N, columns velocities u v w p q r. `X_udot` is added mass (M_A = -X_udot),
`X_u` linear and `X_uu` quadratic damping (force X_u u and X_uu |u| u), `X_0` a constant force fixed in the body (the
asymmetry of hull and thrusters, a tether). Beside them stand the restoring quantities
`W_minus_B` and `BG_x`, `BG_y`, `BG_z` = r_G W - r_B B, of which `BG_z` = z_G W - z_B B rights the vehicle.
"""

from __future__ import annotations

from typing import Literal

from towtank.errors import InputError, nearest

__all__ = [
    "COEFFICIENTS",
    "COLUMNS",
    "HYDRODYNAMIC",
    "RESTORING",
    "ROWS",
    "Kind",
    "describe",
    "index",
    "mirror",
    "unit",
]

ROWS = "XYZKMN"
COLUMNS = "uvwpqr"
RESTORING = ("W_minus_B", "BG_x", "BG_y", "BG_z")
Kind = Literal["mass", "linear", "quadratic", "constant", "weight", "moment"]
# by kind, then (force row?, linear velocity column?)
_UNITS = {
    ("mass", True, True): "kg",
    ("mass", True, False): "kg m",
    ("mass", False, True): "kg m",
    ("mass", False, False): "kg m^2",
    ("linear", True, True): "N s/m",
    ("linear", True, False): "N s/rad",
    ("linear", False, True): "N s",
    ("linear", False, False): "N m s/rad",
    ("quadratic", True, True): "kg/m",
    ("quadratic", True, False): "kg m/rad^2",
    ("quadratic", False, True): "kg",
    ("quadratic", False, False): "kg m^2/rad^2",
}
_AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")


def _table() -> dict[str, tuple[Kind, int, int]]:
    table: dict[str, tuple[Kind, int, int]] = {}
    for i, row in enumerate(ROWS):
        for j, column in enumerate(COLUMNS):
            table[f"{row}_{column}dot"] = ("mass", i, j)
            table[f"{row}_{column}"] = ("linear", i, j)
            table[f"{row}_{column}{column}"] = ("quadratic", i, j)
    for i, row in enumerate(ROWS):
        table[f"{row}_0"] = ("constant", i, 0)
    table["W_minus_B"] = ("weight", 0, 0)
    for axis, name in enumerate(RESTORING[1:]):
        table[name] = ("moment", axis, 0)
    return table


_INDEX = _table()


COEFFICIENTS: tuple[str, ...] = tuple(_INDEX)


HYDRODYNAMIC: tuple[str, ...] = tuple(name for name in COEFFICIENTS if name not in RESTORING)


def index(name: str) -> tuple[Kind, int, int]:
    """Return (kind, row, column) of a coefficient; for `weight` (0, 0), `constant` (row, 0), `moment` (axis, 0).

    Raises:
        InputError: no coefficient has this name.

    >>> index("N_vdot")
    ('mass', 5, 1)
    """
    if name not in _INDEX:
        raise InputError(f'"{name}" is not a coefficient{nearest(name, COEFFICIENTS)}')
    return _INDEX[name]


def unit(name: str) -> str:
    """Return the SI unit of a coefficient, as `kg/m` for X_uu. Raises InputError for an unknown name."""
    kind, i, j = index(name)
    if kind == "weight":
        return "N"
    if kind == "moment":
        return "N m/rad"
    if kind == "constant":
        return "N" if i < 3 else "N m"
    return _UNITS[kind, i < 3, j < 3]


def describe(name: str) -> str:
    """Return what a coefficient is, in a few words. Raises InputError for an unknown name."""
    kind, i, j = index(name)
    if kind == "weight":
        return "weight minus buoyancy, positive sinks"
    if kind == "moment":
        return f"restoring moment arm times force, {'xyz'[i]}_G W - {'xyz'[i]}_B B"
    what = "force" if i < 3 else "moment"
    if kind == "constant":
        return f"constant {_AXES[i]} {what}, fixed in the body"
    if kind == "mass":
        noun = ("added mass" if i < 3 else "added inertia") if i == j else "added-mass coupling"
        return f"{noun}: {_AXES[i]} {what} per {_AXES[j]} acceleration"
    square = f"{COLUMNS[j]}|{COLUMNS[j]}|" if kind == "quadratic" else COLUMNS[j]
    return f"{kind} damping: {_AXES[i]} {what} per {square}"


def mirror(name: str) -> str:
    """Return the name of the transposed element, as `N_vdot` for `Y_rdot`. Raises InputError for an unknown name."""
    kind, i, j = index(name)
    if kind in ("weight", "moment", "constant"):
        return name
    column = COLUMNS[i]
    tail = {"mass": f"{column}dot", "linear": column, "quadratic": column * 2}[kind]
    return f"{ROWS[j]}_{tail}"
