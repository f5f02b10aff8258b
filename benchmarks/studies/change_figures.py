"""The figures of the study of changes, from what it wrote.

    python benchmarks/studies/change_figures.py change.json... --output docs/images/changes [--format svg]

`followed`: one surge run through its change. `noticed`: over all runs, after how long a change was noticed.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from change_cases import surge_course
from figure_style import DASHED, DPI, DRAG, INK, MASS, OTHER, dress, figure_of, finished, line
from matplotlib import rc_context
from matplotlib.figure import Figure

from towtank.outputs import write_atomically

CASES = {
    "surge": ("surge alone", MASS, "-"),
    "payload": ("payload, all axes", DRAG, "-"),
    "ballast": ("ballast", OTHER, "-"),
    "righting": ("righting moment", INK, "-"),
    "thruster": ("thruster at 60 %", DRAG, DASHED),
    "known": ("configuration recognised", MASS, DASHED),
}


def followed_figure(seed: int) -> Figure:
    """Draw inertia and drag of one surge run beside the truth, with 95 % bands."""
    course, truth, when, said = surge_course(seed)
    figure = figure_of(8.4, 3.2, "A payload taken up: surge, seconds after the change")
    panels = [figure.add_subplot(1, 2, k + 1) for k in range(2)]
    course = course[::5]
    t = course[:, 0] - when
    for k, (axes, name, unit, colour) in enumerate(
        zip(panels, ("inertia", "drag"), ("kg", "kg/m"), (MASS, DRAG), strict=True)
    ):
        value, std = np.abs(course[:, 1 + k]), course[:, 3 + k]
        axes.fill_between(t, value - 1.96 * std, value + 1.96 * std, color=colour, alpha=0.18, linewidth=0)
        axes.plot(t, value, color=colour, linewidth=1.6)
        axes.step([t[0], 0.0, t[-1]], [truth[0][k], truth[1][k], truth[1][k]], where="post", color=INK, linewidth=0.9,
                  linestyle=DASHED)  # fmt: skip
        axes.axvline(said, color=OTHER, linewidth=1.0)
        axes.set_xlim(-4.0, 10.0)
        span = abs(truth[1][k] - truth[0][k])
        axes.set_ylim(min(truth[0][k], truth[1][k]) - 0.8 * span, max(truth[0][k], truth[1][k]) + 0.8 * span)
        dress(axes, name, unit)
    entries = [line(MASS, "inertia, 95 %"), line(DRAG, "drag, 95 %"), line(INK, "truth", DASHED, 0.9),
               line(OTHER, "noticed", "-", 1.0)]  # fmt: skip
    return finished(figure, panels, entries)


def noticed_figure(document: dict[str, Any]) -> Figure:
    """Draw the share of runs in which each kind of change had been noticed, over the time since."""
    figure = figure_of(6.4, 3.4, "Share of runs in which a change had been noticed")
    axes = figure.add_subplot(1, 1, 1)
    entries = []
    for case, (label, colour, style) in CASES.items():
        if case not in document:
            continue
        key = "onset" if case == "known" else "noticed"
        times = np.sort([np.inf if each[key] is None else float(each[key]) for each in document[case]])
        shown = np.concatenate([[0.0], times[np.isfinite(times)]])
        axes.step(shown, 100.0 * np.arange(shown.size) / times.size, where="post", color=colour, linestyle=style,
                  linewidth=1.5)  # fmt: skip
        entries.append(line(colour, f"{label} ({times.size})", style))
    axes.set_xlim(0.0, 5.0)
    axes.set_ylim(0.0, 101.0)
    dress(axes, "seconds after the change", "%")
    return finished(figure, [axes], entries)


def main(argv: Sequence[str] | None = None) -> int:
    """Draw the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", type=Path, nargs="+", help="what change_study.py --output wrote")
    parser.add_argument("--output", type=Path, required=True, help="folder of the figures")
    parser.add_argument("--format", choices=("svg", "png"), default="svg", help="of the figures (default svg)")
    parser.add_argument("--seed", type=int, default=1001, help="of the run that is drawn (default 1001)")
    options = parser.parse_args(argv)
    document: dict[str, Any] = {}
    for file in options.files:
        document |= json.loads(file.read_text(encoding="utf-8"))
    options.output.mkdir(parents=True, exist_ok=True)
    with rc_context({"svg.hashsalt": "towtank", "svg.fonttype": "none"}):
        metadata = {"Date": None} if options.format == "svg" else None
        figures = {"followed": followed_figure(options.seed), "noticed": noticed_figure(document)}
        for name, figure in figures.items():
            write = partial(figure.savefig, format=options.format, dpi=DPI, metadata=metadata)
            write_atomically(options.output / f"{name}.{options.format}", write)
    return 0


if __name__ == "__main__":
    sys.exit(main())
