"""From a tracked marker at r in the body to the body origin: p_o = p_m - R r, v_o = v_m - omega x r."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.errors import InputError
from towtank.recording.channel import Channel
from towtank.recording.frames.rotations import align_signs, rotate
from towtank.recording.grids.timing import common_samples, interpolation_weights, quaternion_samples
from towtank.recording.recording import Recording
from towtank.recording.standard import EULER, POSITION, QUANTITIES, QUATERNION, RATES

__all__ = ["marker_to_origin", "origin_motion", "origin_position", "origin_velocity"]

_AXIS = {name: k for each in QUANTITIES if each.swept for k, name in enumerate(each.channels)}


def origin_position(position: Array, q: Array, marker: Array) -> Array:
    """Position (..., 3) [m] in NED of the body origin.

    Args:
        position: of the marker (..., 3) [m], NED.
        q: attitude (..., 4) [w x y z], body FRD to NED.
        marker: the marker in the body (3,) [m], FRD.
    """
    return position - rotate(q, np.asarray(marker, dtype=np.float64))


def origin_velocity(velocity: Array, omega: Array, marker: Array) -> Array:
    """Velocity (..., 3) [m/s] in body FRD of the body origin.

    Args:
        velocity: of the marker (..., 3) [m/s], body FRD.
        omega: p, q, r (..., 3) [rad/s].
        marker: the marker in the body (3,) [m], FRD.
    """
    result: Array = velocity - np.cross(omega, np.asarray(marker, dtype=np.float64))
    return result


def origin_motion(
    position: Array, velocity: Array, eulers: Array, omega: Array, marker: Array, dvl: Array
) -> tuple[Array, Array]:
    """Position (n, 3) [m, NED] and velocity (n, 3) [m/s, body] of the body origin.

    Rows stay as they are where what moves them is unknown.

    Args:
        position: of the marker (n, 3) [m], NED. velocity: of the DVL (n, 3) [m/s], body FRD.
        eulers: phi theta psi (n, 3) [rad], NaN where unknown; depth alone does not depend on psi.
        omega: p q r (n, 3) [rad/s], NaN where unknown.
        marker, dvl: their places in the body (3,) [m], FRD.
    """
    depth_only = np.isnan(position[:, :2]).all(axis=1) & np.isnan(eulers[:, 2])
    q = quaternions_from_eulers(np.where(depth_only[:, None] & (np.arange(3) == 2), 0.0, eulers))
    moved, swept = origin_position(position, q, marker), origin_velocity(velocity, omega, dvl)
    return np.where(np.isnan(moved), position, moved), np.where(np.isnan(swept), velocity, swept)


def marker_to_origin(
    recording: Recording, marker: Sequence[float], of: Sequence[str] = ("position", "velocity")
) -> Recording:
    """Move position and velocity, where recorded, from the marker to the body origin.

    Attitude and rates may have other times than position and velocity: they are interpolated, never over a
    gap, and samples of the marker for which they are unknown are left out.

    Args:
        recording: in NED and FRD, `x y z` and speeds (`u v w` and what else is swept) of the marker.
        marker: the marker in the body (3,) [m], FRD.
        of: "position", "velocity" or both.

    Raises:
        InputError: there is no attitude to move the position with, or no rates to move the velocity with.
    """
    arm = np.asarray(marker, dtype=np.float64)
    moved: list[Channel] = []
    places = [name for name in POSITION if name in recording]
    if "position" in of and places:
        t, q = _attitude(recording, depth_only=places == ["z"])
        q = align_signs(q)
        for name in places:
            known = recording[name].measured
            turned = rotate(interpolation_weights(t, known.t).rotation(q), arm)
            moved.append(known.with_values(known.values - turned[:, POSITION.index(name)]).measured)
    speeds = [name for name in _AXIS if name in recording]
    if "velocity" in of and speeds:
        if not all(name in recording for name in RATES):
            raise InputError(f"{recording.source}: moving the marker's velocity to the body origin needs p, q and r")
        t, omega = common_samples([recording[name] for name in RATES])
        for name in speeds:
            known = recording[name].measured
            swept = np.cross(interpolation_weights(t, known.t).linear(omega), arm)
            moved.append(known.with_values(known.values - swept[:, _AXIS[name]]).measured)
    for channel in moved:
        if not len(channel):
            raise InputError(
                f'{recording.source}: "{channel.name}" of the marker and the attitude or rates that move it '
                "to the body origin are never measured at the same time"
            )
    lost = sum(len(recording[channel.name].measured) - len(channel) for channel in moved)
    where = ", ".join(f"{value:g}" for value in arm)
    what = ", ".join(channel.name for channel in moved)
    notes = [f"{what} moved from the marker at [{where}] m to the body origin"]
    if lost:
        notes.append(f"{lost} samples of the marker left out: attitude or rates are unknown there")
    return recording.replace(moved).with_notes(*notes) if moved else recording


def _attitude(recording: Recording, *, depth_only: bool) -> tuple[Array, Array]:
    """Times (n,) and quaternions (n, 4); depth does not depend on yaw, which may then be absent."""
    if all(name in recording for name in QUATERNION):
        t, q = quaternion_samples(recording)
    else:
        names = EULER[:2] if depth_only and "psi" not in recording else EULER
        missing = [name for name in names if name not in recording]
        if missing:
            raise InputError(
                f"{recording.source}: moving the marker's position to the body origin needs the attitude; "
                f"{', '.join(missing)} not recorded"
            )
        t, angles = common_samples([recording[name] for name in names])
        if len(names) == 2:
            angles = np.column_stack([angles, np.zeros(t.size)])
        q = quaternions_from_eulers(angles)
    if not t.size:
        raise InputError(f"{recording.source}: roll, pitch and yaw are never measured at the same time")
    return t, q
