"""The demo's page: one HTML file with figures and table inside."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

from towtank.app.demo_progress import Course
from towtank.app.demo_table import estimate_text
from towtank.digits import short

__all__ = ["demo_page"]

_COLUMNS = ("Coefficient", "Unit", "Truth", "Estimate ± std", "Error %", "in std")
_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.55 system-ui, sans-serif; color: #1b2733; background: #f4f6f8; margin: 0; }
main { max-width: 62rem; margin: 0 auto; padding: 2rem 1.25rem 4rem; }
h1 { font-size: 1.7rem; margin: 0 0 .4rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .6rem; }
p.lead { font-size: 1.1rem; margin: 0 0 1rem; }
figure { margin: 0; background: #fff; border: 1px solid #dfe5ea; border-radius: 8px; padding: .75rem; }
figure img { width: 100%; height: auto; display: block; }
.scroll { overflow-x: auto; background: #fff; border: 1px solid #dfe5ea; border-radius: 8px; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: .35rem .8rem; text-align: right; white-space: nowrap; border-top: 1px solid #edf1f4; }
th { border: 0; font-size: .85rem; color: #5b6874; text-align: right; }
th:first-child, td:first-child, th:nth-child(2), td:nth-child(2) { text-align: left; }
td:nth-child(2) { color: #5b6874; }
pre { background: #1b2733; color: #e9eef2; padding: .9rem 1.1rem; border-radius: 8px; overflow-x: auto; }
code { font: .92em/1.5 ui-monospace, monospace; }
pre i { color: #8fa3b3; font-style: normal; }
.note { color: #5b6874; }
"""


def demo_page(
    verdict: str,
    course: Course,
    figures: Sequence[tuple[str, str, bytes]],
    setting: str,
    commands: Sequence[tuple[str, str]],
) -> str:
    """Return the page.

    Args:
        verdict: one sentence on the accuracy. figures: heading, caption and PNG bytes of each.
        setting: a paragraph on what was simulated. commands: to be typed next, each with what it does before it.
    """
    parts = [
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>towtank demo</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<main>",
        "<h1>A vehicle learned in a simulated tank</h1>",
        f'<p class="lead">{escape(verdict)}</p>',
        f'<p class="note">{escape(setting)}</p>',
        "<h2>Coefficients</h2>",
        _table(course),
        '<p class="note">Rigid body and surrounding water move as one: motion tells only the sum of inertia and added '
        "inertia, so the sum is what is judged here. Inertias, drags and the righting moment are in SI; ± is the "
        "estimate's own standard deviation.</p>",
    ]
    for heading, caption, image in figures:
        data = base64.b64encode(image).decode("ascii")
        parts += [
            f"<h2>{escape(heading)}</h2>",
            f'<figure><img alt="{escape(heading, quote=True)}" src="data:image/png;base64,{data}"></figure>',
            f'<p class="note">{escape(caption)}</p>',
        ]
    lines = "\n".join(f"<i># {escape(purpose)}</i>\n{escape(command)}" for purpose, command in commands)
    parts += ["<h2>Next, in the folder of this page</h2>", f"<pre><code>{lines}</code></pre>"]
    parts += ["</main>\n</body>\n</html>\n"]
    return "\n".join(parts)


def _table(course: Course) -> str:
    head = "".join(f"<th>{name}</th>" for name in _COLUMNS)
    rows = []
    for quantity, value, std in course.latest():
        known = value == value
        cells = (
            quantity.name,
            quantity.unit,
            short(quantity.truth, 5),
            estimate_text(value, std) if known else "not identified",
            f"{100.0 * (value / quantity.truth - 1.0):+.2f}" if known else "",
            f"{abs(value - quantity.truth) / std:.1f}" if known else "",
        )
        rows.append("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>")
    body = "\n".join(rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>'
