"""Names of coefficients in plain words: axis, role, unit of speed; also `delay`, `lag` and `gain_<thruster>`."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from towtank.identification.axes import AXES
from towtank.vehicle.names import COEFFICIENTS, COLUMNS, ROWS, index

__all__ = ["Role", "label", "percent", "phrase", "role", "speed_unit"]


@dataclass(frozen=True)
class Role:
    """What a free parameter does.

    Attributes:
        kind: "inertia", "linear", "quadratic" (all three on the diagonal), "coupling", "restoring", "constant", "gain",
            "delay", "lag" or "other".
        row: axis (0..5) whose force it makes, -1 for none. column: axis whose speed or acceleration makes it, or -1.
    """

    kind: str
    row: int = -1
    column: int = -1

    @property
    def scales(self) -> bool:
        """Whether it grows with the unit of force, as masses, drags and thrusts do."""
        return self.kind not in ("delay", "lag", "other")


def role(name: str) -> Role:
    """Return the role of a coefficient or input parameter."""
    if name in ("delay", "lag"):
        return Role(name)
    if name.startswith("gain_"):
        return Role("gain")
    if name not in COEFFICIENTS:
        return Role("other")
    kind, i, j = index(name)
    if kind == "weight":
        return Role("restoring", 2)
    if kind == "moment":
        return Role("restoring", (4, 3, 3)[i])
    if kind == "constant":
        return Role("constant", i)
    if i != j:
        return Role("coupling", i, j)
    return Role("inertia" if kind == "mass" else kind, i, j)


def label(name: str) -> str:
    """Return what is really known of it: of an added inertia the sum with the rigid body's.

    >>> label("N_rdot"), label("N_r")
    ('I_z - N_rdot', 'N_r')
    """
    part = role(name)
    return AXES[part.row].sum_name if part.kind == "inertia" else name


def speed_unit(axis: int) -> str:
    """Return the unit of an axis' speed."""
    return "m/s" if axis < 3 else "rad/s"


def percent(share: float) -> str:
    """Return a share as text: two digits below 10 %, whole above.

    >>> percent(0.0234), percent(0.5)
    ('2.3 %', '50 %')
    """
    value = 100.0 * share
    return f"{value:.2g} %" if value < 9.95 else f"{value:.0f} %"


def phrase(name: str, names: Collection[str] = ()) -> str:
    """Return what a person calls it; drag is linear or quadratic only where `names` hold both.

    >>> phrase("X_uu"), phrase("N_r", ["N_r", "N_rr"]), phrase("K_pdot")
    ('surge drag', 'linear yaw drag', 'roll inertia')
    """
    part = role(name)
    if part.kind == "inertia":
        return f"{AXES[part.row].name} {'mass' if part.row < 3 else 'inertia'}"
    if part.kind in ("linear", "quadratic"):
        row, column = ROWS[part.row], COLUMNS[part.row]
        both = f"{row}_{column}" in names and f"{row}_{column * 2}" in names
        return f"{part.kind + ' ' if both else ''}{AXES[part.row].name} drag"
    if part.kind == "coupling":
        return f"the coupling {name}"
    if part.kind == "constant":
        return f"the constant {AXES[part.row].name} {'force' if part.row < 3 else 'moment'}"
    if part.kind == "gain":
        return f"the gain of thruster {name.removeprefix('gain_')}"
    special = {"W_minus_B": "the net weight", "BG_z": "the righting moment", "delay": "the delay", "lag": "the lag"}
    return special.get(name, name)
