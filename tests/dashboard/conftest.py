"""One session with its page for all tests of the page, and one browser."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from .rig import CHROMIUM, FLAGS, Rig


@pytest.fixture(scope="package")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    rig = Rig(tmp_path_factory.mktemp("page"))
    rig.start()
    yield rig
    rig.close()


@pytest.fixture(scope="package")
def browser() -> Iterator[object]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()
