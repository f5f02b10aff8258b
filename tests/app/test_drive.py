"""`towtank live --drive`: what it needs before anything is opened, each said in a line."""

from __future__ import annotations

from pathlib import Path

import pytest

from towtank.planning import Accuracy, Plan, Planned, Segment, Space, write_plan

from .commands import command, refused

UDP = "udpin:127.0.0.1:47655"
SEGMENT = Segment("telegraph", 6.0, (0,), (20.0,), ((1.0, 2.0),), ((1.0,),))


def plan(folder: Path, sensors: str = "pose", space: Space | None = None, vehicle: str = "bluerov2_heavy") -> Path:
    place = folder / "plan.toml"
    wanted = (Accuracy("X_uu", 0.5, 0.04, 0.03, 0.05),)
    write_plan(Plan(vehicle, sensors, space, 0.05, (Planned(SEGMENT, (1.0, 0.1, 0.1), 0.0),), wanted), place)
    return place


def drive(*words: object, source: str = UDP, vehicle: str = "bluerov2_heavy") -> str:
    return refused("live", source, "--vehicle", vehicle, "--drive", "--page", "127.0.0.1:0", *words)


def test_it_needs_a_plan() -> None:
    assert "--drive: expected --plan PLAN.toml" in drive()


def test_it_needs_walls(tmp_path: Path) -> None:
    assert "--drive: the plan is for open water; plan with --space" in drive("--plan", plan(tmp_path))


def test_it_needs_a_pose(tmp_path: Path) -> None:
    line = drive("--plan", plan(tmp_path, "dvl", Space.from_text("5x5x2.5")))
    assert "--drive: the plan is for dvl; the guard needs a pose" in line


def test_it_needs_a_vehicle_that_speaks_mavlink(tmp_path: Path) -> None:
    line = drive("--plan", plan(tmp_path, space=Space.from_text("5x5x2.5")), source="json:127.0.0.1:47656")
    assert "--drive: found json:127.0.0.1:47656, expected a MAVLink source" in line


def test_it_needs_a_link_that_it_may_speak_on(tmp_path: Path) -> None:
    line = drive("--plan", plan(tmp_path, space=Space.from_text("5x5x2.5")), source=f"{UDP}?listen")
    assert "?listen, with which nothing may be sent" in line


def test_it_needs_a_vehicle_under_ardusub(tmp_path: Path) -> None:
    line = drive("--plan", plan(tmp_path, space=Space.from_text("9x9x5"), vehicle="vlbv300"), vehicle="vlbv300")
    assert "only vehicles under ArduSub are driven" in line


def test_it_needs_somebody_who_can_hold_a_key(tmp_path: Path) -> None:
    line = refused("live", UDP, "--vehicle", "bluerov2_heavy", "--plan", plan(tmp_path), "--drive", "--json")
    assert "--drive: expected --page, or a terminal" in line


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--drive-by", "joystick"), '--drive-by: found "joystick", expected "manual" or "rc"'),
        (("--drive-limit", "0"), "--drive-limit: found 0, expected more than 0 and at most 100"),
        (("--drive-limit", "nan"), "--drive-limit: found nan, expected more than 0 and at most 100"),
    ],
)
def test_numbers_and_ways_that_cannot_be_are_refused(words: tuple[str, str], said: str) -> None:
    assert said in drive(*words)


def test_the_help_says_where_it_was_tested() -> None:
    words = " ".join(command("live", "--help").out.replace("│", " ").split())
    assert "Tested against simulated vehicles only" in words
