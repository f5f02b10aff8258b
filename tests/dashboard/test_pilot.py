"""The pilot's mode on the page: now, next and done, in Chromium; the vehicle is simulated while it is driven."""

from __future__ import annotations

import itertools
import json
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from towtank.app.live.coaching import Coaching, plan_document
from towtank.core.arrays import Array
from towtank.dashboard import About, Address
from towtank.dashboard.live_feed import LiveFeed
from towtank.dashboard.page import Page
from towtank.live import Sample, SourceState
from towtank.live.session import Session
from towtank.live.warm_up import new_learner, warm_up
from towtank.planning import Accuracy, Plan, Planned, Segment, Space
from towtank.planning.braking import PERIOD
from towtank.planning.coach import Stage, View
from towtank.planning.guarded import DT, Tank
from towtank.vehicle import Vehicle, allocate, load_vehicle, thruster_forces

from .rig import grave, needs_browser, needs_page, wait_until
from .test_page import until

pytestmark = [needs_page, needs_browser]
SPACE = Space.from_text("6x6x4")
WANTED = ("X_udot", "X_uu", "N_rdot", "N_rr")
SURGE = Segment("telegraph", 6.0, (0, 5), (25.0, 1.5), ((2.0, 4.0), (3.0,)), ((1.0,), (-1.0,)))
POSE = ("x", "y", "z", "phi", "theta", "psi")
TRIES = 6  # few segments are judged: that the search is a good one is asked by the tests of plans
TOO_LATE = 0.3  # s


class Tanked:
    """A link to a simulated vehicle whose pilot does what he is shown, in real time.

    It is seen 25 times a second, of which a busy machine learns in time.
    """

    name, patient, keeps_time = "tank", False, True

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._tank = Tank(vehicle, np.zeros((100_000, 6)), SPACE.eta0)
        self._names = tuple(f"cmd_{each.name}" for each in vehicle.thrusters)
        self._commands: dict[tuple[float, ...], Array] = {}
        self._noise = np.random.default_rng(1)
        self._period, self._began = 0, 0.0
        self.shown: Any = None  # what the pilot sees
        self.drives = True
        self.restless = False  # moves the sticks to and fro until the count-down
        self.late = 0.0  # s at most that a period was driven late: where the machine stalls, movements are missed

    def open(self) -> None:
        self._began = time.time()

    def _asked(self) -> Array:
        """Return the commands; those of a movement are allocated once, since that takes milliseconds."""
        wrench = np.zeros(6)
        view: View | None = None if self.shown is None else self.shown()
        for row in range(6 if view is not None and self.drives else 0):
            now, _ = view.now_and_next(row)  # type: ignore[union-attr]
            wrench[row] = 0.0 if now is None else now.force
        if self.restless and view is not None and view.stage is Stage.BRING:
            wrench[1] = 20.0 if self._period // 10 % 2 else -20.0
        key = tuple(wrench.tolist())
        if key not in self._commands:
            self._commands[key] = allocate(self._vehicle, wrench)
        return self._commands[key]

    def read(self, timeout: float) -> Sequence[Sample]:
        time.sleep(0.02)
        out = []
        while self._began + (self._period + 1) * PERIOD <= time.time():
            at = self._began + self._period * PERIOD
            self.late = max(self.late, time.time() - at - PERIOD)
            commands = self._asked()
            out.append(Sample("tank", "commands", at, at, self._names, tuple(commands.tolist())))
            row = self._tank.period(self._period, thruster_forces(self._vehicle, commands))[-1]
            pose = self._tank.pose(row) + 1e-3 * self._noise.standard_normal(6)
            t = self._began + row * DT
            out.append(Sample("tank", "pose", t, t, POSE, tuple(pose.tolist())))
            self._period += 1
        return out

    def state(self) -> SourceState:
        return SourceState(rates={"pose": 1.0 / PERIOD})

    def close(self) -> None:
        pass


class Led:
    """A session that is led through a plan, and its page."""

    def __init__(self, plan: Plan | None) -> None:
        self.vehicle = load_vehicle("bluerov2_heavy")
        self.link = Tanked(self.vehicle)
        warm_up(self.vehicle, new_learner(self.vehicle, "joint", WANTED), lambda text, share: None)
        learner: Any = new_learner(self.vehicle, "joint", WANTED, background=True, changes=False)
        self.session = Session([("tank", self.link)], self.vehicle, learner, epoch=time.time())
        self.coaching = Coaching(self.session, self.vehicle, plan, tries=TRIES)
        self.link.shown = self.coaching.view
        feed = LiveFeed(self.session, About("tank", self.vehicle, "joint"), guide=self.coaching)
        self.page = Page(feed, Address("127.0.0.1", 0))
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.session.run, args=(self.stop,))

    @property
    def plan(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.page.pump.state).get("plan") or {}
        return found

    def __enter__(self) -> Led:
        self.session.open()
        self.thread.start()
        self.page.start()
        self.coaching.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.coaching.__exit__(None, None, None)
        self.stop.set()
        self.thread.join()
        self.page.close()


@pytest.fixture(scope="module")
def led() -> Iterator[Led]:
    expected = tuple(Accuracy(name, 0.5, 0.05, 0.05, 0.05, "") for name in WANTED)
    planned = Planned(SURGE, (1.0, 0.1, 0.1), 0.0)
    with Led(Plan("bluerov2_heavy", "pose", SPACE, 0.002, (planned, planned), expected, by_hand=True)) as led:
        led.link.restless = True
        wait_until(lambda: led.plan, 60.0)
        yield led


def rows(page: Any) -> list[list[str]]:
    """Return the table of movements as it stands."""
    found: list[list[str]] = page.evaluate(
        "[...document.querySelectorAll('#plan tbody tr')].map((row) => [...row.children].map((cell) => cell.innerText))"
    )
    return found


@contextmanager
def driven_in_time(led: Led) -> Iterator[None]:
    """Skip what fails while the vehicle is driven late, as where the machine stalls: movements are missed then."""
    led.link.late = 0.0
    try:
        yield
    except AssertionError:
        if led.link.late > TOO_LATE:
            pytest.skip(f"the machine stalled for {led.link.late:.1f} s while the vehicle was driven")
        raise


def test_the_page_leads_through_a_segment(browser: Any, led: Led) -> None:
    page = browser.new_context(viewport={"width": 1440, "height": 900}).new_page()
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(led.page.url)
    until(page, "document.body.dataset.sequence && !document.querySelector('#plan').hidden", 30.0)
    first = rows(page)
    assert [row[0] for row in first] == ["surge", "yaw"]
    assert first[0][3].startswith("forward ")
    assert first[1][3].startswith("turn left ")
    with driven_in_time(led):
        page.click("#plan-begin")
        until(page, "/begins in [1-5]/.test(document.querySelector('#plan-text').innerText)")
        until(page, "document.querySelector('#plan').dataset.stage === 'drive'")
        now = rows(page)
        assert now[0][1].startswith("forward ")
        assert 0.0 < float(now[0][2]) <= 2.0
        assert now[0][3].startswith("back ")
        until(page, "document.querySelector('#plan tbody tr').children[1].innerText.startsWith('back ')")
        assert grave(page, "'#plan'") == []
        until(page, "document.querySelector('#plan tbody tr').children[5].innerText.startsWith('1 of ')")
        until(page, "document.querySelector('#plan-note').innerText.includes('Segment 2')", 120.0)
        wait_until(lambda: any(event.text.startswith("segment 1 driven") for event in led.session.events.all))
        texts = [event.text for event in led.session.events.all]
        assert "segment 1 begins" in texts
        assert "segment 1 driven: 5 of 5 movements done" in texts
    assert complaints == []
    page.context.close()


@pytest.mark.parametrize("width", [360, 1440])
def test_nothing_lies_over_anything(browser: Any, led: Led, width: int) -> None:
    page = browser.new_context(viewport={"width": width, "height": 900}).new_page()
    page.goto(led.page.url)
    until(page, "document.body.dataset.sequence && !document.querySelector('#plan').hidden", 30.0)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    parts = "['#plan-text', '#plan .buttons', '#plan .scroll', '#plan-line', '#plan-known', '#plan-note']"
    boxes = f"{parts}.map((each) => document.querySelector(each).getBoundingClientRect())"
    until(page, f"{boxes}.slice(1, -1).every((box) => box.height > 0)", 120.0)  # the next segment may be sought now
    sizes = page.evaluate(f"{boxes}.map((box) => [box.top, box.bottom])")
    for (_, bottom), (top, _) in itertools.pairwise(sizes[1:]):
        assert top >= bottom - 0.5
    table = "document.querySelector('#plan .scroll')"
    assert page.evaluate(f"{table}.scrollWidth <= {table}.clientWidth")  # what comes next is in sight
    page.context.close()


def test_without_a_token_nobody_begins(browser: Any, led: Led) -> None:
    page = browser.new_context().new_page()
    page.goto(led.page.url.partition("?")[0])
    until(page, "document.body.dataset.sequence")
    assert page.evaluate("document.querySelector('#plan-begin').disabled")
    status = page.evaluate("fetch('api/begin', {method: 'POST'}).then((answer) => answer.status)")
    assert status in (401, 403)
    page.context.close()


def test_without_a_plan_the_page_says_what_narrows_most(browser: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("towtank.app.live.coaching._FIRST", 3.0)
    with Led(None) as led:
        led.link.drives = False
        wait_until(lambda: led.plan.get("movements"), 90.0)
        assert led.plan["stage"] == "bring"
        assert led.plan["text"].endswith("then press Begin.")
        page = browser.new_context().new_page()
        page.goto(led.page.url)
        until(page, "document.body.dataset.sequence && !document.querySelector('#plan').hidden")
        assert rows(page)
        monkeypatch.setattr("towtank.app.live.coaching.plan_document", lambda view: plan_document(view) | {"axes": []})
        until(page, "document.querySelector('#plan thead').getBoundingClientRect().height === 0")  # all is known
        page.context.close()
