"""What windows say about a change: whether there was one and since when, of which parts, or of which thruster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from towtank.core.arrays import Array
from towtank.identification.change_kinds import Hypothesis
from towtank.identification.change_window import Window

__all__ = ["Verdict", "judged"]

_TOUCHED = 0.05  # probability of a part from which on it is thought to have changed too,
_ALONG = 0.2  # and the share of its step that any other part of the body may have made: a payload touches all


@dataclass(frozen=True, eq=False)
class Verdict:
    """What the windows say.

    Attributes:
        evidence: log Bayes factor of any change against none, of the window that has the largest.
        window: index of the one that what is blamed fits best: it began where the change did.
        parts: of the body, with the probability that each changed, given that the body did.
        thruster: the one that is blamed, None where it is the body.
        clear: log odds of what is blamed, the body or that one gain, against all else.
        steps: deviations (n,) of what changed by the likelier family.
        changed: log evidence of any change in that window, on the scale of `Window.evidence`.
    """

    evidence: float
    window: int
    parts: dict[str, float]
    thruster: str | None
    clear: float
    steps: Array
    changed: float


def judged(windows: Sequence[Window], ways: Sequence[Hypothesis]) -> Verdict:
    """Weigh every way of a change at the beginning of every window by its evidence.

    What came before a window began is the same under all of them, so that windows compare as they are.
    """
    none = np.array([window.evidence(window.P0) for window in windows])
    scores = np.array(
        [
            [way.weight + window.evidence(window.P0 + np.diag(way.steps**2)) - least for way in ways]
            for window, least in zip(windows, none, strict=True)
        ]
    )
    each = np.asarray(logsumexp(scores, axis=1))
    thrusters = np.array([way.thruster is not None for way in ways])
    body = float(logsumexp(scores[:, ~thrusters])) if not thrusters.all() else -np.inf
    gain = {int(k): float(logsumexp(scores[:, k])) for k in np.flatnonzero(thrusters)}
    best = max(gain, key=lambda k: gain[k]) if gain else None
    if best is not None and gain[best] <= body:
        best = None
    blamed = ~thrusters if best is None else np.arange(len(ways)) == best
    blame = float(logsumexp(scores[:, blamed]))
    clear = blame - (float(logsumexp(scores[:, ~blamed])) if not blamed.all() else -np.inf)
    fits = int(np.argmax(logsumexp(scores[:, blamed], axis=1)))
    parts = _parts(ways, scores[fits], ~thrusters)
    return Verdict(
        evidence=float(each.max()),
        window=fits,
        parts=parts,
        thruster=None if best is None else ways[best].thruster,
        clear=clear,
        steps=ways[best].steps if best is not None else _union(ways, parts, windows[fits].score.size),
        changed=float(each[fits] + none[fits]),
    )


def _parts(ways: Sequence[Hypothesis], scores: Array, body: Array) -> dict[str, float]:
    """Return the probability of each part of the body, given that the body changed."""
    out: dict[str, float] = {}
    if body.any():
        among = float(logsumexp(scores[body]))
        for k in (int(each) for each in np.flatnonzero(body)):
            for part in ways[k].parts:
                out[part] = out.get(part, 0.0) + float(np.exp(scores[k] - among))
    return out


def _union(ways: Sequence[Hypothesis], parts: dict[str, float], size: int) -> Array:
    """Return the deviations of every part that may well have changed, and a share of those of all others."""
    steps = np.zeros(size)
    for way in ways:
        if way.thruster is None:
            touched = all(parts[part] > _TOUCHED for part in way.parts)
            steps = np.maximum(steps, way.steps if touched else _ALONG * way.steps)
    return steps
