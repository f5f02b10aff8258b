"""A learner that learns nothing, for tests of what it is given."""

from __future__ import annotations

from typing import Any

from towtank import Learner


class Counting(Learner):
    """A learner that keeps the times that it is taught, and after how many of them it began anew."""

    def __init__(self) -> None:
        self.seen: list[float] = []
        self.restarts: list[int] = []

    def update(self, t: float, **arguments: Any) -> bool:
        self.seen.append(t)
        return True

    def settle(self) -> None:
        pass

    def restart(self) -> None:
        self.restarts.append(len(self.seen))

    @property
    def estimate(self) -> None:  # type: ignore[override]
        return None
