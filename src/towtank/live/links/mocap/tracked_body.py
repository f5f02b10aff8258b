"""A rigid body as motion capture sees it, in NED and FRD.

Motion capture knows neither north nor the bow: its world is the one it was calibrated with, its body the one that was
drawn around the markers. Without a word from a mapping the world is taken as ENU, x east, y north, z up, and the body
as FLU, x forward, y to port, z up. A world with y up is turned about x first, and the body, which was drawn along its
axes, with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from towtank.errors import InputError, nearest
from towtank.live.pipeline.frames import MarkerArm, to_ned_frd
from towtank.recording.frames.rotations import conjugate, multiply
from towtank.recording.mapping import ColumnMapping
from towtank.recording.standard import POSITION, QUATERNION

__all__ = ["TrackedBody", "body_named", "capture_address", "quaternion_of_matrix"]

_FARTHEST = 1e4  # m
_UPRIGHT = np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0, 0.0])  # y up to z up: a quarter turn about x


class TrackedBody:
    """Turns positions and attitudes of one body into standard channels.

    Attributes:
        seen, hidden: frames in which the body was seen, and was not.
        convention: how its frames are understood, for a person.
    """

    def __init__(self, mapping: ColumnMapping | None, up: str = "z") -> None:
        """`up`: the axis of the capture's world that points up, "y" or "z"."""
        given = set() if mapping is None else mapping.model_fields_set
        self._world = mapping.world if mapping is not None and "world" in given else "ENU"
        self._body = mapping.body if mapping is not None and "body" in given else "FLU"
        self._turned = up == "y"
        self._arm = MarkerArm(mapping.marker) if mapping is not None and mapping.marker is not None else None
        self.seen = self.hidden = 0
        turned = "y up turned to z up, " if self._turned else ""
        assumed = "" if {"world", "body"} <= given else "; a mapping may say otherwise"
        self.convention = f"{turned}world taken as {self._world}, body as {self._body}{assumed}"

    def channels(self, position: Sequence[float], q: Sequence[float]) -> dict[str, float]:
        """Return x y z and qw qx qy qz in NED and FRD; nothing where the body was not seen.

        Args:
            position: in the capture's world (3,) [m]. q: attitude (4,), w x y z, from its body to its world.
        """
        length = math.hypot(*q)
        if not (abs(length - 1.0) < 0.1 and all(abs(x) < _FARTHEST for x in position)):
            self.hidden += 1
            return {}
        self.seen += 1
        place, turn = np.asarray(position, dtype=np.float64), np.asarray(q, dtype=np.float64)
        if self._turned:
            place = np.array([place[0], -place[2], place[1]])
            turn = multiply(multiply(_UPRIGHT, turn), conjugate(_UPRIGHT))
        raw = dict(zip((*POSITION, *QUATERNION), (*place.tolist(), *turn.tolist()), strict=True))
        known = to_ned_frd(raw, self._body, self._world)
        return known if self._arm is None else self._arm.to_origin(known)

    @property
    def said(self) -> list[str]:
        """How it goes, in lines for a person."""
        frames = self.seen + self.hidden
        hidden = f"; hidden in {self.hidden} of {frames} frames" if self.hidden else ""
        return [f"{self.convention}{hidden}"]


def quaternion_of_matrix(columns: Sequence[float]) -> tuple[float, float, float, float]:
    """Return w x y z of a rotation matrix given column after column (9,); NaN where it holds one.

    The largest of the four is found first, so that nothing is divided by a small number (Shepperd 1978).
    """
    a, d, g, b, e, h, c, f, i = columns  # rows: a b c, d e f, g h i
    if not all(map(math.isfinite, columns)):
        return (math.nan,) * 4
    squares = (1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i)
    largest = max(range(4), key=lambda k: squares[k])
    twice = math.sqrt(max(squares[largest], 0.0))
    if twice < 1e-3:
        return (math.nan,) * 4
    w, x, y, z = (
        (twice * twice, h - f, c - g, d - b),
        (h - f, twice * twice, b + d, c + g),
        (c - g, b + d, twice * twice, f + h),
        (d - b, c + g, f + h, twice * twice),
    )[largest]
    scale = 0.5 / twice
    return w * scale, x * scale, y * scale, z * scale


def body_named(text: str, wanted: str, names: Sequence[str]) -> int:
    """Return the place of a body among those that there are; the only one where none is named.

    Raises:
        InputError: there is none, none of that name, or several and none is named.
    """
    listed = ", ".join(f'"{name}"' for name in names[:20]) or "none"
    if wanted:
        if wanted not in names:
            raise InputError(f'source "{text}": no rigid body "{wanted}"{nearest(wanted, names)}; it has {listed}')
        return list(names).index(wanted)
    if len(names) != 1:
        raise InputError(
            f'source "{text}": it has {len(names)} rigid bodies ({listed}), expected SOURCE/BODY naming one'
        )
    return 0


def capture_address(text: str, prefix: str, port: int) -> tuple[str, int, str, dict[str, str]]:
    """Return host, port, body and options of PREFIXHOST[:PORT][/BODY][?NAME=VALUE&...].

    Raises:
        InputError: it is none of these.
    """
    rest, _, query = text.removeprefix(prefix).partition("?")
    place, _, body = rest.partition("/")
    host, colon, number = place.rpartition(":")
    if not colon or place.endswith("]"):
        host, number = place, str(port)
    pairs = [part.partition("=") for part in query.split("&") if part]
    good = number.isascii() and number.isdigit() and 0 < int(number) < 65536
    if not host or not good or not all(value for _, _, value in pairs):
        raise InputError(f'source "{text}": expected {prefix}HOST[:PORT][/BODY]')
    return host.strip("[]"), int(number), body, {name: value for name, _, value in pairs}
