"""Fits to what was learned from."""

from __future__ import annotations

import io

from rich.console import Console

from towtank.app.tables.fits import show_own_fits
from towtank.app.terminal.output import Output


def told(fit: dict[str, float | None]) -> str:
    output = Output()
    output.console = Console(file=io.StringIO(), width=100)
    show_own_fits(fit, output)
    assert isinstance(output.console.file, io.StringIO)
    return output.console.file.getvalue()


def test_speeds_are_told_where_they_are_measured_else_the_pose() -> None:
    both = told({"u": 80.0, "x": -50.0})
    assert "u" in both
    assert "-50" not in both
    pose = told({"u": None, "x": 60.0, "phi": 70.0})
    assert "60" in pose
    assert "70" in pose


def test_positions_that_drift_are_explained() -> None:
    assert "--horizon 10" in told({"u": None, "x": -50.0, "phi": 70.0})
    assert "--horizon" not in told({"u": None, "x": 60.0, "phi": -70.0})
    assert "--horizon" not in told({"u": 10.0, "x": -50.0})
