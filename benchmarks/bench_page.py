"""The live page under load: frames drawn, share of a core, memory of the page, and what it costs the learning loop.

    python benchmarks/bench_page.py [--seconds 600] [--loop-seconds 300] [--json]

A simulated vehicle with 28 thrusters, pose, velocity, accelerometers and supply (50 signals at 100 Hz with the wrench)
is learned live, in a process of its own. In one session two viewers, one of whom never reads, come and go in turns of
five seconds: the latency of the loop (receipt to updated estimate, samples not held back) with and without them. In
another headless Chromium looks on, and a third has no page: frames drawn, at least 15 a second; what the page costs, at
most 10 % of a core (process with page less process without, over the same seconds of a session); and what the page in
the browser grows by, less than 20 MB.
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from typing import Any

from figures import Figure, report

from towtank import load_vehicle

RATE = 100.0
THRUSTERS = 28
NEUTRAL = 1500.0  # us
GROWTH, SHARE, FRAMES = 20.0, 10.0, 15.0  # MB, %, 1/s
LOOP = 1.2  # times
SETTLING, SLICE = 130.0, 5.0  # s; the filter looks back at what it has seen for two minutes
COMPARED = (140, 260)  # s of a session over which it is compared with one without a page
FLAGS = (
    "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --enable-precise-memory-info"
)


def serve(seconds: float, paged: bool) -> None:
    """Run a session, in this process; standard output tells the address, and at the end how it went."""
    from towtank.dashboard import About, Address
    from towtank.dashboard.live_feed import LiveFeed
    from towtank.dashboard.page import Page
    from towtank.dashboard.prediction import warm_up as warm_page_up
    from towtank.live import Sample, SourceState
    from towtank.live.pipeline.instants import rows_of
    from towtank.live.session import Session
    from towtank.live.warm_up import new_learner, warm_up
    from towtank.recording.channel import standard_channel
    from towtank.simulation import Ins, manoeuvre, simulate

    vehicle = load_vehicle("bluerov2_heavy")
    thrusters = [vehicle.thrusters[k % 8].model_copy(update={"name": f"t{k + 1}"}) for k in range(THRUSTERS)]
    vehicle = vehicle.model_copy(update={"thrusters": tuple(thrusters)})
    plan = manoeuvre("all-multisine", vehicle, duration=seconds + 30.0, dt=1.0 / RATE, seed=1)
    gentle = NEUTRAL + 0.3 * (plan.commands - NEUTRAL)
    run = simulate(vehicle, commands=gentle, dt=1.0 / RATE, sensors=Ins(), seed=1)
    pose = simulate(vehicle, commands=gentle, dt=1.0 / RATE, seed=1)
    t = run["cmd_t1"].t
    channels = {name: run[name] if name in run else pose[name] for name in {*run, *pose}}
    channels["voltage"] = standard_channel("voltage", t, 15.0 + 0.0 * t)
    from towtank.recording import Recording

    rows = list(rows_of(Recording(channels)))
    began = [0.0]

    class Paced:
        keeps_time, patient, name = True, False, "simulated"

        def __init__(self) -> None:
            self.next = 0

        def open(self) -> None:
            began[0] = time.time()

        def read(self, timeout: float) -> list[Sample]:
            time.sleep(0.005)
            found = []
            while self.next < len(rows) and rows[self.next][0] <= time.time() - began[0]:
                stamp, names, values = rows[self.next]
                found.append(Sample("test", "all", began[0] + stamp, time.time(), names, values))
                self.next += 1
            return found

        def state(self) -> SourceState:
            return SourceState(rates={"all": RATE}, ended=self.next >= len(rows))

        def close(self) -> None:
            pass

    learner = new_learner(vehicle, "joint", background=True)
    warm_up(vehicle, new_learner(vehicle, "joint", background=True), lambda text, share: None)
    warm_page_up(vehicle)
    session = Session([("simulated", Paced())], vehicle, learner, epoch=time.time(), window=0.0)
    page = Page(LiveFeed(session, About("bench", vehicle, "joint")), Address("127.0.0.1", 0)) if paged else None
    apart = Apart(session, page)
    session.open()
    if page is not None:
        page.start()
    print(json.dumps({"url": page.url if page else ""}), flush=True)
    spent: dict[int, float] = {}

    def look(status: Any) -> None:
        spent[int(status.elapsed)] = time.process_time()

    status = session.run(threading.Event(), seconds=seconds, show=look, period=0.25)
    state = json.loads(page.pump.state) if page else {}
    if page is not None:
        page.close()
    first, last = COMPARED if seconds >= COMPARED[1] + 5 else (10, min(int(seconds) - 1, 60))
    found = {
        "alone": apart.alone.milliseconds(),
        "watched": apart.watched.milliseconds(),
        "dropped": status.dropped,
        "instants": status.learnt.instants,
        "cpu": 100.0 * (spent[last] - spent[first]) / (last - first),
        "thread": 100.0 * state.get("page", {}).get("cpu_s", 0.0) / seconds,
        "skipped": state.get("page", {}).get("skipped", 0),
        "signals": 21 + THRUSTERS + 1,
    }
    print(json.dumps(found), flush=True)


class Apart:
    """Latencies of the loop while two look, and while nobody does, once it has settled; put in place of its own."""

    def __init__(self, session: Any, page: Any) -> None:
        from towtank.live.pipeline.measures import Latency

        self.alone, self.watched = Latency(), Latency()
        self._page, self._began = page, time.monotonic() + SETTLING
        self._own = session.learning._processing
        session.learning._processing = self

    def add(self, seconds: float) -> None:
        viewers = self._page.pump.viewers if self._page is not None else 0
        self._own.add(seconds)
        if time.monotonic() > self._began and viewers in (0, 2):
            (self.watched if viewers else self.alone).add(seconds)

    def milliseconds(self) -> dict[str, float]:
        found: dict[str, float] = self._own.milliseconds()
        return found


class Served:
    """A session in a process of its own."""

    def __init__(self, seconds: float, *, paged: bool) -> None:
        words = [sys.executable, __file__, "--serve", str(seconds), *(["--paged"] if paged else [])]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.url = json.loads(self.process.stdout.readline())["url"]

    def end(self) -> dict[str, Any]:
        """Wait for the end and return how it went."""
        out = self.process.communicate()[0]
        found: dict[str, Any] = json.loads(out.splitlines()[-1])
        return found


def viewer(url: str) -> socket.socket:
    """Return a socket that is greeted as a viewer."""
    host, _, port = url.split("/")[2].partition(":")
    link = socket.create_connection((host, int(port)))
    key = base64.b64encode(os.urandom(16)).decode()
    link.sendall(
        f"GET /api/stream HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
    )
    return link


def loop(seconds: float) -> list[Figure]:
    """Return what two viewers, one of whom never reads, cost the loop: they come and go every few seconds."""
    served = Served(seconds + SETTLING, paged=True)
    time.sleep(SETTLING)
    until = time.monotonic() + seconds - 2.0 * SLICE
    while time.monotonic() < until:
        time.sleep(SLICE)
        slow, quick = viewer(served.url), viewer(served.url)
        threading.Thread(target=drain, args=(quick,), daemon=True).start()
        time.sleep(SLICE)
        quick.shutdown(socket.SHUT_RDWR)
        slow.close()
    found = served.end()
    alone, watched = found["alone"], found["watched"]
    what = f"{seconds:.0f} s, in turns of {SLICE:.0f} s, window 0"
    return [
        Figure("page_loop_p99_alone", alone["p99"], "ms", note=what),
        Figure("page_loop_p99_two_viewers", watched["p99"], "ms", LOOP * alone["p99"], note="one never reads"),
        Figure("page_loop_median_alone", alone["median"], "ms"),
        Figure("page_loop_median_two_viewers", watched["median"], "ms"),
        Figure("page_loop_dropped", found["dropped"], "samples", 0.0),
    ]


def drain(link: socket.socket) -> None:
    """Read until the end."""
    while link.recv(1 << 16):
        pass


def drawn(seconds: float) -> list[Figure]:
    """Return what Chromium draws, and what the page takes."""
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    served = Served(seconds, paged=True)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS.split())
        page = browser.new_page(viewport={"width": 1440, "height": 900})
        page.goto(served.url)
        link = page.context.new_cdp_session(page)
        link.send("Performance.enable")
        settling = min(30.0, 0.25 * seconds)
        time.sleep(settling)  # until the twenty seconds that are shown are there
        first, began = memory(page, link), time.monotonic()
        frames, instants = int(page.evaluate("window.towtank.frames")), samples(served.url)
        time.sleep(max(seconds - settling - 15.0, 5.0))
        count = int(page.evaluate("window.towtank.frames")) - frames
        passed = time.monotonic() - began
        rate = (samples(served.url) - instants) / passed
        last = memory(page, link)
        browser.close()
    found = served.end()
    without = Served(min(seconds, COMPARED[1] + 5.0), paged=False).end()
    what = f"{passed:.0f} s of {rate:.0f} samples/s, {found['signals']} signals"
    return [
        Figure("page_frames_drawn", count / passed, "1/s", FRAMES, at_least=True, note=what),
        Figure("page_memory_growth", last - first, "MB", GROWTH, note=f"{passed:.0f} s; {last:.1f} MB at the end"),
        Figure("page_share_of_core", found["cpu"] - without["cpu"], "%", SHARE, note="process with page, less without"),
        Figure("page_thread_share_of_core", found["thread"], "%", SHARE, note="the page's own thread"),
        Figure("page_frames_skipped", found["skipped"], "frames"),
    ]


def memory(page: Any, link: Any) -> float:
    """Return what the page holds after its garbage is collected [MB]: heap, arrays and DOM."""
    for _ in range(2):
        link.send("HeapProfiler.collectGarbage")
    heap = {each["name"]: each["value"] for each in link.send("Performance.getMetrics")["metrics"]}
    arrays = link.send("Runtime.getHeapUsage")
    return (heap["JSHeapUsedSize"] + arrays.get("backingStorageSize", 0.0)) / 1e6


def samples(url: str) -> int:
    """Return how many samples came by now."""
    with urllib.request.urlopen(f"{url.split('?')[0]}api/state") as answer:
        return int(json.loads(answer.read())["samples"])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="in Chromium; 0 leaves it out")
    parser.add_argument("--loop-seconds", type=float, default=300.0, help="of viewers that come and go; 0: none")
    parser.add_argument("--serve", type=float, help=argparse.SUPPRESS)
    parser.add_argument("--paged", action="store_true", help=argparse.SUPPRESS)
    requested, rest = parser.parse_known_args()
    if requested.serve is not None:
        serve(requested.serve, requested.paged)
        return 0

    def figures() -> list[Figure]:
        found = loop(requested.loop_seconds) if requested.loop_seconds else []
        return found + (drawn(requested.seconds) if requested.seconds else [])

    return report("live page", figures, rest)


if __name__ == "__main__":
    sys.exit(main())
