"""Water that begins to move otherwise, in waves or another current, weighed against a vehicle that has changed.

Filters that were split off go over their samples once more: in waves, or in a current that walks faster, instead of
with wider coefficients. What the innovations gain on the first filter's is a log Bayes factor, as it is with these. A
few seconds do not tell waves from a current that begins to flow (it looks like a long wave): later passes do.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from towtank.core.zero_order_hold import ZeroOrderHold
from towtank.identification.changes.branch import Branch, Kept, Running, copied, definite
from towtank.identification.data.samples import Samples
from towtank.identification.kalman.filter import take_all
from towtank.identification.kalman.passes import WAVE_PERIODS
from towtank.identification.kalman.state import JointState, coefficient_block, healthy_snapshot, in_waves

__all__ = ["Waters"]

_PERIODS = WAVE_PERIODS[::2]  # s: some seconds tell no more of it
_SIZES, _WALKS = (0.03, 0.1), (0.03, 0.1)  # m/s of waves, m/s per sqrt(s) of a current, that may begin
_LESS_LIKELY = 10.0  # of the log likelihood: water that has so much less than the best is not asked again


class _Water(NamedTuple):
    """Waves of a size [m/s] and period [s], or, without any, a current that walks [m/s per sqrt(s)]."""

    size: float
    period: float
    walk: float

    def of(self, state: JointState) -> JointState:
        """Return a copy of a filter in such water."""
        if self.size > 0.0:
            return in_waves(state, np.full(3, self.size), self.period)
        other = copied(state)
        other.settings["current_walk"] = self.walk**2
        return other


class _Replay(NamedTuple):
    gained: float  # on the first filter, log likelihood
    water: _Water
    branch: Branch
    state: JointState
    held: ZeroOrderHold


class Begun(NamedTuple):
    """When the water began to move otherwise [s], as far as known; the filter in it; what was known of the vehicle."""

    t: float
    running: Running
    kept: Kept


class Waters:
    """How the water may move that a filter does not know of yet: fewer with every look at the same suspicion.

    Args:
        running: the first filter.
    """

    def __init__(self, running: Running) -> None:
        levels = running.levels
        self._left = [_Water(0.0, 0.0, walk) for walk in _WALKS if walk > levels.current_walk]
        if not levels.waves.any():
            self._left += [_Water(size, period, 0.0) for period, size in itertools.product(_PERIODS, _SIZES)]
        self._all = len(self._left)

    def weighed(
        self, branches: Sequence[Branch], rows_since: Callable[[float], Samples], running: Running
    ) -> tuple[float, Begun | None]:
        """Return how much likelier than the water of before such water is (log), and what goes on in it.

        Args:
            branches: at whose beginnings the water may have begun to. rows_since: what came after a time.
        """
        known, found = float(running.state.clock[0].log_likelihood), list[_Replay]()
        since = [(branch, rows_since(branch.t)) for branch in branches]
        for (branch, rows), water in itertools.product(since, self._left):
            state, held = water.of(branch.parent), copied(branch.parent_held)
            take_all(state, held, rows)
            if healthy_snapshot(state) is not None and state.clock[0].resets == branch.resets:
                gained = float(np.nan_to_num(float(state.clock[0].log_likelihood) - known, nan=-np.inf))
                found.append(_Replay(gained, water, branch, state, held))
        if not found:
            return -np.inf, None
        best = max(found, key=lambda each: each.gained)
        likely = {each.water for each in found if each.gained > best.gained - _LESS_LIKELY}
        self._left = [each for each in self._left if each in likely]
        evidence = float(logsumexp([each.gained for each in found])) - math.log(self._all * len(branches))
        return evidence, _gone_on(best, running)


def _gone_on(best: _Replay, running: Running) -> Begun:
    """Return the filter that goes on: coefficients as they were known, in water that moves otherwise."""
    state, parent = best.state, best.branch.parent
    walk = math.sqrt(state.settings[0].current_walk)
    own = running._replace(
        state=state,
        held=best.held,
        settings=replace(running.settings, wave_period=best.water.period or running.settings.wave_period),
        levels=replace(running.levels, waves=state.wave_level.copy(), current_walk=walk),
    )
    known = definite(coefficient_block(parent))
    kept = Kept(running.prior.names, parent.theta, known, parent.linearised_at, running.disagreement, running.apart)
    return Begun(best.branch.t, own, kept)
