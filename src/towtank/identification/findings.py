"""What a run says of each coefficient, as records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from towtank.errors import InputError, nearest

__all__ = ["Combination", "Finding", "Hold", "Identifiability", "State"]

State = Literal["determined", "merged", "undetermined"]
Hold = Literal["", "zero", "value"]


@dataclass(frozen=True)
class Finding:
    """What the run says of one coefficient. Deviations are relative: 0.04 is 4 %.

    Attributes:
        state: "determined"; "merged": known only together with `partner`, for which it stands if that is held, or the
            other way round; "undetermined".
        std: with all others unknown. conditional: if all others were known. given: with what is held held, NaN if held.
        hold: "" free, "zero" or "value" (the vehicle's): what to do with it.
        reason: one sentence.
    """

    name: str
    state: State
    std: float
    conditional: float
    given: float
    hold: Hold
    partner: str | None
    reason: str

    @property
    def rough(self) -> bool:
        """Whether it is not determined, and yet further than its deviation from nothing."""
        return self.state == "undetermined" and self.std < 1.0


@dataclass(frozen=True)
class Combination:
    """A combination that is known where its members are not: sum of weight times relative change, and its deviation."""

    names: tuple[str, ...]
    weights: tuple[float, ...]
    std: float
    text: str


@dataclass(frozen=True)
class Identifiability:
    """Findings in the order of the names, and the combinations that are known instead."""

    findings: tuple[Finding, ...]
    combinations: tuple[Combination, ...]

    def __getitem__(self, name: str) -> Finding:
        for finding in self.findings:
            if finding.name == name:
                return finding
        raise InputError(f'"{name}" was not free{nearest(name, [each.name for each in self.findings])}')

    @property
    def determined(self) -> tuple[str, ...]:
        """Names of the coefficients that are determined."""
        return tuple(each.name for each in self.findings if each.state == "determined")

    @property
    def free(self) -> tuple[str, ...]:
        """Names of the coefficients to estimate: all that are not held."""
        return tuple(each.name for each in self.findings if not each.hold)

    @property
    def held(self) -> Mapping[str, Hold]:
        """Which coefficients to hold, and at what: "zero" or the vehicle's "value"."""
        return {each.name: each.hold for each in self.findings if each.hold}

    @property
    def reasons(self) -> Mapping[str, str]:
        """Why the others are not determined."""
        return {each.name: each.reason for each in self.findings if each.state != "determined"}
