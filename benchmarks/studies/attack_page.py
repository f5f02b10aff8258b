"""Strings that would be commands, wherever a log's or a link's own words are shown; and a server under fire.

    python benchmarks/studies/attack_page.py [--frames 10000] [--requests 2000] [--seed 1] [--without-browser]

Strings that a browser would run, that a terminal would obey, that end a string of TOML or turn a line round, and one
that is long without a place to break it, stand as the name of a vehicle, its description and sources, of a log's file,
of channels and units, in notes, status texts, topics and events. Report and page are opened in headless Chromium at
three widths: no script may run, nothing may be asked for elsewhere, nothing may stick out, and the Content-Security-
Policy may have nothing to report, since all is escaped before. Commands are run on a terminal and on a pipe: no byte
that steers a terminal may come from the log. Models are read back as TOML, tables as CSV. At last the page's server is
sent malformed frames and requests, foreign hosts and origins: refused, counted, said once, and nothing else.
"""

from __future__ import annotations

import argparse
import base64
import csv
import os
import pty
import re
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import tests.dashboard.rig as rigs
from tests.dashboard.rig import CHROMIUM, FLAGS, Rig, wait_until

import towtank as tt
from towtank.live import SourceState
from towtank.recording import Recording
from towtank.recording.channel import Channel
from towtank.recording.event import Event
from towtank.recording.repairs import Content, Repairs
from towtank.simulation import manoeuvre, simulate
from towtank.vehicle import Provenance, Vehicle, load_vehicle, save_vehicle

HIT = "document.documentElement.dataset.hit='1'"  # what a script would leave behind, were it run
STRINGS = (
    f"<script>{HIT}</script>",
    f'"><img src=x onerror="{HIT}">',
    f"'><svg/onload={HIT}>",
    f"</title></style></script><script>{HIT}</script>",
    f'</h1><iframe srcdoc="<script>parent.{HIT}</script>"></iframe>',
    f"<a href=\"javascript:{HIT}\" style='position:fixed;inset:0'>x</a>",
    "<style>*{display:none}</style><link rel=stylesheet href=//attack.example/a.css>",
    "<meta http-equiv=refresh content='0;url=http://attack.example/'><base href=http://attack.example/>",
    "{{7*7}} ${7*7} &lt;b&gt; &#x3c;b&#x3e; <!-- --> ]]> \\x3cscript\\x3e",
    "\x1b[31;5mRED\x1b[0m\x1b[2J\x1b[H\x1b]0;title\x07\x1b]8;;http://attack.example/\x1b\\link\x1b]8;;\x1b\\",
    "\x9b31m\x9d0;title\x9c \r over \x08\x08 \x00 \x7f [bold red]markup[/] [link=http://attack.example/]x[/link]",
    "left \u202eright to left\u202c \u2066isolate \u200bnothing\ufeff \u2028 line",
    'quote " \' """ \'\'\' \\ \\u0041 # comment\n[posterior]\nnames = ["X_u"]',
    '=HYPERLINK("http://attack.example/","x"),+1+cmd|" /C calc"!A0,@SUM(1),-1\t=1',
    "W" * 400,
    "\u0baf\u0bcd\u6c34\U0001f30a" * 60,
)
EVERY = " ".join(STRINGS)
WIDTHS = (360, 768, 1440)
_STEERING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\u200b\u2028\ufeff]")
_OF_RICH = re.compile(r"\x1b\[(?:[0-9;]*m|\?25[lh]|[0-9]*[AK]|[0-9]*G)")  # colours, and bars that are drawn again
_LONGEST_NAME = 200  # bytes of UTF-8: a file system takes 255, and an ending and some words come behind them
_OURS = ("commands", "report", "page", "files", "server")


@dataclass(frozen=True)
class Check:
    """One thing that was looked at: of which part, what, and what was wrong; "" where nothing was."""

    part: str
    what: str
    wrong: str = ""


# -- what is shown


def hostile_vehicle(text: str, base: str = "seamor") -> Vehicle:
    """Return a vehicle of the catalog in which every free text is this one."""
    plain = load_vehicle(base)
    coefficients = {name: each.model_copy(update={"source": text}) for name, each in plain.hydrodynamics.items()}
    thrusters = tuple(each.model_copy(update={"source": text}) for each in plain.thrusters)
    return plain.model_copy(
        update={
            "name": text, "description": text, "hydrodynamics": coefficients, "thrusters": thrusters,
            "rigid_body": plain.rigid_body.model_copy(update={"source": text}),
            "provenance": Provenance(source=text, notes=(text, text)),
        }
    )  # fmt: skip


def hostile_recording(text: str, vehicle: Vehicle) -> Recording:
    """Return 15 s of a run in which every free text is this one."""
    plan = manoeuvre("surge-square", vehicle, duration=15.0, dt=0.02, seed=1)
    run = simulate(vehicle, commands=plan.commands, dt=0.02, sensors="mocap", seed=1)
    foreign = Channel(text, run["x"].t, run["x"].values, text, text)
    repairs = Repairs(nan=3, dead=(text,), details=(text,))
    contents = (Content(text, text, 3, 1.0, (text,), text), Content(text, text, 1, None, (), text))
    return Recording(
        {**run.channels, text: foreign}, text, (text, text), {text: text, "vehicle": text}, repairs, contents
    )


class HostileLink(rigs.Paced):
    """A link that says everything."""

    def state(self) -> SourceState:
        """How it fares."""
        rates = {text: float(k) for k, text in enumerate(STRINGS)}
        return replace(super().state(), said=STRINGS, rates=rates, asked=rates, senders=STRINGS)


def hostile_rig(folder: Path) -> Rig:
    """Return a session of which everything that others name is hostile."""
    rig = Rig(folder, title=EVERY, vehicle=hostile_vehicle(EVERY), link=HostileLink)
    kinds = ("configuration", "outlier", "mark")
    rig.learner.events = tuple(Event(1.0 + k, kinds[k % 3], text, {}) for k, text in enumerate(STRINGS))
    return rig


# -- browser


_SEEN = """() => ({
  hit: document.documentElement.dataset.hit || '',
  elements: [...document.querySelectorAll(
    'script:not([src]), iframe, img, base, object, embed, [onerror], [onload], ' +
    'a[href^="javascript" i], link[href*="attack"], meta[content*="attack"]'
  )].map((e) => e.outerHTML.slice(0, 80)),
  wide: document.documentElement.scrollWidth - innerWidth,
  sticking: [...document.querySelectorAll('body *')]
    .filter((e) => e.offsetParent !== null && !e.closest('.scroll, .hidden, .skip, svg, figure.wide'))
    .filter((e) => e.getBoundingClientRect().right > innerWidth + 1).map((e) => e.outerHTML.slice(0, 80)),
})"""


_POLICY = """document.addEventListener(
  'securitypolicyviolation', (e) => console.error('policy: ' + e.violatedDirective)
)"""


def opened(browser: Any, url: str, part: str, ready: Callable[[Any], None] = lambda page: None) -> Iterator[Check]:
    """Open an address at three widths and yield what is wrong with it."""
    own = url.partition("?")[0].rstrip("/")
    for width in WIDTHS:
        context = browser.new_context(viewport={"width": width, "height": 900})
        page, said, asked = context.new_page(), list[str](), list[str]()
        page.on("console", lambda message, said=said: said.append(message.text))
        page.on("pageerror", lambda error, said=said: said.append(str(error)))
        page.on("dialog", lambda dialog, said=said: (said.append(f"dialog {dialog.message}"), dialog.dismiss()))
        page.on("request", lambda request, asked=asked: asked.append(request.url))
        page.add_init_script(_POLICY)
        page.goto(url)
        ready(page)
        seen = page.evaluate(_SEEN)
        name = f"{part}, {width} px"
        foreign = [each for each in asked if not each.startswith((own, "data:", "blob:"))]
        yield Check(part, f"{name}: a script ran", seen["hit"])
        yield Check(part, f"{name}: elements of the attack", "; ".join(seen["elements"]))
        yield Check(part, f"{name}: the policy or the console said something", "; ".join(said))
        yield Check(part, f"{name}: something else was asked for", "; ".join(foreign))
        yield Check(part, f"{name}: wider than the window", f"by {seen['wide']} px" if seen["wide"] > 0 else "")
        yield Check(part, f"{name}: elements outside the window", "; ".join(seen["sticking"][:3]))
        context.close()


def report_checks(browser: Any, folder: Path) -> Iterator[Check]:
    """Learn from a hostile log, and open the reports on it."""
    vehicle = hostile_vehicle(EVERY)
    log = hostile_recording(EVERY, vehicle)
    learned = tt.learn(log, vehicle, free=("X_udot", "X_uu"))
    learned.report(folder / "learned.html", [f"towtank learn {EVERY}"])
    judged = tt.validate(learned, log)
    judged.report(folder / "judged.html", [EVERY])
    for kind in ("learned", "judged"):
        html = (folder / f"{kind}.html").read_text(encoding="utf-8")
        found = _STEERING.search(html)
        yield Check("report", f"{kind}: a character that steers", repr(found[0]) if found else "")
        yield Check("report", f"{kind}: a script in the text", "yes" if re.search("<script", html, re.I) else "")
        if browser is not None:
            yield from opened(browser, (folder / f"{kind}.html").as_uri(), "report")


def page_checks(browser: Any, rig: Rig) -> Iterator[Check]:
    """Open the page of a hostile session."""

    def ready(page: Any) -> None:
        deadline = time.monotonic() + 30.0
        while not page.evaluate("document.body.dataset.sequence && window.towtank.frames > 5"):
            if time.monotonic() > deadline:
                raise TimeoutError("the page shows nothing")
            time.sleep(0.05)

    if browser is not None:
        yield from opened(browser, rig.page.url, "page", ready)


# -- terminal and files


def on_a_terminal(words: Sequence[str], width: int = 100) -> bytes:
    """Return what a command writes to a terminal."""
    leader, follower = pty.openpty()
    environment = {**os.environ, "TERM": "xterm-256color", "COLUMNS": str(width), "LINES": "40"}
    done = subprocess.Popen(words, stdin=follower, stdout=follower, stderr=follower, env=environment)
    os.close(follower)
    out = b""
    while True:
        try:
            piece = os.read(leader, 65536)
        except OSError:  # the other side is closed
            break
        if not piece:
            break
        out += piece
    done.wait()
    os.close(leader)
    return out


def raw_in(text: str, *, terminal: bool) -> str:
    """Return what of a command's output would steer a terminal and is not the command's own."""
    if terminal:
        text = _OF_RICH.sub("", text).replace("\r\n", "\n")
        text = re.sub(r"\r(?=\n|$)", "", text)
    return ", ".join(sorted({repr(each) for each in _STEERING.findall(text)} - ({"'\\r'"} if terminal else set())))


def file_names(folder: Path) -> list[Path]:
    """Return names of files that can be had, short enough, and hostile."""
    plain = [text.replace("/", "_").replace("\x00", "")[:80].encode() for text in STRINGS]
    found = [name[:_LONGEST_NAME].decode(errors="ignore") for name in plain]
    half = os.fsdecode(b"\x1b[2J\x1b]0;title\x07 half \xff.csv")  # not UTF-8
    return [folder / f"{text}.csv" for text in found] + [folder / half]


def on_a_pipe(words: Sequence[str]) -> tuple[int, bytes]:
    """Run a command in a process of its own; return its exit code and all that it says."""
    ran = subprocess.run([sys.executable, "-m", "towtank", *words], capture_output=True, check=False)
    return ran.returncode, ran.stdout + ran.stderr


def command_checks(
    folder: Path, paths: Sequence[Path], piped: Callable[[Sequence[str]], tuple[int, bytes]] = on_a_pipe
) -> Iterator[Check]:
    """Run commands on logs of which name, columns and vehicle are hostile; on a pipe and on a terminal."""
    vehicle = folder / "vehicle.toml"
    save_vehicle(hostile_vehicle(EVERY), vehicle)
    run = hostile_recording("plain", load_vehicle("seamor"))
    run = run.without("plain")
    run.write(folder / "plain.csv")
    lines = (folder / "plain.csv").read_text().splitlines()
    columns = [*STRINGS, "t\x1b[2J"]
    quoted = ",".join('"' + text.replace('"', '""').replace("\n", " ").replace("\x00", "") + '"' for text in columns)
    text = "\n".join([f"{lines[0]},{quoted}", *(f"{line}{',1' * len(columns)}" for line in lines[1:])])
    program = [sys.executable, "-m", "towtank"]
    for path in paths:
        path.write_text(text, encoding="utf-8", errors="surrogateescape")
        model = folder / "out.toml"
        for words in (
            ["inspect", str(path)],
            ["learn", str(path), "--vehicle", str(vehicle), "--free", "X_udot,X_uu", "-o", str(model)],
            ["validate", str(model), str(path)],
            ["inspect", str(path) + " is not there"],
            ["convert", str(path), str(folder / "out.csv")],
        ):
            shown = f"{words[0]} {path.name[:24]!r}"
            code, told = piped(words)
            both = told.decode("utf-8", "surrogateescape")
            yield Check("commands", f"{shown}: on a pipe", raw_in(both, terminal=False))
            yield Check("commands", f"{shown}: ended in a fault", both[-200:] if code == 1 else "")
            said = on_a_terminal([*program, *words]).decode("utf-8", "surrogateescape")
            yield Check("commands", f"{shown}: on a terminal", raw_in(said, terminal=True))
        yield from file_checks(model, folder / "out.csv")
        for made in (model, folder / "out.csv", path):
            made.unlink(missing_ok=True)


def file_checks(model: Path, table: Path) -> Iterator[Check]:
    """Read a model as TOML and a table as CSV, as others would."""
    wrong = "it was not written"
    if model.exists():
        text = model.read_text(encoding="utf-8")
        document = tomllib.loads(text)
        same = document["name"] == EVERY and EVERY in document["provenance"]["notes"]
        raw = _STEERING.search(text.replace("\n", ""))
        wrong = repr(raw[0]) if raw else "" if same and "posterior" in document else "the texts are not what they were"
    yield Check("files", "model as TOML", wrong)
    wrong = "it was not written"
    if table.exists():
        head, *rows = csv.reader(table.read_text(encoding="utf-8").splitlines())
        numbers = all(re.fullmatch(r"-?[0-9.e+-]*|nan", cell) for row in rows for cell in row)
        plain = all(re.fullmatch(r"[A-Za-z_][\w.-]*", cell) for cell in head)
        wrong = "" if numbers and plain else "a cell is neither a standard name nor a number"
    yield Check("files", "table as CSV", wrong)


# -- server


def greeted(port: int, **headers: str) -> socket.socket:
    """Return a socket that has been greeted as a viewer."""
    link = socket.create_connection(("127.0.0.1", port), 10)
    key = base64.b64encode(os.urandom(16)).decode()
    told = {"Host": f"127.0.0.1:{port}", "Upgrade": "websocket", "Connection": "Upgrade", **headers}
    told |= {"Sec-WebSocket-Key": key, "Sec-WebSocket-Version": "13"}
    lines = ["GET /api/stream HTTP/1.1", *(f"{name}: {value}" for name, value in told.items()), "", ""]
    link.sendall("\r\n".join(lines).encode())
    return link


def frame(random: np.random.Generator) -> bytes:
    """Return what no page of ours sends."""
    kind = int(random.integers(6))
    body = random.bytes(int(random.integers(0, 400)))
    mask = random.bytes(4)
    if kind == 0:
        return random.bytes(int(random.integers(2, 200)))
    if kind == 1:  # not masked
        return bytes([0x80 | int(random.integers(16)), len(body[:100])]) + body[:100]
    if kind == 2:  # longer than it may be
        return b"\x82\xff" + struct.pack(">Q", int(random.integers(2**16, 2**62))) + mask + body
    if kind == 3:  # reserved bits and codes
        return bytes([int(random.integers(256)) | 0x70, 0x80 | len(body[:100])]) + mask + body[:100]
    if kind == 4:  # parts of a message that never began, or never ends
        return bytes([int(random.integers(2)), 0x80 | len(body[:100])]) + mask + body[:100]
    return b"\x81" + bytes([0x80 | len(body[:100])]) + mask + body[:100]  # text, of any bytes


def request(random: np.random.Generator, port: int) -> bytes:
    """Return a request that is none of ours."""
    paths = ("/", "/../..", "/%2e%2e/%00", "/api/state", "/api/mark", "/page.js", "/" + "a" * 3000, "*")
    method = ("GET", "POST", "HEAD", "BREW", "get", "CONNECT")[int(random.integers(6))]
    head = f"{method} {paths[int(random.integers(len(paths)))]} HTTP/1.{int(random.integers(3))}\r\n".encode()
    host = (f"127.0.0.1:{port}", "evil.example", "")[int(random.integers(3))]
    head += f"Host: {host}\r\nContent-Length: {int(random.integers(-5, 10**6))}\r\n\r\n".encode()
    cut = int(random.integers(1, len(head) + 1)) if random.random() < 0.3 else len(head)
    return head[:cut] + random.bytes(int(random.integers(0, 200)))


def closed(link: socket.socket, seconds: float = 0.3) -> bool:
    """Read until the server closes, at most so long."""
    link.settimeout(seconds)
    deadline = time.monotonic() + seconds
    try:
        while time.monotonic() < deadline:
            if not link.recv(1 << 16):
                return True
    except TimeoutError:
        return False
    except ConnectionError:
        return True
    return False


def foreign_checks(rig: Rig) -> Iterator[Check]:
    """Ask under other names and from other pages: a name that was bound to this machine anew gets nothing."""
    port, token = rig.page.address.port, rig.page.access.token
    hosts = (
        "attack.example",
        f"attack.example:{port}",
        f"127.0.0.1.attack.example:{port}",
        f"[::1]:{port}",
        "",
        "127.0.0.1:1",
    )
    for host in hosts:
        for path in ("/", "/api/state", "/page.js", f"/?token={token}"):
            with socket.create_connection(("127.0.0.1", port), 10) as link:
                link.sendall(f"GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n".encode())
                answer = b"".join(iter(lambda link=link: link.recv(65536), b""))
            refused = answer.split(b" ")[1] in (b"400", b"403")
            yield Check("server", f"HTTP as {host!r}", "" if refused else answer[:40].decode("latin-1"))
        with greeted(port, Host=host) as link:
            answer = link.recv(64)
        yield Check("server", f"WebSocket as {host!r}", "answered" if b" 101 " in answer else "")
    for origin in (
        "http://attack.example",
        "null",
        f"https://127.0.0.1:{port}",
        f"http://localhost.attack.example:{port}",
    ):
        with greeted(port, Origin=origin) as link:
            answer = link.recv(64)
        yield Check("server", f"WebSocket from {origin}", "answered" if b" 101 " in answer else "")
    with urllib.request.urlopen(rig.page.url, timeout=10) as answer:
        headers, body = {name.lower(): value for name, value in answer.headers.items()}, answer.read()
    policy = headers["content-security-policy"]
    wanted = {"referrer-policy": "no-referrer", "x-content-type-options": "nosniff", "x-frame-options": "DENY"}
    yield Check("server", "headers", "".join(name for name, value in wanted.items() if headers.get(name) != value))
    loose = [word for word in ("unsafe", "*", "http:", "data:") if word in policy]
    tight = "frame-ancestors 'none'" in policy and "script-src 'self'" in policy
    yield Check("server", "policy", "" if tight and not loose else policy)
    spoken = body.decode() + rig.page.pump.state + "".join(rig.told)
    yield Check("server", "the token in a line, a page or a state", "yes" if token in spoken else "")


def fire_checks(rig: Rig, frames: int, requests: int, random: np.random.Generator) -> Iterator[Check]:
    """Send malformed frames and requests; the page must answer, no viewer be left, learning have gone on."""
    port, told = rig.page.address.port, len(rig.told)
    ended = 0
    for _ in range(frames):
        with greeted(port) as link:
            link.recv(64)
            link.sendall(frame(random) + b"\x88\x80mask")  # and goodbye, where the frame left room for it
            ended += closed(link)
    for _ in range(requests):
        with socket.create_connection(("127.0.0.1", port), 10) as link:
            link.sendall(request(random, port))
            closed(link, 0.05)
    instants = rig.session.learning.now.instants
    with urllib.request.urlopen(f"{rig.base}/api/state", timeout=10) as answer:
        yield Check(
            "server", f"answers after {frames} frames and {requests} requests", "" if answer.status == 200 else "no"
        )
    wait_until(lambda: rig.page.pump.viewers == 0)
    wait_until(lambda: rig.session.status().learnt.instants > instants or rig.session.learning.now.t >= 199.0)
    dropped = rig.session.status().dropped
    yield Check("server", "samples dropped", str(dropped) if dropped else "")
    lines = len(rig.told) - told
    yield Check("server", "lines said", f"{lines}" if lines > 10 else "")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--requests", type=int, default=2_000)
    parser.add_argument("--names", type=int, help="of files that commands are run on (default all)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--without-browser", action="store_true")
    options = parser.parse_args()
    if CHROMIUM is None and not options.without_browser:
        parser.error("no Chromium is installed; --without-browser leaves out what needs one")
    random, found = np.random.default_rng(options.seed), list[Check]()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        threads = threading.active_count()
        rig = hostile_rig(folder)
        rig.start()
        try:
            with browser_of(options.without_browser) as browser:
                found += report_checks(browser, folder)
                found += page_checks(browser, rig)
            found += foreign_checks(rig)
            found += fire_checks(rig, options.frames, options.requests, random)
        finally:
            rig.close()
        found.append(Check("server", "threads left", "yes" if threading.active_count() > threads else ""))
        found += command_checks(folder, file_names(folder)[: options.names])
    table = Table(title=f"{len(STRINGS)} hostile strings", title_justify="left")
    for name in ("part", "checks", "wrong"):
        table.add_column(name, justify="left" if name == "part" else "right")
    for part in _OURS:
        own = [each for each in found if each.part == part]
        table.add_row(part, str(len(own)), str(sum(bool(each.wrong) for each in own)))
    Console().print(table)
    for each in found:
        if each.wrong:
            print(f"WRONG {each.part}: {each.what}: {each.wrong!a}")
    return 1 if any(each.wrong for each in found) else 0


class browser_of:
    """Chromium for as long as it is needed; None where it is not wanted."""

    def __init__(self, without: bool) -> None:
        self._without = without

    def __enter__(self) -> Any:
        if self._without:
            return None
        from playwright.sync_api import sync_playwright

        self._playwright = sync_playwright().start()
        self._browser = self._playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        return self._browser

    def __exit__(self, *_: object) -> None:
        if not self._without:
            self._browser.close()
            self._playwright.stop()


if __name__ == "__main__":
    sys.exit(main())
