"""What is said of an estimate: why a coefficient is known, known only with another, or not; what pulled it out of the
physical; who judged it. Coefficients have names in plain words: axis, role, unit of speed; so have `delay`, `lag` and
`gain_<thruster>`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.model.terms import AXES, TERMS, Term
from towtank.vehicle.names import COEFFICIENTS, COLUMNS, KINDS, ROWS, index, unit

__all__ = [
    "NOT_DETERMINED",
    "as_fitted",
    "current_estimated",
    "current_suspected",
    "free_runs_remark",
    "inertia_doubted",
    "least_squares_remark",
    "not_narrowed",
    "phrase",
    "reversed_force",
    "role",
]

HELD = "; held at the vehicle's value"
NOT_FREE, NOT_DETERMINED = "not free", "not determined"
_SEPARATE = 0.2  # deviation that both of a pair must reach
_WIDEST = 10.0  # times the speeds of the run that are still worth proposing
_NOTHING = 2.0  # deviation from which "nothing" is the word
_EVEN = 1.6  # ratio of the weights of a plain ratio or product
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
    _, i, j = index(name)
    return Role(*_term(name).role(i, j))


def _term(name: str) -> Term:
    """Return the row of a coefficient's kind."""
    return TERMS[KINDS[index(name)[0]].code]


def not_narrowed(name: str, share: float) -> str:
    """Return why a coefficient is not identified: what is left of its prior's deviation, and what would narrow it."""
    left = f"the data leave {100.0 * min(share, 1.0):.0f} % of the prior's deviation"
    part = role(name)
    if part.kind == "coupling":
        return f"{left}; {_term(name).apart}"
    if part.kind == "constant":
        return f"{left}; a run over all headings and attitudes would narrow it"
    if part.row < 0:
        return left
    axis = AXES[part.row].name
    if part.kind == "restoring":
        return f"{left}; larger angles would narrow it" if name.startswith("BG") else f"{left}; heave would narrow it"
    how = "faster and slower" if part.kind in ("linear", "quadratic") else "harder, to and fro"
    return f"{left}; driving {axis} {how} would narrow it"


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
        return f"the {_term(name).noun} {name}"
    if part.kind == "constant":
        return f"the constant {AXES[part.row].name} {'force' if part.row < 3 else 'moment'}"
    if part.kind == "gain":
        return f"the gain of thruster {name.removeprefix('gain_')}"
    special = {"W_minus_B": "the net weight", "BG_z": "the righting moment", "delay": "the delay", "lag": "the lag"}
    return special.get(name, name)


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


class KnownOfPair(NamedTuple):
    """A combination of relative changes that is known of a pair: weights, its deviation, and what it is called."""

    weights: tuple[float, float]
    std: float
    text: str


@dataclass(frozen=True)
class PairWords:
    """Sentences about a pair, and what is known of it."""

    winner: str
    loser: str
    known: KnownOfPair


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


def scale_held(name: str, axis: int, common: float, gain: bool) -> str:
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


def pair_words(pair: Pair) -> PairWords:
    """Say which of a pair gives way, what is known of both together, and what would tell them apart."""
    damping = {pair.winner_role.kind, pair.loser_role.kind} == {"linear", "quadratic"}
    damping = damping and pair.winner_role.row == pair.loser_role.row
    damping = damping and pair.information[0, 1] > 0.0
    known = _sum(pair) if damping else _product(pair)
    I2 = pair.information
    size = float(np.sqrt(I2[0, 0] * I2[1, 1]))
    r = abs(float(I2[0, 1])) / size if size > 0.0 else 1.0
    first, second = sorted((pair.winner, pair.loser), key=lambda name: (len(name), name))
    known_as = f"only {known.text} is known (to {percent(known.std)})"
    alike = f"{label(first)} and {label(second)} are correlated {_correlation(r)} in this run; {known_as}"
    cure = _separating(pair) if damping else _distinguishing(pair)
    held = "held at 0" if damping else "held at the vehicle's value"
    stands = f"{label(pair.winner)} stands for both" if damping else f"learned with {label(pair.loser)} held"
    return PairWords(
        winner=f"{alike}: {cure}; {stands}", loser=f"{alike}: {cure}; {label(pair.loser)} {held}", known=known
    )


def _correlation(r: float) -> str:
    return f"{r:.2f}" if r < 0.99 else f"{r:.3f}"


def _sum(pair: Pair) -> KnownOfPair:
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
    return KnownOfPair((float(shares[0]), float(shares[1])), std, f"their sum at about {speed:.2g} {unit}")


def _product(pair: Pair) -> KnownOfPair:
    """The combination of relative changes that is known best, its larger weight 1."""
    values, vectors = np.linalg.eigh(pair.information)
    w = vectors[:, 1] / vectors[np.argmax(np.abs(vectors[:, 1])), 1]
    std = float(np.abs(1.0 / (np.sqrt(max(values[1], 1e-300)) * np.abs(vectors[:, 1]).max())))
    even = np.abs(w).max() < _EVEN * np.abs(w).min()
    word = ("their ratio" if w[0] * w[1] < 0.0 else "their product") if even else "one combination of them"
    return KnownOfPair((float(w[0]), float(w[1])), std, word)


def needed_factor(information: Array, linear: int) -> float:
    """Return how many times the speeds of this run a second one as long needs, so that both damping terms are known
    to 20 %; inf where ten times are not enough.

    At k times the speed the information on linear damping grows by k^2, on quadratic by k^4, between both by k^3.
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


def _distinguishing(pair: Pair) -> str:
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
        roles = ((pair.winner_role, pair.winner), (pair.loser_role, pair.loser))
        return max((_term(name) for part, name in roles if part.kind == "coupling"), key=lambda term: term.given).apart
    return "a more varied run would tell them apart"


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
    elif kind in ("ahead", "astern"):
        what = "drag that feeds energy in one way"
        check = f"a run both ways in {AXES[row].name} would tell both"
    elif kind == "loss":
        what = "thrusters that gain thrust from the water through them"
        check = "check their curves ahead and astern"
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


def inertia_doubted(name: str, reason: str | None, std: float, unit_of_sum: str) -> str:
    """An inertia that was asked for and found, though least squares could not tell it."""
    why = (reason or NOT_DETERMINED).removesuffix(HELD)
    return (
        f"{name}: least squares cannot tell it ({why}); its deviation of {std:.2g} {unit_of_sum} holds if "
        "what disturbs the vehicle is a slow random force, and may be far too small if it is not"
    )


def current_estimated(flow: str) -> str:
    """A current that was learned along."""
    return f"the water flows: {flow}, at the end of the last recording"


def current_suspected(flow: str) -> str:
    """A current that was not."""
    return (
        f"a water current of {flow} would explain these recordings far better than water at rest, and "
        "drag is off without it; learn it along: --current"
    )


def free_runs_remark(
    verdict: str,
    saved: tuple[float, float] | None,
    fits: tuple[float, float],
    added: Sequence[str],
    *,
    thinned: bool,
    requested: bool,
) -> str:
    """How free runs compare with the joint filter.

    Args:
        verdict: "white", "better" or "worse". saved: share of the square error, and its deviation; None if unknown.
        fits: of free runs and of the filter [%]. added: terms. thinned: not all windows were looked at.
        requested: somebody asked for output error, whatever the verdict.
    """
    if verdict == "white":
        return (
            "free runs leave nothing but the sensors' noise (their residuals are white), so output error is the "
            "better judge"
        )
    where = "windows spread over the recordings" if thinned else "windows of the recordings"
    if saved is None:
        text = "the recordings are too short to compare free runs over windows held out, so the joint filter judges"
    else:
        shares = _saved(saved)
        if not np.isfinite(saved[0]):
            shares = "the runs of the other one go nowhere"
        elif np.isfinite(fits).all():
            shares = f"{fits[0]:.0f} % against {fits[1]:.0f} %, {shares}"
        if verdict == "better":
            terms = f" (with {', '.join(added)})" if added else ""
            return f"output error{terms} predicts {where} that it has not seen better than the joint filter: {shares}"
        text = f"output error does not predict {where} that it has not seen better than the joint filter: {shares}"
    return text + "; output error was asked for" if requested else text


def least_squares_remark(saved: tuple[float, float]) -> str:
    """That least squares is better than either; follows `free_runs_remark`."""
    return f"; but free runs with the coefficients of least squares are nearer than either ({_saved(saved)})"


def _saved(saved: tuple[float, float]) -> str:
    return f"{100.0 * saved[0]:.0f} +- {100.0 * saved[1]:.0f} % less square error"


def reversed_force(axis: int, reversed_share: float, share: float) -> str:
    """A commanded force that acts the wrong way round; shares of the speed's square that it explains either way."""
    return (
        f"the {_wrench(axis)} acts with the opposite sign: reversed, it explains "
        f"{100.0 * reversed_share:.0f} % of {AXES[axis].velocity}, as it is {100.0 * share:.0f} %"
    )
