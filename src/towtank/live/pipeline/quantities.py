"""Which of several topics tells a quantity: chosen from what came lately, and kept until another is clearly better."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from towtank.readers.common.sources import QUANTITIES, Source, choose

__all__ = ["Quantities"]

_KEPT = 0.5  # of the best score is enough to go on with what is used
_WORTH = 4.0  # as in `readers.sources`: a step farther from the sensor has to be as many times as fast


class Quantities:
    """The choice as it stands: quantity -> name of a table; and why the others are not used."""

    def __init__(self) -> None:
        self.used: dict[str, str] = {}
        self.reasons: dict[str, str] = {}

    def decide(self, sources: Sequence[Source]) -> None:
        """Choose anew among what the last seconds brought."""
        choice = choose(sources)
        used: dict[str, str] = {}
        for best in choice.used:
            used[best.quantity] = best.table
            before = best.quantity, self.used.get(best.quantity)
            kept = next((each for each in sources if (each.quantity, each.table) == before), None)
            if kept is not None and not kept.refused and _score(kept) >= _KEPT * _score(best):
                used[best.quantity] = kept.table
        self.used = {quantity: used[quantity] for quantity in QUANTITIES if quantity in used}
        refused = (source for source, _ in choice.reasons if source.refused)
        self.reasons = {f"{source.table}: {source.quantity}": source.refused for source in refused}

    def of(self, table: str) -> set[str]:
        """Return the quantities that a table is used for."""
        return {quantity for quantity, name in self.used.items() if name == table}

    def said(self, labels: Mapping[str, str] | None = None) -> list[str]:
        """Return what is used and what is refused, in lines for a person."""
        by_table: dict[str, list[str]] = {}
        for quantity, table in self.used.items():
            by_table.setdefault(table, []).append(quantity)
        used = ", ".join(f"{(labels or {}).get(table, table)} ({', '.join(what)})" for table, what in by_table.items())
        return ([f"uses {used}"] if used else []) + [f"not used: {what}: {why}" for what, why in self.reasons.items()]


def _score(source: Source) -> float:
    return source.samples / _WORTH**source.distance
