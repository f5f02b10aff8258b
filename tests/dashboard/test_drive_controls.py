"""The drive's switch and key on the page: who may press them, and that signs of the key end with it."""

from __future__ import annotations

import http.client
import time
from collections.abc import Iterator, Mapping
from itertools import pairwise
from statistics import median
from typing import Any

import pytest

from .rig import Rig, needs_browser, needs_page, wait_until

pytestmark = needs_page
ASKED = ("drive-on", "drive-off", "drive-key", "drive-let-go")
PLAN = {
    "stage": "count", "text": "Segment 1 begins in 3.", "clock_s": -3.0, "segment": 1, "planned": 1,
    "duration_s": 8.0, "manoeuvred_s": 0.0, "accuracy": 0.05, "offset_m": [], "axes": [], "movements": [], "known": [],
}  # fmt: skip


class Guide:
    """Says how a drive stands, and notes what is asked and when."""

    def __init__(self) -> None:
        self.stage, self.asked = "ready", list[tuple[float, str]]()

    def document(self) -> Mapping[str, Any]:
        drive = {"stage": self.stage, "text": f"It is {self.stage}.", "held": False, "guarded": False, "walls": "2 m"}
        return {**PLAN, "drive": drive}

    def ask(self, what: str) -> bool:
        self.asked.append((time.monotonic(), what))
        return True

    @property
    def words(self) -> list[str]:
        return [what for _, what in self.asked]


@pytest.fixture
def guide(rig: Rig) -> Iterator[Guide]:
    found = Guide()
    rig.feed._guide = found
    yield found
    rig.feed._guide = None


def post(rig: Rig, name: str, **headers: str) -> int:
    link = http.client.HTTPConnection("127.0.0.1", rig.page.address.port, timeout=30)
    try:
        link.request("POST", f"/api/{name}", b"", headers)
        return link.getresponse().status
    finally:
        link.close()


def test_nobody_drives_without_the_token_or_from_a_foreign_page(rig: Rig, guide: Guide) -> None:
    token = {"Authorization": f"Bearer {rig.page.access.token}"}
    cookie = {"Cookie": f"{rig.page.access.cookie}={rig.page.access.token}"}
    for name in ASKED:
        assert post(rig, name) == 403
        assert post(rig, name, Authorization="Bearer wrong") == 403
        assert post(rig, name, **cookie) == 403
        assert post(rig, name, **cookie, Origin="http://evil.example") == 403
    assert guide.asked == []
    for name in ASKED:
        assert post(rig, name, **token) == 204
    assert guide.words == list(ASKED)


def test_where_nothing_drives_the_controls_do_nothing(rig: Rig) -> None:
    assert post(rig, "drive-on", Authorization=f"Bearer {rig.page.access.token}") == 409


@pytest.fixture
def page(rig: Rig, guide: Guide, browser: Any) -> Iterator[Any]:
    context = browser.new_context()
    found = context.new_page()
    found.goto(f"{rig.base}/?token={rig.page.access.token}")
    found.wait_for_selector("#drive-key:not([disabled])")
    yield found
    context.close()


@needs_browser
@pytest.mark.parametrize("by", ["mouse", "space"])
def test_signs_come_while_the_key_is_down_and_end_with_it(page: Any, guide: Guide, by: str) -> None:
    if by == "mouse":
        page.hover("#drive-key")
    press, release = (
        (page.mouse.down, page.mouse.up)
        if by == "mouse"
        else (
            lambda: page.keyboard.down(" "),
            lambda: page.keyboard.up(" "),
        )
    )
    press()
    time.sleep(1.5)
    release()
    wait_until(lambda: "drive-let-go" in guide.words)
    time.sleep(0.5)
    signs = [at for at, what in guide.asked if what == "drive-key"]
    assert len(signs) >= 10
    assert median(b - a for a, b in pairwise(signs)) < 0.2  # a busy computer may miss some
    assert guide.words[-1] == "drive-let-go"
    assert set(guide.words) == {"drive-key", "drive-let-go"}


@needs_browser
def test_after_a_stop_a_key_that_is_still_down_sends_nothing(page: Any, guide: Guide) -> None:
    page.keyboard.down(" ")
    wait_until(lambda: len(guide.asked) > 3)
    guide.stage = "off"
    page.wait_for_selector("#drive-key[disabled]")
    time.sleep(0.2)
    guide.stage, before = "ready", len(guide.asked)
    page.wait_for_selector("#drive-key:not([disabled])")
    time.sleep(0.5)
    assert len(guide.asked) == before
    page.keyboard.up(" ")


@needs_browser
def test_a_page_that_loses_the_focus_lets_go(page: Any, guide: Guide) -> None:
    page.keyboard.down(" ")
    wait_until(lambda: len(guide.asked) > 3)
    page.evaluate("dispatchEvent(new Event('blur'))")
    wait_until(lambda: "drive-let-go" in guide.words)
    count = len(guide.asked)
    time.sleep(0.4)
    assert len(guide.asked) <= count + 1


@needs_browser
@pytest.mark.parametrize("by", ["m", "?"])
def test_a_key_that_is_let_go_elsewhere_is_let_go(page: Any, guide: Guide, by: str) -> None:
    """The focus goes into a field or a dialog while the key is down: its release is not heard there."""
    page.keyboard.down(" ")
    wait_until(lambda: len(guide.asked) > 3)
    page.keyboard.press(by)
    wait_until(lambda: "drive-let-go" in guide.words)
    count = len(guide.asked)
    time.sleep(0.4)
    assert len(guide.asked) <= count + 1
    page.keyboard.up(" ")
