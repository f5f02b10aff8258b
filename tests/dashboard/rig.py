"""A session with a page, fed in real time from a simulated run."""

from __future__ import annotations

import json
import shutil
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from towtank import load_vehicle
from towtank.dashboard import About, Address
from towtank.dashboard.assets import page_assets
from towtank.dashboard.live_feed import LiveFeed
from towtank.dashboard.page import Page
from towtank.errors import InputError
from towtank.identification import Learner
from towtank.live import Sample, SourceState
from towtank.live.pipeline.instants import rows_of
from towtank.live.session import Session
from towtank.live.warm_up import new_learner
from towtank.recording.event import Event
from towtank.recording.mcap.log import McapLog
from towtank.simulation import Mocap, manoeuvre, simulate
from towtank.vehicle import Vehicle

WEB = Path(__file__).resolve().parents[2] / "web"
AXE = WEB / "node_modules" / "axe-core" / "axe.min.js"
VEHICLE = "seamor"
EPOCH = 1.7e9
SECONDS = 900.0  # more than a module's tests take on a busy machine
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def built() -> bool:
    """Whether the files of the page are there."""
    try:
        page_assets()
    except InputError:
        return False
    return True


needs_page = pytest.mark.skipif(not built(), reason="the live page is not built (web/, npm run build)")
needs_browser = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")


class Paced:
    """A link that hands over a run at its own pace."""

    keeps_time, patient, name = True, False, "simulated"

    def __init__(self, samples: Sequence[Sample]) -> None:
        self._samples, self._next, self._began = samples, 0, 0.0

    def open(self) -> None:
        self._began = time.monotonic()

    def read(self, timeout: float) -> Sequence[Sample]:
        time.sleep(0.01)
        first, now = self._next, time.monotonic() - self._began
        while self._next < len(self._samples) and self._samples[self._next].t - EPOCH <= now:
            self._next += 1
        return self._samples[first : self._next]

    def state(self) -> SourceState:
        return SourceState(rates={"all": 100.0}, ended=self._next >= len(self._samples))

    def close(self) -> None:
        pass


class Noticing:
    """A learner that tells of events, as those do that watch the vehicle."""

    def __init__(self, learner: Learner) -> None:
        self._learner = learner
        self.events: tuple[Event, ...] = ()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._learner, name)


class Rig:
    """A running session and its page."""

    def __init__(
        self, folder: Path, *, title: str = "a tank", vehicle: Vehicle | None = None, link: type[Paced] = Paced
    ) -> None:
        self.vehicle = load_vehicle(VEHICLE) if vehicle is None else vehicle
        plan = manoeuvre("all-multisine", self.vehicle, duration=SECONDS, dt=0.02, seed=1)
        run = simulate(self.vehicle, commands=plan.commands, dt=0.02, sensors=Mocap(rate=50.0), seed=1)
        samples = [Sample("test", "all", EPOCH + t, EPOCH + t, names, values) for t, names, values in rows_of(run)]
        self.learner: Any = Noticing(new_learner(self.vehicle, "joint", ("X_udot", "X_uu", "N_rdot", "N_rr")))
        self.recording = folder / "dive.mcap"
        log = McapLog.open(self.recording)
        self.session = Session([("simulated", link(samples))], self.vehicle, self.learner, epoch=EPOCH, log=log)
        before = {name: self.vehicle.coefficient(name) for name in self.vehicle.hydrodynamics}
        self.about = About(title, self.vehicle, "joint", before)
        self.feed = LiveFeed(self.session, self.about)
        self.told: list[str] = []
        self.page = self.new_page()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self.session.run, args=(self._stop,))

    def new_page(self, port: int = 0, token: str | None = None) -> Page:
        return Page(self.feed, Address("127.0.0.1", port), say=self.told.append, token=token)

    @property
    def base(self) -> str:
        return f"http://{self.page.address.text}"

    def start(self) -> None:
        self.session.open()
        self._thread.start()
        self.page.start()
        wait_until(self._known, 60.0)

    def _known(self) -> bool:
        """Whether everything is known, here and on the page."""
        known = json.loads(self.page.pump.state).get("coefficients", {})
        return bool(known) and all(each["identified"] for each in known.values())

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.page.close()


def grave(page: Any, what: str = "document") -> list[tuple[str, list[str]]]:
    """Return what axe-core finds serious or critical on a page: rule, and the elements; skip where it is not there."""
    if not AXE.exists():
        pytest.skip("axe-core is not installed (web/, npm ci)")
    if not page.evaluate("'axe' in window"):
        page.evaluate(AXE.read_text())
    found = page.evaluate(f"axe.run({what}, {{resultTypes: ['violations']}})")
    assert len(found["passes"]) > 3
    return [
        (each["id"], [node["html"][:150] for node in each["nodes"]])
        for each in found["violations"]
        if each["impact"] in ("serious", "critical")
    ]


def wait_until(told: Callable[[], Any], seconds: float = 60.0) -> None:
    """Wait for something to become true; fail where it does not."""
    deadline = time.monotonic() + seconds
    while not told():
        assert time.monotonic() < deadline, "it did not come about"
        time.sleep(0.02)
