"""The estimate of the streaming joint filter, read from its state at any time."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.estimate import AxisReport, Estimate
from towtank.identification.information import told_by_data
from towtank.identification.joint import prior_deviation
from towtank.identification.joint_estimate import assemble, judge
from towtank.identification.joint_levels import caution
from towtank.identification.joint_start import size_of
from towtank.identification.joint_state import C_DURATION, C_ROWS, JointState
from towtank.identification.parameters import DELAY, GAIN_PREFIX, LAG, LINEAR, MASS, QUADRATIC, FreeParameters
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
    left_out: Mapping[str, str],
) -> Estimate:
    """Return what the filter knows.

    Args:
        asked: names to tell of, None for all. prior: information (n, n) put in.
        left_out: why damping terms are taken as 0.
    """
    n = len(free)
    covariance = state.P[N_FIXED : N_FIXED + n, N_FIXED : N_FIXED + n].copy()
    scale = size_of(vehicle, free)
    deviation = prior_deviation(free, scale)
    covariance = _cautious(covariance, deviation, prior, _grown(free, state))
    findings = judge(free, state.theta, covariance, deviation, scale, prior=prior)
    why = {name: reason for name, reason in findings.reasons.items() if not _is_input(name)}
    why |= left_out
    wanted = [name for name in (asked or (*free.names, *left_out)) if not _is_input(name)]
    duration, rows = float(state.clock[C_DURATION]), int(state.clock[C_ROWS])
    return assemble(vehicle, free, state.theta, covariance, wanted, why, tuple(left_out), axes, duration, rows).estimate


def _cautious(covariance: Array, deviation: Array, prior: Array | None, grown: Array) -> Array:
    """Return the covariance (n, n) with what the data told, and that alone, less sure by the factors grown (n,)."""
    before = np.diag(deviation**-2.0) + (0.0 if prior is None else prior)
    told = told_by_data(covariance, before) / np.outer(grown, grown)
    return np.asarray(np.linalg.inv(told + before))


def _grown(free: FreeParameters, state: JointState) -> Array:
    """Return by how much deviations (n,) grow, since the disturbance's level is not known but estimated as well."""
    each = caution(state.level[:, 3])
    axes = [int(code[1]) if code[0] in (MASS, LINEAR, QUADRATIC) else -1 for code in free.codes]
    used = [axis for axis in axes if axis >= 0] or list(range(6))
    most = float(each[used].max())
    return np.array([each[axis] if axis >= 0 else most for axis in axes])


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
