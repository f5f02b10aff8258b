"""What pulled an estimate out of the physical: the sentences of `physical`."""

from __future__ import annotations

from collections.abc import Sequence

from towtank.core.arrays import Array
from towtank.identification.axes import AXES
from towtank.vehicle.names import unit

__all__ = ["coupling", "diagonal", "follows", "unreachable"]

_NOISE = 2.0  # deviations below which nothing need be wrong


def diagonal(kind: str, row: int, name: str, value: float, std: float, deviations: float, to: float) -> str:
    """One coefficient beyond its bound."""
    measured = f"{value:+.3g} +- {std:.2g} {unit(name)}"
    held = "held at 0" if to == 0.0 else f"moved to {to:.3g}"
    if deviations < _NOISE:
        return f"{name} came out as {measured}, {deviations:.1f} deviations beyond what is physical; {held}"
    by = f"by {deviations:.2g} deviations" if deviations < float("inf") else "without any deviation"
    if kind in ("linear", "quadratic"):
        what = "drag that feeds energy in"
        check = f"check the direction of the {_wrench(row)}, the delay, a current or a slow disturbance"
    elif kind == "added":
        what = "an added mass below zero" if row < 3 else "an added inertia below zero"
        check = f"check the {_body(row)} in the file, the thrusters' force scale or the delay"
    else:
        what = f"a total inertia {AXES[row].sum_name} below zero"
        check = f"check the direction of the {_wrench(row)} and the delay"
    return f"the data pull {name} to {measured}, {what} {by}: {check}; {held}"


def _body(row: int) -> str:
    return "mass" if row < 3 else f"moment of inertia {AXES[row].inertia_symbol}"


def _wrench(row: int) -> str:
    return f"commanded {AXES[row].name} {'force' if row < 3 else 'moment'}"


def coupling(kind: str, names: Sequence[str], before: Array, after: Array, deviations: float) -> str:
    """Couplings too large for their diagonal."""
    what = {
        "added": "the added-mass matrix is not positive semidefinite",
        "inertia": "the total mass matrix is not positive definite",
        "linear": "linear damping feeds energy in",
        "quadratic": "quadratic damping feeds energy in",
    }[kind]
    moves = ", ".join(f"{name} {a:.3g} -> {b:.3g}" for name, a, b in zip(names, before, after, strict=True))
    by = f"by {deviations:.2g} deviations" if deviations < float("inf") else "without any deviation"
    doubt = (
        ": this may be chance" if deviations < _NOISE else ": check lever arms, the place of the body origin and signs"
    )
    return f"{what} in a combination of {', '.join(names)}, {by}{doubt}; moved to the nearest physical values ({moves})"


def follows(name: str, value: float, std: float) -> str:
    """A coefficient that reaches its bound only because others move."""
    return f"{name}, {value:.3g} +- {std:.2g} {unit(name)} by itself, comes to 0 once the others are physical"


def unreachable(names: Sequence[str]) -> str:
    """A bound that nothing free can mend."""
    return (
        f"not physical in {', '.join(names)}, and what was learned cannot mend it"
        ": the coefficients held in the vehicle's file are at fault; left as it is"
    )
