"""The report of `towtank plan`: its numbers, its drawings, its words."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from towtank.planning import Accuracy, Plan, Planned, Segment, Space
from towtank.report.plan_drawings import Ellipse, TankView, ellipse_svg, tank_svg, time_line_svg
from towtank.report.verdict import plan_notes, plan_verdict

from .conftest import Made
from .pages import numbers_agree

TANK = Space.from_text("4x4x2")
SEGMENT = Segment("telegraph", 8.0, (0, 5), (12.0, 1.5), ((2.0, 4.0), (6.0,)), ((1.0,), (-1.0,)))


def plan_of(*expected: Accuracy, **changes: Any) -> Plan:
    planned = Planned(SEGMENT, (1.0, 0.5, 0.2), 0.4)
    return replace(Plan("a vehicle", "pose", TANK, 0.05, (planned, planned), expected), **changes)


def test_the_verdict_comes_first_and_every_section_is_there(planned: Made) -> None:
    planned.page.self_contained()
    assert planned.page.sections == ["missing", "accuracy", "segments", "known", "vehicle", "origin"]
    lead = planned.page.html.index('class="lead"')
    assert lead < planned.page.html.index("<section")
    assert f"of manoeuvring, in {len(planned.document['segments'])} segment" in planned.page.text
    for note in planned.document["missing"]:
        assert note.removeprefix("driven").strip() in planned.page.text


def test_every_number_is_that_of_json(planned: Made) -> None:
    keys = numbers_agree(planned.page, planned.document)
    for name in planned.document["expected"]:
        assert {f"expected/{name}/{key}" for key in ("before", "after", "low", "high")} <= keys
    for k in range(len(planned.document["segments"])):
        assert {f"segments/{k}/leaves", *(f"segments/{k}/reached_m/{i}" for i in range(3))} <= keys
    assert {"leaves", "manoeuvring_s"} <= keys


def test_the_page_repeats_the_command_and_names_each_segment(planned: Made) -> None:
    many = len(planned.document["segments"])
    assert "--accuracy 2.9%" in planned.page.html
    assert planned.page.html.count("What each axis is asked<") == many
    assert planned.page.html.count('class="chart tank"') == many
    assert planned.page.html.count("bring it back to the start") == many - 1
    assert planned.page.html.count('class="chart ellipse"') == 2  # surge and yaw


def test_paths_end_at_the_walls_that_they_touch() -> None:
    away = np.linspace(0.0, 3.0, 201)[:, None] * np.array([[1.0, 0.0, 0.0]]) + np.array([0.0, 0.0, 1.0])
    still = np.tile([0.0, 0.0, 1.0], (201, 1))
    svg = tank_svg(TankView(still, np.array([away, still]), TANK, 0.5), "paths")
    assert svg.count('class="touch"') == 2  # from above and from the side
    assert svg.count('class="drawn"') == 2
    metre = (420 - 46 - 12) / 4.0
    crosses = [float(each) for each in re.findall(r'class="touch" d="M([\d.]+) ', svg)]
    assert crosses == pytest.approx([46 + 3.5 * metre - 3.5] * 2, abs=1.6)  # 1.5 m ahead: 0.5 m before the wall
    assert tank_svg(TankView(still, np.array([away]), None, 0.0), "open water").count('class="touch"') == 0


def test_blocks_stand_where_the_axis_is_asked() -> None:
    svg = time_line_svg(SEGMENT, "blocks")
    blocks = re.findall(r'<rect class="(plus|minus)" x="([\d.]+)" y="[\d.]+" width="([\d.]+)"', svg)
    second = (420 - 74 - 12) / 8.0
    assert [each[0] for each in blocks] == ["plus", "minus", "plus", "minus", "plus"]
    starts = [(float(each[1]) - 74.5) / second for each in blocks]
    assert starts == pytest.approx([0.0, 2.0, 4.0, 0.0, 6.0], abs=0.01)
    assert "12 N<" in svg
    assert "1.5 N m<" in svg
    waves = replace(SEGMENT, form="chirp", switches=((0.2, 0.8), (0.2, 0.8)))
    assert time_line_svg(waves, "waves").count('<path class="plus"') > 2


def test_an_ellipse_holds_95_percent() -> None:
    covariance = np.array([[0.0009, -0.0006], [-0.0006, 0.0016]])
    svg = ellipse_svg([Ellipse(100.0 * covariance, "bound"), Ellipse(covariance, "last")], 0.05, ("a", "b"), "known")
    points = np.array(re.findall(r"([\d.]+) ([\d.]+)", re.findall(r'class="last" d="M(.*?)Z"', svg)[0]), dtype=float)
    box = re.findall(r'class="asked" x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)"', svg)[0]
    width, height = float(box[2]), float(box[3])
    assert np.ptp(points[:, 0]) / width == pytest.approx(0.03 / 0.05, rel=0.01)
    assert np.ptp(points[:, 1]) / height == pytest.approx(0.04 / 0.05, rel=0.01)
    middle = np.array([float(box[0]) + 0.5 * width, float(box[1]) + 0.5 * height])
    drawn = np.random.default_rng(1).multivariate_normal([0.0, 0.0], covariance, 4000)
    scale = np.array([width, -height]) / (2.0 * 0.05 * np.sqrt(-2.0 * np.log(0.05)))
    around = points - middle
    angles, reach = np.arctan2(around[:, 1], around[:, 0]), np.hypot(*around.T)
    order = np.argsort(angles)
    placed = drawn * scale
    limit = np.interp(np.arctan2(placed[:, 1], placed[:, 0]), angles[order], reach[order], period=2.0 * np.pi)
    assert np.mean(np.hypot(*placed.T) <= limit) == pytest.approx(0.95, abs=0.012)


def test_what_cannot_be_had_is_one_line_for_each_reason() -> None:
    hidden = "no thruster moves the vehicle in sway"
    made = plan_of(
        Accuracy("X_uu", 0.5, 0.03, 0.02, 0.04),
        Accuracy("Y_vdot", 0.5, 0.4, 0.4, 0.4, hidden, np.inf),
        Accuracy("Y_vv", 0.5, 0.4, 0.4, 0.4, hidden, np.inf),
        Accuracy("N_r", 0.5, 0.09, 0.08, 0.2, "would take about 30 s of manoeuvring", 30.0),
        Accuracy("N_rr", 0.5, 0.1, 0.08, 0.2, "would take about 70 s of manoeuvring", 70.0),
        leaves=0.6,
        room=(5.31, 6.0, 2.44),
    )
    assert plan_verdict(made).grade == "fair"
    assert plan_verdict(made).text.startswith("1 of 5 coefficients that are wanted will be known to 5 %")
    assert plan_notes(made) == [
        "Y_vdot and Y_vv: no thruster moves the vehicle in sway",
        "5 % of N_rr needs about 70 s of manoeuvring, this plan has 16 s (--minutes); 1 more need less",
        "driven as it stands, with nobody steering, it ends at a wall in 60 % of cases: 5.4 x 6 x 2.5 m would hold"
        " 95 %",
    ]


def test_a_plan_that_meets_all_has_nothing_to_say_before() -> None:
    made = plan_of(Accuracy("X_uu", 0.5, 0.03, 0.02, 0.04))
    assert plan_verdict(made).grade == "good"
    assert plan_verdict(made).text == "X_uu will be known to 5 % after 16 s of manoeuvring, in 2 segments."
    assert plan_notes(made) == []
    assert "in any tank" in plan_notes(replace(made, leaves=0.9, room=(np.inf,) * 3))[0]


def test_a_report_of_open_water_and_of_no_pose(make: Any) -> None:
    found = make("open", "plan", "bluerov2_heavy", "--want", "X_udot,X_uu", "--minutes", 0.1, "--no-pose")
    assert "open water" in found.page.text
    assert "Ends at a wall" not in found.page.text
    assert found.document["pose"] is False
    assert found.document["pause_s"] == 15.0
    found.page.self_contained()


def test_a_report_goes_where_it_can_be_written(tmp_path: Path) -> None:
    from tests.app.commands import refused

    said = refused("plan", "bluerov2_heavy", "--report", tmp_path / "plan.txt")
    assert "expected a name that ends in .html or .pdf" in said
