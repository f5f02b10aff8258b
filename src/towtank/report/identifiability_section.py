"""What the log could tell apart: the correlations of what was learned."""

from __future__ import annotations

import numpy as np

from towtank.identification.estimate import Estimate
from towtank.report.elements import listed, paragraph, section
from towtank.report.heatmap import correlation, heatmap_svg, strongest

__all__ = ["identifiability_section"]

_STRONG = 0.9
_TOLD = 6


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
        "Correlation of the errors of two estimates. Near zero (pale): told apart. Near +1 (blue) or −1 (orange): an "
        "error in one is made up for by the other, and only a more varied run separates them."
    )
    calm = "" if pairs else paragraph(f"No two coefficients are correlated beyond {_STRONG:g}: all are told apart.")
    drawing = f'<figure class="wide">{heatmap_svg(names, matrix)}</figure>'
    return section("identifiability", "What was told apart", paragraph(note, "note"), drawing, listed(said), calm)
