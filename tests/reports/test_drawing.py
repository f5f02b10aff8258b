"""Charts, heat maps and decimation: nothing is lost, nothing breaks, and an hour's log stays small."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from towtank.identification.offline.convergence import Convergence
from towtank.identification.posterior.estimate import Estimate
from towtank.recording import Recording
from towtank.report import LearnFacts, ValidateFacts
from towtank.report.chart import Band, Chart, Line, Point, Stem, chart_svg, decimated, pieces, ticks
from towtank.report.learn_page import report_html
from towtank.report.sections.identifiability import correlation, heatmap_svg, strongest
from towtank.report.sections.vehicle import thrusters_svg
from towtank.report.validate_page import validate_html
from towtank.validation import CHANNELS, Prediction, score
from towtank.vehicle import load_vehicle

from .pages import Page

HOUR = np.arange(360_000) * 0.01


def test_decimation_keeps_every_extreme() -> None:
    rng = np.random.default_rng(1)
    y = rng.normal(size=HOUR.size)
    y[123_456], y[200_001] = 50.0, -60.0
    x, kept = decimated(HOUR, y, 300, (0.0, 3600.0))
    assert x.size <= 600
    assert np.all(np.diff(x) > 0.0)
    assert {50.0, -60.0} <= set(kept)
    columns = (HOUR / 12.0).astype(int)
    most = np.maximum.reduceat(y, np.flatnonzero(np.diff(columns, prepend=-1)))
    assert set(most) <= set(kept)


def test_short_series_are_drawn_whole() -> None:
    x = np.arange(10.0)
    assert decimated(x, x, 5, (0.0, 9.0))[0].size == 10


def test_lines_break_at_gaps_and_span_slow_sensors() -> None:
    x = np.arange(100.0)
    slow = np.where(x % 5 == 0, 1.0, np.nan)
    assert len(pieces(x, slow)) == 1
    slow[30:80] = np.nan
    assert [part[0].size for part in pieces(x, slow)] == [6, 4]
    assert pieces(x, np.full(100, np.nan)) == []


@given(st.floats(-1e9, 1e9), st.floats(1e-9, 1e9))
def test_ticks_are_few_round_and_inside(low: float, span: float) -> None:
    found = ticks(low, low + span)
    room = 1e-6 * max(abs(low), span)
    assert all(low - room <= value <= low + span + room for value in found)
    assert len(found) <= 12


@pytest.mark.parametrize("scale", [0.0, 1.0, 1e-12, 1e12])
def test_charts_are_well_formed(scale: float) -> None:
    x = np.linspace(0.0, 1.0, 500)
    y = scale * np.sin(9.0 * x)
    y[100:110] = np.nan
    parts = [Band(x, y - 1.0, y + 1.0), Line(x, y, "estimate"), Stem(x[:9], y[:9]), Point(1.0, 0.0, -1.0, 1.0)]
    svg = chart_svg(Chart('<&"', parts, "s", levels=[(0.0, "truth")], cuts=[0.5]))
    tree = ElementTree.fromstring(svg)
    assert tree.attrib["aria-label"] == '<&"'
    assert "nan" not in svg
    assert "inf" not in svg


def test_nothing_to_draw() -> None:
    assert chart_svg(Chart("empty", [])) == ""
    assert chart_svg(Chart("unknown", [Line(np.zeros(3), np.full(3, np.nan), "estimate")])) == ""


def test_what_diverges_stays_in_its_frame() -> None:
    t = np.arange(0.0, 10.0, 0.1)
    channels = {"u": (np.sin(t), np.exp(60.0 * t) * np.where(t > 9.0, np.inf, 1.0))}
    prediction = Prediction(t, channels, (0.0,))
    judged = score([prediction])
    page = Page(validate_html(ValidateFacts("m", load_vehicle("seamor"), judged)))
    page.self_contained()
    assert "diverges" in page.text


def test_correlations() -> None:
    covariance = np.array([[4.0, -1.98, 0.0], [-1.98, 1.0, 0.0], [0.0, 0.0, 9.0]])
    matrix = correlation(covariance)
    assert matrix[0, 1] == pytest.approx(-0.99)
    assert strongest(["a", "b", "c"], matrix, 0.9) == [("b", "a", pytest.approx(-0.99))]
    tree = ElementTree.fromstring(heatmap_svg(["a", "b", "c"], matrix))
    assert "−0.99" in "".join(tree.itertext())


@pytest.mark.parametrize("name", ["vlbv300", "bluerov2_heavy", "seamor", "blueboat", "lauv", "rexrov"])
def test_thrusters_of_every_kind_of_vehicle(name: str) -> None:
    vehicle = load_vehicle(name)
    drawings = thrusters_svg(vehicle)
    assert len(drawings) == (2 if vehicle.thrusters else 0)
    for _, svg in drawings:
        tree = ElementTree.fromstring(svg)
        width, height = (float(v) for v in tree.attrib["viewBox"].split()[2:])
        numbers = [e for e in tree.iter() if e.attrib.get("class") == "hubtext"]
        assert sorted(int(k) for e in numbers for k in (e.text or "").split(", ")) == [
            k + 1 for k in range(len(vehicle.thrusters))
        ]
        assert all(0 < float(e.attrib["x"]) < width and 0 < float(e.attrib["y"]) < height for e in numbers)


def test_an_hour_at_100_hz_stays_below_a_megabyte_and_a_half() -> None:
    rng = np.random.default_rng(2)
    noisy = {name: rng.normal(size=HOUR.size) for name in CHANNELS}
    prediction = Prediction(HOUR, {name: (y, 0.5 * y) for name, y in noisy.items()}, (0.0,), "hour.csv")
    judged = score([prediction])
    names = ("X_udot", "X_uu", "Y_vdot", "Y_vv", "Z_wdot", "Z_ww", "K_pdot", "K_pp", "M_qdot", "M_qq", "N_rdot", "N_rr")
    n = len(names)
    estimate = Estimate(
        names, -np.ones(n), 0.1 * np.ones(n), 0.01 * np.eye(n), (True,) * n, (None,) * n, (), (), 3600.0, HOUR.size
    )
    course = Convergence(names, HOUR[::1800], rng.normal(size=(200, n)), np.ones((200, n)))
    commands = {f"cmd_{k}": np.round(noisy["u"], 1) for k in range(8)}
    recording = Recording.from_table(HOUR, {**noisy, **commands}, source="hour.csv")
    vehicle = load_vehicle("bluerov2_heavy")
    facts = LearnFacts(
        vehicle=vehicle,
        model=vehicle,
        estimate=estimate,
        fit=judged.fit,
        rmse=judged.rmse,
        predictions=[prediction],
        recordings=[recording],
        convergence=course,
    )
    html = report_html(facts)
    assert 100_000 < len(html.encode()) < 1_500_000
    Page(html).self_contained()
    rows = slice(0, 40_000)
    short = Prediction(HOUR[rows], {name: (y[rows], 0.5 * y[rows]) for name, y in noisy.items()}, (0.0,), "part.csv")
    many = report_html(LearnFacts(vehicle, vehicle, estimate, fit=judged.fit, predictions=[short] * 9))
    assert len(many.encode()) < 1_500_000
    assert "3 further logs are not drawn" in Page(many).text
    assert len(validate_html(ValidateFacts("m", vehicle, judged)).encode()) < 1_500_000
