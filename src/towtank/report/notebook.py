"""Charts of a report for notebooks: a piece of a page with a style of its own, for light and dark themes alike."""

from __future__ import annotations

from towtank.report.sections.prediction import prediction_figures
from towtank.validation import Validation

__all__ = ["prediction_html"]

_MOST = 2  # logs that are drawn
_STYLE = """<style>
.towtank { --measured: #9aa5b0; --blue: #2b8fc9; --line: #8886; --faint: #8883; margin-top: 10px; }
.towtank .grid { display: grid; grid-template-columns: repeat(auto-fit, minmax(300px, 1fr)); gap: 8px 14px; }
.towtank figure { margin: 0; min-width: 0; }
.towtank figure svg { display: block; width: 100%; height: auto; }
.towtank figure svg svg { width: unset; height: unset; }
.towtank .head { display: flex; justify-content: space-between; gap: 12px; font-size: 13px; }
.towtank .head small, .towtank .head span, .towtank .legend { font-weight: 400; opacity: .8; }
.towtank .legend span { margin-right: 18px; font-size: 13px; }
.towtank .legend i { display: inline-block; width: 22px; border-top: 3px solid; margin-right: 8px; }
.towtank .legend i { vertical-align: middle; }
.towtank .legend .measured { border-color: var(--measured); }
.towtank .legend .predicted { border-color: var(--blue); }
.towtank .chart text { font-size: 12px; fill: currentColor; opacity: .8; }
.towtank .tx { text-anchor: middle; }
.towtank .ty { text-anchor: end; }
.towtank .chart path { fill: none; }
.towtank .chart .rule { stroke: var(--faint); }
.towtank .chart .zero { stroke: var(--line); }
.towtank .chart .measured { stroke: var(--measured); stroke-width: 2.2; }
.towtank .chart .predicted { stroke: var(--blue); stroke-width: 1.3; }
</style>"""


def prediction_html(scores: Validation) -> str:
    """Return the predicted motion beside the measured one, channel by channel, of the first recordings."""
    figures = prediction_figures(scores.predictions, scores.fit, most=_MOST)
    return f'{_STYLE}<div class="towtank">{figures}</div>' if figures else ""
