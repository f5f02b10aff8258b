"""Screenshots of the reports for docs/report.md: simulates, learns, judges, and looks with Chromium.

    python docs/shots/report.py [FOLDER]      (default: docs/images/report)

Needs playwright and an installed Chromium or Chrome. Everything is seeded; the pictures are the same every time.
"""

from __future__ import annotations

import io
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, sync_playwright
from typer.testing import CliRunner

from towtank.app.cli import app
from towtank.vehicle import load_vehicle, save_vehicle

FLAGS = [
    *("--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking"),
    *("--disable-component-update", "--disable-sync", "--font-render-hinting=none"),
]
MOST = 200_000  # bytes of a picture


def run(*words: object) -> None:
    result = CliRunner().invoke(app, [str(word) for word in words])
    if result.exit_code:
        sys.exit(result.stderr)


def reports(folder: Path) -> tuple[Path, Path]:
    """Return a report of a learning and one of a validation, made from a simulated session and an unseen one."""
    sensed = ("--sensors", "ins", "--disturbance", 0.3)
    run("simulate", "vlbv300", "tank-session", "-o", folder / "tank.csv", "--duration", 60, *sensed, "--seed", 1)
    run("simulate", "vlbv300", "all-multisine", "-o", folder / "unseen.csv", "--duration", 40, *sensed, "--seed", 2)
    model, learned, judged = folder / "learned.toml", folder / "learned.html", folder / "judged.html"
    started = load_vehicle("vlbv300")
    copied = {name: 0.6 * each.value for name, each in started.hydrodynamics.items()}  # another vehicle's numbers
    save_vehicle(started.with_coefficients(copied), folder / "copied.toml")
    run("learn", folder / "tank.csv", "--vehicle", folder / "copied.toml", "-o", model, "--report", learned)
    run("validate", model, folder / "unseen.csv", "--horizon", 5, "--report", judged)
    return learned, judged


def shot(browser: Browser, page: Path, target: Path, *, width: int, height: int, scheme: str, at: str = "") -> None:
    """Take a picture of a page, from a section on."""
    tab = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme, device_scale_factor=1)  # type: ignore[arg-type]
    tab.goto(page.as_uri())
    if at:
        tab.evaluate("name => document.getElementById(name).scrollIntoView()", at)
        tab.evaluate("scrollBy(0, -18)")
    data = tab.screenshot()
    tab.close()
    image = Image.open(io.BytesIO(data)).convert("RGB").quantize(128, dither=Image.Dither.NONE)
    image.save(target, optimize=True)
    size = target.stat().st_size
    print(f"{target}: {size / 1e3:.0f} kB")
    if size > MOST:
        sys.exit(f"{target}: {size} bytes, more than {MOST}")


def main() -> None:
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent.parent / "images" / "report"
    target.mkdir(parents=True, exist_ok=True)
    program = next((found for name in ("chromium", "google-chrome") if (found := shutil.which(name))), None)
    if program is None:
        sys.exit("no Chromium or Chrome is installed")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        learned, judged = reports(Path(folder))
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        wide = {"width": 1180, "height": 860}
        shot(browser, learned, target / "learned.png", scheme="light", **wide)
        shot(browser, learned, target / "prediction.png", scheme="light", at="prediction", **wide)
        shot(browser, learned, target / "convergence.png", scheme="dark", at="convergence", **wide)
        shot(browser, learned, target / "told_apart.png", scheme="light", at="identifiability", **wide)
        shot(browser, judged, target / "errors.png", scheme="light", at="errors", **wide)
        shot(browser, learned, target / "phone.png", scheme="light", width=390, height=844)
        browser.close()


if __name__ == "__main__":
    main()
