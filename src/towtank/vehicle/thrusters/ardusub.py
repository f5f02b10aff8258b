"""ArduSub's frames: what each motor does at a positive command, and a vehicle's thrusters beside them.

ArduSub mixes by a table of signs, AP_Motors6DOF::setup_motors: for each motor a factor of roll, pitch, yaw, throttle
(up), forward and lateral (to starboard). With MOT_n_DIRECTION allowed for, a command above neutral pushes as the
table says, whatever way the propeller turns. The table is no geometry: it knows neither places nor angles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.digits import joined
from towtank.vehicle.thrusters.wrench import configuration_matrix
from towtank.vehicle.vehicle import Vehicle

__all__ = ["FRAMES", "Frame", "by_frame", "frame_named"]

_ALIKE = 0.7  # cosine of the angle between what a thruster and a motor do, above which they are one
_APART = 0.9  # ... and below which, with the file's own order, another order is looked for


class Frame(NamedTuple):
    """One of ArduSub's frames.

    Attributes:
        name: as ArduSub prints it. motors: per motor its factors of roll, pitch, yaw, throttle, forward and lateral.
    """

    name: str
    motors: tuple[tuple[float, ...], ...]

    @property
    def wrench(self) -> Array:
        """What each motor does at a positive command: signs of X Y Z K M N (6, n), FRD."""
        roll, pitch, yaw, throttle, forward, lateral = np.array(self.motors).T
        return np.array([forward, lateral, -throttle, roll, pitch, yaw]) + 0.0


_VECTORED = (
    (0.0, 0.0, 1.0, 0.0, -1.0, 1.0),
    (0.0, 0.0, -1.0, 0.0, -1.0, -1.0),
    (0.0, 0.0, -1.0, 0.0, 1.0, 1.0),
    (0.0, 0.0, 1.0, 0.0, 1.0, -1.0),
)
_PAIR = ((0.0, 0.0, -1.0, 0.0, 1.0, 0.0), (0.0, 0.0, 1.0, 0.0, 1.0, 0.0))
_BESIDE = ((1.0, 0.0, 0.0, -1.0, 0.0, 0.0), (-1.0, 0.0, 0.0, -1.0, 0.0, 0.0))

# FRAME_CONFIG -> frame; 7 is CUSTOM, of which only the boat's own firmware knows the motors
FRAMES: dict[int, Frame] = {
    0: Frame(
        "BLUEROV1",
        (
            *_PAIR,
            (-0.5, 0.5, 0.0, 0.45, 0.0, 0.0),
            (0.5, 0.5, 0.0, 0.45, 0.0, 0.0),
            (0.0, -1.0, 0.0, 1.0, 0.0, 0.0),
            (-0.25, 0.0, 0.0, 0.0, 0.0, 1.0),
        ),
    ),
    1: Frame("VECTORED", (*_VECTORED, *_BESIDE)),
    2: Frame(
        "VECTORED_6DOF",
        (
            *_VECTORED,
            (1.0, -1.0, 0.0, -1.0, 0.0, 0.0),
            (-1.0, -1.0, 0.0, -1.0, 0.0, 0.0),
            (1.0, 1.0, 0.0, -1.0, 0.0, 0.0),
            (-1.0, 1.0, 0.0, -1.0, 0.0, 0.0),
        ),
    ),
    3: Frame(
        "VECTORED_6DOF_90DEG",
        (
            (1.0, 1.0, 0.0, 1.0, 0.0, 0.0),
            (0.0, 0.0, 1.0, 0.0, 1.0, 0.0),
            (1.0, -1.0, 0.0, 1.0, 0.0, 0.0),
            (0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
            (0.0, 0.0, 0.0, 0.0, 0.0, 1.0),
            (-1.0, 1.0, 0.0, 1.0, 0.0, 0.0),
            (0.0, 0.0, -1.0, 0.0, 1.0, 0.0),
            (-1.0, -1.0, 0.0, 1.0, 0.0, 0.0),
        ),
    ),
    4: Frame("SIMPLEROV_3", (*_PAIR, (0.0, 0.0, 0.0, -1.0, 0.0, 0.0))),
    5: Frame("SIMPLEROV_4", (*_PAIR, *_BESIDE)),
    6: Frame("SIMPLEROV_5", (*_PAIR, *_BESIDE, (0.0, 0.0, 0.0, 0.0, 0.0, 1.0))),
}


def frame_named(name: str) -> Frame | None:
    """Return the frame of this name; None for CUSTOM and any that is not known."""
    return next((frame for frame in FRAMES.values() if frame.name == name), None)


def by_frame(vehicle: Vehicle, name: str) -> tuple[Vehicle, str]:
    """Return the vehicle with thrusters in the order and sense of a frame's motors, and in words what was changed.

    A thruster is a motor where its force and moment point along (or against) what the table says of the motor. The
    vehicle is returned as it is, with no words, where nothing need be changed or where it is of another frame.
    """
    frame = frame_named(name)
    if frame is None or len(frame.motors) != len(vehicle.thrusters):
        return vehicle, ""
    alike = _likeness(frame.wrench, configuration_matrix(vehicle))
    own = np.diag(alike)
    places = np.arange(len(own)) if np.abs(own).min() >= _APART else _assigned(np.abs(alike))
    cosines = alike[np.arange(len(own)), places]
    if np.abs(cosines).min() < _ALIKE:
        return vehicle, ""
    turned, moved = np.flatnonzero(cosines < 0.0), np.flatnonzero(places != np.arange(len(own)))
    if not turned.size and not moved.size:
        return vehicle, ""
    thrusters = []
    for motor, place in enumerate(places):
        thruster = vehicle.thrusters[place]
        sign = -1.0 if cosines[motor] < 0.0 else 1.0
        direction = tuple(sign * x + 0.0 for x in thruster.direction)
        thrusters.append(thruster.model_copy(update={"name": vehicle.thrusters[motor].name, "direction": direction}))
    words = []
    if moved.size:
        words.append(f"outputs {_numbers(moved)} drive other thrusters")
    if turned.size:
        words.append(f"{'motor' if turned.size == 1 else 'motors'} {_numbers(turned)} push{_es(turned)} the other way")
    said = f"the log's frame is {name}: {' and '.join(words)} than the file says; taken as the frame has them"
    return vehicle.model_copy(update={"thrusters": tuple(thrusters)}), said


def _es(which: NDArray[np.intp]) -> str:
    return "es" if which.size == 1 else ""


def _numbers(which: NDArray[np.intp]) -> str:
    return joined([str(k + 1) for k in which])


def _likeness(table: Array, B: Array) -> Array:
    """Return cosines (motors, thrusters) between what motors (6, n) and thrusters (6, n) do, arms alike."""
    arms = np.abs(B[3:]).max(axis=1)
    size = np.concatenate([np.ones(3), np.where(arms > 1e-3, arms, 1.0)])
    columns = B / size[:, None]
    columns = np.where(np.abs(columns) > 0.3 * np.abs(columns).max(axis=0), np.sign(columns), 0.0)
    rows = np.sign(table)
    lengths = np.linalg.norm(rows, axis=0)[:, None] * np.linalg.norm(columns, axis=0)[None, :]
    return np.asarray(rows.T @ columns / np.maximum(lengths, 1e-9))


def _assigned(alike: Array) -> Array:
    """Return the thruster (n,) of each motor, so that all together are most alike; of equals the file's own."""
    from scipy.optimize import linear_sum_assignment  # slow to import, seldom needed

    return np.asarray(linear_sum_assignment(alike + 1e-6 * np.eye(len(alike)), maximize=True)[1])
