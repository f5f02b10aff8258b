"""The report in one sentence, and the state of a coefficient in one word."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from towtank.digits import joined
from towtank.identification.model.terms import AXES
from towtank.identification.posterior.estimate import Estimate, Learned
from towtank.vehicle import index

__all__ = ["NAMES", "Verdict", "learn_verdict", "state_of", "validate_verdict"]

_SURE, _FAIR = 0.1, 0.5  # relative deviations: known, roughly known
_GOOD, _USABLE = 80.0, 50.0  # fits [%]
_MERGED = ("stands for both", "cannot be told apart", "are correlated", "stands in proportion", "known only together")
NAMES: Mapping[str, str] = {
    "u": "surge speed", "v": "sway speed", "w": "heave speed", "p": "roll rate", "q": "pitch rate", "r": "yaw rate",
    "x": "north", "y": "east", "z": "depth", "phi": "roll", "theta": "pitch", "psi": "heading",
}  # fmt: skip


@dataclass(frozen=True)
class Verdict:
    """A sentence, and how it is meant: "good", "fair" or "poor"."""

    grade: str
    text: str


def state_of(each: Learned) -> tuple[str, str]:
    """Return a word on what is known of a coefficient, and its grade.

    "known" to 10 %, "roughly known" to 50 %, "sign only" to 100 %, "near zero" beyond; and of those that were not
    learned "merged" (another one stands for it), "zero", "held" (at the vehicle's value) or "not identifiable".
    """
    if not each.identified:
        reason = each.reason or ""
        if any(words in reason for words in _MERGED):
            return "merged", ""
        if "not different from 0" in reason:
            return "zero", ""
        return ("held", "") if "held at the vehicle" in reason else ("not identifiable", "")
    share = each.std / abs(each.value) if each.value else float("inf")
    if share <= _SURE:
        return "known", "good"
    if share <= _FAIR:
        return "roughly known", "fair"
    return ("sign only", "fair") if share <= 1.0 else ("near zero", "")


def learn_verdict(estimate: Estimate, fit: Mapping[str, float | None], predicted: str) -> Verdict:
    """Return what was learned, how well, and how well it predicts."""
    learned = [each for each in estimate.coefficients if each.identified]
    if not learned:
        why = next((reason for reason in estimate.reasons if reason), "no motion was seen")
        return Verdict("poor", f"Nothing could be identified: {why}.")
    axes = [axis.name for axis in AXES if any(_row(each.name) == axis.index for each in learned)]
    known = [each for each in learned if state_of(each)[0] == "known"]
    share = "all" if len(known) == len(learned) else "none" if not known else f"{len(known)}"
    text = (
        f"{joined(axes).capitalize()} {'was' if len(axes) == 1 else 'were'} learned: {len(learned)} of "
        f"{len(estimate.names)} coefficients identified, {share} of them to 10 % or better"
    )
    moving = {axis.velocity for axis in AXES if axis.name in axes}
    fits = {name: value for name, value in fit.items() if value is not None and name in moving}
    grade = "good" if 2 * len(known) >= len(learned) else "fair"
    if fits:
        worst, best = min(fits.values()), max(fits.values())
        spread = f"{best:.0f} %" if len(fits) == 1 else f"{worst:.0f} to {best:.0f} %"
        names = joined([NAMES[name] for name in fits]) if len(fits) <= 3 else "the speeds"
        text += f"; the model predicts {names} of {predicted} with a fit of {spread}"
        grade = "fair" if worst < _USABLE and grade == "good" else grade
    return Verdict(grade, f"{text}.")


def validate_verdict(name: str, fit: Mapping[str, float | None], errors: Sequence[str]) -> Verdict:
    """Return how well a model predicts. errors: kinds of what the errors are, per channel."""
    fits = {channel: value for channel, value in fit.items() if value is not None}
    if not fits:
        return Verdict("poor", f"{name} could not be judged: no motion was measured.")
    good = [channel for channel, value in fits.items() if value >= _GOOD]
    poor = [channel for channel, value in fits.items() if value < _USABLE]
    best, worst = max(fits, key=lambda c: fits[c]), min(fits, key=lambda c: fits[c])
    text = f"{name} predicts {NAMES[best]} best (fit {_fit(fits[best])})"
    if worst != best:
        text += f" and {NAMES[worst]} least well ({_fit(fits[worst])})"
    text += f"; {len(good)} of {len(fits)} channels reach a fit of {_GOOD:.0f} %"
    lacking = sum(kind == "follows the command" for kind in errors)
    if lacking:
        text += f". The errors of {lacking} follow the command: there the model lacks something"
    grade = "good" if len(good) == len(fits) and not lacking else "poor" if len(poor) == len(fits) else "fair"
    return Verdict(grade, f"{text}.")


def _fit(value: float) -> str:
    return "diverges" if value <= -999.0 else f"{value:.0f} %"


def _row(name: str) -> int:
    kind, i, _ = index(name)
    return 2 if kind == "weight" else (4, 3, 3)[i] if kind == "moment" else i
