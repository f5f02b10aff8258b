"""The segment that makes most known: a search over segments, judged by forecasts for vehicles drawn from what is known.

The criterion is -log det of the covariance of the wanted coefficients' logarithms, so that no unit counts; it is the
mean over the draws. Room, tilt and speed are bounds that cost as much as they are broken. With the same seed and the
same number of tries the same segment comes out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError, nearest
from towtank.planning.forecast import Forecast, Outlook, draws_of, forecast
from towtank.planning.segments import LONGEST, SHORTEST, Segment, changed, commands_of, drawn_segment
from towtank.planning.space import Space
from towtank.vehicle import COEFFICIENTS, Vehicle, index
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = ["Design", "design", "diagonal", "excess", "judged", "require_possible"]

_DRAWS, _TRIES = 4, 60
_RANDOM = 0.4  # share of the tries that begin anew; the others change the best so far
_COST = 60.0  # of a metre, a radian or a metre per second beyond a bound, in the units of the criterion
_SPARE = 0.5  # of the room along the shortest side, that a pilot is left
_LOST = 1e6  # of a run that grows beyond all bounds


def excess(found: Forecast, space: Space | None, radius: float) -> float:
    """Return by how much a motion leaves its space, tilts and speeds too much, in m, rad, m/s and rad/s together."""
    if space is None:
        space = _OPEN
    short = space.margin - float(space.clearance(found.eta[:, :3], radius).min())
    tilt = float(np.arccos(np.clip(np.cos(found.eta[:, 3]) * np.cos(found.eta[:, 4]), -1.0, 1.0)).max()) - space.tilt
    speed = float(np.linalg.norm(found.nu[:, :3], axis=1).max()) - space.speed
    turn = float(np.abs(found.nu[:, 3:]).max()) - space.turn
    return sum(max(each, 0.0) for each in (short, tilt, speed, turn))


_OPEN = Space((1e4, 1e4, 1e4), margin=0.0)


@dataclass(frozen=True, eq=False)
class Design:
    """A segment, and what is expected of it.

    Attributes:
        segment: that was found. commands: (n, m) at the rate of forecasts.
        forecasts: for each draw, the mean vehicle first. score: the criterion less what broken bounds cost.
        inside: share of the draws that keep within the bounds. tries: that the search took.
    """

    segment: Segment
    commands: Array
    forecasts: tuple[Forecast, ...]
    score: float
    inside: float
    tries: int

    @property
    def extents(self) -> Array:
        """How far the draws go from the start (3,) at most [m]."""
        return np.asarray(
            np.max([np.abs(each.eta[:, :3] - each.eta[0, :3]).max(axis=0) for each in self.forecasts], axis=0)
        )


def diagonal(outlook: Outlook) -> tuple[str, ...]:
    """Return the diagonal coefficients that are unknown: added masses, and the damping that is larger at 0.3 m/s."""
    names = []
    for row, column in zip(ROWS, COLUMNS, strict=True):
        linear, quadratic = f"{row}_{column}", f"{row}_{column * 2}"
        sizes = [abs(outlook.vehicle.coefficient(linear)), 0.3 * abs(outlook.vehicle.coefficient(quadratic))]
        names += [f"{row}_{column}dot", linear if sizes[0] > sizes[1] else quadratic]
    return tuple(name for name in names if name in outlook.known.names)


def design(
    outlook: Outlook,
    wanted: Sequence[str],
    *,
    space: Space | None = None,
    duration: float = 8.0,
    rows: tuple[int, ...] | None = None,
    draws: int = _DRAWS,
    tries: int = _TRIES,
    seed: int = 0,
    by_hand: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Design:
    """Return the segment of this duration that makes most known of the wanted coefficients.

    Args:
        space: that it is driven in, from its start; None in open water. rows: of the wrench that may be driven;
            default: all that the vehicle has.
        draws: vehicles that it is judged by. tries: segments that are judged. by_hand: one that a pilot can drive.

    Raises:
        InputError: a name that is no unknown; a duration that is no segment's.
    """
    require_possible(outlook, wanted, duration)
    radius = 0.0 if space is None else space.require_room(outlook.vehicle)
    if space is not None and by_hand:
        space = _for_hands(space, radius)
    generator = np.random.default_rng(seed)
    vehicles = draws_of(outlook, draws, seed)
    best: Design | None = None
    first = tuple({index(name)[1] for name in wanted if name in COEFFICIENTS})
    for k in range(tries):
        if best is None or k < _RANDOM * tries:
            segment = drawn_segment(
                outlook.vehicle, generator, duration=duration, rows=rows, by_hand=by_hand, first=first
            )
        else:
            segment = changed(best.segment, generator, by_hand=by_hand)
        found = judged(
            outlook, wanted, segment, vehicles, space, radius, at_least=-np.inf if best is None else best.score
        )
        if found is not None and (best is None or found.score > best.score):
            best = found
        if progress is not None:
            progress((k + 1) / tries)
    if best is None:
        raise InputError(f"{outlook.vehicle.name}: no segment keeps its motion within bounds")
    return replace(best, tries=tries)


def _for_hands(space: Space, radius: float) -> Space:
    """Return the space with more to spare, since a pilot is late and does not hit the sticks exactly."""
    room = 0.5 * min(space.size) - radius - space.margin
    return replace(space, margin=space.margin + _SPARE * max(room, 0.0), start=tuple(space.eta0[:3].tolist()))


def require_possible(outlook: Outlook, wanted: Sequence[str], duration: float) -> None:
    """Raise InputError for a name that is no unknown, or a duration that is no segment's."""
    for name in wanted:
        if name not in outlook.known.names:
            known = [each for each in outlook.known.names if each in COEFFICIENTS]
            raise InputError(f'--want: "{name}" is no unknown of {outlook.vehicle.name}{nearest(name, known)}')
    if not SHORTEST <= duration <= LONGEST:
        raise InputError(f"found a segment of {duration:g} s, expected {SHORTEST:g} to {LONGEST:g} s")


def judged(
    outlook: Outlook,
    wanted: Sequence[str],
    segment: Segment,
    vehicles: Sequence[Vehicle],
    space: Space | None,
    radius: float,
    *,
    at_least: float = -np.inf,
) -> Design | None:
    """Return what is expected of a segment; None as soon as it cannot come to `at_least`.

    The mean vehicle is asked first: no draw is asked of a segment that is far behind for it.
    """
    commands = commands_of(segment, outlook.vehicle)
    forecasts, scores, inside = [], [], 0
    for k, vehicle in enumerate(vehicles):
        try:
            found = forecast(outlook, vehicle, commands, start=None if space is None else space.eta0)
        except InputError:  # the draw's motion grows beyond all bounds
            scores.append(-_LOST)
            continue
        beyond = excess(found, space, radius)
        inside += beyond == 0.0
        forecasts.append(found)
        scores.append(found.information(wanted) - _COST * beyond)
        if k == 0 and scores[0] < at_least - _COST:
            return None
    if not forecasts:
        return None
    return Design(segment, commands, tuple(forecasts), float(np.mean(scores)), inside / len(vehicles), 1)
