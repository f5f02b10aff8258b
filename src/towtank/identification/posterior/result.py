"""From the posterior's coordinates to what is said and kept: coefficients, reasons, a model with its posterior."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.identification.model.parameters import GAIN_PREFIX
from towtank.identification.model.prior import Prior
from towtank.identification.model.terms import AXES
from towtank.identification.posterior.estimate import Estimate, SumOfInertias
from towtank.identification.posterior.physical import consistent
from towtank.identification.posterior.thrusters import with_thrusters
from towtank.identification.posterior.wording import contradicted, not_narrowed, not_shown
from towtank.vehicle import COEFFICIENTS, Coefficient, Provenance, Vehicle
from towtank.vehicle.names import COLUMNS, ROWS, index
from towtank.vehicle.posterior import Posterior

__all__ = ["NARROWED", "estimate_of", "model_of", "with_posterior", "without_data"]

_TINY = 1e-12
NARROWED = 0.5  # share of the prior's deviation up to which a coefficient counts as identified


def estimate_of(
    vehicle: Vehicle,
    prior: Prior,
    theta: Array,
    covariance: Array,
    duration: float,
    samples: int,
    learned: NDArray[np.bool_] | None = None,
    undoubted: Array | None = None,
) -> tuple[Estimate, tuple[str, ...]]:
    """Return the coefficients of a posterior, and what had to be moved for them to be physical.

    A coefficient is identified where its deviation is at most half of what it was before any data, or would be by its
    bounds alone. Values are the likeliest physical ones; deviations stay those of the posterior, so that none claims
    more for having met a bound.

    Args:
        vehicle: what is not free. theta, covariance: (n,), (n, n) in the coordinates of the prior's `free`.
        learned: which of them were (n,), by default all; of the others nothing shows or drives the motion.
        undoubted: covariance (n, n) before another picture of the data widened it, where one did.
    """
    free = prior.free
    rows = [k for k, name in enumerate(free.names) if name in COEFFICIENTS]
    names = tuple(free.names[k] for k in rows)
    slopes, values = free.slopes(theta)[rows], free.values(theta)[rows]
    block = covariance[np.ix_(rows, rows)] * np.outer(slopes, slopes)
    physical = consistent(vehicle, names, values, block)
    std = np.sqrt(np.maximum(np.diag(block), 0.0))
    supposed = without_data(prior, theta)[rows]
    share, before = (
        np.sqrt(np.maximum(np.diag(each), 0.0))[rows] / supposed
        for each in (covariance, covariance if undoubted is None else undoubted)
    )
    identified = tuple(bool(each <= NARROWED) for each in share)
    sums = []
    for axis in AXES:
        if axis.added_mass in names and identified[names.index(axis.added_mass)]:
            i = names.index(axis.added_mass)
            total = float(vehicle.rigid_body_matrix[axis.index, axis.index]) - float(physical.values[i])
            sums.append(SumOfInertias(axis.sum_name, total, float(std[i]), axis.unit))
    taken = np.ones(len(rows), dtype=np.bool_) if learned is None else learned[rows]
    reasons = tuple(
        None if ok else _reason(name, float(left), narrow=bool(alone <= NARROWED), shown=bool(shown))
        for name, ok, left, alone, shown in zip(names, identified, share, before, taken, strict=True)
    )
    estimate = Estimate(names, physical.values, std, block, identified, reasons, tuple(sums), (), duration, samples)
    return estimate, physical.messages


def without_data(prior: Prior, theta: Array) -> Array:
    """Return the prior's `reference` (n,); of asymmetric drag at most what its bound leaves, |X_u2| <= -X_uu."""
    out, values = prior.reference.copy(), prior.free.values(theta)
    for k, name in enumerate(prior.names):
        kind, i, j = index(name) if name in COEFFICIENTS else ("", 0, 0)
        quadratic = f"{ROWS[i]}_{2 * COLUMNS[j]}"
        if kind == "asymmetric" and quadratic in prior.names:
            out[k] = min(out[k], max(abs(values[prior.names.index(quadratic)]) / math.sqrt(3.0), _TINY))
    return out


def _reason(name: str, left: float, *, narrow: bool, shown: bool) -> str:
    if narrow:
        return contradicted()
    return not_narrowed(name, left) if shown else not_shown(name)


def model_of(
    vehicle: Vehicle,
    estimate: Estimate,
    source: str,
    *,
    delay: float,
    lag: float,
    gains: Mapping[str, tuple[float, float]],
) -> Vehicle:
    """Return the vehicle with all that was free at the posterior's mean, and its deviations."""
    changes: dict[str, Coefficient | float] = {}
    for each in estimate.coefficients:
        origin = source if each.identified else f"{source}: {each.reason}"
        changes[each.name] = Coefficient(value=each.value, std=each.std, source=origin)
    kept = vehicle.provenance.notes
    notes = kept if isinstance(kept, tuple) else (kept,) if kept else ()
    model = vehicle.with_coefficients(changes, provenance=Provenance(source=source, notes=notes))
    if vehicle.thrusters:
        model = with_thrusters(model, lag=lag, gains=gains).model_copy(update={"command_delay": max(0.0, delay)})
    return model


def with_posterior(model: Vehicle, prior: Prior, theta: Array, covariance: Array) -> Vehicle:
    """Return the model with the posterior itself, from which learning goes on and vehicles are drawn."""
    signs = prior.free.signs
    at = np.where(signs < 0.0, prior.free.rigid - theta, theta)
    for k, name in enumerate(prior.names):
        if name.startswith(GAIN_PREFIX):
            at[k] = 0.0  # the model's thrusters have the gains that were found
    posterior = Posterior.from_covariance(prior.names, at, covariance * np.outer(signs, signs), prior.reference)
    return model.model_copy(update={"posterior": posterior})
