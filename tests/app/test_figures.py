"""Figures: they draw whatever there is, also where something is missing."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from towtank.app.demo.files import Trace, convergence_figure, png, prediction_figure
from towtank.validation import Prediction

SIGNATURE = b"\x89PNG\r\n\x1a\n"
T = np.linspace(0.0, 10.0, 50)


def trace(name: str, truth: float | None, *, known: bool = True) -> Trace:
    values = np.where(T > 2.0, 40.0 + np.exp(-T), np.nan) if known else np.full(T.size, np.nan)
    return Trace(name, "kg", ("surge",), values, 0.1 * np.ones(T.size), truth)


def test_convergence_shows_every_trace_and_an_overview() -> None:
    traces = [trace("m - X_udot", 40.0), trace("X_uu", None), trace("Y_vv", -72.0, known=False)]
    figure = convergence_figure(T, traces, [("surge", 1.0, 4.0)], "title")
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles[:3] == ["m - X_udot", "X_uu", "Y_vv"]
    assert titles[3].startswith("all: error")
    assert any(text.get_text() == "not identified" for text in figure.axes[2].texts)
    assert png(figure).startswith(SIGNATURE)


@pytest.mark.parametrize("count", [1, 4, 5, 13])
def test_any_number_of_traces_finds_its_place(count: int) -> None:
    figure = convergence_figure(T, [trace("m - X_udot", 40.0)] * count)
    assert len(figure.axes) == count + 1


def test_prediction_shows_what_was_measured_with_its_fit() -> None:
    measured = np.where(T > 1.0, np.sin(T), np.nan)
    wild = np.where(T > 5.0, np.inf, np.sin(T))
    channels = {"x": (measured, np.sin(T)), "phi": (measured, wild), "u": (measured, measured)}
    figure = prediction_figure(Prediction(T, channels, (0.0,)), {"x": 99.0, "phi": -999.0}, "title")
    assert len(figure.axes) == 2
    assert "fit 99.0 %" in [text.get_text() for text in figure.axes[0].texts]
    assert "no fit" in [text.get_text() for text in figure.axes[1].texts]
    assert figure.axes[1].get_title(loc="right") == "°"
    assert png(figure).startswith(SIGNATURE)


def test_prediction_without_a_pose_is_an_empty_figure() -> None:
    assert png(prediction_figure(Prediction(T, {}, (0.0,)), {})).startswith(SIGNATURE)


def test_matplotlib_is_imported_on_first_use_only() -> None:
    code = "import sys, towtank.app.demo.files; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
