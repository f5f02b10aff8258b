"""What is said of an estimate: names in plain words, why a coefficient is not identified, what pulled it out of the
physical.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from towtank.core.arrays import Array
from towtank.digits import measured
from towtank.identification.model.terms import AXES, term_of
from towtank.vehicle.names import COEFFICIENTS, COLUMNS, ROWS, index, unit

__all__ = [
    "contradicted",
    "not_narrowed",
    "phrase",
    "reversed_force",
    "role",
    "surer_together",
]

_SURER = 0.5  # times the deviation of the delay, of a sum that is worth a word
_NOISE = 2.0  # deviations below which nothing need be wrong


@dataclass(frozen=True)
class Role:
    """What a free parameter does.

    Attributes:
        kind: "inertia", "linear", "quadratic" (all three on the diagonal), "coupling" (forward-speed terms too),
            "restoring", "constant", "gain", "delay", "lag" or "other".
        row: axis (0..5) whose force it makes, -1 for none. column: axis whose speed or acceleration makes it, or -1.
    """

    kind: str
    row: int = -1
    column: int = -1


def role(name: str) -> Role:
    """Return the role of a coefficient or input parameter."""
    if name in ("delay", "lag"):
        return Role(name)
    if name.startswith("gain_"):
        return Role("gain")
    if name not in COEFFICIENTS:
        return Role("other")
    _, i, j = index(name)
    return Role(*term_of(name).role(i, j))


def not_narrowed(name: str, share: float) -> str:
    """Return why a coefficient is not identified: what is left of its prior's deviation, and what would narrow it."""
    left = f"the data leave {100.0 * min(share, 1.0):.0f} % of the prior's deviation"
    part = role(name)
    if part.kind == "coupling":
        return f"{left}; {term_of(name).apart}"
    if part.kind == "constant":
        return f"{left}; a run over all headings and attitudes would narrow it"
    if part.row < 0:
        return left
    axis = AXES[part.row].name
    if part.kind == "restoring":
        return f"{left}; {'larger angles' if name.startswith('BG') else 'driving heave'} would narrow it"
    how = "faster and slower" if part.kind in ("linear", "quadratic") else "harder, to and fro"
    return f"{left}; driving {axis} {how} would narrow it"


def surer_together(std: float | None, together: tuple[float, float] | None) -> tuple[str, str] | None:
    """Return delay and lag together, and their deviation [ms], where that is far surer than the delay is."""
    if std is None or together is None or together[1] > _SURER * std:
        return None
    return measured(1e3 * together[0], 1e3 * together[1])


def contradicted() -> str:
    """Return why a coefficient is not identified that one reading of the data narrows, and another puts elsewhere."""
    return "the data narrow it, but read in another way give another value: see how it was learned"


def not_shown(name: str) -> str:
    """Return why a coefficient was not learned at all: no motion that it makes or answers to.

    >>> not_shown("K_pp")
    'nothing measures or drives roll, so the prior is kept'
    """
    part = role(name)
    axes = list(dict.fromkeys(AXES[axis].name for axis in (part.row, part.column) if axis >= 0))
    of = " or ".join(axes) or "surge, sway and heave"
    return f"nothing measures or drives {of}, so the prior is kept"


def label(name: str) -> str:
    """Return what is really known of it: of an added inertia the sum with the rigid body's.

    >>> label("N_rdot"), label("N_r")
    ('I_z - N_rdot', 'N_r')
    """
    part = role(name)
    return AXES[part.row].sum_name if part.kind == "inertia" else name


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
        return f"the {term_of(name).noun} {name}"
    if part.kind == "constant":
        return f"the constant {AXES[part.row].name} {'force' if part.row < 3 else 'moment'}"
    if part.kind == "gain":
        return f"the gain of thruster {name.removeprefix('gain_')}"
    special = {"W_minus_B": "the net weight", "BG_z": "the righting moment", "delay": "the delay", "lag": "the lag"}
    return special.get(name, name)


def will_be_known(what: str, value: float) -> str:
    """A line of `inspect`."""
    return f"{what} will be known to {percent(value / 100.0)}" if value < 100.0 else f"{what} cannot be told from 0"


def diagonal(kind: str, row: int, name: str, value: float, std: float, deviations: float, to: float) -> str:
    """One coefficient beyond its bound."""
    measured = f"{value:+.3g} +- {std:.2g} {unit(name)}"
    held = f"moved to {to:.3g}"
    if deviations < _NOISE:
        return f"{name} came out as {measured}, {deviations:.1f} deviations beyond what is physical; {held}"
    by = f"by {deviations:.2g} deviations" if deviations < float("inf") else "without any deviation"
    if kind in ("ahead", "astern"):
        what = "drag that feeds energy in one way"
        check = f"a run both ways in {AXES[row].name} would tell both"
    elif kind == "loss":
        what = "thrusters that gain thrust from the water through them"
        check = "check their curves ahead and astern"
    elif kind == "added":
        what = "an added mass below zero" if row < 3 else "an added inertia below zero"
        check = f"check the {_body(row)} in the file, the thrusters' force scale or the delay"
    elif kind == "inertia":
        what = f"a total inertia {AXES[row].sum_name} below zero"
        check = f"check the direction of the {_wrench(row)} and the delay"
    else:
        what = "drag that feeds energy in"
        check = f"check the direction of the {_wrench(row)}, the delay, a current or a slow disturbance"
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
    }.get(kind, f"{kind} damping feeds energy in")
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


def reversed_force(axis: int) -> str:
    """A recorded force that acts the wrong way round."""
    return f"the {_wrench(axis)} acts with the opposite sign"
