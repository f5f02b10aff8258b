"""The screenshots of the live page, made from a demo that runs: docs/images/page/.

    python docs/shots/page.py [--seconds 60] [--output docs/images/page]

Needs the libraries of the page and Chromium. The demo is that of `towtank demo --page`; the shots are taken when so
many of its seconds have passed, with an event marked before.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

LARGEST = 200_000  # bytes
SHOTS = (
    ("desktop-light.png", 1440, 900, "light", "body"),
    ("desktop-dark.png", 1440, 900, "dark", "body"),
    ("phone.png", 390, 844, "light", "body"),
    ("convergence.png", 1440, 900, "light", "#convergence"),
)
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--output", type=Path, default=Path(__file__).resolve().parents[1] / "images" / "page")
    asked = parser.parse_args()
    asked.output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        words = ["demo", "--page", "127.0.0.1:0", "--no-browser", "--output", folder, "--json"]
        demo = subprocess.Popen(
            [sys.executable, "-m", "towtank", *words], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        try:
            assert demo.stderr is not None
            url = next(line.split()[1] for line in demo.stderr if line.startswith("page: "))
            wait(url, 0.4 * asked.seconds)
            mark(url, "tether clear of the thrusters")
            wait(url, asked.seconds)
            shoot(url, asked.output)
        finally:
            demo.terminate()
            demo.wait()
    for path in asked.output.glob("*.png"):
        shrink(path)
    large = [path.name for path in asked.output.glob("*.png") if path.stat().st_size > LARGEST]
    if large:
        print(f"larger than {LARGEST} bytes: {', '.join(large)}", file=sys.stderr)
    return 1 if large else 0


def shrink(path: Path) -> None:
    """Write a picture with 256 colours, which are enough for a page."""
    from PIL import Image

    with Image.open(path) as image:
        small = image.convert("RGB").quantize(256, dither=Image.Dither.NONE)
    small.save(path, optimize=True)


def wait(url: str, t: float) -> None:
    """Wait until the session has come to time t [s]."""
    now = None
    while now is None or now < t:
        time.sleep(0.2)
        with urllib.request.urlopen(f"{url.partition('?')[0]}api/state") as answer:
            now = json.loads(answer.read()).get("t")


def mark(url: str, text: str) -> None:
    """Mark an event."""
    base, _, token = url.partition("?token=")
    body = json.dumps({"text": text}).encode()
    asked = urllib.request.Request(f"{base}api/mark", body, {"Authorization": f"Bearer {token}"})
    urllib.request.urlopen(asked).close()


def shoot(url: str, folder: Path) -> None:
    """Take the screenshots."""
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        for name, width, height, scheme, place in SHOTS:
            size = {"width": width, "height": height if place == "body" else 2600}
            page = browser.new_page(viewport=size, color_scheme=scheme)  # type: ignore[arg-type]
            page.goto(url)
            while not page.evaluate("document.body.dataset.sequence && window.towtank.frames > 15"):
                time.sleep(0.1)
            if place == "body":
                page.screenshot(path=folder / name)
            else:
                page.locator(place).scroll_into_view_if_needed()
                time.sleep(1.5)  # what comes into sight is drawn with the next state
                page.locator(place).screenshot(path=folder / name)
            page.close()
        browser.close()


if __name__ == "__main__":
    sys.exit(main())
