"""The page as a person sees it, in Chromium."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path
from typing import Any

import pytest

from towtank.recording.event import Event
from towtank.vehicle import load_vehicle

from .rig import Rig, grave, needs_browser, needs_page, wait_until

pytestmark = [needs_page, needs_browser]

DESKTOP, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}


def until(page: Any, expression: str, seconds: float = 60.0) -> None:
    """Wait for an expression to become true; Playwright's own way needs `eval`, which the page forbids."""
    deadline = time.monotonic() + seconds
    while not page.evaluate(expression):
        assert time.monotonic() < deadline, expression
        time.sleep(0.03)


class View:
    """A page that is open; what it asks for and complains of is kept."""

    def __init__(self, browser: Any, rig: Rig, **settings: Any) -> None:
        self.rig = rig
        self.context = browser.new_context(**{"viewport": DESKTOP, **settings})
        self.page = self.context.new_page()
        self.asked: list[str] = []
        self.complaints: list[str] = []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("websocket", lambda socket: self.asked.append(socket.url))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", lambda message: self.complaints.append(message.text) if message.type == "error" else 0)
        self.page.goto(rig.page.url)
        until(self.page, "document.body.dataset.sequence && window.towtank.frames > 5")

    def __enter__(self) -> View:
        return self

    def __exit__(self, *_: object) -> None:
        self.context.close()

    def text(self, selector: str) -> str:
        return str(self.page.inner_text(selector))


def test_it_shows_the_numbers_of_the_api_and_asks_nobody_else(browser: Any, rig: Rig) -> None:
    with View(browser, rig) as view:
        compared = 0
        for _ in range(60):  # until page and API are of one moment
            shown, state = view.page.evaluate(
                """async () => {
                    const state = await (await fetch("/api/state")).json();
                    const rows = [...document.querySelectorAll("#coefficients tbody tr")];
                    const cells = rows.map((row) => [...row.children].map((cell) => cell.textContent));
                    return [{sequence: document.body.dataset.sequence, rows: cells,
                             samples: document.querySelector("#numbers dd").textContent,
                             known: document.querySelector("#known tbody td").textContent}, state];
                }"""
            )
            if int(shown["sequence"]) != state["sequence"]:
                continue
            compared += 1
            assert len(shown["rows"]) == 4
            for name, estimate, unit, relative, before in shown["rows"]:
                truth = state["coefficients"][name]
                value, std = (float(part) for part in estimate.split(" ± "))
                places = len(estimate.partition(" ")[0].partition(".")[2])
                assert value == pytest.approx(truth["value"], abs=0.51 * 10**-places)
                assert std == pytest.approx(truth["std"], rel=0.06)
                assert unit == truth["unit"].replace("^2", "²")
                assert float(relative.removesuffix(" %")) == pytest.approx(100 * truth["relative_std"], rel=0.06)
                assert float(before) == pytest.approx(rig.vehicle.coefficient(name), rel=1e-3)
            assert shown["samples"].startswith(f"{state['samples']}, ")
            surge = state["axes"]["surge"]["known"]
            assert float(shown["known"].removesuffix(" %")) == pytest.approx(100 * surge, rel=0.06)
            if compared >= 5:
                break
        assert compared >= 5
        assert view.text("#verdict") == json.loads(rig.page.pump.state)["verdict"]
        assert all(url.startswith((rig.base, rig.base.replace("http", "ws"))) for url in view.asked), view.asked
        assert len(view.asked) > 4
        assert view.complaints == []
        assert "token" not in view.page.url


def test_axes_are_labelled_with_units(browser: Any, rig: Rig) -> None:
    with View(browser, rig, viewport={"width": 1440, "height": 3000}) as view:
        labels = view.page.evaluate("window.towtank.charts.map((c) => [c.settings.title, c.settings.x, c.settings.y])")
        told = {title: y for title, x, y in labels}
        assert {x for _, x, _ in labels} == {"time, s"}
        assert told["surge"] == "u, m/s"
        assert told["yaw"] == "r, °/s"
        assert told["X_uu"] == "kg/m"
        assert told["N_rr"] == "kg m²/rad²"
        assert told["Force asked for"] == "N"
        assert all(y for y in told.values())
        for name in view.page.locator(".chart:visible [role=img]").all():
            assert len(name.get_attribute("aria-label")) > 5


def test_predicted_follows_measured(browser: Any, rig: Rig) -> None:
    with View(browser, rig) as view:
        until(view.page, "document.querySelector('#velocity .value').textContent.startsWith('rms')")
        assert re.fullmatch(r"rms [\d.e-]+ m/s", view.text("#velocity .value"))
        state = json.loads(rig.page.pump.state)
        assert 0.0 < state["prediction"]["rms"][0] < 0.2


def test_events_appear_and_marks_are_made(browser: Any, rig: Rig) -> None:
    with View(browser, rig) as view:
        rig.learner.events = (*rig.learner.events, Event(3.0, "change", "m - X_udot is 4.2 kg more since 3.0 s"))
        view.page.wait_for_selector("#events td:has-text('4.2 kg more')")
        assert "change: m - X_udot is 4.2 kg more" in view.page.text_content("#latest-event")
        view.page.keyboard.press("m")
        view.page.keyboard.type("skid <b>fitted</b>")
        view.page.keyboard.press("Enter")
        view.page.wait_for_selector("#events td:has-text('skid <b>fitted</b>')")
        assert view.page.input_value("#mark-text") == ""
        assert view.complaints == []


def test_learning_is_paused_and_gone_on_with(browser: Any, rig: Rig) -> None:
    with View(browser, rig) as view:
        view.page.click("#pause")
        view.page.wait_for_selector("#link[data-link=paused]")
        wait_until(lambda: rig.session.learning.now.paused)
        assert view.text("#pause") == "Go on learning"
        view.page.locator("h1").click()
        view.page.keyboard.press("p")
        view.page.wait_for_selector("#link[data-link=open]")


def test_without_the_token_it_can_only_be_looked_at(browser: Any, rig: Rig) -> None:
    context = browser.new_context()
    page = context.new_page()
    page.goto(rig.base)
    until(page, "document.body.dataset.sequence")
    assert page.is_disabled("#pause")
    assert page.is_disabled("#mark-text")
    assert page.is_visible("#coefficients tbody tr")
    context.close()


def test_what_is_saved_is_a_vehicle(browser: Any, rig: Rig, tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from towtank.app.cli import app

    with View(browser, rig) as view:
        with view.page.expect_download() as download:
            view.page.click("#model")
        path = tmp_path / download.value.suggested_filename
        download.value.save_as(path)
        assert path.name == "seamor_learned.toml"
        assert load_vehicle(path).coefficient("X_uu") == pytest.approx(
            rig.session.learning.now.estimate["X_uu"].value, rel=0.2
        )
        checked = CliRunner().invoke(app, ["vehicle", "check", str(path), "--json"])
        assert checked.exit_code == 0, checked.output
        with view.page.expect_download() as download:
            view.page.click("#recording")
        assert download.value.suggested_filename == "dive.mcap"
        assert view.page.is_hidden("#report")


def test_it_comes_back_when_the_server_does(browser: Any, rig: Rig) -> None:
    page = rig.new_page().start()
    port, token = page.address.port, page.access.token
    view = View.__new__(View)
    context = browser.new_context()
    view.page = context.new_page()
    view.page.goto(page.url)
    until(view.page, "document.body.dataset.sequence > 1")
    page._server.should_exit = True  # as killed: nobody is told that the session has ended
    page._thread.join(10)
    page._socket.close()
    view.page.wait_for_selector("#link[data-link=lost]")
    assert re.fullmatch(r"no connection, trying again in \d+ s", view.text("#link"))
    assert view.page.is_disabled("#pause")
    again = rig.new_page(port, token).start()
    view.page.wait_for_selector("#link[data-link=open]", timeout=90_000)
    frames = view.page.evaluate("window.towtank.frames")
    until(view.page, f"window.towtank.frames > {frames + 10}")
    assert view.page.is_enabled("#pause")
    again.close()
    view.page.wait_for_selector("#link:has-text('session ended')")
    context.close()


def test_two_look_at_once(browser: Any, rig: Rig) -> None:
    with View(browser, rig) as one, View(browser, rig) as two:
        wait_until(lambda: rig.page.pump.viewers == 2)
        for view in (one, two):
            frames = view.page.evaluate("window.towtank.frames")
            until(view.page, f"window.towtank.frames > {frames + 20}")
            assert view.page.evaluate("document.body.dataset.sequence") != "0"
        assert rig.page.pump.viewers == 2


OVERLAPS = Path(__file__).with_name("overlaps.js").read_text()


@pytest.mark.parametrize("size", [DESKTOP, PHONE], ids=["desktop", "phone"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_overlaps_and_everybody_can_use_it(
    browser: Any, rig: Rig, size: dict[str, int], scheme: str, tmp_path: Path
) -> None:
    with View(browser, rig, viewport=size, color_scheme=scheme) as view:
        rig.session.mark("a long text that tells of many things that happened to the vehicle at this time of the day")
        view.page.wait_for_selector("#events td")
        view.page.evaluate("document.querySelector('#signals').scrollIntoView()")
        view.page.wait_for_selector("#signals canvas")
        found = view.page.evaluate(OVERLAPS)
        assert found == {"found": [], "sticking": [], "wide": 0}
        assert view.page.evaluate("document.documentElement.dataset.theme") == scheme
        view.page.evaluate("scrollTo(0, 0)")
        image = view.page.screenshot(path=tmp_path / "page.png")
        assert len(image) > 20_000
        assert grave(view.page) == []
        view.page.click("#help")
        assert view.page.is_visible("#help-dialog kbd")
        assert grave(view.page, "'#help-dialog'") == []
        view.page.keyboard.press("Escape")


def test_the_keyboard_reaches_every_control(browser: Any, rig: Rig) -> None:
    with View(browser, rig) as view:
        reached = []
        for _ in range(14):
            view.page.keyboard.press("Tab")
            reached.append(view.page.evaluate("document.activeElement.id || document.activeElement.textContent.trim()"))
        for wanted in ("Skip to the coefficients", "pause", "mark-text", "Mark", "model", "recording", "theme", "help"):
            assert wanted in reached, reached
        view.page.click("#verdict")
        before = view.page.evaluate("document.documentElement.dataset.theme")
        view.page.keyboard.press("t")
        assert view.page.evaluate("document.documentElement.dataset.theme") != before
        view.page.reload()
        until(view.page, "document.body.dataset.sequence")
        assert view.page.evaluate("document.documentElement.dataset.theme") != before  # remembered
