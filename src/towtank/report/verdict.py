"""The report in one sentence, and the state of a coefficient in one word."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from towtank.digits import joined
from towtank.identification.model.terms import AXES, Axis
from towtank.identification.posterior.estimate import Estimate, Learned
from towtank.planning import Plan
from towtank.recording.axes import judged_by
from towtank.recording.consistency import Finding
from towtank.recording.standard import POSE, VELOCITIES
from towtank.validation import AxisUse, Usability
from towtank.validation.usability import SHORTEST
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = [
    "NAMES",
    "Verdict",
    "learn_verdict",
    "plan_notes",
    "plan_verdict",
    "state_of",
    "usable_text",
    "validate_verdict",
]

_SURE, _FAIR = 0.1, 0.5  # relative deviations: known, roughly known
_GOOD, _USABLE = 80.0, 50.0  # fits [%]
_GRADES = ("poor", "fair", "good")
_SPEEDS = np.geomspace(0.05, 2.0, 24)  # m/s, rad/s: at which drag is looked at
_DRIFTING = {"x", "y"}  # these add up every push of the water, whatever the model
_MANY = ("the speeds", "the motion")
_OFTEN = 0.05  # from which on the end of a run at a wall is told
_ALIKE = 3.0  # ratio up to which the larger of two relative deviations stands for both
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
    learned "merged" (another one stands for it), "zero", "held" (at the vehicle's value) or "not identified".
    """
    if not each.identified:
        reason = each.reason or ""
        if any(words in reason for words in _MERGED):
            return "merged", ""
        if "not different from 0" in reason:
            return "zero", ""
        return ("held", "") if "held at the vehicle" in reason else ("not identified", "")
    share = each.std / abs(each.value) if each.value else float("inf")
    if share <= _SURE:
        return "known", "good"
    if share <= _FAIR:
        return "roughly known", "fair"
    return ("sign only", "fair") if share <= 1.0 else ("near zero", "")


def learn_verdict(
    estimate: Estimate,
    fit: Mapping[str, float | None],
    predicted: str,
    findings: Sequence[Finding] = (),
    driven: Sequence[bool] = (),
    use: Usability | None = None,
) -> Verdict:
    """Return what an engineer wants to know first: what the model can be used for; then what cannot be right, or why
    nothing could be identified, or which axes are known, and how well.

    Args:
        predicted: what the fit is of, in words. findings: gravest first. driven: axes (6,), () where not known.
        use: for how long it predicts; where omitted, the fit is told instead.
    """
    grave = [each for each in findings if not each.allowed_for]
    if grave:
        more = len(grave) - 1
        rest = f" (and {more} more below)" if more else ""
        said = f"cannot be right: {grave[0].text}{rest}."
        if use is None or not use.good or not all(each.of_model for each in grave):
            return Verdict("poor", f"Not usable as it is. Something {said}")
        return Verdict("fair", f"{usable_text(use).text}, judged on {predicted}. But something {said}")
    learned = [each for each in estimate.coefficients if each.identified]
    if not learned:
        why = next((reason for reason in estimate.reasons if reason), "no motion was seen")
        next_ = "" if use is None else _next(use, [_known(estimate, axis) for axis in AXES], estimate)
        return Verdict("poor", f"Not usable. Nothing could be identified: {why}.{next_}")
    known = [_known(estimate, axis) for axis in AXES]
    text = "; ".join(_groups(known, driven))
    axes = [axis for axis, each in zip(AXES, known, strict=True) if each.inertia or each.drag]
    if not axes:
        text = f"No inertia and no drag is known, only {joined([each.name for each in learned])}"
    share = [state_of(each)[0] == "known" for each in learned]
    grade = "good" if 2 * sum(share) >= len(share) else "fair"
    if use is not None:
        able = usable_text(use)
        told = f"{able.text}, judged on {predicted}. {text[0].upper()}{text[1:]}.{_next(use, known, estimate)}"
        return Verdict(min(grade, able.grade, key=_GRADES.index), told)
    judging = judged_by([name for name, value in fit.items() if value is not None])
    moving = {name for axis in axes for name in (axis.velocity, POSE[axis.index]) if name in judging} - _DRIFTING
    fits = {name: value for name, value in fit.items() if value is not None and name in moving}
    if fits:
        worst, best = min(fits.values()), max(fits.values())
        spread = f"{best:.0f} %" if len(fits) == 1 else f"{worst:.0f} to {best:.0f} %"
        names = joined([NAMES[name] for name in fits]) if len(fits) <= 3 else _MANY[bool(fits.keys() - set(VELOCITIES))]
        text += f"; the model predicts {names} of {predicted} with a fit of {spread}"
        grade = "fair" if worst < _USABLE and grade == "good" else grade
    return Verdict(grade, f"{text[0].upper()}{text[1:]}.")


def usable_text(use: Usability) -> Verdict:
    """Return what a model can be used for, without a full stop: up to how many seconds, for which axes, and why not.

    >>> surge, yaw = AxisUse("surge", "u", 30.0, 71.0), AxisUse("yaw", "r", 0.0, -12.0)
    >>> usable_text(Usability((surge, yaw), (), (), 90.0)).text
    'Usable for surge (up to 30 s); not usable for yaw (predicted worse than by its mean)'
    """
    if not use.axes:
        why = "no axis that was driven was measured" if use.unmeasured else "no axis was driven"
        return Verdict("poor", f"Not usable for prediction: {why}")
    if not use.good:
        short = use.duration < SHORTEST
        why = f"{use.duration:.2g} s are too short to tell" if short else _failures(use.poor)
        return Verdict("poor", f"Not usable for prediction: {why}")
    spans = _spans(use.good)
    if not use.poor:
        told = " and ".join(f"{span} ({joined(axes)})" for span, axes in spans)
        return Verdict("good", f"Usable for prediction {told}")
    told = " and ".join(f"{joined(axes)} ({span})" for span, axes in spans)
    return Verdict("fair", f"Usable for {told}; not usable for {_failures(use.poor)}")


def _spans(good: Sequence[AxisUse]) -> list[tuple[str, list[str]]]:
    """Return up to when which axes are of use: the shortest time of those that have one, and those of whole runs."""
    timed = [each for each in good if each.seconds < np.inf]
    whole = [each.axis for each in good if each.seconds == np.inf]
    out = [(f"up to {min(each.seconds for each in timed):g} s", [each.axis for each in timed])] if timed else []
    return [*out, ("over whole runs", whole)] if whole else out


def _failures(poor: Sequence[AxisUse]) -> str:
    """Return axes with why their predictions are of no use, those of which the same is said together."""
    said: dict[str, list[str]] = {}
    for each in poor:
        said.setdefault(_why(each), []).append(each.axis)
    return " and ".join(f"{joined(axes)} ({why})" for why, axes in said.items())


def _why(each: AxisUse) -> str:
    if each.fit < 0.0:
        return "predicted worse than by its mean"
    return "no better than the last measured value" if each.held else "less than half of its motion is explained"


def _next(use: Usability, known: Sequence[_Known], estimate: Estimate) -> str:
    """Return what to drive next, as a sentence; nothing where all axes that can be driven are known."""
    poor = {each.axis for each in use.poor} | {each.axis for each in known if not (each.inertia and each.drag)}
    open_ = {*use.undriven, *(each.axis for each in use.axes if use.drivable is None or each.axis in use.drivable)}
    asked = {name[0] for name in estimate.names}
    wanted = [axis.name for axis in AXES if axis.name in poor & open_ and ROWS[axis.index] in asked]
    return f" Next: drive {joined(wanted)}, each by itself, up and down in steps." if wanted else ""


class _Known(NamedTuple):
    """How well an axis is known: relative deviations of total inertia and drag, 0 where they are not identified."""

    axis: str
    inertia: float
    drag: float


def _known(estimate: Estimate, axis: Axis) -> _Known:
    sums = {total.name: total for total in estimate.sums}
    total = sums.get(axis.sum_name)
    inertia = total.std / abs(total.value) if total is not None and total.value else 0.0
    return _Known(axis.name, inertia, _drag_share(estimate, axis.index))


def _drag_share(estimate: Estimate, axis: int) -> float:
    """Return the relative deviation of an axis' drag at the speed where it is known best; 0 if none is identified."""
    row, column = ROWS[axis], COLUMNS[axis]
    names = [name for name in (f"{row}_{column}", f"{row}_{column * 2}") if name in estimate]
    if not any(estimate[name].identified for name in names):
        return 0.0
    at = [estimate.names.index(name) for name in names if np.isfinite(estimate[name].std)]
    powers = [2 if estimate.names[k].endswith(column * 2) else 1 for k in at]
    g = _SPEEDS[:, None] ** np.array(powers)
    drag = np.abs(g @ estimate.values[at])
    std = np.sqrt(np.maximum(np.einsum("si,ij,sj->s", g, estimate.covariance[np.ix_(at, at)], g), 0.0))
    return float(np.min(std / np.maximum(drag, 1e-300)))


def _groups(known: Sequence[_Known], driven: Sequence[bool]) -> list[str]:
    """Return the axes in words, those of which the same is known together."""
    whole = [each for each in known if each.inertia and each.drag]
    partly = [(each, "inertia") for each in known if each.inertia and not each.drag]
    partly += [(each, "drag") for each in known if each.drag and not each.inertia]
    out = []
    if whole:
        inertia, drag = _range([each.inertia for each in whole]), _range([each.drag for each in whole])
        out.append(f"{joined([each.axis for each in whole])}: inertia to {inertia}, drag to {drag}")
    for kind in ("inertia", "drag"):
        group = [each for each, known_of in partly if known_of == kind]
        if group:
            shares = _range([each.inertia or each.drag for each in group])
            out.append(f"of {joined([each.axis for each in group])} only {kind}, to {shares}")
    rest = [k for k, each in enumerate(known) if not (each.inertia or each.drag)]
    still = [known[k].axis for k in rest if driven and not driven[k]]
    unknown = [known[k].axis for k in rest if not driven or driven[k]]
    if still:
        out.append(f"{joined(still)} {'was' if len(still) == 1 else 'were'} not driven")
    if unknown:
        out.append(f"{joined(unknown)} {'stays' if len(unknown) == 1 else 'stay'} unknown")
    return out


def _range(shares: Sequence[float]) -> str:
    """Return relative deviations as text: the largest, or from the smallest on where they differ much."""
    low, high = (f"{max(100.0 * share, 0.1):.{1 if share < 0.0095 else 0}f}" for share in (min(shares), max(shares)))
    return f"{high} %" if max(shares) < _ALIKE * min(shares) or low == high else f"{low} .. {high} %"


def validate_verdict(
    name: str,
    fit: Mapping[str, float | None],
    errors: Sequence[str],
    use: Usability | None = None,
    findings: Sequence[Finding] = (),
) -> Verdict:
    """Return what a model can be used for and how well it predicts; before that what of it cannot be right.

    Args:
        errors: kinds of what the errors are, per channel. use: for how long it predicts; not told where omitted.
        findings: gravest first.
    """
    judged = _judged(name, fit, errors, use)
    if not findings:
        return judged
    grade = min("fair", judged.grade, key=_GRADES.index)
    return Verdict(grade, f"Something cannot be right: {'; '.join(each.text for each in findings)}. {judged.text}")


def _judged(name: str, fit: Mapping[str, float | None], errors: Sequence[str], use: Usability | None = None) -> Verdict:
    """Return what a model can be used for and how well it predicts."""
    fits = {channel: value for channel, value in fit.items() if value is not None}
    if use is not None and use.axes:
        fits = {each.channel: each.fit for each in use.axes}  # what stands still is no measure of a model
    if not fits:
        return Verdict("poor", f"Not usable: {name} could not be judged, for no motion was measured.")
    good = [channel for channel, value in fits.items() if round(value) >= _GOOD]  # as it is printed
    poor = [channel for channel, value in fits.items() if value < _USABLE]
    best, worst = max(fits, key=lambda c: fits[c]), min(fits, key=lambda c: fits[c])
    text = f"{name} predicts {NAMES[best]}{' best' if worst != best else ''} ({_fit(fits[best])})"
    if worst != best:
        text += f" and {NAMES[worst]} least well ({_fit(fits[worst])})"
    if len(fits) > 1:
        text += f"; {len(good)} of {len(fits)} reach a fit of {_GOOD:.0f} %"
    lacking = sum(kind == "follows the command" for kind in errors)
    if lacking:
        many = f"{lacking} channels follow" if lacking > 1 else "1 channel follow"
        text += f". The errors of {many} the command: the model lacks something there"
    grade = "good" if len(good) == len(fits) and not lacking else "poor" if len(poor) == len(fits) else "fair"
    if use is not None:
        able = usable_text(use)
        return Verdict(able.grade, f"{able.text}. {text}.")
    return Verdict(grade, f"{text}.")


def _fit(value: float) -> str:
    if value < 0.0:
        return "diverges" if value <= -999.0 else "worse than its mean"
    return f"fit {value:.0f} %"


def plan_verdict(made: Plan) -> Verdict:
    """Return what will be known after a plan, and after how long."""
    known = [each for each in made.expected if not each.reason]
    every, many = len(made.expected), len(made.segments)
    after = f"after {made.manoeuvring:g} s of manoeuvring, in {many} segment{'' if many == 1 else 's'}"
    share = f"{100.0 * made.accuracy:g} %"
    if len(known) == every:
        which = f"all {every} coefficients that are wanted" if every > 1 else made.expected[0].name
        text = f"{which} will be known to {share} {after}."
        return Verdict("good", f"{text[0].upper()}{text[1:]}")
    return Verdict(
        "fair" if known else "poor",
        f"{len(known) or 'None'} of {every} coefficients that are wanted will be known to {share} {after}.",
    )


def plan_notes(made: Plan) -> list[str]:
    """Return what of the wishes cannot be had and what it would take, a line each: coefficients, then the tank."""
    said: dict[str, list[str]] = {}
    slow = []
    for each in made.expected:
        if each.reason and np.isfinite(each.needs):
            slow.append(each)
        elif each.reason:
            said.setdefault(each.reason, []).append(each.name)
    lines = [f"{joined(names)}: {reason}" for reason, names in said.items()]
    if slow:
        last = max(slow, key=lambda each: each.needs)
        others = f"; {len(slow) - 1} more need less" if len(slow) > 1 else ""
        takes = last.reason.removeprefix("would take ")
        lines.append(
            f"{100.0 * made.accuracy:g} % of {last.name} needs {takes}, this plan has {made.manoeuvring:g} s"
            f" (--minutes){others}"
        )
    if made.room is not None and made.leaves > _OFTEN:
        often = f"in {100.0 * made.leaves:.0f} % of cases"
        if np.isfinite(made.room).all():
            size = " x ".join(f"{np.ceil(10.0 * each) / 10.0:g}" for each in made.room)
            lines.append(
                f"driven as it stands, with nobody steering, it ends at a wall {often}: {size} m would hold 95 %"
            )
        else:
            lines.append(f"driven as it stands, with nobody steering, it ends at a wall {often}, in any tank")
    return lines
