"""A link that dies, as terminal and JSON lines tell it; and the terminal's picture in 80 by 24 characters."""

from __future__ import annotations

import fcntl
import io
import itertools
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from towtank import load_vehicle
from towtank.app.live.readings import Reading, Readings
from towtank.app.live.view import LiveView
from towtank.app.terminal.output import Output
from towtank.app.terminal.wrap import wrapped
from towtank.digits import estimate_text
from towtank.live import open_source
from towtank.live.session import Session
from towtank.live.status import Status
from towtank.live.warm_up import new_learner
from towtank.recording.event import Event
from towtank.simulation import Mocap, manoeuvre, simulate

from .test_live import FREE, VEHICLE, datagrams, free_port, log, send  # noqa: F401

SECONDS = 4.0  # of data, before the link dies


def command(port: int, *arguments: str) -> list[str]:
    source = f"json:127.0.0.1:{port}"
    return [sys.executable, "-m", "towtank", "live", source, "--vehicle", VEHICLE, "--free", FREE, *arguments]


def sent(log: Path, port: int) -> float:  # noqa: F811
    """Send some seconds; return the moment of the last datagram."""
    send([each for each in datagrams(log) if each[0] < SECONDS], port)
    return time.monotonic()


def test_json_lines_tell_of_a_dead_link_in_time(log: Path, tmp_path: Path) -> None:  # noqa: F811
    port = free_port()
    process = subprocess.Popen(
        command(port, "--json-lines"), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    )
    assert process.stdout is not None
    assert process.stderr is not None
    while not process.stderr.readline().startswith("listening"):
        pass
    told: list[tuple[float, dict[str, object]]] = []
    stream = process.stdout

    def listen() -> None:
        for line in stream:
            told.append((time.monotonic(), json.loads(line)))

    thread = threading.Thread(target=listen)
    thread.start()
    stopped = sent(log, port)
    time.sleep(4.5)
    sent(log, port)
    time.sleep(1.5)
    process.send_signal(signal.SIGINT)
    thread.join(30)
    process.wait()
    for pipe in (process.stdout, process.stderr):
        pipe.close()
    before = [line for moment, line in told if moment < stopped and line["samples"]]
    assert {line["state"] for line in before} == {"learning"}
    assert all(line["no_data_s"] is None for line in before)
    moment, first = next((moment, line) for moment, line in told if moment > stopped and line["no_data_s"])
    assert moment - stopped < 2.5
    assert first["state"] == "no data since 2 s"
    source = f"json:127.0.0.1:{port}"
    assert first["verdict"] == f"Link lost: no data since 2 s from {source}. All figures are as of then."
    assert first["prediction"] == {"seconds": 10.0, "text": "no data since 2 s", "rms": {}}
    states = [line["state"] for at, line in told if at > stopped]
    assert "no data since 3 s" in states  # it counts on
    assert "learning" in states
    assert states[-1] == "ended"
    events = [event for _, line in told[:-1] for event in line["events"] if event["kind"] == "link"]  # type: ignore[attr-defined]
    assert [event["details"]["state"] for event in events] == ["lost", "back"]
    assert [event["kind"] for event in told[-1][1]["events"]].count("link") == 2  # type: ignore[attr-defined]


def test_the_terminal_tells_of_a_dead_link_in_time(log: Path, tmp_path: Path) -> None:  # noqa: F811
    port = free_port()
    ours, its = pty.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    settings = {**os.environ, "TERM": "xterm-256color", "COLUMNS": "80", "LINES": "24"}
    process = subprocess.Popen(command(port), stdin=its, stdout=its, stderr=its, cwd=tmp_path, env=settings)
    os.close(its)
    shown = ""

    def until(words: str, seconds: float) -> float:
        nonlocal shown
        deadline = time.monotonic() + seconds
        while words not in shown:
            assert time.monotonic() < deadline, shown[-3000:]
            if select.select([ours], [], [], 0.02)[0]:
                shown += re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", os.read(ours, 65536).decode(errors="replace"))
        return time.monotonic()

    try:
        until("listening to", 120.0)
        sending = threading.Thread(target=sent, args=(log, port))
        began = time.monotonic()
        sending.start()
        until("  learning", 10.0)
        moment = until("no data since 2 s   Ctrl-C ends", 20.0)
        assert moment - (began + SECONDS) < 2.5
        until("Link lost: no data since 2 s from", 1.0)
        until("prediction, 10 s: no data since 2 s", 1.0)
        sending.join()
        shown = ""
        again = threading.Thread(target=sent, args=(log, port))
        again.start()
        until("  learning   Ctrl-C ends", 3.0)
        until("the link was lost", 2.0)
        again.join()
    finally:
        process.send_signal(signal.SIGINT)
        while process.poll() is None:
            if select.select([ours], [], [], 0.05)[0]:
                try:
                    os.read(ours, 65536)
                except OSError:
                    break
        process.wait()
        os.close(ours)
    assert process.returncode == 0


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Status, Reading]:
    """How a session stands that has learned some forty coefficients."""
    vehicle = load_vehicle("bluerov2_heavy")
    plan = manoeuvre("all-multisine", vehicle, duration=20.0, dt=0.04, seed=1)
    path = tmp_path_factory.mktemp("whole") / "all.csv"
    simulate(vehicle, commands=plan.commands, dt=0.04, sensors=Mocap(rate=25.0), seed=1).write(path)
    text = f"replay:{path}@0"
    session = Session([(text, open_source(text, vehicle))], vehicle, new_learner(vehicle, "joint"), epoch=0.0)
    readings = Readings(session, vehicle)
    session.open()
    status = session.run(threading.Event())
    return status, readings.read(status)


@pytest.mark.parametrize("size", [(80, 24), (80, 70), (120, 30), (64, 30)], ids=str)
@pytest.mark.parametrize("busy", [False, True], ids=["calm", "busy"])
def test_the_picture_fits_and_cuts_nothing(size: tuple[int, int], busy: bool, whole: tuple[Status, Reading]) -> None:
    status, reading = whole
    if busy:
        notes = tuple(f"message {k} of the autopilot is not used: it is dead reckoning" for k in range(7))
        reading = replace(reading, notes=("the filter had lost itself (12 times)", *notes))
        change = Event(12.0, "change", "heave drag +30.4 ± 0.3 %, sway drag +30.2 ± 0.4 %, surge drag +30.6 ± 0.5 %")
        link = Event(13.0, "link", "udp: link lost, no data from here on", {"state": "lost"})
        status = replace(
            status, events=(change, link), warnings=("recording: no space left on /data; it is tried again",)
        )
    output = Output()
    output.console = Console(width=size[0], height=size[1], record=True, file=io.StringIO(), force_terminal=True)
    output.console.print(LiveView(output, load_vehicle("bluerov2_heavy"), "joint").picture(status, reading))
    shown = [line.rstrip() for line in output.console.export_text().splitlines()]
    assert max(map(len, shown)) <= size[0]
    assert len(shown) <= size[1]
    assert "…" not in "".join(shown)
    text = " ".join(line.removeprefix("! ").strip() for line in shown)
    assert reading.verdict in text
    assert reading.prediction in text
    for before, after in itertools.pairwise(shown):
        assert not re.search(r"(±|[-\d.]+\d)$", before) or not re.match(
            r"\s*(±|%|N|m|m/s|ms|Hz|kg|s|°/s)(\s|[,;.)]|$)", after
        )
    names = [name for name in status.learnt.estimate.names if any(re.search(rf"\b{name}\b", line) for line in shown)]
    assert len(names) >= ((8 if busy else 12) if size[0] >= 80 else 5)
    if busy:
        assert "- the filter had lost itself (12 times)" in shown
        assert status.warnings[0] in text
        assert "heave drag +30.4 ± 0.3 %" in text
        assert "link lost" not in text  # it is counted among the notes
    if size == (80, 70) and not busy:
        known = [each.name for each in status.learnt.estimate.coefficients if each.identified]
        assert [name for name in known if name not in text] == []


@pytest.mark.parametrize("width", [20, 30, 40, 48, 53])
@pytest.mark.parametrize("height", [24, 90])
def test_a_narrow_window_shows_coefficients_too(width: int, height: int, whole: tuple[Status, Reading]) -> None:
    status, reading = whole
    output = Output()
    output.console = Console(width=width, height=height, record=True, file=io.StringIO(), force_terminal=True)
    output.console.print(LiveView(output, load_vehicle("bluerov2_heavy"), "joint").picture(status, reading))
    shown = output.console.export_text().splitlines()
    assert max(len(line.rstrip()) for line in shown) <= width
    known = {each.name: each for each in status.learnt.estimate.coefficients if each.identified}
    told = [line for line in shown if "±" in line and line.split()[0] in known]
    assert len(told) >= (10 if height == 90 else 1)
    for line in told:
        name, value, sign, std = line.split()[:4]
        assert [value, sign, std] == estimate_text(known[name].value, known[name].std).split()
    assert any("larger" in line for line in shown)


def test_sentences_break_between_words_never_within_a_number() -> None:
    text = "surge drag +30.6 ± 0.5 %, delay 3.8 ms, X 24 Y 22 N, K 0.18 N m, rms 0.02 m/s at 12 Hz"
    for width in range(20, 60):
        lines = wrapped(text, width, first="- ")
        assert max(map(len, lines)) <= width
        assert " ".join(line.strip() for line in lines) == f"- {text}"
        for line in lines:
            assert not re.search(r"(±|\+30.6|30.6 ± 0.5|3.8|\bX|\bK|0.18|N|0.02|12)$", line) or line.endswith("22 N"), (
                lines
            )
