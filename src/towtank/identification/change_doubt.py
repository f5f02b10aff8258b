"""How much more windows err than the filter's model says: real motion has more to it than noise and a random force.

Where nothing changes, the evidence of a change has a known mean. What it has been on average is the factor by which the
variance of what windows tell is larger; windows count that much less. A single window counts for a few times the
average at most, so that a true change does not hide itself.
"""

from __future__ import annotations

from collections.abc import Sequence

from towtank.core.arrays import Array
from towtank.identification.change_window import Window

__all__ = ["Doubt"]

_FADES = 1.0 / 120.0  # of what was learned, with every window
_NEEDED = 20.0  # sum of expected values before any change is believed
_CLIPPED = 5.0  # times the average that one window counts for at most
_TOLD = 0.05  # least expected value of a window that tells anything


class Doubt:
    """A running ratio of what windows showed and what was to be expected."""

    def __init__(self) -> None:
        self._shown = self._expected = self._seen = 0.0

    @property
    def factor(self) -> float:
        """Factor to the variance of what windows tell, 1 or more."""
        return max(1.0, self._shown / self._expected) if self._expected > 0.0 else 1.0

    @property
    def known(self) -> bool:
        """Whether enough windows have been seen."""
        return self._seen >= _NEEDED

    @property
    def numbers(self) -> tuple[float, ...]:
        """What was learned, for `restore`."""
        return self._shown, self._expected, self._seen

    def restore(self, numbers: Sequence[float]) -> None:
        """Go on with the numbers of another one."""
        self._shown, self._expected, self._seen = (float(each) for each in numbers)

    def learn(self, window: Window, steps: Array) -> None:
        """Take a window in which nothing is known to have changed."""
        expected = window.usual(steps)
        if not expected > _TOLD:
            return
        shown = window.most(steps)
        if self._seen > 0.25 * _NEEDED:
            shown = min(shown, _CLIPPED * self.factor * expected)
        self._shown += shown - _FADES * self._shown
        self._expected += expected - _FADES * self._expected
        self._seen += expected
