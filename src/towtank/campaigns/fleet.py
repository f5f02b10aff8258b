"""What is known of a fleet: classes of vehicles, each coefficient of a class, and runs that are out of line.

`pooling` makes it of learned models; a class is a vehicle whose posterior is what is supposed of a new one.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from towtank.campaigns.likelihood import is_inertia, posterior_of
from towtank.core.arrays import Array
from towtank.digits import measured, short
from towtank.errors import InputError, nearest
from towtank.identification.model.parameters import LAG
from towtank.identification.model.prior import Prior
from towtank.identification.posterior.result import NARROWED, estimate_of, model_of, with_posterior
from towtank.identification.posterior.thrusters import learned_gains
from towtank.vehicle import Coefficient, Provenance, Vehicle, save_vehicle
from towtank.vehicle.posterior import Posterior, twin

__all__ = ["Fleet", "FleetClass", "Outlier", "Pooled"]


@dataclass(frozen=True)
class Pooled:
    """One coefficient of a class, in its own unit.

    Attributes:
        value, std, low, high: the mean of the class, its deviation and 95 % interval, the scale of thrust in it.
        between, within: deviations of vehicles about it, and of runs about their vehicle; None where too few know it.
        size: that shares of spreads are of: the total inertia of an added mass, else |value|.
        next_std: deviation of what a new vehicle is supposed to have in a run. prior, prior_std: before all runs.
        runs, vehicles: how many know it by themselves, to half of what was supposed.
    """

    name: str
    unit: str
    value: float
    std: float
    low: float
    high: float
    between: float | None
    within: float | None
    size: float
    next_std: float
    prior: float
    prior_std: float
    runs: int
    vehicles: int

    @property
    def known(self) -> bool:
        """Whether the class is known to half of what was supposed before all runs."""
        return self.std <= NARROWED * self.prior_std

    def document(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {
            "value": self.value,
            "std": self.std,
            "interval": [self.low, self.high],
            "unit": self.unit,
            "between": self.between,
            "within": self.within,
            "size": self.size,
            "next_std": self.next_std,
            "prior": {"value": self.prior, "std": self.prior_std},
            "identified": self.known,
            "runs": self.runs,
            "vehicles": self.vehicles,
        }


@dataclass(frozen=True)
class Outlier:
    """A run whose coefficient lies `deviations` from what all others say: those of runs, and its own."""

    vehicle: str
    run: str
    name: str
    deviations: float

    @property
    def text(self) -> str:
        """In words."""
        return f"{self.run} ({self.vehicle}): {self.name} {self.deviations:+.1f} deviations from what the others say"


@dataclass(frozen=True, eq=False)
class FleetClass:
    """A class of vehicles.

    Attributes:
        vehicles, runs: names of both, in their order. coefficients: without gains and lag. outliers: gravest first.
        base: the vehicle that runs were learned from, with what was supposed where no run tells more.
        prior: of all that was pooled, lag and gains too. mean, covariance: of it for a new vehicle in a run, in the
            coordinates of the prior.
        spread: deviations of runs about their vehicle, 0 where not shown, as `pooling.per_thrust` has them.
    """

    name: str
    vehicles: tuple[str, ...]
    runs: tuple[str, ...]
    coefficients: tuple[Pooled, ...]
    outliers: tuple[Outlier, ...]
    base: Vehicle
    prior: Prior
    mean: Array
    covariance: Array
    spread: Array

    def __getitem__(self, name: str) -> Pooled:
        found = [each for each in self.coefficients if each.name in (name, twin(name))]
        if not found:
            known = [each.name for each in self.coefficients]
            raise InputError(f'class {self.name}: "{name}" was not pooled{nearest(name, known)}')
        return found[0]

    @cached_property
    def vehicle(self) -> Vehicle:
        """The class as a vehicle whose posterior is what is supposed of a new one, for `--prior`.

        Coefficients are the likeliest physical ones, as those of a model that was learned from a log.
        """
        source = f"pooled by towtank: {len(self.runs)} runs of {len(self.vehicles)} vehicles"
        if len(self.vehicles) < 2:
            source += "; how vehicles differ one cannot say, so that no deviation is below that before any data"
        prior, theta = self.prior, self.mean
        estimate, _ = estimate_of(self.base, prior, theta, self.covariance, 0.0, 0)
        gains = learned_gains(self.base, prior.free, theta, np.sqrt(np.diag(self.covariance)))
        lag = max(float(theta[prior.names.index(LAG)]), 0.0) if LAG in prior.names else math.nan
        made = model_of(self.base, estimate, source, delay=self.base.command_delay, lag=lag, gains=gains)
        made = with_posterior(made, prior, theta, self.covariance)
        notes = (*self.base.provenance.notes, "means and deviations are of a new vehicle of the class")
        words = {"name": self.name, "description": f"a new vehicle of {self.name}", "posterior": made.posterior}
        return made.model_copy(update={**words, "provenance": Provenance(source=source, notes=notes)})

    def widened(self, model: Vehicle) -> Vehicle:
        """Return the model of a single run with deviations that include what runs of one vehicle differ by.

        Raises:
            InputError: the model has no posterior.
        """
        posterior = posterior_of(model, model.name)
        signs, wider, added = self.prior.free.signs, posterior.covariance, {}
        scale = self._thrust(model)
        for k, name in enumerate(self.prior.free.names):
            row = [i for i, other in enumerate(posterior.names) if other in (name, twin(name))]
            if row:
                grown = self.spread[k] * (scale if self.prior.free.forces[k] else 1.0)
                wider[row[0], row[0]] += grown**2
                added[posterior.names[row[0]]] = grown * self._unit(k, model) * signs[k]
        known = {**model.hydrodynamics, **{n: c for n, c in model.restoring if c is not None}}
        changes: dict[str, Coefficient | float] = {
            name: known[name].model_copy(update={"std": math.hypot(known[name].std or 0.0, each)})
            for name, each in added.items()
            if name in known
        }
        found = Posterior.from_covariance(posterior.names, posterior.mean, wider, posterior.prior_std)
        return model.with_coefficients(changes).model_copy(update={"posterior": found})

    def _thrust(self, model: Vehicle) -> float:
        """Return the mean gain of the model's thrusters as a multiple of the base's."""
        before = {each.name: each.gain for each in self.base.thrusters}
        ratios = [math.log(each.gain / before[each.name]) for each in model.thrusters if each.name in before]
        return math.exp(float(np.mean(ratios))) if ratios else 1.0

    def _unit(self, k: int, model: Vehicle) -> float:
        """Return the size of a coefficient's change for one unit of its coordinate."""
        i = self.prior.free.codes[k, 1]
        return float(model.mass_matrix[i, i]) if is_inertia(self.prior.free)[k] else 1.0

    def document(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {
            "vehicles": list(self.vehicles),
            "runs": list(self.runs),
            "coefficients": {each.name: each.document() for each in self.coefficients},
            "outliers": [
                {"vehicle": each.vehicle, "run": each.run, "coefficient": each.name, "deviations": each.deviations}
                for each in self.outliers
            ],
        }

    def rows(self) -> list[tuple[str, ...]]:
        """Return cells of a table, under `Fleet.HEADS`, of what the class knows and of what shows a spread."""
        return [
            (
                each.name,
                *measured(each.value, each.std),
                each.unit,
                *(_share(spread, each) for spread in (each.between, each.within)),
                short(each.next_std, 2),
                short(each.prior_std, 2),
                f"{each.runs}/{each.vehicles}",
            )
            for each in self.coefficients
            if each.known or each.between is not None or each.within is not None
        ]


@dataclass(frozen=True, eq=False)
class Fleet:
    """What runs of vehicles say of the classes of the vehicles."""

    classes: tuple[FleetClass, ...]

    HEADS = (
        "Coefficient",
        ">Class",
        ">± std",
        "Unit",
        ">Vehicles ±",
        ">Runs ±",
        ">A new one ±",
        ">Before ±",
        ">Known by runs/vehicles",
    )

    def __getitem__(self, name: str) -> FleetClass:
        names = [each.name for each in self.classes]
        if name not in names:
            raise InputError(f'class: found "{name}", expected one of {", ".join(names)}{nearest(name, names)}')
        return self.classes[names.index(name)]

    def write(self, path: str | os.PathLike[str], klass: str | None = None) -> None:
        """Write what is supposed of a new vehicle of a class as a vehicle file for `--prior`.

        Raises:
            InputError: several classes and none named, or no such class; the file cannot be written.
        """
        if klass is None and len(self.classes) > 1:
            names = [each.name for each in self.classes]
            raise InputError(f"{path}: found {len(names)} classes ({', '.join(names)}), expected one; name it")
        save_vehicle((self.classes[0] if klass is None else self[klass]).vehicle, path)

    def document(self) -> dict[str, Any]:
        """Return it as JSON has it."""
        return {"classes": {each.name: each.document() for each in self.classes}}


def _share(spread: float | None, each: Pooled) -> str:
    """Return a spread as a share of the size, or in its own unit where there is no size worth sharing."""
    if spread is None:
        return "-"
    return f"{short(100.0 * spread / each.size, 2)} %" if each.size > each.std else short(spread, 2)
