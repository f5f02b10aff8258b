"""What the watch finds: a change, or a configuration met before, with the filter that goes on."""

from __future__ import annotations

from dataclasses import dataclass, field

from towtank.core.arrays import Array
from towtank.identification.change_fork import Fork
from towtank.identification.change_kinds import Hypothesis
from towtank.identification.change_known import Known
from towtank.identification.change_verdict import Verdict
from towtank.identification.held_input import HeldInput
from towtank.identification.joint_state import JointState
from towtank.identification.parameters import FreeParameters

__all__ = ["Change", "Recognised", "Referee"]


@dataclass(frozen=True, eq=False)
class Change:
    """A change that was noticed, and the filter that goes on.

    Attributes:
        t, noticed: when it began, as far as known, and now [s]. verdict: what speaks for it.
        free, state, held: the filter from here on. before: coordinates (n,) before, and their deviations (n,).
    """

    t: float
    noticed: float
    verdict: Verdict
    free: FreeParameters
    state: JointState
    held: HeldInput
    before: tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class Recognised:
    """A configuration met before that the vehicle has become, or, where it was given up, has not.

    Attributes:
        t: now [s]. name: of the configuration. probability: of it. taken: as prior; False where it is given up.
        free, state, held: the filter from here on.
    """

    t: float
    name: str
    probability: float
    taken: bool
    free: FreeParameters
    state: JointState
    held: HeldInput


@dataclass(eq=False)
class Referee:
    """A split filter that goes on beside a change, to compare it with what is known."""

    fork: Fork
    ways: tuple[Hypothesis, ...]
    keeps: FreeParameters
    steps: Array
    until: float
    taken: str | None = None
    known: list[Known] = field(default_factory=list)
