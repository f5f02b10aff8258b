"""Still water: the supposition that nothing disturbs the vehicle, which a look of the streaming filter tries.

A level of the disturbance that is estimated never falls to nothing in a few seconds, and a slow stair of thrust looks
like a slow force: in still water a stream would wait for two times as long as it need. So beside the usual level a look
supposes that there is no disturbance, and keeps to that where it is likelier. A marker that jumps by three deviations
of its noise is mistaken for a force by the one and costs the other dear; so, where the supposition is not plainly
wrong, a free run judges as well, whose residuals are white in still water.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.free_run_gain import columns_of
from towtank.identification.free_runs import FreeRuns
from towtank.identification.joint_health import known_to
from towtank.identification.joint_state import C_DURATION, O_TIME_CONSTANT, JointState, Tuning
from towtank.identification.log_learning import Levels
from towtank.identification.parameters import MASS, FreeParameters
from towtank.identification.samples import Samples
from towtank.vehicle import Vehicle

__all__ = ["PLAINLY_WRONG", "Still", "freely_white", "still_water"]

PLAINLY_WRONG = -100.0  # log likelihood ratio beyond which no free run is asked
_STILL = 0.1  # of the usual disturbance
_SHOWS = 1.5  # time constants after which a random force has begun to show,
_SHOWS_FREELY = 2.25  # and after which free runs show it: until then coefficients bend to it
_FELT = 0.5  # deviation of the logarithm of an inertia


@dataclass(frozen=True, eq=False)
class Still:
    """Levels in still water, what is usual there, and the axes that it is supposed of."""

    levels: Levels
    tuning: Tuning
    axes: tuple[int, ...]

    def kept(self, levels: Levels) -> Levels:
        """Return levels with the disturbance of these axes as it is supposed."""
        sigma = levels.sigma.copy()
        sigma[list(self.axes)] = self.levels.sigma[list(self.axes)]
        return replace(levels, sigma=sigma)


def still_water(state: JointState, levels: Levels, free: FreeParameters, tuning: Tuning) -> Still | None:
    """Return still water about all axes of which something is known; None too early.

    A random force that is still what it was at the beginning looks like any constant one.
    """
    if state.clock[C_DURATION] < _SHOWS * tuning.time_constant:
        return None
    axes = [int(code[1]) for code, s in zip(free.codes, known_to(state), strict=True) if code[0] == MASS and s < _FELT]
    if not axes:
        return None
    sigma, usual = levels.sigma.copy(), np.array(tuning.usual)
    sigma[axes] = np.minimum(sigma[axes], _STILL * usual[axes])
    usual[axes] = 0.0
    return Still(replace(levels, sigma=sigma), replace(tuning, usual=tuple(usual)), tuple(axes))


def freely_white(
    stretches: Sequence[Samples],
    vehicle: Vehicle,
    free: FreeParameters,
    state: JointState,
    noise: Array,
    *,
    delay: float,
    prior: tuple[Array, Array] | None,
) -> Array | None:
    """Return coefficients (n,) of a free run, fitted from those of `state`, that leaves white residuals, or None."""
    if state.clock[C_DURATION] < _SHOWS_FREELY * state.options[O_TIME_CONSTANT]:
        return None
    runs = FreeRuns.over(vehicle, stretches, noise, free.names)
    fit = runs.fit(np.array(vehicle.parameters), free, state.theta, delay=delay, prior=prior)
    if fit is None:
        return None
    return fit.theta if fit.memory.white(columns_of(free.names)) else None
