"""What is supposed of a vehicle before any data, as tables and as a document."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from towtank.app.terminal.output import Output
from towtank.digits import measured, short, signed_list
from towtank.identification.model.measurements import SPECIFIC_FORCE
from towtank.identification.model.parameters import GAIN_PREFIX, LATENCIES, PLACES
from towtank.identification.model.prior import prior_of
from towtank.identification.model.terms import AXES, Body
from towtank.intervals import interval
from towtank.vehicle import COEFFICIENTS, Vehicle, index
from towtank.vehicle.posterior import unit_of_unknown

__all__ = ["Supposed", "prior_document", "show_prior", "supposed_of"]

_INERTIA, _COUPLING, _DAMPING, _FORCE, _INPUT, _SENSOR = (
    "Total inertia, body and water together",
    "Couplings of added mass",
    "Damping and forward-speed terms",
    "Weight, righting moments, constant forces",
    "From command to thrust",
    "Sensors, where a log has them",
)
_PLAIN = {"constant": _FORCE, "weight": _FORCE, "moment": _FORCE, "inflow": _INPUT}
_IN_PERCENT = 0.2  # deviation of a logarithm, up to which a percentage says it


@dataclass(frozen=True)
class Supposed:
    """What is supposed of one unknown, in its own unit.

    Attributes:
        value, std, low, high: mean, deviation and 95 % interval. Of what is log-normal the mean is the middle, and the
            deviation is to first order. source: where that comes from. log_std: deviation of the logarithm, None where
            the unknown is normal.
        total: the rigid body's inertia, of which an added mass on the diagonal is taken to make the total.
    """

    name: str
    value: float
    std: float
    low: float
    high: float
    unit: str
    source: str
    log_std: float | None
    total: float | None = None


def supposed_of(vehicle: Vehicle) -> list[Supposed]:
    """Return what is supposed of every unknown of a vehicle driven by its thrusters, all sensors aboard."""
    late = [name for s, name in enumerate(LATENCIES) if s != SPECIFIC_FORCE]
    known = prior_of(vehicle, commands=bool(vehicle.thrusters), more=(*late, *PLACES))
    gains = {GAIN_PREFIX + thruster.name: thruster.gain for thruster in vehicle.thrusters}
    factors = np.array([gains.get(name, 1.0) for name in known.names])
    bounds = [interval(mean, std) or (mean, mean) for mean, std in zip(known.mean, known.std, strict=True)]
    ends = np.sort([factors * known.free.values(np.array(end)) for end in zip(*bounds, strict=True)], axis=0)
    logarithmic = known.free.slopes(known.mean) != known.free.slopes(known.mean + known.std)
    return [
        Supposed(
            name=name,
            value=float(factors[k] * known.values[k]),
            std=float(factors[k] * known.value_std[k]),
            low=float(ends[0, k]),
            high=float(ends[1, k]),
            unit=unit_of_unknown(name),
            source=known.sources[k],
            log_std=float(known.std[k]) if logarithmic[k] else None,
            total=float(known.free.rigid[k]) if _group(name) == _INERTIA else None,
        )
        for k, name in enumerate(known.names)
    ]


def show_prior(vehicle: Vehicle, supposed: list[Supposed], output: Output) -> None:
    """Print what sizes are computed from, a table for each kind of unknown, and where the numbers come from."""
    body = Body(vehicle)
    output.line(f"{vehicle.name}: what is supposed before any data", "bold")
    output.line(f"mass {short(body.m)} kg, as much water as a cube of {short(body.length, 3)} m")
    output.line(
        f"radii of gyration {signed_list(tuple(round(r, 3) for r in body.gyradii.tolist()))} m (roll, pitch, yaw)"
    )
    sources: dict[str, int] = {}
    for group in (_INERTIA, _COUPLING, _DAMPING, _FORCE, _INPUT, _SENSOR):
        members = [each for each in supposed if _group(each.name) == group]
        if not members:
            continue
        output.heading(group)
        table = output.table("Name", ">Mean", ">± std", ">95 % interval", "Unit", "From", wrap="Name")
        for each in members:
            number = sources.setdefault(each.source, len(sources) + 1)
            table.add_row(*_cells(each), each.unit, f"[{number}]")
        output.show(table)
    output.line()
    output.line(
        "Total inertias and gains are log-normal: their mean is the middle, and ± is the deviation of the "
        "logarithm, as a percentage or as a factor either way. All others are normal."
    )
    output.heading("Where the numbers come from")
    for source, number in sources.items():
        output.item(source, mark=f"[{number}]")


def _cells(each: Supposed) -> tuple[str, str, str, str]:
    """Return name, mean, deviation and interval as text; of an added mass on the diagonal those of the total."""
    if each.log_std is None:
        value, spread = measured(each.value, each.std)
        low, high = (measured(bound, each.std)[0] for bound in (each.low, each.high))
        return each.name, value, spread, f"{low} .. {high}"
    percent, factor = f"{100.0 * each.log_std:.2g} %", f"factor {math.exp(each.log_std):.3g}"
    name, numbers = each.name, (each.value, each.low, each.high)
    if each.total is not None:
        name = AXES[index(name)[1]].sum_name
        numbers = (each.total - each.value, each.total - each.high, each.total - each.low)
    middle, least, most = (short(number, 3) for number in numbers)
    return name, middle, percent if each.log_std <= _IN_PERCENT else factor, f"{least} .. {most}"


def _group(name: str) -> str:
    if name in COEFFICIENTS:
        kind, i, j = index(name)
        return (_INERTIA if i == j else _COUPLING) if kind == "mass" else _PLAIN.get(kind, _DAMPING)
    return _SENSOR if name in (*LATENCIES, *PLACES) else _INPUT


def prior_document(vehicle: Vehicle, supposed: list[Supposed]) -> dict[str, Any]:
    """Return the JSON document of what is supposed."""
    body = Body(vehicle)
    return {
        "vehicle": vehicle.name,
        "body": {"mass": body.m, "length": body.length, "gyradii": body.gyradii},
        "unknowns": {
            each.name: {
                "value": each.value,
                "std": each.std,
                "interval": [each.low, each.high],
                "unit": each.unit,
                "source": each.source,
                "log_normal": each.log_std is not None,
            }
            for each in supposed
        },
    }
