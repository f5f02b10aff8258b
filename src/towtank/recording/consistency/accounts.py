"""Two accounts of the same motion in cells of time: speeds as measured, and as the way from pose to pose says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.recording.consistency.tracks import (
    Attitude,
    Track,
    attitude_track,
    halfway,
    held_track,
    pose_track,
    speed_track,
    turned_between,
)
from towtank.recording.frames.rotations import conjugate, rotate
from towtank.recording.recording import Recording
from towtank.recording.standard import LINEAR_VELOCITY, POSITION, RATES, WRENCH

__all__ = [
    "ATTITUDE",
    "LEAST_STRETCHES",
    "Cells",
    "Pair",
    "of_depth",
    "of_heading",
    "of_rates",
    "of_velocity",
    "of_wrench",
]

LEAST_STRETCHES = 6
ATTITUDE = "the attitude"  # where an account of rates comes from, if not from the heading alone
_CELL = 0.05  # s, at least
_PER_STEP = 4  # cells in the step of the slowest channel, at most
_WINDOW = (9, 6.0)  # cells, and steps of the slowest channel: width of the smoothing, at least
_LAG = 0.5  # s
_CORE, _STRETCHES, _PARTS = (60, 600), 32, 12  # cells of a stretch; stretches at most; of a short recording
_JUMP = 4.0  # times the 95 % quantile, at most, of a derived speed: markers that come and go
_MOVES = (0.01, 0.01)  # m/s, rad/s: less is no motion to judge by
_DRIVEN, _LENGTH = 0.05, 0.3  # of the largest component of a wrench that the commands make; m that makes N m of N


class Cells(NamedTuple):
    """Edges (s, n + 1) [s] of the cells of s stretches spread over a recording; each has a margin on both sides.

    Attributes:
        dt: of a cell [s]. lags: cells that one side may be late. core: cells without the margins.
        window: weights (k,) of the smoothing, k odd. step: of the slowest channel [s].
    """

    edges: Array
    dt: float
    step: float
    lags: int
    core: int
    window: Array

    @property
    def middle(self) -> Array:
        """Times (s,) of the stretches."""
        return np.asarray(self.edges.mean(axis=1))

    def smooth(self, x: Array) -> Array:
        """Return x (s, n, k) through the window, without the ends."""
        n = x.shape[1] - self.window.size + 1
        return np.asarray(sum(weight * x[:, i : i + n] for i, weight in enumerate(self.window)))


def _cells(tracks: Sequence[Track]) -> Cells | None:
    """Return cells that all tracks fill; None where they have too little time in common."""
    start, end = max(float(track.t[0]) for track in tracks), min(float(track.t[-1]) for track in tracks)
    step = max(track.step for track in tracks)
    dt = max(_CELL, step / _PER_STEP)
    total = int((end - start) / dt) if end > start else 0
    core = min(max(total // _PARTS, _CORE[0]), _CORE[1])
    stretches = min(_STRETCHES, total // core)
    half = max(_WINDOW[0], round(_WINDOW[1] * step / dt)) // 2
    window = np.hanning(2 * half + 3)[1:-1]
    if stretches < LEAST_STRETCHES or core < 2 * window.size:
        return None
    lags = max(2, round(_LAG / dt))
    margin = lags + half
    first = np.linspace(start, end - core * dt, stretches) - margin * dt
    edges = first[:, None] + dt * np.arange(core + 2 * margin + 1)
    return Cells(edges, dt, step, lags, core, window / window.sum())


@dataclass(frozen=True, eq=False)
class Pair:
    """Two accounts of the same: measured (s, n, k) and derived, over cells.

    Attributes:
        names: of the measured columns (k,). source: where the other account comes from.
        floor: of the derived speed, for it to be motion (k,). others: further derivations, by what is then wrong.
        own_clock: the two have stamps of their own. level: the first two columns lie in one plane that may be turned.
    """

    names: tuple[str, ...]
    source: str
    measured: Array
    derived: Array
    cells: Cells
    floor: Array
    others: dict[str, Array]
    own_clock: bool
    level: bool = False


def of_velocity(recording: Recording) -> Pair | None:
    """Return `u v w` beside the derivative of the position; `u v`, of what floats level, where the heading is known."""
    attitude, heading = attitude_track(recording), pose_track(recording, "psi")
    axes = 2 if attitude is None else 3
    attitude = Attitude((heading,)) if attitude is None and heading is not None else attitude
    place = [pose_track(recording, name) for name in POSITION[:axes]]
    speed = {name: speed_track(recording, name) for name in LINEAR_VELOCITY[:axes]}
    known = [track for track in speed.values() if track is not None]
    where = [track for track in place if track is not None]
    if attitude is None or not known or len(where) < axes:
        return None
    cells = _cells([*where, *known, *attitude.tracks])
    if cells is None:
        return None
    world = np.zeros((*cells.edges[:, 1:].shape, 3))
    world[..., :axes] = _without_jumps(_means(where, cells))
    body = rotate(conjugate(halfway(attitude.at(cells.edges))), world)
    columns = [j for j, track in enumerate(speed.values()) if track is not None]
    others = {}
    if len(columns) == axes:
        turned = world[..., [1, 0, 2]] * np.array([1.0, 1.0, -1.0])
        others["in the world's frame (north, east, down)"] = world[..., :axes]
        others["in the world's frame (east, north, up)"] = turned[..., :axes]
    return Pair(
        tuple(LINEAR_VELOCITY[j] for j in columns),
        "the position",
        _means(known, cells),
        body[..., columns],
        cells,
        np.full(len(columns), _MOVES[0]),
        others,
        not np.array_equal(known[0].t, where[0].t),
        level=columns[:2] == [0, 1],
    )


def of_depth(recording: Recording) -> Pair | None:
    """Return the vertical part of `u v w` beside the derivative of the depth, where there is no other position."""
    if any(name in recording for name in POSITION[:2]):
        return None
    attitude, depth = attitude_track(recording), pose_track(recording, "z")
    speed = [track for track in (speed_track(recording, name) for name in LINEAR_VELOCITY) if track is not None]
    if attitude is None or depth is None or len(speed) < 3:
        return None
    cells = _cells([depth, *speed, *attitude.tracks])
    if cells is None:
        return None
    down = rotate(halfway(attitude.at(cells.edges)), _means(speed, cells))[..., 2:]
    own = not np.array_equal(speed[0].t, depth.t)
    name = ("the vertical part of u v w",)
    return Pair(name, "the depth", down, _means([depth], cells), cells, np.array(_MOVES[:1]), {}, own)


def of_rates(recording: Recording) -> Pair | None:
    """Return `p q r` beside the derivative of the attitude."""
    attitude = attitude_track(recording)
    rates = {name: speed_track(recording, name) for name in RATES}
    known = [track for track in rates.values() if track is not None]
    if attitude is None or not known:
        return None
    cells = _cells([*known, *attitude.tracks])
    if cells is None:
        return None
    body = turned_between(attitude.at(cells.edges)) / cells.dt
    columns = [j for j, track in enumerate(rates.values()) if track is not None]
    names = tuple(RATES[j] for j in columns)
    own = not np.array_equal(known[0].t, attitude.tracks[0].t)
    derived = _without_jumps(body[..., columns])
    return Pair(names, ATTITUDE, _means(known, cells), derived, cells, np.full(len(names), _MOVES[1]), {}, own)


def of_heading(recording: Recording) -> Pair | None:
    """Return `r` beside the derivative of the heading, where roll and pitch are not known."""
    heading, rate = pose_track(recording, "psi"), speed_track(recording, "r")
    if heading is None or rate is None or attitude_track(recording) is not None:
        return None
    cells = _cells([heading, rate])
    if cells is None:
        return None
    derived = _without_jumps(_means([heading], cells))
    own = not np.array_equal(heading.t, rate.t)
    return Pair(("r",), "the heading", _means([rate], cells), derived, cells, np.array(_MOVES[1:]), {}, own)


def of_wrench(recording: Recording, t: Array, wrench: Array) -> Pair | None:
    """Return the recorded wrench beside that of the commands."""
    recorded = {name: held_track(recording[name].t, recording[name].values) for name in WRENCH if name in recording}
    columns = [j for j, name in enumerate(WRENCH) if recorded.get(name) is not None]
    made = [held_track(t, wrench[:, j]) for j in columns]
    known, other = [each for each in recorded.values() if each is not None], [each for each in made if each is not None]
    cells = _cells([*known, *other]) if known and len(other) == len(known) else None
    if cells is None:
        return None
    derived = _means(other, cells)
    length = np.array([1.0 if j < 3 else _LENGTH for j in columns])
    floor = _DRIVEN * length * float(np.max(np.nanstd(derived, axis=(0, 1)) / length))
    names = tuple(WRENCH[j] for j in columns)
    return Pair(names, "the commands", _means(known, cells), derived, cells, floor, {}, own_clock=False)


def _means(tracks: Sequence[Track], cells: Cells) -> Array:
    """Return the means (s, n, k) of the tracks over cells."""
    return np.stack([np.diff(track.at(cells.edges), axis=1) for track in tracks], axis=-1) / cells.dt


def _without_jumps(speed: Array) -> Array:
    """Return derived speeds (s, n, k) with what no motion of this recording is cut off."""
    if not np.isfinite(speed).any():
        return speed
    limit = _JUMP * np.nanquantile(np.abs(speed), 0.95, axis=(0, 1))
    return np.clip(speed, -limit, limit)
