"""The page of a boat that tells its heading alone, while its link is there, dead, and back again; in Chromium."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from towtank.app.live.session import _judge
from towtank.dashboard import About, Address
from towtank.dashboard.live_feed import LiveFeed
from towtank.dashboard.page import Page
from towtank.live import Sample, SourceState
from towtank.live.pipeline.instants import rows_of
from towtank.live.session import Session
from towtank.live.warm_up import new_learner, warm_up
from towtank.recording.event import Event
from towtank.simulation import manoeuvre, simulate
from towtank.vehicle import load_vehicle

from .rig import grave, needs_browser, needs_page, wait_until
from .test_page import until

pytestmark = [needs_page, needs_browser]
NAME = "json:127.0.0.1:5005"
LOST = "The filter had lost itself"
SHOWN, TITLE = "#{} .chart:not([hidden])", "(each) => each.firstChild.textContent"


class Link:
    """Sends heading and commands of a run, in its own time, while it may."""

    name, patient, keeps_time = "test", False, True

    def __init__(self, rows: Sequence[tuple[float, tuple[str, ...], tuple[float, ...]]]) -> None:
        self._rows, self._next, self._began = rows, 0, time.time()
        self.sends = threading.Event()
        self.sends.set()
        self.stopped = 0.0

    def open(self) -> None:
        self._began = time.time()

    def read(self, timeout: float) -> Sequence[Sample]:
        time.sleep(0.02)
        now, found = time.time(), []
        while self._next < len(self._rows) and self._rows[self._next][0] <= now - self._began:
            t, names, values = self._rows[self._next]
            kept = [
                (name, x) for name, x in zip(names, values, strict=True) if name == "psi" or name.startswith("cmd_")
            ]
            self._next += 1
            if kept:
                found.append(Sample("test", "all", self._began + t, now, *map(tuple, zip(*kept, strict=True))))  # type: ignore[arg-type]
        if not self.sends.is_set():
            return []
        if found:
            self.stopped = time.monotonic()
        return found

    def state(self) -> SourceState:
        return SourceState(said=("12 bad, last: not JSON",), rates={"all": 50.0})

    def close(self) -> None:
        pass


class Boat:
    """A session and its page."""

    def __init__(self) -> None:
        self.vehicle = load_vehicle("blueboat")
        plan = manoeuvre("yaw-sine", self.vehicle, duration=300.0, dt=0.02, seed=1)
        run = simulate(self.vehicle, commands=plan.commands, dt=0.02, seed=1)
        self.link = Link(list(rows_of(run)))
        learner: Any = new_learner(self.vehicle, "joint", background=True)
        warm_up(self.vehicle, new_learner(self.vehicle, "joint"), lambda text, share: None)
        self.session = Session([(NAME, self.link)], self.vehicle, learner, epoch=time.time())
        self.judge = _judge(self.session, self.vehicle)
        feed = LiveFeed(self.session, About(NAME, self.vehicle, "joint"), lambda: self.judge.text)
        self.page = Page(feed, Address("127.0.0.1", 0))
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self.session.run, args=(self.stop,))

    @property
    def state(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.page.pump.state)
        return found


@pytest.fixture(scope="module")
def boat() -> Iterator[Boat]:
    boat = Boat()
    boat.session.open()
    boat.thread.start()
    boat.page.start()
    with boat.judge:
        wait_until(lambda: boat.state.get("prediction"), 60.0)
        yield boat
    boat.stop.set()
    boat.thread.join()
    boat.page.close()


@pytest.fixture
def alive(boat: Boat) -> Boat:
    """The boat with its link up."""
    boat.link.sends.set()
    wait_until(lambda: boat.state["state"] == "learning" and boat.state["prediction"])
    return boat


def opened(browser: Any, boat: Boat, **settings: Any) -> Any:
    page = browser.new_context(**{"viewport": {"width": 1440, "height": 2400}, **settings}).new_page()
    page.goto(boat.page.url)
    until(page, "document.body.dataset.sequence && window.towtank.frames > 5")
    return page


def test_what_was_never_measured_has_no_chart_and_the_heading_is_shown(browser: Any, alive: Boat) -> None:
    page = opened(browser, alive)
    until(page, f"document.querySelector('{SHOWN.format('velocity')}')")
    until(page, "document.querySelectorAll('#signals figcaption').length > 3")
    titles = [
        page.evaluate(f"[...document.querySelectorAll('{SHOWN.format(place)} figcaption')].map({TITLE})")
        for place in ("velocity", "signals")
    ]
    assert titles == [["yaw"], ["Attitude", "Force asked for", "Moment asked for", "Commands"]]
    attitude = "window.towtank.charts.find((each) => each.settings.title === 'Attitude')"
    lines = page.evaluate(f"{attitude}.settings.lines.map((line) => line.name)")
    assert lines == ["heading ψ"]
    assert page.inner_text("#attitude").startswith("heading ")
    assert "roll and pitch are not measured" in page.inner_text("#attitude")
    assert page.is_hidden("#track")
    assert "Measured r: slope of the heading" in page.inner_text("#velocity-note")
    rate = alive.page.pump._prediction.run
    assert rate is not None
    assert np.isfinite(rate.rms).tolist() == [False] * 5 + [True]
    page.context.close()


def test_advice_is_of_what_the_thrusters_drive(browser: Any, alive: Boat) -> None:
    page = opened(browser, alive)
    until(page, "document.querySelector('#verdict').textContent.includes('Next: drive ')", 30.0)
    advice = page.inner_text("#verdict").partition("Next: drive ")[2]
    assert "surge" in advice or "yaw" in advice
    assert not any(axis in advice for axis in ("sway", "heave", "roll", "pitch"))
    rows = page.locator("#known tbody tr").all_inner_texts()
    assert ["no thruster" in row for row in rows] == [False, True, True, True, True, False]
    page.context.close()


def test_notes_stand_under_the_verdict_each_once_with_a_count(browser: Any, alive: Boat) -> None:
    for k in range(3):
        alive.session.events.add(Event(float(k), "mended", LOST))
    page = opened(browser, alive, viewport={"width": 360, "height": 800})
    until(page, "document.querySelector('#notes-first').textContent.includes('lost itself')")
    notes = page.locator("#notes-first li").all_inner_texts()
    assert notes.count(f"{LOST} (3 times)") == 1
    assert notes.count("12 bad, last: not JSON") == 1
    assert len(notes) == len(set(notes))
    top = {name: page.evaluate(f"document.querySelector('{name}').getBoundingClientRect().top")
           for name in ("#verdict", "#notes", "#pause", "#known")}  # fmt: skip
    assert sorted(top, key=lambda name: top[name]) == ["#verdict", "#notes", "#pause", "#known"]
    page.context.close()


def test_wide_tables_show_that_they_scroll(browser: Any, alive: Boat) -> None:
    page = opened(browser, alive, viewport={"width": 360, "height": 800})
    box = page.locator("#known .scroll")
    assert box.get_attribute("data-more") == "right"
    assert "transparent" not in box.evaluate("(each) => getComputedStyle(each).getPropertyValue('--right')")
    assert page.is_visible("#known .hint")
    known = "document.querySelector('#known .scroll')"  # it may grow wider when it was scrolled to its end
    until(page, f"(({known}.scrollLeft = 1000), {known}.dataset.more === 'left')")
    page.set_viewport_size({"width": 1440, "height": 900})
    until(page, f"{known}.dataset.more === ''")
    assert page.is_hidden("#known .hint")
    page.context.close()


def until_told(page: Any, boat: Boat) -> float:
    """Cut the link; return the seconds from the last sample until the page says so in all places."""
    boat.link.sends.clear()
    time.sleep(0.05)
    places = ["#verdict", "#link", f"{SHOWN.format('velocity')} .value", "#velocity-note"]
    said = f"{places}.every((each) => document.querySelector(each).textContent.includes('no data since 2 s'))"
    until(page, said, 5.0)
    return time.monotonic() - boat.link.stopped


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_dead_link_shows_within_two_and_a_half_seconds_and_so_does_its_return(
    browser: Any, alive: Boat, scheme: str
) -> None:
    page = opened(browser, alive, color_scheme=scheme)
    assert page.inner_text("#link") == "learning"
    for _ in range(3):  # the browser of a busy machine may be late by itself, but not each time
        taken = until_told(page, alive)
        if taken < 2.5:
            break
        alive.link.sends.set()
        page.wait_for_selector("#link[data-link=open]")
        until(page, "document.querySelector('#velocity .chart:not([hidden]) .value').textContent.startsWith('rms')")
    assert taken < 2.5
    assert page.get_attribute("#link", "data-link") == "silent"
    assert page.get_attribute("#verdict", "data-stale") == "true"
    assert page.inner_text("#verdict") == f"Link lost: no data since 2 s from {NAME}. All figures are as of then."
    until(page, "document.querySelector('#verdict').textContent.includes('no data since 4 s')", 5.0)
    assert alive.state["prediction"] is None
    assert alive.state["no_data_s"] > 4.0
    assert all(each["asked_rms"] == 0.0 for each in alive.state["axes"].values())
    assert "link lost" in page.locator("#events tbody tr").first.inner_text()
    assert grave(page) == []
    alive.link.sends.set()
    page.wait_for_selector("#link[data-link=open]")
    until(page, "document.querySelector('#events tbody tr').textContent.includes('link back after')")
    until(page, "document.querySelector('#velocity .chart:not([hidden]) .value').textContent.startsWith('rms')")
    assert page.get_attribute("#verdict", "data-stale") == "false"
    page.context.close()


def test_a_page_that_hears_nothing_of_the_session_says_so(browser: Any, alive: Boat) -> None:
    page = opened(browser, alive)
    alive.page._loop.call_soon_threadsafe(time.sleep, 4.0)  # type: ignore[union-attr]
    until(
        page,
        "document.querySelector('#verdict').textContent.startsWith('Connection lost: no word from the session since')",
        4.0,
    )
    assert page.inner_text("#link").startswith("no word from the session since")
    until(page, "document.querySelector('#link').dataset.link === 'open'")
    assert page.get_attribute("#verdict", "data-stale") == "false"
    page.context.close()
