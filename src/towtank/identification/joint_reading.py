"""The estimate of the streaming joint filter, read from its state at any time."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.estimate import AxisReport, Estimate
from towtank.identification.joint import prior_deviation
from towtank.identification.joint_estimate import assemble, judge
from towtank.identification.joint_start import size_of
from towtank.identification.joint_state import C_DURATION, C_ROWS, JointState
from towtank.identification.parameters import DELAY, GAIN_PREFIX, LAG, FreeParameters
from towtank.identification.transition import N_FIXED
from towtank.vehicle import Vehicle

__all__ = ["nothing_yet", "reading"]


def reading(
    vehicle: Vehicle,
    free: FreeParameters,
    state: JointState,
    asked: Sequence[str] | None,
    prior: Array | None,
    axes: Sequence[AxisReport],
) -> Estimate:
    """Return what the filter knows. prior: information (n, n) put in. asked: names to tell of, None for all."""
    n = len(free)
    covariance = state.P[N_FIXED : N_FIXED + n, N_FIXED : N_FIXED + n].copy()
    scale = size_of(vehicle, free)
    findings = judge(free, state.theta, covariance, prior_deviation(free, scale), scale, prior=prior)
    why = {name: reason for name, reason in findings.reasons.items() if not _is_input(name)}
    wanted = [name for name in (asked or free.names) if not _is_input(name)]
    duration, rows = float(state.clock[C_DURATION]), int(state.clock[C_ROWS])
    return assemble(vehicle, free, state.theta, covariance, wanted, why, (), axes, duration, rows).estimate


def _is_input(name: str) -> bool:
    return name in (DELAY, LAG) or name.startswith(GAIN_PREFIX)


def nothing_yet(vehicle: Vehicle, names: Collection[str]) -> Estimate:
    """Return the estimate of one who has seen nothing."""
    known = tuple(name for name in names if not _is_input(name))
    n = len(known)
    return Estimate(
        names=known,
        values=np.array([vehicle.coefficient(name) for name in known]),
        std=np.full(n, np.nan),
        covariance=np.full((n, n), np.nan),
        identified=(False,) * n,
        reasons=("nothing has been learned yet",) * n,
        sums=(),
        axes=(),
        duration=0.0,
        samples=0,
    )
