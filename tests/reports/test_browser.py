"""Reports in a browser: opened from a file without a network, at the widths of a desk and a phone, and printed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.dashboard.rig import grave
from typer.testing import CliRunner

from towtank.app.cli import app
from towtank.errors import InputError
from towtank.report import browser as printing

from .conftest import Made
from .pages import FLAGS, need_browser


@pytest.fixture(scope="module")
def chromium() -> Iterator[object]:
    program = need_browser()
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=program, args=FLAGS)
        yield started
        started.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 1440])
@pytest.mark.parametrize("kind", ["learned", "judged", "planned"])
def test_it_opens_offline_and_fits(
    kind: str, width: int, scheme: str, chromium, request: pytest.FixtureRequest
) -> None:
    made: Made = request.getfixturevalue(kind)
    context = chromium.new_context(viewport={"width": width, "height": 900}, offline=True, color_scheme=scheme)
    page = context.new_page()
    said: list[str] = []
    wanted: list[str] = []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda asked: wanted.append(asked.url))
    page.goto(made.path.as_uri())
    assert said == []
    assert [url for url in wanted if not url.startswith(("file:", "data:"))] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    spilled = page.evaluate(
        """() => [...document.querySelectorAll('h1, h2, p, figure, .scroll, dl, pre, li')]
        .filter(e => e.getBoundingClientRect().right > innerWidth + 0.5).length"""
    )
    assert spilled == 0
    assert grave(page) == []
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (dark == "rgb(15, 20, 25)") is (scheme == "dark")
    context.close()


@pytest.mark.parametrize("kind", ["learned", "judged", "planned"])
def test_nothing_is_wider_than_the_paper(kind: str, chromium, request: pytest.FixtureRequest) -> None:
    made: Made = request.getfixturevalue(kind)
    page = chromium.new_page(viewport={"width": 687, "height": 1000}, color_scheme="dark")  # 182 mm of A4
    page.emulate_media(media="print")
    page.goto(made.path.as_uri())
    cut = "[...document.querySelectorAll('table, figure, svg')].map(e => e.getBoundingClientRect().right)"
    assert max(page.evaluate(cut)) <= 688
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert page.evaluate("getComputedStyle(document.querySelector('.legend i')).display") == "inline-block"
    page.close()


def test_it_prints_on_a_few_pages(learned: Made, logs: Path, tmp_path: Path) -> None:
    need_browser()
    path = tmp_path / "learned.pdf"
    printing.print_pdf(learned.page.html, path)
    data = path.read_bytes()
    assert data.startswith(b"%PDF-")
    assert 2 <= len(re.findall(rb"/Type\s*/Page\b", data)) <= 14
    assert [each.name for each in tmp_path.iterdir()] == ["learned.pdf"]


def test_the_command_writes_a_pdf(logs: Path, tmp_path: Path) -> None:
    need_browser()
    path = tmp_path / "r.pdf"
    words = ["learn", logs / "yaw.csv", "--vehicle", "vlbv300", "--method", "paper", "--free", "N_rdot,N_rr"]
    ran = CliRunner().invoke(app, [*map(str, words), "--delay", "0", "--report", str(path)])
    assert ran.exit_code == 0, ran.stderr
    assert path.read_bytes().startswith(b"%PDF-")
    assert "report written to" in ran.stdout


def test_without_a_browser_it_says_what_to_do_before_any_work(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(printing, "_PLACES", ())
    for words in (["learn", logs / "yaw.csv", "--vehicle", "vlbv300"], ["validate", "vlbv300", logs / "yaw.csv"]):
        ran = CliRunner().invoke(app, [*map(str, words), "--report", str(tmp_path / "r.pdf")])
        assert ran.exit_code == 2
        assert len(ran.stderr.splitlines()) == 1
        assert "install Chromium, Chrome or Edge, or ask for .html" in ran.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "script, why",
    [("echo no display >&2; exit 3", "no display"), ("exit 0", "it said nothing"), ("exec sleep 9", "no answer")],
)
def test_a_browser_that_fails_leaves_nothing(
    script: str, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "bin" / "chromium"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:/bin:/usr/bin")
    monkeypatch.setattr(printing, "_LONGEST", 0.5)
    with pytest.raises(InputError, match=why):
        printing.print_pdf("<p>", tmp_path / "r.pdf")
    assert not (tmp_path / "r.pdf").exists()


@pytest.mark.parametrize(
    "name, expected", [("r.txt", "expected a name that ends in .html or .pdf"), ("no/r.html", "does not exist")]
)
def test_a_place_that_cannot_be_is_refused_at_once(name: str, expected: str, logs: Path, tmp_path: Path) -> None:
    place = tmp_path / name
    for words in (["learn", logs / "yaw.csv", "--vehicle", "vlbv300"], ["validate", "vlbv300", logs / "yaw.csv"]):
        ran = CliRunner().invoke(app, [*map(str, words), "--report", str(place)])
        assert ran.exit_code == 2
        assert expected in ran.stderr
