"""A live session over the Foxglove WebSocket protocol: a server of the foxglove SDK, fed by a thread of its own.

The learning thread only puts instants into a queue that forgets the oldest; the server keeps a bounded queue for each
viewer. Neither ever waits for a viewer.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from towtank.errors import InputError
from towtank.live.learning import Learnt
from towtank.live.recording.messages import (
    COEFFICIENTS,
    POSE,
    PREDICTION,
    SESSION,
    VELOCITY,
    WORLD,
    WRENCHES,
    coefficients,
    pose,
    prediction,
    session,
    vector,
)
from towtank.live.recording.recorder import Form, Message
from towtank.live.session import Session
from towtank.recording.event import EVENT_SCHEMA, EVENT_TOPIC, event_json
from towtank.vehicle import Vehicle, thruster_wrench

__all__ = ["LAYOUT", "FoxgloveServer"]

_PERIOD, _SLOW = 0.05, 1.0  # s between two looks at what has come, and between two readings of the session
_WAITING = 1000  # instants
_BACKLOG = 1024  # messages that wait for one viewer
_BODY = "body"  # FRD
_UP = "world"  # ENU, so that pictures stand upright
LAYOUT = Path(__file__).with_name("foxglove-layout.json")  # to import in Foxglove
Instant = tuple[float, Mapping[str, Any]]  # time [s], arguments of the learner
FreeRuns = Callable[[Sequence[Instant], Learnt], Iterable[tuple[float, Sequence[float], Sequence[float]]]]


class FoxgloveServer:
    """Serves a session.

    Args:
        session: before it runs. vehicle: whose thrusters are commanded. epoch: Unix time of t = 0 [s].
        address: HOST:PORT to listen at.
        free_runs: takes the instants that came and where learning stands; returns times and velocities (6,), measured
            and predicted, that have not been told yet. None: nothing is predicted.
    """

    def __init__(
        self, session: Session, vehicle: Vehicle, epoch: float, address: str, free_runs: FreeRuns | None = None
    ) -> None:
        self._free_runs, self._unpredicted = free_runs, deque[Instant](maxlen=_WAITING)
        self._session, self._vehicle, self._epoch = session, vehicle, epoch
        self._host, self._port = _parts(address)
        self._came: deque[tuple[float, Mapping[str, Any]]] = deque(maxlen=_WAITING)
        self._events = 0
        self._server: Any = None
        self._context: Any = None
        self._channels: dict[str, Any] = {}
        self._frames: Any = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="foxglove", daemon=True)
        self._next = 0.0

    def open(self) -> str:
        """Begin to serve; return the address at which it listens. Raises InputError where it cannot."""
        if importlib.util.find_spec("foxglove") is None:
            raise InputError('--foxglove: the foxglove SDK is not installed; pip install "towtank[foxglove]"')
        import foxglove
        from foxglove.channels import FrameTransformsChannel

        self._context = context = foxglove.Context()  # its channels close with it
        try:
            self._server = foxglove.start_server(
                name="towtank", host=self._host, port=self._port, context=context, message_backlog_size=_BACKLOG
            )
        except Exception as error:  # the SDK's own kinds
            raise InputError(f"--foxglove {self._host}:{self._port}: cannot listen there ({error})") from None
        for form in (POSE, VELOCITY, WRENCHES, PREDICTION, COEFFICIENTS, SESSION, Form(EVENT_TOPIC, EVENT_SCHEMA)):
            name, encoding, data = form.schema
            schema = foxglove.Schema(name=name, encoding=encoding, data=data)
            self._channels[form.topic] = foxglove.Channel(
                form.topic, schema=schema, message_encoding="json", context=context
            )
        self._frames = FrameTransformsChannel("/tf", context=context)
        self._session.learning.listeners += (self._see,)
        self._thread.start()
        return f"{self._host}:{self._server.port}"

    def close(self) -> None:
        """Publish what is left, and end."""
        if self._server is None:
            return
        self._stop.set()
        self._thread.join()
        with contextlib.suppress(Exception):
            self._server.stop()
        self._server = None

    def _see(self, t: float, arguments: Mapping[str, Any]) -> None:
        self._came.append((t, arguments))

    def _run(self) -> None:
        elapsed = 0.0
        while not self._stop.wait(_PERIOD):
            elapsed += _PERIOD
            self._instants()
            if elapsed >= _SLOW:
                elapsed = 0.0
                self._publish_status()
        self._instants()
        self._publish_status()

    def _instants(self) -> None:
        """Publish every instant that has come, its wrench from the commands where these came."""
        for _ in range(len(self._came)):
            t, arguments = self._came.popleft()
            self._unpredicted.append((t, arguments))
            values = arguments.get("pose")
            if values is not None:
                self._put(pose(t, self._epoch, values))
                self._transform(t, values)
            if "velocity" in arguments:
                self._put(vector(VELOCITY, t, arguments["velocity"]))
            wrench = arguments.get("wrench")
            if "commands" in arguments:
                wrench = thruster_wrench(self._vehicle, arguments["commands"])
            if wrench is not None:
                self._put(vector(WRENCHES, t, np.asarray(wrench).tolist()))

    def _publish_status(self) -> None:
        status = self._session.status()
        self._put(coefficients(status.learnt))
        if self._free_runs is not None:
            came = [self._unpredicted.popleft() for _ in range(len(self._unpredicted))]
            for t, measured, predicted in self._free_runs(came, status.learnt):
                self._put(prediction(t, measured, predicted))
        self._put(session(status))
        for event in status.events[self._events :]:
            self._put(Message(Form(EVENT_TOPIC, EVENT_SCHEMA), max(event.t, 0.0), event_json(event)))
        self._events = len(status.events)

    def _put(self, message: Message | None) -> None:
        if message is not None:
            self._channels[message.form.topic].log(message.text, log_time=self._time(message.t))

    def _transform(self, t: float, values: Any) -> None:
        """Publish where the body is in the world, and that the world's z points down."""
        message = pose(t, self._epoch, values)
        if message is None:
            return
        from foxglove.messages import FrameTransform, FrameTransforms, Quaternion, Timestamp, Vector3

        q = json.loads(message.text)["pose"]["orientation"]
        when = Timestamp.from_epoch_secs(self._epoch + t)
        half = math.sqrt(0.5)
        down = FrameTransform(
            timestamp=when,
            parent_frame_id=_UP,
            child_frame_id=WORLD,
            translation=Vector3(x=0.0, y=0.0, z=0.0),
            rotation=Quaternion(x=half, y=half, z=0.0, w=0.0),
        )
        body = FrameTransform(
            timestamp=when,
            parent_frame_id=WORLD,
            child_frame_id=_BODY,
            translation=Vector3(**dict(zip("xyz", map(float, values[:3]), strict=True))),
            rotation=Quaternion(**q),
        )
        self._frames.log(FrameTransforms(transforms=[down, body]), log_time=self._time(t))

    def _time(self, t: float) -> int:
        return max(round((self._epoch + t) * 1e9), 0)


def _parts(address: str) -> tuple[str, int]:
    host, colon, port = address.rpartition(":")
    if not colon or not port.isascii() or not port.isdigit() or int(port) > 65535:
        raise InputError(f'--foxglove: found "{address}", expected HOST:PORT with a port of 0 to 65535')
    return host.strip("[]") or "127.0.0.1", int(port)
