"""A plan: segments that follow each other until all that is wanted is known well enough, or what keeps that from being.

Each segment is designed from what the ones before it leave known. Between segments the vehicle is brought back, which
tells little and is not counted. Written as TOML, which a person can read and change.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.outputs import write_text
from towtank.planning.design import Design, design, diagonal, excess, require_possible
from towtank.planning.forecast import RATE, Forecast, Outlook, draws_of, forecast
from towtank.planning.segments import FORMS, Segment, commands_of
from towtank.planning.space import Space
from towtank.simulation import OrnsteinUhlenbeck, available_rows, simulate
from towtank.vehicle import COEFFICIENTS, Vehicle, index
from towtank.vehicle.names import ROWS

__all__ = ["PAUSE", "Accuracy", "Plan", "Planned", "aims", "plan", "read_plan", "write_plan"]

PAUSE = 6.0  # s between two segments, in which the vehicle is brought back
_BAND = (5.0, 95.0)  # percentiles over the draws
_DRAWS, _RUNS = 8, 100  # vehicles of the band; runs of the probability of leaving
_LONGEST = 600.0  # s, of a segment that a person wrote
_ENOUGH = 0.02  # by which a segment must lessen what is missing, in logarithms, as a share of it, to be worth driving
_TITLE = "written by towtank plan; towtank simulate VEHICLE plan.toml drives it in simulation"
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Accuracy:
    """What is expected of a coefficient at the end, as shares of its size (of an added mass: of the total inertia).

    Attributes:
        before, after: deviations of the mean vehicle. low, high: of nine in ten vehicles that it may be.
        reason: why it cannot be had, empty where it can.
    """

    name: str
    before: float
    after: float
    low: float
    high: float
    reason: str = ""


@dataclass(frozen=True)
class Planned:
    """A segment of a plan: `reached` (3,) [m] off its start at most, and the probability that it leaves the space."""

    segment: Segment
    reached: tuple[float, float, float]
    leaves: float


@dataclass(frozen=True)
class Plan:
    """What to drive.

    Attributes:
        vehicle: its name. sensors: names of `INSTRUMENTS`. space: None in open water. accuracy: asked, a share.
        segments: in their order. expected: for each coefficient that is wanted. by_hand: a pilot can drive it.
    """

    vehicle: str
    sensors: str
    space: Space | None
    accuracy: float
    segments: tuple[Planned, ...]
    expected: tuple[Accuracy, ...]
    by_hand: bool = False

    @property
    def manoeuvring(self) -> float:
        """Time in segments [s]."""
        return sum(each.segment.duration for each in self.segments)

    @property
    def met(self) -> bool:
        """Whether all that is wanted will be known well enough, for the mean vehicle."""
        return all(each.after <= self.accuracy for each in self.expected)

    def commands(self, vehicle: Vehicle) -> Array:
        """Return the commands (n, m) of all segments at `RATE`, at rest in the pauses between."""
        rest = np.tile([each.curve.rest for each in vehicle.thrusters], (round(PAUSE * RATE), 1))
        parts = [part for each in self.segments for part in (commands_of(each.segment, vehicle), rest)]
        return np.vstack(parts[:-1])


def plan(
    vehicle: Vehicle,
    *,
    space: Space | None = None,
    sensors: str = "pose",
    accuracy: float = 0.05,
    want: Sequence[str] = (),
    minutes: float = 3.0,
    force: float | None = None,
    duration: float = 8.0,
    tries: int = 40,
    draws: int = 3,
    seed: int = 0,
    by_hand: bool = False,
    progress: Progress | None = None,
) -> Plan:
    """Return what to drive, until the wanted coefficients are known to `accuracy` or `minutes` are over.

    Args:
        want: coefficients; default: the twelve on the diagonal, as far as the vehicle has them.
        minutes: of manoeuvring, pauses left out. force: random force in the water [N]; default: the usual one.
        duration: of a segment [s]. tries, draws: of each segment's search. seed: of the search.
        by_hand: segments that a pilot can drive: two axes at a time, and not too quick.

    Raises:
        InputError: a vehicle that has no room or no thrusters, sensors or names that there are not.
    """
    outlook = Outlook.of(vehicle, sensors, force=force)
    wanted = tuple(want) or diagonal(outlook)
    require_possible(outlook, wanted, duration)
    radius = 0.0 if space is None else space.require_room(vehicle)
    most = max(1, int(60.0 * minutes / duration))
    found: list[Design] = []
    middle, now = draws_of(outlook, 1)[0], outlook
    before = _relative(outlook, middle, wanted)
    missing, unmet = math.inf, aims(vehicle, wanted)
    for k in range(most):
        if progress is not None:
            progress(f"segment {k + 1}", k / most)
        best = design(
            now, unmet, space=space, duration=duration, tries=tries, draws=draws, seed=seed + k, by_hand=by_hand
        )
        now = now.after(best.forecasts[0].covariance)
        relative = best.forecasts[0].relative(wanted)
        found.append(best)
        left = float(np.log(np.maximum(relative / accuracy, 1.0)).sum())
        if left == 0.0 or left > (1.0 - _ENOUGH) * missing:
            break
        missing, unmet = left, aims(vehicle, tuple(np.array(wanted)[relative > accuracy].tolist()))
    if progress is not None:
        progress("what it will make known", 0.95)
    ends = [_after(outlook, each, found, space) for each in draws_of(outlook, _DRAWS, seed + 1)]
    band = np.array([each.relative(wanted) for each in ends])
    low, high = np.percentile(band, _BAND, axis=0)
    seconds = duration * len(found)
    expected = tuple(
        Accuracy(
            name,
            float(before[k]),
            float(band[0, k]),
            float(low[k]),
            float(high[k]),
            _reason(vehicle, name, before[k], band[0, k], accuracy, seconds),
        )
        for k, name in enumerate(wanted)
    )
    radius = 0.0 if space is None else space.require_room(vehicle)
    segments = tuple(
        Planned(each.segment, _three(each.extents), _leaving(outlook, each.segment, space, radius, seed))
        for each in found
    )
    return Plan(vehicle.name, sensors, space, accuracy, segments, expected, by_hand)


def aims(vehicle: Vehicle, unmet: tuple[str, ...]) -> tuple[str, ...]:
    """Return the coefficients that the next segment is for: those on axes that thrusters drive, if there are any left.

    The others are shown only by chance, as where a drawn vehicle tilts by itself.
    """
    able = available_rows(vehicle)
    return tuple(name for name in unmet if name not in COEFFICIENTS or index(name)[1] in able) or unmet


def _three(values: Array) -> tuple[float, float, float]:
    x, y, z = (float(each) for each in values)
    return x, y, z


def _relative(outlook: Outlook, middle: Vehicle, wanted: Sequence[str]) -> Array:
    """Return the deviations before any run, as shares."""
    rest = np.tile([each.curve.rest for each in outlook.vehicle.thrusters], (2, 1))
    nothing = forecast(outlook, middle, rest)
    return Forecast(
        nothing.t, nothing.eta, nothing.nu, nothing.names, nothing.theta, outlook.known.covariance, nothing.quantities
    ).relative(wanted)


def _after(outlook: Outlook, truth: Vehicle, found: Sequence[Design], space: Space | None) -> Forecast:
    """Return what all segments make known of one drawn vehicle."""
    start = None if space is None else space.eta0
    for each in found:
        last = forecast(outlook, truth, each.commands, start=start)
        outlook = outlook.after(last.covariance)
    return last


def _reason(vehicle: Vehicle, name: str, before: float, after: float, accuracy: float, seconds: float) -> str:
    """Return why a coefficient is not known well enough at the end; empty where it is."""
    if after <= accuracy:
        return ""
    row = ROWS.index(name[0])
    if row not in available_rows(vehicle) and after > 0.5 * before:
        return "no thruster moves the vehicle along this axis"
    if after > 0.8 * before:
        return "these sensors and thrusters hardly show it"
    return f"would take about {seconds * (after / accuracy) ** 2:.0f} s of manoeuvring"


def _leaving(outlook: Outlook, segment: Segment, space: Space | None, radius: float, seed: int) -> float:
    """Return the probability that a segment leaves the space: vehicle and force drawn at random, nobody steering."""
    if space is None:
        return 0.0
    commands, left = commands_of(segment, outlook.vehicle), 0
    inertia = np.diag(outlook.vehicle.mass_matrix)
    levels = tuple((np.array(outlook.disturbance) * inertia).tolist())
    push = OrnsteinUhlenbeck(std=levels, time_constant=outlook.correlation)
    walls = Space(space.size, margin=0.0, start=space.start, tilt=math.pi - 1e-9, speed=1e3, turn=1e3)
    for k, truth in enumerate(draws_of(outlook, _RUNS, seed + 2)):
        try:
            run = simulate(
                truth, commands=commands, dt=1.0 / RATE, substeps=2, eta0=space.eta0, disturbance=push, seed=seed + k
            )
        except InputError:
            left += 1
            continue
        eta = np.column_stack([run[name].values for name in ("x", "y", "z", "phi", "theta", "psi")])
        still = Forecast(run["x"].t, eta, np.zeros_like(eta), (), np.zeros(0), np.zeros((0, 0)))
        left += excess(still, walls, radius) > 0.0
    return left / _RUNS


# -- files


def write_plan(found: Plan, place: str | os.PathLike[str]) -> None:
    """Write a plan as TOML, whole or not at all."""
    document = tomlkit.document()
    document.add(tomlkit.comment(_TITLE))
    document.update({"vehicle": found.vehicle, "sensors": found.sensors, "accuracy": found.accuracy})
    document["by_hand"] = found.by_hand
    if found.space is not None:
        document["space"] = {"size": list(found.space.size), "margin": found.space.margin}
        if found.space.start is not None:
            document["space"]["start"] = list(found.space.start)
    segments = tomlkit.aot()
    for each in found.segments:
        table = tomlkit.table()
        table.update(
            {
                "form": each.segment.form,
                "duration": each.segment.duration,
                "axes": [ROWS[row] for row in each.segment.rows],
                "amplitude": list(each.segment.amplitude),
                "switches": [list(row) for row in each.segment.switches],
                "signs": [list(row) for row in each.segment.signs],
                "reached": list(each.reached),
                "leaves": each.leaves,
            }
        )
        segments.append(table)
    document["segments"] = segments
    document["expected"] = {
        each.name: {
            "before": each.before,
            "after": each.after,
            "low": each.low,
            "high": each.high,
            "reason": each.reason,
        }
        for each in found.expected
    }
    write_text(Path(place), tomlkit.dumps(document))


def read_plan(place: str | os.PathLike[str]) -> Plan:
    """Return a plan of a TOML file.

    Raises:
        InputError: no such file, not TOML, or no plan.
    """
    path = Path(place)
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid TOML ({error})") from None
    try:
        return _plan_of(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise InputError(
            f"{path}: this is no plan ({type(error).__name__}: {error}), expected what towtank plan writes"
        ) from None


def _plan_of(data: dict[str, Any]) -> Plan:
    box = data.get("space")
    space = None
    if box is not None:
        start = _three(np.array(_floats(box["start"]))) if "start" in box else None
        space = Space(_three(np.array(_floats(box["size"]))), margin=float(box["margin"]), start=start)
    segments = [_planned(each) for each in data["segments"]]
    if not segments:
        raise InputError("found no segments, expected one at least")
    expected = [
        Accuracy(
            name,
            float(each["before"]),
            float(each["after"]),
            float(each["low"]),
            float(each["high"]),
            str(each["reason"]),
        )
        for name, each in data["expected"].items()
    ]
    return Plan(
        str(data["vehicle"]),
        str(data["sensors"]),
        space,
        float(data["accuracy"]),
        tuple(segments),
        tuple(expected),
        data.get("by_hand") is True,
    )


def _planned(data: dict[str, Any]) -> Planned:
    rows = tuple(ROWS.index(axis) for axis in data["axes"])
    switches, signs = (tuple(_floats(row) for row in data[key]) for key in ("switches", "signs"))
    amplitude, duration = _floats(data["amplitude"]), float(data["duration"])
    if data["form"] not in FORMS or len({len(rows), len(amplitude), len(switches), len(signs)}) > 1 or not rows:
        raise InputError(
            f'segments: found the form "{data["form"]}" with {len(rows)} axes, expected {", ".join(FORMS)} and a row of'
            " amplitude, switches and signs for each axis"
        )
    if not 0.0 < duration <= _LONGEST or any(not row for row in (*switches, *signs)):
        raise InputError(
            f"segments: found a duration of {duration:g} s or an empty row, expected one up to {_LONGEST:g}"
        )
    segment = Segment(data["form"], duration, rows, amplitude, switches, signs)
    return Planned(segment, _three(np.array(_floats(data["reached"]))), float(data["leaves"]))


def _floats(values: Any) -> tuple[float, ...]:
    numbers = tuple(float(each) for each in values)
    if not all(math.isfinite(each) for each in numbers):
        raise InputError("found a number that is not finite")
    return numbers
