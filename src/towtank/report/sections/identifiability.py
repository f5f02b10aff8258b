"""What the log could tell apart: the correlations of what was learned, as a matrix of names, values and colours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from towtank.core.arrays import Array
from towtank.identification.posterior.estimate import Estimate
from towtank.printable import escaped
from towtank.report.elements import bullets, paragraph, section

__all__ = ["correlation", "heatmap_svg", "identifiability_section", "strongest"]

_CELL, _MARGIN = 44, 88
_DEEPEST = 0.7  # opacity of a whole correlation: the value stays readable on it
_STRONG = 0.9
_TOLD = 6


def correlation(covariance: Array) -> Array:
    """Return the correlations (n, n) of a covariance (n, n)."""
    std = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.clip(covariance / np.outer(std, std), -1.0, 1.0))


def strongest(names: Sequence[str], matrix: Array, least: float) -> list[tuple[str, str, float]]:
    """Return the pairs whose correlation is at least so large, the strongest first."""
    n = len(names)
    found = [
        (names[i], names[j], float(matrix[i, j])) for i in range(n) for j in range(i) if abs(matrix[i, j]) >= least
    ]
    return sorted(found, key=lambda pair: -abs(pair[2]))


def heatmap_svg(names: Sequence[str], matrix: Array) -> str:
    """Return the matrix as an `<svg>` element, a cell for each pair with its value in it."""
    n = len(names)
    width, height = _MARGIN + n * _CELL + 30, _MARGIN + n * _CELL + 4
    out = [
        f'<svg class="heat" viewBox="0 0 {width} {height}" width="{width}" role="img" '
        f'aria-label="Correlations of {escaped(", ".join(names))}">'
    ]
    for i, name in enumerate(names):
        middle = _MARGIN + (i + 0.5) * _CELL
        out.append(f'<text class="ty name" x="{_MARGIN - 8}" y="{middle + 4:.0f}">{escaped(name)}</text>')
        turned = f'transform="translate({middle + 4:.0f} {_MARGIN - 8}) rotate(-45)"'
        out.append(f'<text class="name" {turned}>{escaped(name)}</text>')
        for j in range(n):
            value = float(matrix[i, j])
            if value != value:
                continue
            x, y = _MARGIN + j * _CELL, _MARGIN + i * _CELL
            style = "own" if i == j else "plus" if value >= 0.0 else "minus"
            text = "1" if i == j else "0" if abs(value) < 0.005 else f"{value:+.2f}".replace("-", "−")
            strong = " strong" if abs(value) > 0.6 and i != j else ""
            out.append(
                f"<g><title>{escaped(name)} and {escaped(names[j])}: {value:+.3f}</title>"
                f'<rect class="{style}" x="{x}" y="{y}" width="{_CELL - 2}" height="{_CELL - 2}" rx="3" '
                f'fill-opacity="{_DEEPEST * abs(value):.2f}"/>'
                f'<text class="cell{strong}" x="{x + _CELL / 2 - 1:.0f}" y="{y + _CELL / 2 + 3:.0f}">{text}</text></g>'
            )
    return "".join([*out, "</svg>"])


def identifiability_section(estimate: Estimate) -> str:
    """Return the correlation matrix of what was identified; nothing for fewer than two coefficients."""
    rows = np.flatnonzero(np.array(estimate.identified, dtype=np.bool_))
    if rows.size < 2:
        return ""
    names = [estimate.names[i] for i in rows]
    matrix = correlation(estimate.covariance[np.ix_(rows, rows)])
    pairs = strongest(names, matrix, _STRONG)
    said = [
        f"{a} and {b} are correlated {r:+.3f}: the log tells a combination of them better than each by itself".replace(
            "+-", "-"
        )
        for a, b, r in pairs[:_TOLD]
    ]
    note = (
        "Correlation of the errors of two estimates. Near zero (pale) the log tells them apart. Near +1 (blue) or −1 "
        "(orange) an error in one is balanced by an error in the other; only a more varied run separates them."
    )
    calm = "" if pairs else paragraph(f"No two coefficients are correlated beyond {_STRONG:g}: all are told apart.")
    drawing = f'<figure class="wide" tabindex="0">{heatmap_svg(names, matrix)}</figure>'
    return section("identifiability", "What was told apart", paragraph(note, "note"), drawing, bullets(said), calm)
