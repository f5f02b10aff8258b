"""The page's server, asked by those who should not and by those who may."""

from __future__ import annotations

import base64
import gc
import http.client
import io
import json
import os
import re
import socket
import struct
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from websockets.sync.client import ClientConnection, connect

from towtank import load_vehicle
from towtank.app.demo.run import run_demo
from towtank.app.live.session import LiveOptions, run_live
from towtank.app.terminal.output import Output
from towtank.dashboard.access import Address
from towtank.dashboard.feed import RecordingFile
from towtank.dashboard.page import Page
from towtank.dashboard.pump import Kind, decode
from towtank.errors import InputError
from towtank.readers import read
from towtank.simulation import manoeuvre, simulate
from towtank.vehicle import parse_vehicle

from .rig import Rig, needs_page, wait_until

pytestmark = needs_page


def ask(rig: Rig, method: str, path: str, body: bytes | None = None, **headers: str) -> tuple[int, bytes, Any]:
    link = http.client.HTTPConnection("127.0.0.1", rig.page.address.port, timeout=30)
    try:
        link.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
        answer = link.getresponse()
        return answer.status, answer.read(), answer.headers
    finally:
        link.close()


def bearer(rig: Rig) -> dict[str, str]:
    return {"Authorization": f"Bearer {rig.page.access.token}"}


def stream(rig: Rig, **headers: str) -> ClientConnection:
    url = f"ws://127.0.0.1:{rig.page.address.port}/api/stream"
    return connect(url, additional_headers=headers, max_size=None, compression=None, proxy=None)


def test_the_state_is_one_document_of_plain_numbers(rig: Rig) -> None:
    status, body, headers = ask(rig, "GET", "/api/state")
    assert status == 200
    assert "script-src 'self';" in headers["content-security-policy"]
    state = json.loads(body, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    estimate = rig.session.learning.now.estimate
    assert set(state["coefficients"]) == set(estimate.names)
    known = state["coefficients"]["X_uu"]
    assert known["unit"] == "kg/m"
    assert known["relative_std"] == pytest.approx(known["std"] / abs(known["value"]))
    assert state["samples"] > 0
    assert state["recording"]["file"] == "dive.mcap"
    assert set(state["axes"]) == {"surge", "sway", "heave", "roll", "pitch", "yaw"}


def test_the_stream_tells_names_once_and_then_numbers(rig: Rig) -> None:
    with stream(rig) as viewer:
        told: dict[str, Any] = {}
        frames: dict[Kind, int] = {}
        last = -np.inf
        deadline = time.monotonic() + 60.0
        while len(frames) < 4 or frames[Kind.SIGNALS] < 20:
            assert time.monotonic() < deadline
            message = viewer.recv(10)
            if isinstance(message, str):
                document = json.loads(message)
                told.setdefault(document["type"], document)
                continue
            kind, _, t, values = decode(message)
            assert told["hello"]
            frames[kind] = frames.get(kind, 0) + 1
            if kind == Kind.SIGNALS:
                assert values.shape[1] == len(told["hello"]["signals"])
                assert t[0] > last  # history first, then on without a gap in order
                last = t[-1]
            if kind == Kind.COEFFICIENTS:
                assert values.shape[1] == 2 * len(told["hello"]["coefficients"])
    assert set(told) == {"you", "hello", "state", "events"}
    assert told["you"] == {"type": "you", "steers": False}
    assert [each["unit"] for each in told["hello"]["signals"][:6]] == ["m", "m", "m", "°", "°", "°"]


def test_the_model_is_a_vehicle_and_the_recording_a_log(rig: Rig, tmp_path: Path) -> None:
    status, body, headers = ask(rig, "GET", "/api/model.toml")
    assert status == 200
    assert headers["content-disposition"] == 'attachment; filename="seamor_learned.toml"'
    model = parse_vehicle(body.decode(), "model")
    assert model.coefficient("X_uu") != rig.vehicle.coefficient("X_uu")
    wait_until(lambda: rig.session.status().recording.size > 10_000)
    status, body, _ = ask(rig, "GET", "/api/recording")
    (tmp_path / "a.mcap").write_bytes(body)
    assert status == 200
    assert len(read(tmp_path / "a.mcap")["x"]) > 50


def test_controls_need_the_token(rig: Rig) -> None:
    port = rig.page.address.port
    cookie = f"{rig.page.access.cookie}={rig.page.access.token}"
    for headers in (
        {},
        {"Authorization": "Bearer wrong"},
        {"Cookie": cookie},
        {"Cookie": cookie, "Origin": "http://evil.example"},
        {"Cookie": f"{rig.page.access.cookie}=wrong", "Origin": f"http://127.0.0.1:{port}"},
    ):
        for name in ("pause", "resume", "mark"):
            assert ask(rig, "POST", f"/api/{name}", b"{}", **headers)[0] == 403
    assert not rig.session.status().learnt.paused
    assert ask(rig, "POST", "/api/pause", **bearer(rig))[0] == 204
    wait_until(lambda: rig.session.learning.now.paused)
    assert ask(rig, "POST", "/api/resume", Cookie=cookie, Origin=f"http://127.0.0.1:{port}")[0] == 204
    wait_until(lambda: not rig.session.learning.now.paused)


def test_a_mark_is_an_event_of_plain_text(rig: Rig) -> None:
    body = json.dumps({"text": "  skid\non\x00 <b>" + "x" * 500}).encode()
    assert ask(rig, "POST", "/api/mark", body, **bearer(rig))[0] == 204
    text = rig.session.status().events[-1].text
    assert text.startswith("skid on <b>xxx")
    assert len(text) <= 200
    for wrong in (b"[]", b'"a"', b'{"text": 3}', b"{", b"\xff", b"[" * 2000):
        assert ask(rig, "POST", "/api/mark", wrong, **bearer(rig))[0] == 400
    assert rig.session.status().events[-1].text == text


def test_other_hosts_and_wrong_tokens_are_refused(rig: Rig) -> None:
    for host in ("evil.example", f"evil.example:{rig.page.address.port}", "127.0.0.1:1"):
        for path in ("/", "/api/state", "/page.js"):
            assert ask(rig, "GET", path, Host=host)[0] == 403
    status, body, headers = ask(rig, "GET", "/?token=wrong")
    assert (status, headers["set-cookie"]) == (403, None)
    status, body, headers = ask(rig, "GET", f"/?token={rig.page.access.token}")
    assert status == 200
    assert "HttpOnly" in headers["set-cookie"]
    assert "SameSite=strict" in headers["set-cookie"]
    assert rig.page.access.token.encode() not in body


@pytest.mark.parametrize(
    "path",
    [
        "/../pyproject.toml",
        "/..%2f..%2fpyproject.toml",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/static/../page.js",
        "//etc/passwd",
        "/page.js/",
        "/page.js%00",
        "/api/recording/../../../etc/passwd",
        "/api/recording?file=/etc/passwd&x=..",
        "/index.html",
        "/api",
        "/api/report",
        "/docs",
        "/openapi.json",
        "\\..\\..\\etc",
    ],
)
def test_no_path_reaches_a_file(rig: Rig, path: str) -> None:
    with socket.create_connection(("127.0.0.1", rig.page.address.port), 10) as link:
        link.sendall(f"GET {path} HTTP/1.1\r\nHost: {rig.page.address.text}\r\nConnection: close\r\n\r\n".encode())
        answer = b""
        while piece := link.recv(65536):
            answer += piece
    assert b"root:" not in answer
    assert b"[project]" not in answer
    if path.startswith("/api/recording?"):
        assert b"dive.mcap" in answer[:2000]
    else:
        assert answer.split(b" ")[1] in (b"404", b"400"), answer[:200]


def test_no_other_method_is_answered(rig: Rig) -> None:
    for method in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"):
        assert ask(rig, method, "/", **bearer(rig))[0] == 405
        assert ask(rig, method, "/api/state", **bearer(rig))[0] == 405
    assert ask(rig, "GET", "/api/pause", **bearer(rig))[0] == 405


@pytest.mark.parametrize("declared", [True, False])
def test_a_body_of_a_gigabyte_is_refused_after_its_first_bytes(rig: Rig, declared: bool) -> None:
    head = (
        f"POST /api/mark HTTP/1.1\r\nHost: {rig.page.address.text}\r\nAuthorization: Bearer {rig.page.access.token}\r\n"
    )
    head += f"Content-Length: {10**9}\r\n\r\n" if declared else "Transfer-Encoding: chunked\r\n\r\n"
    sent = 0
    piece = b"x" * 65536
    with socket.create_connection(("127.0.0.1", rig.page.address.port), 10) as link:
        link.sendall(head.encode())
        try:
            while sent < 10**9:
                link.sendall(piece if declared else b"10000\r\n" + piece + b"\r\n")
                sent += len(piece)
        except OSError:
            pass
    assert sent < 50e6
    assert ask(rig, "GET", "/api/state")[0] == 200


def handshake(rig: Rig, **headers: str) -> socket.socket:
    """Return a raw socket that has been greeted as a viewer."""
    link = socket.socket()
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    link.settimeout(10)
    link.connect(("127.0.0.1", rig.page.address.port))
    key = base64.b64encode(os.urandom(16)).decode()
    lines = [
        "GET /api/stream HTTP/1.1",
        f"Host: {rig.page.address.text}",
        "Upgrade: websocket",
        "Connection: Upgrade",
        f"Sec-WebSocket-Key: {key}",
        "Sec-WebSocket-Version: 13",
        *(f"{name}: {value}" for name, value in headers.items()),
    ]
    link.sendall("\r\n".join(lines).encode() + b"\r\n\r\n")
    assert link.recv(12).startswith(b"HTTP/1.1 ")
    return link


def ended(link: socket.socket) -> bool:
    """Read until the server closes."""
    try:
        while link.recv(65536):
            pass
    except ConnectionError:
        return True
    except TimeoutError:
        return False
    return True


def test_malformed_frames_end_their_socket_and_nothing_else(rig: Rig) -> None:
    random = np.random.default_rng(5)
    before, told = rig.page.refusals.total, len(rig.told)
    fixed = [
        b"\x81\x01a",  # not masked
        b"\xff" * 20,  # reserved bits
        b"\x81\xff" + struct.pack(">Q", 2**62) + b"mask",  # longer than anything
        b"\x81\x85mask" + bytes(5) + b"\x88\x80mask",  # a message, from a page that sends none
        b"\x89\xfe" + struct.pack(">H", 500) + b"mask" + bytes(500),  # a ping that is too long
        b"\x88\x81mask\x00",  # a close of one byte
        b"\x81\x82\x00\x00\x00\x00\xff\xfe",  # text that is none
        b"\x00\x81mask\x00",  # goes on with nothing
    ]
    for k in range(200):
        data = fixed[k] if k < len(fixed) else b"\x8f" + random.bytes(int(random.integers(1, 300)))
        with handshake(rig) as link:
            link.sendall(data)
            assert ended(link), data
    assert rig.page.refusals.total >= before + 190
    assert len(rig.told) <= told + 2
    wait_until(lambda: rig.page.pump.viewers == 0)
    assert ask(rig, "GET", "/api/state")[0] == 200


def test_a_socket_from_a_foreign_page_is_refused(rig: Rig) -> None:
    before = rig.page.pump.viewers
    for headers in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {"Sec-Fetch-Site": "cross-site"}):
        with handshake(rig, **headers) as link:
            assert b"Forbidden" in link.recv(100)
    assert rig.page.pump.viewers == before


def heard(rig: Rig) -> float:
    """Return up to when samples were learned from, or left out because the vehicle lies upside down [s]."""
    now = rig.session.learning.now
    return now.t if now.left_out is None else max(now.t, now.left_out.end)


def test_a_viewer_that_never_reads_holds_nobody_up(rig: Rig) -> None:
    with handshake(rig) as slow, stream(rig) as quick:
        wait_until(lambda: rig.page.pump.viewers == 2)
        boxes = list(rig.page.pump._boxes)
        seen, longest = 0, 0
        deadline = time.monotonic() + 60.0
        before = heard(rig)
        while rig.page.pump.skipped < 20:
            assert time.monotonic() < deadline
            seen += isinstance(quick.recv(5), bytes)
            longest = max(longest, *(len(box) for box in boxes))
        assert seen > 20
        assert longest <= 50
        assert heard(rig) > before
        assert rig.session.status().dropped == 0
        slow.close()
    wait_until(lambda: rig.page.pump.viewers == 0)


def test_more_viewers_than_there_is_room_for_are_sent_away(rig: Rig) -> None:
    from towtank.dashboard.pump import VIEWERS

    viewers = [handshake(rig) for _ in range(VIEWERS)]
    wait_until(lambda: rig.page.pump.viewers == VIEWERS)
    with handshake(rig) as late:
        assert ended(late)
    for viewer in viewers:
        viewer.close()
    wait_until(lambda: rig.page.pump.viewers == 0)


def test_other_addresses_need_the_token_for_everything(rig: Rig) -> None:
    with Page(rig.feed, Address("0.0.0.0", 0)) as page:
        outside = Rig.__new__(Rig)
        outside.page = page
        for path in ("/", "/page.js", "/api/state", "/api/model.toml", "/api/recording"):
            assert ask(outside, "GET", path)[0] == 401
        with handshake(outside) as link:
            assert b"Forbidden" in link.recv(100)
        assert ask(outside, "GET", "/api/state", **bearer(outside))[0] == 200
        assert ask(outside, "GET", "/", Host=f"rebound.example:{page.address.port}", **bearer(outside))[0] == 403
        cookie = f"{page.access.cookie}={page.access.token}"
        with stream(outside, Cookie=cookie) as viewer:
            assert json.loads(viewer.recv(5)) == {"type": "you", "steers": True}


def test_an_address_that_is_taken_is_one_line(rig: Rig) -> None:
    with pytest.raises(InputError, match=r"--page 127.0.0.1:\d+: cannot be served there \(Address already in use\)"):
        Page(rig.feed, Address("127.0.0.1", rig.page.address.port))


def test_a_report_is_served_where_there_is_one(rig: Rig) -> None:
    with Page(rig.feed, Address("127.0.0.1", 0), reports=lambda: b"<h1>report</h1>") as page:
        outside = Rig.__new__(Rig)
        outside.page = page
        status, body, headers = ask(outside, "GET", "/api/report")
        assert (status, body) == (200, b"<h1>report</h1>")
        assert headers["content-disposition"] == 'attachment; filename="report.html"'
        with stream(outside) as viewer:
            told = [json.loads(viewer.recv(5)) for _ in range(2)]
            assert told[1]["report"] is True


class Told(Output):
    """An output whose lines can be waited for."""

    def __init__(self) -> None:
        super().__init__(json=True)
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        self.lines.append(text)

    @property
    def address(self) -> str:
        return next((line.split()[1] for line in self.lines if line.startswith("page: ")), "")


def state_of(url: str) -> dict[str, Any]:
    with urllib.request.urlopen(f"{url.partition('?')[0]}api/state", timeout=10) as answer:
        found: dict[str, Any] = json.loads(answer.read())
        return found


def test_live_serves_its_page(tmp_path: Path) -> None:
    vehicle = load_vehicle("seamor")
    plan = manoeuvre("surge-sine", vehicle, duration=9.0, dt=0.02, seed=1)
    simulate(vehicle, commands=plan.commands, dt=0.02, sensors="mocap", seed=1).write(tmp_path / "a.csv")
    told = Told()
    options = LiveOptions((f"replay:{tmp_path / 'a.csv'}@2",), "seamor", free=("X_udot", "X_uu"), page="127.0.0.1:0")
    run = threading.Thread(target=run_live, args=(options, told))
    run.start()
    wait_until(lambda: told.address, 60.0)
    wait_until(lambda: state_of(told.address).get("samples", 0) > 200)
    state = state_of(told.address)
    assert state["links"][0]["text"] == options.sources[0]
    assert set(state["coefficients"]) == {"X_udot", "X_uu"}
    base, _, token = told.address.partition("?token=")
    body, headers = json.dumps({"text": "here"}).encode(), {"Authorization": f"Bearer {token}"}
    urllib.request.urlopen(urllib.request.Request(f"{base}api/mark", body, headers), timeout=10).close()
    wait_until(lambda: state_of(told.address)["samples"] > state["samples"])
    run.join(60)
    assert not run.is_alive()


def test_the_demo_serves_its_page(tmp_path: Path) -> None:
    shown = Console(file=io.StringIO(), width=80, force_terminal=False)
    assert isinstance(shown.file, io.StringIO)
    found: dict[str, Any] = {}

    def demo() -> None:
        found.update(run_demo(tmp_path / "out", seconds=3.0, page="127.0.0.1:0", console=shown))

    run = threading.Thread(target=demo)
    run.start()
    wait_until(lambda: "page: http" in shown.file.getvalue(), 60.0)
    url = re.search(r"page: (\S+)", shown.file.getvalue())[1]
    wait_until(lambda: state_of(url).get("samples", 0) > 100)
    state = state_of(url)
    assert state["t"] > 0.9
    run.join(60)
    assert found["samples"] == 300  # the page took none of them


def test_a_download_that_is_broken_off_leaves_no_open_file(
    rig: Rig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "dive.mcap"
    path.write_bytes(b"\0" * (1 << 21))
    monkeypatch.setattr(type(rig.page.pump), "recording", RecordingFile(path, 1 << 21, 0))
    slow = Path.open
    monkeypatch.setattr(Path, "open", lambda *given: (time.sleep(0.02), slow(*given))[1])
    for wait in (0.0, 0.01, 0.03):
        link = socket.create_connection(("127.0.0.1", rig.page.address.port))
        link.sendall(f"GET /api/recording HTTP/1.1\r\nHost: {rig.page.address.text}\r\n\r\n".encode())
        time.sleep(wait)
        link.close()
    time.sleep(0.3)
    gc.collect()  # a file that is left to it would be told of as a failure of this test
    assert str(path) not in [os.path.realpath(each) for each in Path("/proc/self/fd").iterdir()]
