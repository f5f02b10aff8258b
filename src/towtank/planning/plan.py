"""A plan: segments that follow each other until all that is wanted is known well enough, or what keeps that from being.

Each segment is designed from what the ones before it leave known. Between segments the vehicle is brought back, which
tells little and is not counted. Written as TOML, which a person can read and change.
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.outputs import write_text
from towtank.planning.design import Design, design, diagonal, judged, require_possible
from towtank.planning.forecast import INSTRUMENTS, RATE, Forecast, Outlook, draws_of, forecast
from towtank.planning.segments import FORMS, SHORTEST, Segment, commands_of
from towtank.planning.space import Space
from towtank.planning.unsteered import unsteered
from towtank.recording import Recording
from towtank.recording.standard import COMMAND_PREFIX, POSE, VELOCITIES, WRENCH
from towtank.simulation import available_rows
from towtank.vehicle import COEFFICIENTS, Vehicle, index, thruster_wrench
from towtank.vehicle.names import ROWS
from towtank.vehicle.posterior import GAIN_PREFIX

__all__ = ["PAUSE", "Accuracy", "Plan", "Planned", "aims", "forecasts", "gentle", "plan", "read_plan", "write_plan"]

PAUSE = 6.0  # s between two segments, in which the vehicle is brought back
_PAUSE_UNSEEN = 15.0  # s that it takes by eye, where no pose is measured
_GENTLE, _GENTLER, _TIMES = 0.15, 0.8, 5  # leaves at most, where nobody sees it; else driven so much less, so often
_AHEAD, _HURRIED, _HURRY = 24, 6, 6  # segments that are looked ahead, how many are searched for, with so many tries
_NARROWED = 0.5  # of what is supposed: the data tell something
_FEW = 60  # vehicles by which a segment is found gentle enough
_BAND = (5.0, 95.0)  # percentiles over the draws
_DRAWS = 8  # vehicles of the band
_WORDS = ("surge", "sway", "heave", "roll", "pitch", "yaw")
_PUSHES = (
    *("along x", "along y", "along z", "along y or z, off the x axis", "along x or z, off the y axis"),
    "along x or y, off the z axis",
)
_LONGEST = 600.0  # s, of a segment that a person wrote, and of manoeuvring that is foreseen
_ENOUGH = 0.02  # by which a segment must lessen what is missing, in logarithms, as a share of it, to be worth driving
_TITLE = "written by towtank plan; towtank simulate VEHICLE plan.toml drives it in simulation"
Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class Accuracy:
    """What is expected of a coefficient at the end, as shares of its size (of an added mass: of the total inertia).

    Attributes:
        before, after: deviations of the mean vehicle. low, high: of nine in ten vehicles that it may be.
        reason: why it cannot be had, empty where it can.
        needs: manoeuvring that it would take [s], as the information grew; infinite where more time is no help.
    """

    name: str
    before: float
    after: float
    low: float
    high: float
    reason: str = ""
    needs: float = 0.0


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
        pose: whether it is known where the vehicle is while it is driven. pause: between segments [s].
        leaves: the probability that one segment or another ends at a wall, if nobody steers.
        room: length, width, depth (3,) [m] of the least tank, begun in its middle, in which 95 % of such runs keep off
            the walls; None in open water.
    """

    vehicle: str
    sensors: str
    space: Space | None
    accuracy: float
    segments: tuple[Planned, ...]
    expected: tuple[Accuracy, ...]
    by_hand: bool = False
    pose: bool = True
    pause: float = PAUSE
    leaves: float = 0.0
    room: tuple[float, float, float] | None = None

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
        rest = np.tile([each.curve.rest for each in vehicle.thrusters], (round(self.pause * RATE), 1))
        parts = [part for each in self.segments for part in (commands_of(each.segment, vehicle), rest)]
        return np.vstack(parts[:-1])

    def sequence(self, vehicle: Vehicle) -> Recording:
        """Return the commands as a recording, at `RATE`, with the wrench that they make: what a program can play."""
        commands = self.commands(vehicle)
        columns = {f"{COMMAND_PREFIX}{each.name}": row for each, row in zip(vehicle.thrusters, commands.T, strict=True)}
        columns |= dict(zip(WRENCH, thruster_wrench(vehicle, commands).T, strict=True))
        return Recording.from_table(np.arange(len(commands)) / RATE, columns, source=f"plan for {vehicle.name}")


def plan(
    vehicle: Vehicle,
    *,
    space: Space | None = None,
    sensors: str = "pose",
    accuracy: float = 0.05,
    want: Sequence[str] = (),
    minutes: float = 3.0,
    force: float | None = None,
    duration: float | None = None,
    tries: int = 40,
    draws: int = 3,
    seed: int = 0,
    by_hand: bool = False,
    pose: bool = True,
    progress: Progress | None = None,
) -> Plan:
    """Return what to drive, until the wanted coefficients are known to `accuracy` or `minutes` are over.

    Args:
        want: coefficients; default: the twelve on the diagonal, as far as the vehicle has them.
        minutes: of manoeuvring, pauses left out. force: random force in the water [N]; default: the usual one.
        duration: of a segment [s], 8 by default. tries, draws: of each segment's search. seed: of the search.
        by_hand: segments that a pilot can drive: two axes at a time, and not too quick.
        pose: False: nobody knows where the vehicle is while it is driven: segments of 6 s, gentle enough that few of
            the vehicles that it may be leave the space, and longer pauses to bring it back.

    Raises:
        InputError: a vehicle that has no room or no thrusters, sensors or names that there are not, or nothing of what
            is wanted can be had.
    """
    outlook = Outlook.of(vehicle, sensors, force=force)
    wanted = tuple(want) or diagonal(outlook)
    duration = (8.0 if pose else SHORTEST) if duration is None else duration
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
        if space is not None and not pose:
            soft = gentle(outlook, best.segment, space)
            best = judged(now, unmet, soft, draws_of(now, draws, seed + k), space, radius) or best
        now = now.after(best.forecasts[0].covariance)
        relative = best.forecasts[0].relative(wanted)
        found.append(best)
        left = float(np.log(np.maximum(relative / accuracy, 1.0)).sum())
        if left == 0.0 or left > (1.0 - _ENOUGH) * missing:
            break
        missing, unmet = left, aims(vehicle, tuple(np.array(wanted)[relative > accuracy].tolist()))
    if progress is not None:
        progress("what it will make known", 0.95)
    driven = [each.segment for each in found]
    ends = [forecasts(outlook, each, driven, space)[-1] for each in draws_of(outlook, _DRAWS, seed + 1)]
    band = np.array([each.relative(wanted) for each in ends])
    low, high = np.percentile(band, _BAND, axis=0)
    expected = [
        Accuracy(name, float(before[k]), float(band[0, k]), float(low[k]), float(high[k]))
        for k, name in enumerate(wanted)
    ]
    if any(each.after > accuracy for each in expected):
        more = _more(outlook, ends[0], driven, space, wanted, accuracy)
        expected = [_reasoned(outlook, each, accuracy, more[each.name]) for each in expected]
    _require_some(vehicle, expected)
    alone = None if space is None else unsteered(outlook, driven, space, seed=seed + 2)
    leaves = [0.0] * len(found) if alone is None else alone.leaves
    segments = tuple(
        Planned(each.segment, _three(each.extents), share) for each, share in zip(found, leaves, strict=True)
    )
    return Plan(
        vehicle.name,
        sensors,
        space,
        accuracy,
        segments,
        tuple(expected),
        by_hand,
        pose,
        PAUSE if pose else _PAUSE_UNSEEN,
        0.0 if alone is None else alone.whole,
        None if alone is None else alone.room(),
    )


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


def forecasts(
    outlook: Outlook, truth: Vehicle, segments: Sequence[Segment], space: Space | None
) -> tuple[Forecast, ...]:
    """Return what is known of a drawn vehicle after each of the segments."""
    out = []
    start = None if space is None else space.eta0
    for each in segments:
        out.append(forecast(outlook, truth, commands_of(each, outlook.vehicle), start=start))
        outlook = outlook.after(out[-1].covariance)
    return tuple(out)


def gentle(outlook: Outlook, segment: Segment, space: Space) -> Segment:
    """Return a segment with so much less force that few of the vehicles that it may be leave the space."""
    for _ in range(_TIMES):
        if unsteered(outlook, [segment], space, vehicles=_FEW, forces=1).whole <= _GENTLE:
            break
        segment = replace(segment, amplitude=tuple(_GENTLER * each for each in segment.amplitude))
    return segment


def _hidden(outlook: Outlook, name: str) -> str:
    """Return why nothing shows a coefficient: no thruster drives its axis, no sensor sees it; empty where one may."""
    if name not in COEFFICIENTS:
        return ""
    row = index(name)[1]
    if row not in available_rows(outlook.vehicle):
        return f"no thruster moves the vehicle in {_WORDS[row]}; one that pushes {_PUSHES[row]} would"
    if not {POSE[row], VELOCITIES[row]} & outlook.instruments.channels.keys():
        able = [each.name for each in INSTRUMENTS.values() if {POSE[row], VELOCITIES[row]} & each.channels.keys()]
        return f"{outlook.instruments.summary} do not measure {_WORDS[row]}; {' or '.join(able)} would"
    return ""


def _require_some(vehicle: Vehicle, expected: Sequence[Accuracy]) -> None:
    """Raise InputError where nothing of what is wanted would be narrowed to half of what is supposed."""
    if any(not each.reason or each.after <= _NARROWED * each.before for each in expected):
        return
    first, others = expected[0], ", ".join(each.name for each in expected[1:])
    also = f"; nor can {others}" if others else ""
    raise InputError(f"{vehicle.name}: {first.name} cannot be had: {first.reason}{also}")


class _More(NamedTuple):
    """What driving on would tell.

    Attributes:
        needs: manoeuvring until it is enough [s]. floor: the deviation in the end, a share of the size.
        by_force: how much of the deviation would be left if the thrusters' force were known, a share of it.
    """

    needs: float
    floor: float
    by_force: float


def _more(
    outlook: Outlook,
    last: Forecast,
    driven: Sequence[Segment],
    space: Space | None,
    wanted: tuple[str, ...],
    accuracy: float,
) -> dict[str, _More]:
    """Return what driving on would tell of each coefficient: some segments found in a hurry, then all again and again.

    Variances fall as floor + c / t: what no run of the vehicle tells, such as the scale of force, stays.
    """
    truth, segments = draws_of(outlook, 1)[0], list(driven)
    variance, times = [last.relative(wanted) ** 2], [sum(each.duration for each in driven)]
    for k in range(_AHEAD):
        unmet = tuple(name for name, each in zip(wanted, variance[-1], strict=True) if each > accuracy**2)
        if not unmet:
            break
        outlook = outlook.after(last.covariance)
        if k < _HURRIED:
            goal, duration = aims(outlook.vehicle, unmet), driven[0].duration
            hurried = design(outlook, goal, space=space, duration=duration, tries=_HURRY, draws=1, seed=k)
            segments.append(hurried.segment)
        following = segments[(len(driven) + k) % len(segments)]
        [last] = forecasts(outlook, truth, [following], space)
        variance.append(last.relative(wanted) ** 2)
        times.append(times[-1] + following.duration)
    v, t, half = np.array(variance), np.array(times), len(times) // 2
    falls = (v[half] - v[-1]) / (1.0 / t[half] - 1.0 / t[-1]) if half < len(t) - 1 else np.zeros(len(wanted))
    floor = np.maximum(v[-1] - falls / t[-1], 0.0)
    by_force = _without_gains(last, wanted)
    out = {}
    for k, name in enumerate(wanted):
        enough = np.flatnonzero(v[:, k] <= accuracy**2)
        if enough.size:
            needs = float(t[enough[0]])
        else:
            needs = float(falls[k] / (accuracy**2 - floor[k])) if accuracy**2 > floor[k] else math.inf
        out[name] = _More(needs, float(np.sqrt(floor[k])), float(by_force[k]))
    return out


def _without_gains(last: Forecast, wanted: tuple[str, ...]) -> Array:
    """Return the deviations that would be left if all gains of thrusters were known, as shares of what they are."""
    gains = [k for k, name in enumerate(last.names) if name.startswith(GAIN_PREFIX)]
    rows, c = [last.names.index(name) for name in wanted], last.covariance
    shared = c[np.ix_(gains, rows)]
    told = np.einsum("gk,gk->k", shared, np.linalg.solve(c[np.ix_(gains, gains)], shared))
    return np.asarray(np.sqrt(np.maximum(1.0 - told / np.diag(c)[rows], 0.0)))


def _reasoned(outlook: Outlook, known: Accuracy, accuracy: float, more: _More) -> Accuracy:
    """Return what is expected with why it is not known well enough at the end; nothing where it is."""
    if known.after <= accuracy:
        return known
    hidden = _hidden(outlook, known.name)
    if known.after > _NARROWED * known.before and hidden:
        return replace(known, reason=hidden, needs=math.inf)
    if known.after > 0.8 * known.before:
        return replace(known, reason="these sensors and thrusters hardly show it", needs=math.inf)
    if more.needs <= _LONGEST:
        return replace(known, reason=f"would take about {more.needs:.0f} s of manoeuvring", needs=more.needs)
    if more.by_force < _NARROWED:
        reason = f"no better than {100.0 * more.floor:.1f} % in any time: the thrusters' force is known no better"
        return replace(known, reason=reason, needs=math.inf)
    return replace(known, reason=f"would take more than {_LONGEST:g} s of manoeuvring", needs=more.needs)


# -- files


def write_plan(found: Plan, place: str | os.PathLike[str]) -> None:
    """Write a plan as TOML, whole or not at all."""
    document = tomlkit.document()
    document.add(tomlkit.comment(_TITLE))
    document.update({"vehicle": found.vehicle, "sensors": found.sensors, "accuracy": found.accuracy})
    document.update({"by_hand": found.by_hand, "pose": found.pose, "pause": found.pause, "leaves": found.leaves})
    if found.room is not None:
        document["room"] = list(found.room)
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
        each.name: {key: value for key, value in asdict(each).items() if key != "name"} for each in found.expected
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
            float(each.get("needs", 0.0)),
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
        data.get("pose") is not False,
        _pause(data.get("pause", PAUSE)),
        float(data.get("leaves", 0.0)),
        _three(np.array(_floats(data["room"]))) if "room" in data else None,
    )


def _pause(value: float) -> float:
    """Return a pause [s]. Raises InputError."""
    if not 0.0 <= float(value) <= _LONGEST:
        raise InputError(f"pause: found {value}, expected 0 to {_LONGEST:g} s")
    return float(value)


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
