"""Draws the figures of "How far to trust it" from what the studies wrote.

    python benchmarks/studies/figures.py surge.json delay.json coupled.json --output docs/images/trust

From any of the files, those that are given (of an experiment that several have, the last one's): RMSE beside the bound
over time (surge, delay), the times to 5 % beside those of an estimator at the bound (settling), coverage of the 95 %
intervals over time (coverage), the delay found beside its bound (delay-found), all coefficients of the coupled runs at
their end (coupled) and over time (minute).
Vectors (.svg) on white; `--format png` for a look where nothing shows those.
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
from experiments import EXPERIMENTS
from figure_style import (
    BAND,
    DASHED,
    DPI,
    DRAG,
    INK,
    MASS,
    OTHER,
    array,
    band,
    dot,
    dress,
    figure_of,
    finished,
    legend,
    line,
    log_ticks,
    panels_of,
)
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from towtank.core.arrays import Array
from towtank.outputs import write_atomically

COVERAGE, COUPLED_COVERAGE = (0.90, 0.98), (0.85, 0.99)
REST = 0.5  # s
MOST = 0.95  # share of the runs whose times to 5 % a panel shows
KNOWN = 0.5  # share of the runs that must call a coefficient identified for their RMSE to be drawn
AXES = ("#0b6fa4", "#c4461a", "#3d8b37", "#7a4fb0", "#b8860b", "#5b6770")
TITLES = {
    "s1-1mm-stairs": "S1, 1 mm, stairs", "s1-1mm-square": "S1, 1 mm, square wave", "s1-5mm-stairs": "S1, 5 mm, stairs",
    "s1-5mm-square": "S1, 5 mm, square wave", "s2-stairs": "S2, random force, stairs",
    "s2-square": "S2, random force, square wave", "delay-s1-stairs": "S1, 1 mm, stairs",
    "delay-s1-square": "S1, 1 mm, square wave", "delay-s2-stairs": "S2, random force, stairs",
    "delay-s2-square": "S2, random force, square wave", "coupled-pose": "pose",
    "coupled-dvl": "DVL, gyro, depth", "coupled-gyro": "gyro, depth",
}  # fmt: skip


def rmse_figure(parts: Sequence[dict[str, Any]], title: str) -> Figure:
    """Draw RMSE and bound of mass and drag over time, one panel for each experiment."""
    figure, panels = panels_of(len(parts), title)
    for axes, part in zip(panels, parts, strict=False):
        stream = part["stream"]
        t, rmse, bound = array(stream["t"]), _known_rmse(stream), 100.0 * array(stream["bound"])
        least = [np.nanmin(bound[-1], initial=10.0), np.nanmin(rmse[-1], initial=10.0)]
        for i, colour in enumerate((MASS, DRAG)):
            axes.semilogy(t, bound[:, i], color=colour, linewidth=1.1, linestyle=DASHED)
            axes.semilogy(t, rmse[:, i], color=colour, linewidth=1.5)
            batch = [each for each in part["batch"] if each["name"] == stream["names"][i]]
            whole = 100.0 * array([b["rmse"] for b in batch])
            axes.plot([b["t"] for b in batch], whole, "o", color=colour, markersize=5, markeredgecolor="white")
            least.append(np.nanmin(whole, initial=10.0))
        axes.set_xlim(0.0, float(t[-1]))
        axes.set_ylim(0.6 * float(min(least)), 100.0)
        dress(axes, TITLES[part["experiment"]], "%")
        log_ticks(axes)
    first = parts[0]["stream"]
    handles = [
        line(MASS, first["names"][0]), line(DRAG, first["names"][1]),
        line(INK, f"RMSE of {runs_of(parts)} runs, streamed"), dot(INK, "learned from the first seconds as a whole"),
        line(INK, "Cramér-Rao bound", DASHED),
    ]  # fmt: skip
    return finished(figure, panels, handles)


def settling_figure(parts: Sequence[dict[str, Any]]) -> Figure:
    """Draw the share of runs that are within 5 % for good, over time, beside an estimator at the bound."""
    figure, panels = panels_of(len(parts), "Time until mass and drag stay within 5 %")
    for axes, part in zip(panels, parts, strict=False):
        ideal, found = (np.sort(array(part[name], never=np.inf)) for name in ("t5_at_bound", "t5"))
        end = float(array(part["stream"]["t"])[-1]) - REST
        for times, style, colour in ((ideal, DASHED, INK), (found, "-", MASS)):
            share = np.append(np.arange(times.size + 1) / times.size, np.isfinite(times).mean())
            axes.step(
                np.concatenate([[0.0], times, [end]]), share, where="post", color=colour, linewidth=1.5, linestyle=style
            )
        nearly = [np.sort(each[np.isfinite(each)])[: round(MOST * each.size)] for each in (found, ideal)]
        axes.set_xlim(0.0, min(end, 1.1 * max((float(each[-1]) for each in nearly if each.size), default=end)))
        axes.set_ylim(0.0, 1.02)
        dress(axes, TITLES[part["experiment"]], "share of the runs")
    handles = [line(MASS, f"{runs_of(parts)} runs, streamed"), line(INK, "an estimator at the bound", DASHED)]
    return finished(figure, panels, handles, "s since the manoeuvre began")


def coverage_figure(parts: Sequence[dict[str, Any]]) -> Figure:
    """Draw how many of the 95 % intervals hold the truth, over time."""
    figure, panels = panels_of(len(parts), "Share of the 95 % intervals that hold the truth")
    for axes, part in zip(panels, parts, strict=False):
        stream = part["stream"]
        t, held = array(stream["t"]), array(stream["coverage"])
        known = _share_known(stream) >= KNOWN
        axes.axhspan(*COVERAGE, color=BAND, linewidth=0)
        axes.axhline(0.95, color=INK, linewidth=0.6, alpha=0.5)
        for i, colour in enumerate((MASS, DRAG)):
            axes.plot(t, np.where(known[:, i], held[:, i], np.nan), color=colour, linewidth=1.2)
            batch = [each for each in part["batch"] if each["name"] == stream["names"][i]]
            values = array([b["coverage"] for b in batch])
            axes.plot([b["t"] for b in batch], values, "o", color=colour, markersize=5, markeredgecolor="white")
        axes.set_xlim(0.0, float(t[-1]))
        axes.set_ylim(0.5, 1.02)
        dress(axes, TITLES[part["experiment"]], "")
    names = parts[0]["stream"]["names"]
    handles = [
        line(MASS, names[0]), line(DRAG, names[1]), line(INK, "streamed"),
        dot(INK, "learned from the first seconds as a whole"), band("0.90 to 0.98"),
    ]  # fmt: skip
    return finished(figure, panels, handles)


def delay_figure(parts: Sequence[dict[str, Any]]) -> Figure:
    """Draw RMSE and bound of the delay found, without and with a random force."""
    families = [[part for part in parts if part["experiment"].startswith(f"delay-{f}")] for f in ("s1", "s2")]
    families = [family for family in families if family]
    figure, panels = panels_of(len(families), "Error of the delay found, the lag being unknown too")
    handles: list[Line2D] = []
    for axes, family in zip(panels, families, strict=False):
        handles = []
        for part, colour in zip(family, (MASS, DRAG), strict=False):
            bound = part["bound"]
            t, std = array(bound["t"]), 1e3 * array(bound["std"])[:, bound["unknowns"].index("delay")]
            axes.semilogy(t, std, color=colour, linewidth=1.1, linestyle=DASHED)
            rmse = 1e3 * array([each["rmse"] for each in part["delay"]])
            axes.plot([each["t"] for each in part["delay"]], rmse, "o", color=colour, markersize=6)
            handles.append(line(colour, TITLES[part["experiment"]].split(", ")[-1]))
        axes.axhline(20.0, color=INK, linewidth=0.6, alpha=0.5)
        axes.set_xlim(0.0, float(t[-1]))
        axes.set_ylim(0.7, 150.0)
        dress(axes, TITLES[family[0]["experiment"]].rsplit(", ", 1)[0], "ms")
        log_ticks(axes)
    runs = parts[0]["delay"][0]["runs"]
    handles += [
        dot(INK, f"RMSE of {runs} runs, learned as a whole"), line(INK, "Cramér-Rao bound", DASHED),
        line(INK, "20 ms", width=0.6),
    ]  # fmt: skip
    return finished(figure, panels, handles)


def coupled_figure(parts: Sequence[dict[str, Any]]) -> Figure:
    """Draw RMSE and bound of every coefficient at the end of the coupled runs, and their coverage."""
    figure = figure_of(9.6, 6.2, "Thirteen coefficients from one run of 60 s on all axes")
    grid = figure.add_gridspec(2, 1, height_ratios=(2.2, 1.0))
    above, below = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    below.axhspan(*COUPLED_COVERAGE, color=BAND, linewidth=0)
    handles = []
    end = max(each["t"] for each in parts[0]["batch"])
    names = [each["name"] for each in parts[0]["batch"] if each["t"] == end]
    for k, (part, colour) in enumerate(zip(parts, (MASS, DRAG, OTHER), strict=False)):
        last = [each for each in part["batch"] if each["t"] == end]
        x = np.arange(len(last)) + 0.27 * (k - 0.5 * (len(parts) - 1))
        rmse, bound, held = (array([each[field] for each in last]) for field in ("rmse", "bound", "coverage"))
        above.bar(x, 100.0 * rmse, width=0.24, color=colour, alpha=0.85)
        above.hlines(100.0 * bound, x - 0.13, x + 0.13, color=INK, linewidth=2.0)
        below.plot(x, held, "o", color=colour, markersize=5)
        for place, each in zip(x, last, strict=True):
            if each["identified"] < each["runs"]:
                top = 100.0 * max(each["rmse"] or 0.0, each["bound"] or 0.0)
                text = f"{each['identified']} of {each['runs']}"
                above.text(place, 1.12 * top, text, rotation=90, ha="center", va="bottom", fontsize=7.5, color=INK)
        handles.append(line(colour, TITLES[part["experiment"]], width=7))
    above.set_yscale("log")
    dress(above, f"RMSE of {parts[0]['batch'][0]['runs']} runs", "%")
    log_ticks(above)
    low, high = above.get_ylim()
    above.set_ylim(low, 2.0 * high)
    dress(below, "share of the 95 % intervals that hold the truth", "")
    below.set_ylim(0.5, 1.03)
    for axes in (above, below):
        axes.set_xticks(np.arange(len(names)), names, fontsize=7.5)
        axes.set_xlim(-0.6, len(names) - 0.4)
        axes.grid(False, axis="x")
    legend(figure, [*handles, line(INK, "Cramér-Rao bound"), band("0.85 to 0.99")])
    return figure


def minute_figure(part: dict[str, Any]) -> Figure:
    """Draw RMSE and bound of all coefficients over time, streamed: inertias and righting moment, and drags."""
    stream = part["stream"]
    t, rmse, bound = array(stream["t"]), _known_rmse(stream), 100.0 * array(stream["bound"])
    title = "A small ROV's coefficients in one minute, from pose and thruster commands alone"
    figure, panels = panels_of(2, title)
    drags = [k for k, name in enumerate(stream["names"]) if name[0] in "XYZKMN"]
    others = [k for k in range(len(stream["names"])) if k not in drags]
    for axes, group, of in zip(panels, (others, drags), ("inertias, righting moment", "drags"), strict=True):
        for place, k in enumerate(group):
            colour = AXES[place] if place < len(AXES) else INK
            axes.semilogy(t, bound[:, k], color=colour, linewidth=0.9, linestyle=DASHED)
            axes.semilogy(t, rmse[:, k], color=colour, linewidth=1.5, label=stream["names"][k])
        axes.set_xlim(0.0, float(t[-1]))
        axes.set_ylim(0.05, 100.0)
        dress(axes, of, "error, %")
        log_ticks(axes)
        axes.legend(ncols=2, fontsize=7.5, frameon=False, loc="upper right")
    return finished(
        figure, panels, [line(INK, f"RMSE of {stream['runs']} runs"), line(INK, "Cramér-Rao bound", DASHED)]
    )


def draw(document: dict[str, Any]) -> dict[str, Figure]:
    """Return the figures of one study by name, of the experiments that some run came through."""
    parts = [part for part in document["parts"] if part.get("stream", {}).get("t")]
    if not parts:
        return {}
    if document["study"] == "surge":
        return {
            "surge": rmse_figure(parts, "Error of surge mass and drag beside the bound"),
            "settling": settling_figure(parts),
            "coverage": coverage_figure(parts),
        }
    if document["study"] == "delay":
        title = "Error of surge mass and drag where nobody tells the delay of 0.15 s and the lag of 0.10 s"
        return {"delay": rmse_figure(parts, title), "delay-found": delay_figure(parts)}
    if document["study"] != "coupled":
        return {}
    figures = {"coupled": coupled_figure(parts)}
    if parts[0]["experiment"] == "coupled-pose":
        figures["minute"] = minute_figure(parts[0])
    return figures


def _share_known(stream: dict[str, Any]) -> Array:
    return np.asarray(array(stream["identified"]) / stream["runs"])


def _known_rmse(stream: dict[str, Any]) -> Array:
    """Return the RMSE (m, k) [%] at times at which enough of the runs know the coefficient; NaN at others."""
    return np.where(_share_known(stream) >= KNOWN, 100.0 * array(stream["rmse"]), np.nan)


def together(documents: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return one document for each study: of an experiment that several have, the last one's."""
    found: dict[str, dict[str, Any]] = {}
    for each in documents:
        parts = {part["experiment"]: part for part in found.get(each["study"], each)["parts"]}
        parts |= {part["experiment"]: part for part in each["parts"]}
        order = sorted(parts, key=lambda name: EXPERIMENTS.index(name) if name in EXPERIMENTS else -1)
        found[each["study"]] = {**each, "parts": [parts[name] for name in order]}
    return list(found.values())


def runs_of(parts: Sequence[dict[str, Any]]) -> str:
    """Return how many streams the parts have: "80", or "80 to 400"."""
    runs = [int(part["stream"]["runs"]) for part in parts]
    return f"{runs[0]}" if min(runs) == max(runs) else f"{min(runs)} to {max(runs)}"


def main(argv: Sequence[str] | None = None) -> int:
    """Draw what can be drawn from the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("studies", nargs="+", type=Path, help="JSON files that the studies wrote")
    parser.add_argument("--output", type=Path, required=True, help="folder of the figures")
    parser.add_argument("--format", choices=("svg", "png"), default="svg", help="of the figures (default svg)")
    options = parser.parse_args(argv)
    options.output.mkdir(parents=True, exist_ok=True)
    metadata = {"Date": None} if options.format == "svg" else None
    for document in together([json.loads(path.read_text()) for path in options.studies]):
        for name, figure in draw(document).items():
            target = options.output / f"{name}.{options.format}"
            with rc_context({"svg.hashsalt": "towtank", "svg.fonttype": "none"}):
                write = partial(figure.savefig, format=options.format, dpi=DPI, metadata=metadata)
                write_atomically(target, write)
            sys.stdout.write(f"{target}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
