"""The demo's page while a payload is taken up, as a person sees it in Chromium."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from towtank.app.demo.feed import DemoFeed
from towtank.app.demo.progress import LearningCurve, quantities
from towtank.app.demo.stream import stream
from towtank.dashboard import Address
from towtank.dashboard.page import Page
from towtank.identification import Learner
from towtank.simulation import tank
from towtank.simulation.tank import FREE, Session, tank_session

from .rig import needs_browser, needs_page, wait_until

pytestmark = [needs_page, needs_browser]

WATCH = """() => {  // counts the moments in which a chart has a line with more points than another
  window.uneven = 0;
  const even = (chart) => chart.data.every((line) => line.length === chart.data[0].length);
  setInterval(() => { if (!window.towtank.charts.every(even)) window.uneven += 1; }, 5);
}"""


@dataclass
class Ran:
    session: Session
    course: LearningCurve
    page: Page
    begin: threading.Event  # what is drawn is what was learned while somebody looked


@pytest.fixture(scope="module")
def ran() -> Iterator[Ran]:
    """What `demo --page --payload --fast` runs to 15 s after the change; the page stays until the tests are done."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tank, "PAYLOAD_TAIL", 30.0)
        session = tank_session(20.0, payload=True)
    learner = Learner(session.known)
    course = LearningCurve(quantities(session.truth, weight=True))
    feed = DemoFeed(session, learner, course)
    page = Page(feed, Address("127.0.0.1", 0), reports=feed.report)
    begin = threading.Event()
    slowly: dict[str, Any] = {"paced": False, "show": lambda _: begin.wait(60.0) and time.sleep(0.05), "watch": feed}
    thread = threading.Thread(target=stream, args=(session, learner, course), kwargs=slowly)
    with page:
        thread.start()
        yield Ran(session, course, page, begin)
        begin.set()
        thread.join()


def test_a_payload_appears_while_it_is_learned(browser: Any, ran: Ran, tmp_path: Path) -> None:
    context = browser.new_context(viewport={"width": 1440, "height": 2200})
    view = context.new_page()
    complaints: list[str] = []
    view.on("pageerror", lambda error: complaints.append(str(error)))
    view.goto(ran.page.url)
    ran.begin.set()
    view.wait_for_selector("#events td:has-text('net weight')", timeout=300_000)
    assert "change: " in view.text_content("#latest-event")
    assert ran.course.events
    when, kind, text = view.locator("#events tbody tr").first.locator("td, th").all_inner_texts()
    assert kind == "change"
    assert "N" in text.partition("net weight +")[2]
    assert when
    later = ran.session.final
    shown = view.locator("#coefficients tbody tr[data-name=Z_ww] :nth-child(5)")
    wait_until(lambda: float(shown.inner_text()) == pytest.approx(later.coefficient("Z_ww"), rel=1e-3))
    known = view.evaluate("document.querySelectorAll('#convergence figure').length")
    assert known >= len(FREE)
    wait_until(lambda: ran.course.t[-1] > ran.session.changed + 6.0, 60.0)  # enough for a prediction
    with view.expect_download() as download:
        view.click("#report")
    path = tmp_path / "report.html"
    download.value.save_as(path)
    report = path.read_text()
    assert "What happened" in report
    assert "net weight +" in report.lower()
    assert "since the vehicle changed" in report
    assert complaints == []
    context.close()


def test_the_course_goes_on_through_the_change(browser: Any, ran: Ran) -> None:
    context = browser.new_context(viewport={"width": 1440, "height": 2200})
    view = context.new_page()
    view.goto(ran.page.url)
    view.evaluate(WATCH)
    ran.begin.set()
    wait_until(lambda: ran.course.t and ran.course.t[-1] > ran.session.changed + 5.0, 60.0)
    place = "document.querySelector('#convergence')"  # the last one of the page: drawn where it is seen
    wait_until(lambda: view.evaluate(f"{place}.scrollIntoView() || !!{place}.querySelector('canvas')"), 90.0)
    view.locator("#convergence figure", has_text="W_minus_B").first.scroll_into_view_if_needed(timeout=60_000)
    find = "window.towtank.charts.find((c) => c.settings.title === 'W_minus_B')"
    whole = f"{find}?.data?.[0]?.[0] < {ran.session.changed} && {find}.data[0].at(-1) >= {ran.session.changed}"
    wait_until(lambda: view.evaluate(whole), 60.0)  # on a busy machine what is newest may be drawn before the rest
    t, _, reference = view.evaluate(f"{find}.data.slice(0, 3)")
    before = [y for x, y in zip(t, reference, strict=True) if x < ran.session.changed]
    after = [y for x, y in zip(t, reference, strict=True) if x >= ran.session.changed]
    assert before
    assert set(before) == {0.0}
    assert set(after) == {2.0}
    assert view.evaluate("window.uneven") == 0
    context.close()
