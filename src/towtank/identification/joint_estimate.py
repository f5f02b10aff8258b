"""From the joint estimator's coordinates to coefficients: values, deviations, what is known, what is physical."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.axes import AXES
from towtank.identification.estimate import AxisReport, Estimate, SumOfInertias
from towtank.identification.findings import Identifiability
from towtank.identification.identifiability import DETERMINED, identifiability
from towtank.identification.information import told_by_data
from towtank.identification.parameters import IN_DELAY, PLAIN, FreeParameters
from towtank.identification.physical import consistent
from towtank.vehicle import COEFFICIENTS, Vehicle

__all__ = ["Assembled", "assemble", "judge"]


@dataclass(frozen=True)
class Assembled:
    """The estimate, and remarks in plain words."""

    estimate: Estimate
    remarks: tuple[str, ...]


def judge(
    free: FreeParameters,
    theta: Array,
    covariance: Array,
    deviation: Array,
    scale: Array,
    *,
    prior: Array | None = None,
    speeds: Array | None = None,
    yielding: Collection[str] = (),
    enough: float = DETERMINED,
) -> Identifiability:
    """Say what a run determined, from the covariance after it less the deviations (n,) that it started from.

    Args:
        scale: size (n,) of coordinates that are no logarithms. prior: information (n, n) that was put in.
        speeds: (6, 2), yielding, enough: see `identifiability`.
    """
    before = np.diag(deviation**-2.0) if prior is None else np.diag(deviation**-2.0) + prior
    information = told_by_data(covariance, before)
    log = [bool(free.codes[k, 3] != PLAIN) for k in range(len(free))]
    size = np.maximum(np.abs(theta), 0.0)
    for k in range(len(free)):
        if free.codes[k, 0] == IN_DELAY:
            size[k] = max(size[k], 0.05)
        elif not log[k]:
            size[k] = max(size[k], 0.05 * scale[k])
    return identifiability(
        free.names,
        theta,
        information,
        logarithmic=log,
        size=size,
        prior=prior,
        speeds=speeds,
        yielding=yielding,
        enough=enough,
    )


def assemble(
    vehicle: Vehicle,
    free: FreeParameters,
    theta: Array,
    covariance: Array,
    wanted: Sequence[str],
    unidentified: Mapping[str, str],
    zeroed: Sequence[str],
    axes: Sequence[AxisReport],
    duration: float,
    samples: int,
    roughly: Collection[str] = (),
) -> Assembled:
    """Return the estimate of `wanted` names.

    Args:
        covariance: of theta (n, n). unidentified: why a name is not; it keeps the vehicle's value, or 0 if in `zeroed`,
            or what was fitted beside the others if in `roughly`.
    """
    rows = [k for k, name in enumerate(free.names) if name in COEFFICIENTS]
    names_free = [free.names[k] for k in rows]
    slopes = free.slopes(theta)[rows]
    values_free = free.values(theta)[rows]
    block = covariance[np.ix_(rows, rows)] * np.outer(slopes, slopes)
    known = [name not in unidentified for name in names_free]
    physical = consistent(vehicle, names_free, values_free, block)
    names = [name for name in wanted if name in COEFFICIENTS]
    names += [name for name in names_free if name not in names]
    n = len(names)
    values, spread = np.zeros(n), np.full((n, n), np.nan)
    at = [names.index(name) for name in names_free]
    for i, name in enumerate(names):
        values[i] = 0.0 if name in zeroed else vehicle.coefficient(name)
    for a, i in enumerate(at):
        if known[a] or names_free[a] in roughly:
            values[i] = physical.values[a]
        if not known[a]:
            continue
        for b, j in enumerate(at):
            if known[b]:
                spread[i, j] = physical.covariance[a, b]
    identified = tuple(name in names_free and name not in unidentified for name in names)
    std = np.sqrt(np.where(np.isnan(np.diag(spread)), np.nan, np.maximum(np.diag(spread), 0.0)))
    sums = []
    for axis in AXES:
        if axis.added_mass in names and identified[names.index(axis.added_mass)]:
            i = names.index(axis.added_mass)
            total = float(vehicle.rigid_body_matrix[axis.index, axis.index]) - float(values[i])
            sums.append(SumOfInertias(axis.sum_name, total, float(std[i]), axis.unit))
    default = "not free"
    verdicts = list(zip(names, identified, strict=True))
    estimate = Estimate(
        names=tuple(names),
        values=values,
        std=std,
        covariance=spread,
        identified=identified,
        reasons=tuple(None if ok else unidentified.get(name, default) for name, ok in verdicts),
        sums=tuple(sums),
        axes=tuple(axes),
        duration=duration,
        samples=samples,
    )
    return Assembled(estimate, physical.messages)
