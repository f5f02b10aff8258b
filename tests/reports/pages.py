"""Reading a report as a browser would, without one."""

from __future__ import annotations

import json
import re
import shutil
from html.parser import HTMLParser
from typing import Any
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from towtank.app.cli import app

__all__ = ["BROWSER", "FLAGS", "Page", "need_browser", "numbers_agree", "run"]

FLAGS = [
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync"),
]
BROWSER = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), ""
)
SHARES = "expected/"  # in the document; percent on the page
VOID = {"meta", "link", "br", "img", "input", "hr"}


def need_browser() -> str:
    if not BROWSER:
        pytest.skip("no Chromium or Chrome is installed")
    return BROWSER


def run(*words: object) -> dict[str, Any]:
    """Run a command with --json and return its document."""
    result = CliRunner().invoke(app, [*map(str, words), "--json"])
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    assert isinstance(found, dict)
    return found


class Page(HTMLParser):
    """A page taken apart: its text, its sections, its numbers with their keys; open elements must close in order."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.html = html
        self.numbers: list[tuple[str, float, str]] = []
        self.sections: list[str] = []
        self.resources: list[str] = []
        self.elements: list[str] = []
        self._open: list[str] = []
        self._key: tuple[str, float] | None = None
        self.feed(html)
        assert not self._open, self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.elements.append(tag)
        if tag not in VOID:
            self._open.append(tag)
        self.resources += [str(found[name]) for name in ("src", "href", "xlink:href", "data") if name in found]
        if tag == "section":
            self.sections.append(str(found["id"]))
        if "data-value" in found:
            self._key = (found.get("data-key") or "", float(str(found["data-value"])))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self._open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self._key is not None:
            self.numbers.append((*self._key, data))
            self._key = None

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", re.sub(r"<style>.*?</style>|<[^>]+>", " ", self.html, flags=re.S))

    def self_contained(self) -> None:
        """Fail where the page wants anything but itself."""
        assert all(place.startswith(("#", "data:")) for place in self.resources), self.resources
        assert not {"script", "iframe", "object", "embed", "base"} & set(self.elements)
        style = "".join(re.findall(r"<style>(.*?)</style>", self.html, flags=re.S))
        assert "url(" not in style
        assert "@import" not in style
        for svg in re.findall(
            r"<svg class.*?</svg></svg>|<svg class=\"(?:heat|plan)\".*?</svg>", self.html, flags=re.S
        ):
            ElementTree.fromstring(svg)


def numbers_agree(page: Page, document: dict[str, Any]) -> set[str]:
    """Fail where a number of the page is not the document's, to the last bit, or shown otherwise; return the keys."""
    keyed = [(key, value, text) for key, value, text in page.numbers if key]
    for key, value, text in keyed:
        place: Any = document
        for step in key.split("/"):
            step = step.replace("~1", "/").replace("~0", "~")
            place = place[int(step)] if isinstance(place, list) else place[step]
        assert place == value, key
        scale = 100.0 if key.startswith(SHARES) or key == "leaves" or key.endswith("/leaves") else 1.0
        assert rounds_to(scale * value, text), (key, value, text)
    return {key for key, _, _ in keyed}


def rounds_to(value: float, text: str) -> bool:
    """Whether a text is a rounding of the value, in its unit or in thousandths of it (ms)."""
    if text == "diverges":
        return value <= -999.0
    shown = text.replace("−", "-")
    number = float(shown)
    digits = len(shown.partition("e")[0].partition(".")[2])
    step = 10.0**-digits * (10.0 ** int(shown.partition("e")[2]) if "e" in shown else 1.0)
    return any(
        abs(scaled - number) <= 0.5000001 * step + 1e-12 or _whole(scaled, number) for scaled in (value, 1e3 * value)
    )


def _whole(value: float, number: float) -> bool:
    """Whether a whole number is a rounding of the value to two digits or more, as 1230 is of 1234."""
    return number == round(number) and abs(value - number) <= 0.05 * abs(value) and abs(value) >= 10.0
