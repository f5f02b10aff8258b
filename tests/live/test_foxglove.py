"""Foxglove: a viewer that speaks its protocol sees what the session knows; recordings bear schemas that hold."""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import threading
import time
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from towtank import load_vehicle
from towtank.dashboard.prediction import FreeRuns
from towtank.errors import InputError
from towtank.live import Raw, Sample
from towtank.live.foxglove import LAYOUT, FoxgloveServer, _parts
from towtank.live.links.source import SourceState
from towtank.live.pipeline.instants import rows_of
from towtank.live.recording import messages
from towtank.live.recording.recorder import Form
from towtank.live.session import Session
from towtank.live.status import Status
from towtank.live.warm_up import new_learner
from towtank.readers import read
from towtank.recording import Recording
from towtank.recording.mcap.log import McapLog
from towtank.recording.standard import VELOCITIES
from towtank.simulation import Mocap, manoeuvre, simulate
from towtank.vehicle import COEFFICIENTS, Vehicle, thruster_wrench

from .schemas import faults

pytest.importorskip("foxglove")
websockets = pytest.importorskip("websockets")
client = pytest.importorskip("websockets.sync.client")

EPOCH = 1.7e9
SECONDS = 6.0


class Link:
    """A link at the pace of the clock, eight times as fast."""

    name, keeps_time, patient = "test", True, False

    def __init__(self, samples: Sequence[Sample], pace: float = 8.0) -> None:
        self._samples, self._pace = list(samples), pace
        self._began = 0.0

    def open(self) -> None:
        self._began = time.monotonic()

    def read(self, timeout: float) -> Sequence[Sample | Raw]:
        time.sleep(0.02)
        due = EPOCH + self._pace * (time.monotonic() - self._began)
        ready = [each for each in self._samples if each.t <= due]
        self._samples = self._samples[len(ready) :]
        return [*ready, *(Raw("test", "all", each.received, b"raw") for each in ready)]

    def state(self) -> SourceState:
        return SourceState(ended=not self._samples)

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("seamor")


@pytest.fixture(scope="module")
def run(vehicle: Vehicle) -> Recording:
    plan = manoeuvre("surge-sine", vehicle, duration=SECONDS, dt=0.02, seed=1)
    return simulate(vehicle, commands=plan.commands, dt=0.02, sensors=Mocap(rate=50.0), seed=1)


def samples(run: Recording) -> list[Sample]:
    return [Sample("test", "all", EPOCH + t, EPOCH + t, names, values) for t, names, values in rows_of(run)]


def made(vehicle: Vehicle, run: Recording, **settings: Any) -> Session:
    learner = new_learner(vehicle, "joint", ("X_udot", "X_uu"), background=False)
    return Session([("test", Link(samples(run)))], vehicle, learner, epoch=EPOCH, **settings)


class Viewer:
    """Subscribes to everything, as Foxglove does."""

    def __init__(self, address: str, protocol: str) -> None:
        self.channels: dict[int, dict[str, Any]] = {}
        self.messages: dict[str, list[tuple[int, bytes]]] = {}
        self._stack = contextlib.ExitStack()
        self._link = self._stack.enter_context(
            client.connect(f"ws://{address}", subprotocols=[protocol], max_size=2**24)
        )
        self._topics: dict[int, str] = {}
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        with contextlib.suppress(websockets.ConnectionClosed):
            self._hear()

    def _hear(self) -> None:
        for message in self._link:
            if isinstance(message, bytes):
                if message[0] == 1:
                    number, stamp = struct.unpack_from("<IQ", message, 1)
                    self.messages.setdefault(self._topics[number], []).append((stamp, message[13:]))
                continue
            told = json.loads(message)
            if told["op"] == "advertise":
                for each in told["channels"]:
                    self.channels[each["id"]] = each
                    self._topics[each["id"] + 100] = each["topic"]
                wanted = [{"id": each["id"] + 100, "channelId": each["id"]} for each in told["channels"]]
                self._link.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def close(self) -> None:
        self._stack.close()
        self._thread.join(5.0)


@pytest.fixture
def watched(vehicle: Vehicle, run: Recording) -> tuple[Viewer, Status, Session]:
    session = made(vehicle, run, interval=0.05)
    server = FoxgloveServer(session, vehicle, EPOCH, "127.0.0.1:0", FreeRuns(vehicle))
    address = server.open()
    viewer = Viewer(address, "foxglove.sdk.v1")
    end = time.monotonic() + 30.0
    while len(viewer.channels) < 8 and time.monotonic() < end:
        time.sleep(0.01)
    session.mark("begun")
    session.open()
    status = session.run(threading.Event())
    end = time.monotonic() + 30.0
    while "/towtank/coefficients" not in viewer.messages and time.monotonic() < end:
        time.sleep(0.01)
    time.sleep(0.2)
    server.close()
    time.sleep(0.2)
    viewer.close()
    return viewer, status, session


def test_a_viewer_sees_what_the_session_knows(
    watched: tuple[Viewer, Status, Session], vehicle: Vehicle, run: Recording
) -> None:
    viewer, status, _ = watched
    schemas = {each["topic"]: each for each in viewer.channels.values()}
    names = ("pose", "velocity", "wrench", "prediction", "coefficients", "session", "events")
    assert set(schemas) == {"/tf", *(f"/towtank/{name}" for name in names)}
    assert schemas["/towtank/pose"]["schemaName"] == "foxglove.PoseInFrame"
    assert schemas["/tf"]["schemaName"] == "foxglove.FrameTransforms"
    for topic, own in viewer.messages.items():
        if schemas[topic]["encoding"] == "json":
            schema = json.loads(schemas[topic]["schema"])
            wrong = [fault for _, data in own for fault in faults(schema, json.loads(data))]
            assert not wrong, wrong[:3]
    last = json.loads(viewer.messages["/towtank/coefficients"][-1][1])
    for each in status.learnt.estimate.coefficients:
        if each.identified:
            assert last[each.name]["value"] == pytest.approx(each.value)
            assert last[each.name]["std"] == pytest.approx(each.std)
            assert last[each.name]["high"] - last[each.name]["value"] == pytest.approx(1.96 * each.std, rel=1e-3)
    assert last["X_uu"]["identified"]
    poses = [(stamp, json.loads(data)) for stamp, data in viewer.messages["/towtank/pose"]]
    assert len(poses) > 0.9 * len(run["x"])
    t = np.array([(stamp / 1e9 - EPOCH) for stamp, _ in poses])
    x = np.array([each["pose"]["position"]["x"] for _, each in poses])
    np.testing.assert_allclose(x, np.interp(t, run["x"].t, run["x"].values), atol=1e-3)
    wrenches = [json.loads(data) for _, data in viewer.messages["/towtank/wrench"]]
    commands = {name: run[name] for name in run if name.startswith("cmd_")}
    told = np.array([[each[name] for name in "XYZKMN"] for each in wrenches])
    rows = np.searchsorted(next(iter(commands.values())).t, [each["t"] + 1e-6 for each in wrenches]) - 1
    asked = np.column_stack([commands[f"cmd_{each.name}"].values[rows] for each in vehicle.thrusters])
    np.testing.assert_allclose(told, thruster_wrench(vehicle, asked), atol=1e-9)
    marks = [json.loads(data) for _, data in viewer.messages["/towtank/events"]]
    assert [each["text"] for each in marks if each["kind"] == "mark"] == ["begun"]
    fares = json.loads(viewer.messages["/towtank/session"][-1][1])
    assert fares["samples"] == status.samples
    assert fares["dropped"] == 0
    assert viewer.messages["/tf"]
    predicted = [json.loads(data) for _, data in viewer.messages["/towtank/prediction"]]
    times = np.array([each["t"] for each in predicted])
    assert (np.diff(times) > 0.0).all()
    measured, found = (
        np.array([each[kind]["u"] for each in predicted], dtype=float) for kind in ("measured", "predicted")
    )
    known = np.isfinite(measured)
    slope = np.gradient(run["x"].values, run["x"].t)  # it keeps its heading
    smooth = np.convolve(slope, np.full(20, 0.05), mode="same")
    assert np.std(measured[known] - np.interp(times, run["x"].t, smooth)[known]) < 0.3 * np.std(smooth)
    assert known.mean() > 0.9
    assert np.sqrt(np.nanmean((found - measured) ** 2)) < 0.5 * np.nanstd(measured)


def fields(schema: dict[str, Any], path: list[str]) -> dict[str, Any]:
    """Return the schema of a field; KeyError where there is none."""
    for name in path:
        schema = schema["properties"][name] if name in schema["properties"] else schema["additionalProperties"]
    return schema


def test_the_layout_shows_what_there_is() -> None:
    forms = {form.topic: form for form in vars(messages).values() if isinstance(form, Form)}
    schemas = {topic: json.loads(form.schema[2]) for topic, form in forms.items()}
    layout = json.loads(LAYOUT.read_text())
    plotted = [path["value"] for each in layout["configById"].values() for path in each.get("paths", ())]
    for value in plotted:
        topic, *path = value.split(".")
        assert "number" in fields(schemas[topic], path)["type"], value
        if topic == "/towtank/coefficients":
            assert path[0] in COEFFICIENTS
    for axis in VELOCITIES:
        assert {f"/towtank/prediction.measured.{axis}", f"/towtank/prediction.predicted.{axis}"} <= set(plotted)
    for name in ("X_udot", "X_uu", "N_rdot", "N_rr"):
        assert {f"/towtank/coefficients.{name}.{part}" for part in ("value", "low", "high")} <= set(plotted)

    def leaves(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else [*leaves(node["first"]), *leaves(node["second"])]

    [tabs] = [each["tabs"] for name, each in layout["configById"].items() if name.startswith("Tab!")]
    shown = [name for tab in tabs for name in leaves(tab["layout"])]
    assert sorted([*shown, layout["layout"]]) == sorted(layout["configById"])


def test_a_viewer_that_never_reads_holds_nothing_up(vehicle: Vehicle, run: Recording) -> None:
    session = made(vehicle, run)
    server = FoxgloveServer(session, vehicle, EPOCH, "127.0.0.1:0")
    host, port = server.open().rsplit(":", 1)
    with socket.create_connection((host, int(port))) as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.sendall(
            f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        text = json.dumps(
            {"op": "subscribe", "subscriptions": [{"id": k, "channelId": k} for k in range(1, 9)]}
        ).encode()
        deaf.sendall(bytes([0x81, 0x80 | 126]) + struct.pack(">H", len(text)) + b"\0\0\0\0" + text)
        session.open()
        status = session.run(threading.Event())
        server.close()
    assert status.samples == status.learnt.instants == len(samples(run))


def test_recordings_bear_schemas_that_hold(vehicle: Vehicle, run: Recording, tmp_path: Path) -> None:
    log = McapLog.open(tmp_path / "a.mcap", epoch=datetime.fromtimestamp(EPOCH, UTC), interval=0.1)
    session = made(vehicle, run, log=log, interval=0.05)
    session.mark("begun")
    session.open()
    session.run(threading.Event())
    topics: dict[str, int] = {}
    with (tmp_path / "a.mcap").open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            topics[channel.topic] = topics.get(channel.topic, 0) + 1
            if channel.topic.startswith("/raw/"):
                continue  # bytes as they came
            assert schema is not None
            if schema.encoding == "jsonschema":
                wrong = faults(json.loads(schema.data), json.loads(message.data))
                assert not wrong, wrong[:3]
                assert message.log_time / 1e9 - EPOCH < SECONDS + 1.0
            else:
                assert schema.encoding == "ros2msg"
                fields = [line.split()[:2] for line in schema.data.decode().splitlines()]
                assert {kind for kind, _ in fields} == {"float64"}
                assert len(message.data) == 4 + 8 * len(fields)
    assert topics["/towtank/coefficients"] == pytest.approx(SECONDS, abs=2)
    assert topics["/towtank/pose"] == pytest.approx(10 * SECONDS, rel=0.2)
    assert topics["/towtank/events"] == 1
    kept = read(tmp_path / "a.mcap")
    assert len(kept["x"]) == len(run["x"])
    reasons = {each.name: each.reason for each in kept.contents}
    assert reasons["/towtank/coefficients"] == "kept for viewers"
    again = McapLog.resume(tmp_path / "a.mcap")
    again.close()
    assert len(read(tmp_path / "a.mcap")["x"]) == len(run["x"])


def test_where_it_cannot_listen(vehicle: Vehicle, run: Recording, monkeypatch: pytest.MonkeyPatch) -> None:
    session = made(vehicle, run)
    with pytest.raises(InputError, match="expected HOST:PORT"):
        FoxgloveServer(session, vehicle, EPOCH, "nowhere")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(InputError, match="cannot listen there"):
            FoxgloveServer(session, vehicle, EPOCH, address).open()
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"towtank\[foxglove\]"):
        FoxgloveServer(session, vehicle, EPOCH, "127.0.0.1:0").open()


@pytest.mark.parametrize("address", ["", "host", "host:", ":x", "host:²", "host:65536", "host:-1"])
def test_an_address_that_is_none_is_one_line(address: str) -> None:
    with pytest.raises(InputError, match="expected HOST:PORT with a port of 0 to 65535"):
        _parts(address)


def test_an_address_is_a_host_and_a_port() -> None:
    assert _parts("host:65535") == ("host", 65535)
    assert _parts(":0") == ("127.0.0.1", 0)
    assert _parts("[::1]:8765") == ("::1", 8765)
