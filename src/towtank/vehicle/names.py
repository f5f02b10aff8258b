"""The SNAME names of hydrodynamic coefficients: which kind and which element each is, its unit and its meaning.

Rows are forces and moments X Y Z K M N, columns velocities u v w p q r. `X_udot` is added mass (M_A = -X_udot),
`X_u` linear and `X_uu` quadratic damping (force X_u u and X_uu |u| u), `X_0` a constant force fixed in the body (the
asymmetry of hull and thrusters, a tether), `Y_uv` a forward-speed term (force Y_uv u v, lift of hull and wings), `X_u2`
asymmetric drag (force X_u2 u^2, by which drag differs ahead and astern). `inflow_loss` is the share of its thrust that
a thruster loses per m/s of water that meets it. Beside them stand the restoring quantities `W_minus_B` and `BG_x`,
`BG_y`, `BG_z` = r_G W - r_B B, of which `BG_z` = z_G W - z_B B rights the vehicle.

All of it is one table, a row per kind of coefficient; what an estimator needs of a kind besides stands in
`towtank.identification.model.terms`, its forces in `towtank.core`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from towtank.core import layout
from towtank.errors import InputError, nearest

__all__ = [
    "COEFFICIENTS",
    "COLUMNS",
    "FORWARD_SPEED",
    "HYDRODYNAMIC",
    "KINDS",
    "RESTORING",
    "ROWS",
    "Kind",
    "KindOfCoefficient",
    "describe",
    "index",
    "mirror",
    "short_words",
    "unit",
]

ROWS = "XYZKMN"
COLUMNS = "uvwpqr"
RESTORING = ("W_minus_B", "BG_x", "BG_y", "BG_z")
Kind = Literal["mass", "linear", "quadratic", "constant", "weight", "moment", "forward", "asymmetric", "inflow"]
_AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_ALL = tuple((i, j) for i in range(6) for j in range(6))
_FORWARD = tuple(zip(layout.FORWARD_ROWS, layout.FORWARD_COLUMNS, strict=True))


@dataclass(frozen=True)
class KindOfCoefficient:
    """A row of the table.

    Attributes:
        code: its number in the kernels (`towtank.core.layout`). elements: (row, column) of each of its coefficients.
        name: of an element. units: [force in a moment's row?][velocity in an angle's column?].
        words: what an element is. short: the same in two or three words.
        mirrored: whether the transposed element has a name too.
        damps: whether an element on the diagonal takes energy out where it is negative, and feeds it in where positive.
        outweighed_by: the damping of its axis beyond which an element, whatever its sign, feeds energy in one way.
    """

    code: int
    elements: tuple[tuple[int, int], ...]
    name: Callable[[int, int], str]
    units: tuple[tuple[str, str], tuple[str, str]]
    words: Callable[[int, int], str]
    short: Callable[[int, int], str]
    mirrored: bool = False
    damps: bool = False
    outweighed_by: Kind | None = None


def _force(i: int) -> str:
    return f"{_AXES[i]} {'force' if i < 3 else 'moment'}"


def _added_mass(i: int, j: int) -> str:
    noun = ("added mass" if i < 3 else "added inertia") if i == j else "added-mass coupling"
    return f"{noun}: {_force(i)} per {_AXES[j]} acceleration"


def _drag(kind: str, name: Callable[[int, int], str]) -> Callable[[int, int], str]:
    return lambda i, j: f"{_AXES[i]} {kind} drag" if i == j else f"{kind} damping {name(i, j)}"


def _mass_name(i: int, j: int) -> str:
    return f"{ROWS[i]}_{COLUMNS[j]}dot"


def _linear_name(i: int, j: int) -> str:
    return f"{ROWS[i]}_{COLUMNS[j]}"


def _quadratic_name(i: int, j: int) -> str:
    return f"{ROWS[i]}_{COLUMNS[j] * 2}"


KINDS: dict[Kind, KindOfCoefficient] = {
    "mass": KindOfCoefficient(
        layout.MASS,
        _ALL,
        _mass_name,
        (("kg", "kg m"), ("kg m", "kg m^2")),
        _added_mass,
        lambda i, j: f"added-mass coupling {_mass_name(i, j)}",
        mirrored=True,
    ),
    "linear": KindOfCoefficient(
        layout.LINEAR,
        _ALL,
        _linear_name,
        (("N s/m", "N s/rad"), ("N s", "N m s/rad")),
        lambda i, j: f"linear damping: {_force(i)} per {COLUMNS[j]}",
        _drag("linear", _linear_name),
        mirrored=True,
        damps=True,
    ),
    "quadratic": KindOfCoefficient(
        layout.QUADRATIC,
        _ALL,
        _quadratic_name,
        (("kg/m", "kg m/rad^2"), ("kg", "kg m^2/rad^2")),
        lambda i, j: f"quadratic damping: {_force(i)} per {COLUMNS[j]}|{COLUMNS[j]}|",
        _drag("quadratic", _quadratic_name),
        mirrored=True,
        damps=True,
    ),
    "constant": KindOfCoefficient(
        layout.CONSTANT,
        tuple((i, 0) for i in range(6)),
        lambda i, _: f"{ROWS[i]}_0",
        (("N", "N"), ("N m", "N m")),
        lambda i, _: f"constant {_force(i)}, fixed in the body",
        lambda i, _: f"constant {_force(i)}",
    ),
    "weight": KindOfCoefficient(
        layout.WEIGHT,
        ((0, 0),),
        lambda *_: RESTORING[0],
        (("N", "N"), ("N", "N")),
        lambda *_: "weight minus buoyancy, positive sinks",
        lambda *_: "net weight W - B",
    ),
    "moment": KindOfCoefficient(
        layout.MOMENT,
        tuple((axis, 0) for axis in range(3)),
        lambda axis, _: RESTORING[1 + axis],
        (("N m/rad", "N m/rad"), ("N m/rad", "N m/rad")),
        lambda axis, _: f"restoring moment arm times force, {'xyz'[axis]}_G W - {'xyz'[axis]}_B B",
        lambda axis, _: "righting moment BG_z" if axis == 2 else f"trim moment {RESTORING[1 + axis]}",
    ),
    "forward": KindOfCoefficient(
        layout.FORWARD,
        _FORWARD,
        lambda i, j: f"{ROWS[i]}_u{COLUMNS[j]}",
        (("kg/m", "kg"), ("kg", "kg m")),
        lambda i, j: f"forward-speed term: {_force(i)} per u {COLUMNS[j]}",
        lambda i, j: f"{_force(i)} per u {COLUMNS[j]}",
    ),
    "asymmetric": KindOfCoefficient(
        layout.ASYMMETRY,
        tuple((i, i) for i in range(6)),
        lambda i, j: f"{ROWS[i]}_{COLUMNS[j]}2",
        (("kg/m", "kg/m"), ("kg m^2/rad^2", "kg m^2/rad^2")),
        lambda i, j: f"asymmetric drag: {_force(i)} per {COLUMNS[j]}^2, of the same sign either way",
        lambda i, _: f"{_AXES[i]} asymmetric drag",
        outweighed_by="quadratic",
    ),
    "inflow": KindOfCoefficient(
        layout.INFLOW,
        ((0, 0),),
        lambda *_: "inflow_loss",
        (("s/m", "s/m"), ("s/m", "s/m")),
        lambda *_: "loss of thrust with inflow",
        lambda *_: "loss of thrust with inflow",
    ),
}
_INDEX: dict[str, tuple[Kind, int, int]] = {
    KINDS[kind].name(i, j): (kind, i, j)
    for kinds in (
        ("mass", "linear", "quadratic"),
        ("constant",),
        ("weight",),
        ("moment",),
        ("forward",),
        ("asymmetric",),
        ("inflow",),
    )
    for i, j in KINDS[kinds[0]].elements
    for kind in kinds
}


COEFFICIENTS: tuple[str, ...] = tuple(_INDEX)


HYDRODYNAMIC: tuple[str, ...] = tuple(name for name in COEFFICIENTS if name not in RESTORING)


FORWARD_SPEED: tuple[str, ...] = tuple(KINDS["forward"].name(i, j) for i, j in _FORWARD)


def index(name: str) -> tuple[Kind, int, int]:
    """Return (kind, row, column) of a coefficient; for `weight` (0, 0), `constant` (row, 0), `moment` (axis, 0).

    Raises:
        InputError: no coefficient has this name.

    >>> index("N_vdot"), index("N_uv")
    (('mass', 5, 1), ('forward', 5, 1))
    """
    if name not in _INDEX:
        raise InputError(f'"{name}" is not a coefficient{nearest(name, COEFFICIENTS)}')
    return _INDEX[name]


def unit(name: str) -> str:
    """Return the SI unit of a coefficient, as `kg/m` for X_uu. Raises InputError for an unknown name."""
    kind, i, j = index(name)
    return KINDS[kind].units[i >= 3][j >= 3]


def describe(name: str) -> str:
    """Return what a coefficient is, in a few words. Raises InputError for an unknown name."""
    kind, i, j = index(name)
    return KINDS[kind].words(i, j)


def short_words(name: str) -> str:
    """Return what a coefficient is in two or three words, as `yaw quadratic drag`. Raises InputError for another name.

    >>> short_words("N_rr"), short_words("W_minus_B"), short_words("N_uv")
    ('yaw quadratic drag', 'net weight W - B', 'yaw moment per u v')
    """
    kind, i, j = index(name)
    return KINDS[kind].short(i, j)


def mirror(name: str) -> str:
    """Return the name of the transposed element, as `N_vdot` for `Y_rdot`; the name itself where there is none.

    Raises:
        InputError: an unknown name.
    """
    kind, i, j = index(name)
    return KINDS[kind].name(j, i) if KINDS[kind].mirrored else name
