"""Why a coefficient is known, known only with another, or not known: the sentences of `identifiability`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.axes import AXES
from towtank.identification.coefficient_words import Role, label, percent, speed_unit

__all__ = [
    "HELD",
    "Pair",
    "PairTold",
    "anchor",
    "as_fitted",
    "determined",
    "entangled",
    "from_prior",
    "needed_factor",
    "pair_told",
    "ratio",
    "ratio_known",
    "rests_on_held",
    "silent",
    "will_be_known",
]

HELD = "; held at the vehicle's value"
_SEPARATE = 0.2  # deviation that both of a pair must reach
_WIDEST = 10.0  # times the speeds of the run that are still worth proposing
_NOTHING = 2.0  # deviation from which "nothing" is the word
_EVEN = 1.6  # ratio of the weights of a plain ratio or product


@dataclass(frozen=True)
class Pair:
    """Two coefficients that only appear together: the one kept first, their sizes and their information (2, 2)."""

    winner: str
    loser: str
    winner_role: Role
    loser_role: Role
    magnitude: tuple[float, float]
    information: Array
    speeds: Array | None


@dataclass(frozen=True)
class PairTold:
    """Sentences about a pair; `known` holds weights, deviation and words of what is known of it."""

    winner: str
    loser: str
    known: tuple[tuple[float, float], float, str]


def determined(name: str, std: float) -> str:
    """A coefficient that is known."""
    return f"{label(name)} is known to {percent(std)}"


def from_prior(name: str, std: float, own: float) -> str:
    """A coefficient that is known from before."""
    alone = f"this run alone would give {percent(own)}" if own < _NOTHING else "this run alone would not tell it"
    return f"{label(name)} is known to {percent(std)} with the prior; {alone}"


def as_fitted(reason: str) -> str:
    """A coefficient that is hardly known, and not held all the same: the sentence for one that is, mended."""
    return f"{reason.removesuffix(HELD)}; as fitted along with the others"


def rests_on_held(name: str, given: float) -> str:
    """A coefficient that is known once another is held."""
    return f"{label(name)} is known to {percent(given)} only with what is held taken as right"


def silent(name: str, role: Role, single: float, speeds: Array | None) -> str:
    """A coefficient that would not be known even if all else were."""
    what = f"the run says nothing of {label(name)}"
    if single < _NOTHING:
        what = f"{label(name)} would be known to {percent(single)} at best, with all else known"
    return f"{what}: {_lack(role, speeds)}{HELD}"


def _lack(role: Role, speeds: Array | None) -> str:
    if role.kind in ("linear", "quadratic") or (role.kind == "coupling" and role.column >= 0):
        if speeds is not None and np.isfinite(speeds[role.column]).all():
            reached = f"{float(speeds[role.column, 1]):.2g} {speed_unit(role.column)}"
            return f"{AXES[role.column].name} reached {reached} only"
        return f"too little {AXES[role.column].name}"
    if role.kind == "inertia":
        return f"too little acceleration in {AXES[role.row].name}"
    if role.kind == "restoring":
        return "nothing shows in heave" if role.row == 2 else "the vehicle hardly tilted"
    if role.kind == "constant":
        return f"nothing shows in {AXES[role.row].name}"
    if role.kind == "gain":
        return "this thruster was hardly used"
    if role.kind in ("delay", "lag"):
        return "the commands hardly changed"
    return "nothing in it depends on this"


def _where(axis: int) -> str:
    return "" if axis < 0 else f" in {AXES[axis].name}"


def _common(common: float) -> str:
    return "nothing fixes the scale of the forces" if common > _NOTHING else f"their scale to {percent(common)} only"


def ratio(name: str, held: str, axis: int, common: float) -> str:
    """A coefficient that is known in proportion to another."""
    where = f"only ratios are known{_where(axis)}, {_common(common)}"
    return f"{where}: {label(name)} stands in proportion to {label(held)}, which is held"


def anchor(name: str, axis: int, common: float, gain: bool) -> str:
    """The coefficient held so that the others have a scale."""
    advice = "bench data or a bollard pull of one thruster would fix it"
    if not gain:
        advice = f"commanded {'moments' if axis > 2 else 'forces'}{_where(axis)} whose size is known would fix it"
    return (
        f"only ratios are known{_where(axis)}, {_common(common)}; {label(name)} held at the vehicle's value: {advice}"
    )


def ratio_known(name: str, held: str) -> str:
    """What is known of one of a group without a scale."""
    return f"{label(name)} in proportion to {label(held)}"


def entangled(name: str, others: Sequence[str], std: float) -> str:
    """A coefficient that is lost among several, or simply not known well enough."""
    if std < _NOTHING and not others:
        return f"{label(name)} is known to {percent(std)} only in this run{HELD}"
    known = f"known to {percent(std)} only" if std < _NOTHING else "not known by itself"
    beside = f": it cannot be told from {_listed([label(other) for other in others])}" if others else ""
    return f"{label(name)} is {known} in this run{beside}{HELD}"


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def will_be_known(what: str, value: float) -> str:
    """A line of `inspect`."""
    return f"{what} will be known to {percent(value / 100.0)}" if value < 100.0 else f"{what} will not be known"


def pair_told(pair: Pair) -> PairTold:
    """Say which of a pair gives way, what is known of both together, and what would tell them apart."""
    damping = {pair.winner_role.kind, pair.loser_role.kind} == {"linear", "quadratic"}
    damping = damping and pair.winner_role.row == pair.loser_role.row
    damping = damping and pair.information[0, 1] > 0.0
    weights, std, known = _sum(pair) if damping else _product(pair)
    I2 = pair.information
    size = float(np.sqrt(I2[0, 0] * I2[1, 1]))
    r = abs(float(I2[0, 1])) / size if size > 0.0 else 1.0
    first, second = sorted((pair.winner, pair.loser), key=lambda name: (len(name), name))
    known_as = f"only {known} is known (to {percent(std)})"
    alike = f"{label(first)} and {label(second)} are correlated {_correlation(r)} in this run; {known_as}"
    cure = _separating(pair) if damping else _telling(pair)
    held = "held at 0" if damping else "held at the vehicle's value"
    stands = f"{label(pair.winner)} stands for both" if damping else f"learned with {label(pair.loser)} held"
    return PairTold(
        winner=f"{alike}: {cure}; {stands}",
        loser=f"{alike}: {cure}; {label(pair.loser)} {held}",
        known=(weights, std, known),
    )


def _correlation(r: float) -> str:
    return f"{r:.2f}" if r < 0.99 else f"{r:.3f}"


def _sum(pair: Pair) -> tuple[tuple[float, float], float, str]:
    """The drag at one speed: L + Q u has the least variance, 1 / I_LL, at u = I_LQ / I_LL (physical units)."""
    linear = 0 if pair.winner_role.kind == "linear" else 1
    quadratic = 1 - linear
    L, Q = pair.magnitude[linear], pair.magnitude[quadratic]
    I2 = pair.information
    # from relative to physical units: divide by the sizes
    I_LL, I_LQ = I2[linear, linear] / L**2, I2[linear, quadratic] / (L * Q)
    speed = I_LQ / I_LL if I_LL > 0.0 else 0.0
    total = L + Q * speed
    if not (speed > 0.0 and np.isfinite(total)):
        return _product(pair)
    std = float(1.0 / (np.sqrt(I_LL) * total))
    shares = [0.0, 0.0]
    shares[linear], shares[quadratic] = L / total, Q * speed / total
    unit = speed_unit(pair.winner_role.row)
    return (float(shares[0]), float(shares[1])), std, f"their sum at about {speed:.2g} {unit}"


def _product(pair: Pair) -> tuple[tuple[float, float], float, str]:
    """The combination of relative changes that is known best, its larger weight 1."""
    values, vectors = np.linalg.eigh(pair.information)
    w = vectors[:, 1] / vectors[np.argmax(np.abs(vectors[:, 1])), 1]
    std = float(np.abs(1.0 / (np.sqrt(max(values[1], 1e-300)) * np.abs(vectors[:, 1]).max())))
    even = np.abs(w).max() < _EVEN * np.abs(w).min()
    word = ("their ratio" if w[0] * w[1] < 0.0 else "their product") if even else "one combination of them"
    return (float(w[0]), float(w[1])), std, word


def needed_factor(information: Array, linear: int) -> float:
    """Return how many times the speeds of this run a second one as long needs, so that both damping terms are known
    to 20 %; inf where ten times are not enough.

    At k times the speed linear damping tells k^2, quadratic k^4 and both together k^3 times as much.
    """
    powers = np.array([1.0, 2.0]) if linear == 0 else np.array([2.0, 1.0])

    def worst(k: float) -> float:
        grown = information * (1.0 + np.multiply.outer(k**powers, k**powers))
        # written out, so that nothing cancels where the run alone tells one combination only
        a, b, c = information[0, 0], information[1, 1], information[0, 1]
        s, q = (k ** float(power) for power in powers)
        own = max(float(a * b - c * c), 0.0) * (1.0 + s * s) * (1.0 + q * q)
        determinant = own + float(c * c) * (s - q) ** 2
        return float(np.sqrt(max(grown[0, 0], grown[1, 1]) / determinant)) if determinant > 0.0 else float("inf")

    low, high = 1.0, _WIDEST
    if worst(high) > _SEPARATE:
        return float("inf")
    if worst(low) <= _SEPARATE:
        return 1.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if worst(middle) > _SEPARATE else (low, middle)
    return high


def _separating(pair: Pair) -> str:
    factor = needed_factor(pair.information, 0 if pair.winner_role.kind == "linear" else 1)
    axis = pair.winner_role.row
    if factor == 1.0:
        return "a run twice as long would separate them"
    if not np.isfinite(factor):
        return "slow and fast stretches in a longer run would separate them"
    if pair.speeds is None or not pair.speeds[axis, 1] > 0.0:
        return f"speeds {factor:.2g} times as high would separate them"
    return f"speeds above {factor * float(pair.speeds[axis, 1]):.2g} {speed_unit(axis)} would separate them"


def _telling(pair: Pair) -> str:
    kinds = {pair.winner_role.kind, pair.loser_role.kind}
    axis = AXES[max(pair.winner_role.row, 0)].name
    if "gain" in kinds:
        return "bench data of the thruster, or using it by itself, would tell them apart"
    if kinds & {"delay", "lag"}:
        return "more and sharper changes of the commands would tell them apart"
    if "restoring" in kinds:
        return f"{axis} motion at several frequencies, and some held tilts, would tell them apart"
    if "inertia" in kinds and kinds & {"linear", "quadratic"}:
        return f"reversals as well as steady {axis} would tell them apart"
    if "coupling" in kinds:
        return "motion in which these axes do not move together would tell them apart"
    return "a more varied run would tell them apart"
