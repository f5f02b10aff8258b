"""What happened to the vehicle, as events: which coefficients changed, by how much, how sure.

The numbers of the last change are revised while they settle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from towtank.core.arrays import Array
from towtank.core.layout import LINEAR, MASS, MOMENT, QUADRATIC, WEIGHT
from towtank.identification.changes.branch import Kept, Running
from towtank.identification.kalman.state import coefficient_std
from towtank.identification.model.parameters import GAIN_PREFIX, UNTRANSFORMED, FreeParameters
from towtank.identification.model.terms import TERMS
from towtank.recording.event import Event

if TYPE_CHECKING:
    from towtank.identification.changes.hypotheses import Verdict

__all__: list[str] = []

_AXES = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_MOST_NAMED, _SURE_STEP = 4, 2.0  # coefficients at most; deviations
_MOVES = "the water moves as it did not before: waves, or another current"
_REVISED, _SETTLES = 1.0, 16.0  # s after which a change is revised, ever later, and at last
_SAME = 8.0  # s for which what is noticed is the change that was noticed before, seen better


@dataclass(frozen=True, eq=False)
class Change:
    """A change that was noticed, and the filter that goes on.

    Attributes:
        t, noticed: when it began, as far as known, and now [s]. verdict: what speaks for it.
        running: the filter from here on. kept: what is known of the vehicle as it is now from before the change.
        before: coordinates (n,) before, and their deviations (n,).
    """

    t: float
    noticed: float
    verdict: Verdict
    running: Running
    kept: Kept
    before: tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Recognised:
    """A configuration met before that the vehicle has become, or, where it was given up, has not.

    Attributes:
        t: now [s]. name: of the configuration. probability: of it. taken: as prior; False where it is given up.
        running: the filter from here on. kept: what is known of the vehicle from before the change.
    """

    t: float
    name: str
    probability: float
    taken: bool
    running: Running
    kept: Kept


@dataclass(frozen=True, eq=False)
class OtherWater:
    """Water that moves otherwise than before, in waves or another current; the vehicle is as it was.

    Attributes:
        t, noticed: when, as far as known, and now [s]. evidence: log Bayes factor against the water of before.
        running: the filter from here on. kept: what was known of the vehicle when that began.
    """

    t: float
    noticed: float
    evidence: float
    running: Running
    kept: Kept


def change_words(
    free: FreeParameters,
    before: tuple[Array, Array],
    now: tuple[Array, Array],
    *,
    thruster: str | None,
) -> str:
    """Return what changed in one line, the surest first.

    Args:
        before, now: coordinates (n,) and their deviations (n,).
        thruster: that is blamed, None for a change of the body.
    """
    step, std = now[0] - before[0], np.hypot(before[1], now[1])
    if thruster is not None:
        k = free.names.index(GAIN_PREFIX + thruster)
        share = 100.0 * math.exp(step[k])
        digits = 0 if share * std[k] >= 1.0 else 1
        return f"thruster {thruster}: {share:.{digits}f} ± {share * std[k]:.{digits}f} % of its thrust"
    steps = [
        (abs(step[k]) / max(std[k], 1e-12), _one(free, k, before[0][k], now[0][k], std[k]))
        for k in range(len(free))
        if std[k] > 0.0
    ]
    sure = [text for size, text in sorted(steps, key=lambda each: -each[0]) if size > _SURE_STEP and text]
    if sure:
        return ", ".join(sure[:_MOST_NAMED])
    return "something about the body, not yet known what"


def change_details(free: FreeParameters, before: tuple[Array, Array], now: tuple[Array, Array]) -> dict[str, float]:
    """Return the step of every coefficient and its deviation, as X_udot and X_udot_std; gains as shares of before."""
    out: dict[str, float] = {}
    old, new = free.values(before[0]), free.values(now[0])
    std = np.hypot(np.abs(free.slopes(before[0])) * before[1], np.abs(free.slopes(now[0])) * now[1])
    for k, name in enumerate(free.names):
        if int(free.codes[k, 0]) in TERMS or name.startswith(GAIN_PREFIX):
            out[name], out[f"{name}_std"] = float(new[k] - old[k]), float(std[k])
    return out


def _one(free: FreeParameters, k: int, old: float, new: float, std: float) -> str:
    kind, i, j, transform = (int(code) for code in free.codes[k])
    name = free.names[k]
    if kind == MASS and transform != UNTRANSFORMED:
        unit = "kg" if i < 3 else "kg m²"
        return f"{_AXES[i]} inertia {_signed(math.exp(new) - math.exp(old), math.exp(new) * std)} {unit}"
    if kind in (LINEAR, QUADRATIC) and i == j and old < 0.0:
        which = "linear drag" if kind == LINEAR else "drag"
        return f"{_AXES[i]} {which} {_signed(100.0 * (new / old - 1.0), 100.0 * std / -old)} %"
    if kind == WEIGHT:
        return f"net weight {_signed(new - old, std)} N"
    if kind == MOMENT and i == 2 and abs(old) > 0.0:
        share = 100.0 / abs(old)
        return f"roll and pitch stiffness {_signed((new - old) * share * math.copysign(1.0, old), std * share)} %"
    if kind in TERMS:
        side = free.signs[k]  # a coordinate of the mass matrix is minus the coefficient
        return f"{name} {_signed(side * (new - old), std)}"
    return ""


def _signed(value: float, std: float) -> str:
    """Return a step and its deviation, to the first digits of the deviation: "+4.1 ± 0.3"."""
    digits = max(0, 1 - math.floor(math.log10(std))) if 0.0 < std < math.inf else 1
    digits -= digits > 0 and std * 10.0**digits >= 20.0
    text = f"{abs(value):.{min(digits, 6)}f}"
    return f"{'−' if value < 0.0 else '+'}{text} ± {std:.{min(digits, 6)}f}"


class ChangeLog:
    """Events in the order in which they were noticed.

    A change that is noticed again while its numbers settle is the same one, seen better.
    """

    def __init__(self) -> None:
        self.events: tuple[Event, ...] = ()
        self._open: tuple[Change, int] | None = None  # the last change, its place among the events
        self._again = _REVISED  # s after it was noticed that it is revised
        self.gone_over = False  # by passes, since the last change

    def add(self, detected: Change | Recognised | OtherWater) -> None:
        """Add a change, a configuration that was recognised, or other water."""
        if isinstance(detected, OtherWater):
            self.settle()
            shown = {"noticed": detected.noticed, "log_evidence": detected.evidence}
            self._put(Event(detected.t, "water", _MOVES, shown))
            return
        if isinstance(detected, Recognised):
            if detected.taken:
                text = f"this is {detected.name}, met before (probability {100.0 * detected.probability:.1f} %)"
            else:
                text = f"this is not {detected.name} after all (probability {100.0 * detected.probability:.1f} %)"
            details: dict[str, float | str] = {
                "configuration": detected.name,
                "probability": detected.probability,
                "taken": float(detected.taken),
            }
            self._put(Event(detected.t, "configuration", text, details))
            return
        before = self._open
        if before is not None and _is_same(before[0], detected):
            self._open = replace(detected, t=before[0].t, noticed=before[0].noticed, before=before[0].before), before[1]
            self.revise(detected.noticed, detected.running)
            return
        self._open, self._again, self.gone_over = (detected, len(self.events)), _REVISED, False
        self._put(_event(detected, detected.running, settled=False))

    def settle(self) -> None:
        """Leave the last change as it stands."""
        self._open = None

    def recovered(self, t: float) -> None:
        """Add that the filter had lost itself and has recovered."""
        self.settle()
        text = "the filter had lost itself; it goes on with what it knew, less sure"
        self._put(Event(t, "mended", text))

    def revise(self, t: float, running: Running) -> None:
        """Revise the last change with what the filter knows at t [s]."""
        if self._open is None or t < self._open[0].noticed + self._again:
            return
        change, place = self._open
        self._again *= 2.0
        if self._again > _SETTLES:
            self._open = None
        self.events = (*self.events[:place], _event(change, running, settled=self.gone_over), *self.events[place + 1 :])

    def restore(self, events: tuple[Event, ...]) -> None:
        """Put in the events of another one."""
        self.events, self._open = events, None

    def _put(self, event: Event) -> None:
        self.events = (*self.events, event)


def _event(change: Change, running: Running, *, settled: bool) -> Event:
    """Return a change as the filter knows it by now; one that went over the samples anew has other unknowns, too.

    Before passes have, which is what `settled` says, it is linearised about the vehicle of before.
    """
    names = [name for name in change.running.free.names if name in running.free.names]
    free = change.running.prior.only(names).free
    old = [change.running.free.names.index(name) for name in names]
    new = [running.free.names.index(name) for name in names]
    before = change.before[0][old], change.before[1][old]
    now = running.state.theta[new], (running.disagreement * coefficient_std(running.state))[new]
    verdict = change.verdict
    text = change_words(free, before, now, thruster=verdict.thruster) + ("" if settled else " (settling)")
    details: dict[str, float | str] = {
        "noticed": change.noticed,
        "settled": float(settled),
        "log_evidence": verdict.evidence,
        "log_odds": float(np.nan_to_num(verdict.clear, posinf=99.0)),
        **({"thruster": verdict.thruster} if verdict.thruster else verdict.parts),
        **change_details(free, before, now),
    }
    return Event(change.t, "thruster" if verdict.thruster else "change", text, details)


def _is_same(one: Change, other: Change) -> bool:
    """Return whether a change is the same one, seen better: of the same kind, while its numbers settle."""
    same_kind = one.verdict.thruster == other.verdict.thruster and one.running.free.names == other.running.free.names
    return same_kind and other.noticed <= one.noticed + _SAME
