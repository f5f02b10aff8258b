"""What was refused: counted, and told once for each peer."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

__all__ = ["Refusals"]

_MOST = 256  # peers that are told of


class Refusals:
    """Counts by reason.

    Args:
        tell: called with one line for each peer and reason, the first time.
    """

    def __init__(self, tell: Callable[[str], None]) -> None:
        self.counts: Counter[str] = Counter()
        self._tell, self._told = tell, set[tuple[str, str]]()

    def add(self, peer: str, reason: str) -> None:
        """Count one refusal of a peer, by its address."""
        self.counts[reason] += 1
        if (peer, reason) not in self._told and len(self._told) < _MOST:
            self._told.add((peer, reason))
            self._tell(f"page: {peer}: {reason}: refused, and counted from now on without a word")

    @property
    def total(self) -> int:
        """How many there were."""
        return sum(self.counts.values())
