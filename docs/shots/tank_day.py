"""Pictures for docs/tank-day.md: plans, and looks at the report with Chromium.

    python docs/shots/tank_day.py [FOLDER]      (default: docs/images/tank-day)

Needs playwright and an installed Chromium or Chrome. Everything is seeded; the pictures are the same every time.
"""

from __future__ import annotations

import io
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright
from typer.testing import CliRunner

from towtank.app.cli import app

FLAGS = [
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--font-render-hinting=none"),
]
MOST = 200_000  # bytes of a picture
SHOTS = {  # name -> from the top of the first element to the bottom of the last
    "verdict.png": (".kind", "#accuracy .scroll"),
    "segment.png": ("#segments h3", "#segments .grid.pair"),
    "ellipses.png": ("#known h2", "#known .grid"),
}


def report(folder: Path) -> Path:
    """Return the report of a plan for a pilot."""
    page = folder / "plan.html"
    words = ["plan", "bluerov2_heavy", "--space", "5x5x2.5", "--by-hand", "--minutes", "1", "--report", str(page)]
    result = CliRunner().invoke(app, words)
    if result.exit_code:
        sys.exit(result.stderr)
    print(result.stdout)
    return page


def shot(page: Page, target: Path, first: str, last: str) -> None:
    """Take a picture of a part of the page, with 128 colours."""
    box = page.evaluate(
        """([first, last]) => {
            const a = document.querySelector(first).getBoundingClientRect()
            const b = document.querySelector(last).getBoundingClientRect()
            return [scrollY + a.top, scrollY + b.bottom]
        }""",
        [first, last],
    )
    main = page.evaluate(
        "(() => { const m = document.querySelector('main').getBoundingClientRect(); return m.width })()"
    )
    clip = {"x": 0, "y": box[0] - 14, "width": main, "height": box[1] - box[0] + 28}
    data = page.screenshot(full_page=True, clip=clip)  # type: ignore[arg-type]
    image = Image.open(io.BytesIO(data)).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    image.save(target, optimize=True)
    size = target.stat().st_size
    print(f"{target}: {size / 1e3:.0f} kB")
    if size > MOST:
        sys.exit(f"{target}: {size} bytes, more than {MOST}")


def main() -> None:
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent.parent / "images" / "tank-day"
    target.mkdir(parents=True, exist_ok=True)
    program = next((found for name in ("chromium", "google-chrome") if (found := shutil.which(name))), None)
    if program is None:
        sys.exit("no Chromium or Chrome is installed")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        place = report(Path(folder))
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        page = browser.new_page(viewport={"width": 1080, "height": 900}, color_scheme="light", device_scale_factor=1)
        page.goto(place.as_uri())
        for name, (first, last) in SHOTS.items():
            shot(page, target / name, first, last)
        browser.close()


if __name__ == "__main__":
    main()
