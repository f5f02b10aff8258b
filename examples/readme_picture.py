"""The picture of the README: the figures of the demo, side by side.

python examples/readme_picture.py [--output docs/images/readme.png]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

HEIGHT = 470
GAP = 24


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw the picture of the README.")
    parser.add_argument("--output", type=Path, default=Path("docs/images/readme.png"))
    output = parser.parse_args().output
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "towtank", "demo", "--fast", "--no-browser", "--output", folder, "--json"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        parts = []
        for name in ("convergence.png", "prediction.png"):
            with Image.open(Path(folder) / name) as image:
                width = round(image.width * HEIGHT / image.height)
                parts.append(image.convert("RGB").resize((width, HEIGHT), Image.Resampling.LANCZOS))
    picture = Image.new("RGB", (sum(part.width for part in parts) + GAP, HEIGHT), "white")
    left = 0
    for part in parts:
        picture.paste(part, (left, 0))
        left += part.width + GAP
    output.parent.mkdir(parents=True, exist_ok=True)
    picture.quantize(128, dither=Image.Dither.NONE).save(output, optimize=True)


if __name__ == "__main__":
    main()
