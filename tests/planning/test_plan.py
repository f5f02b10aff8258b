"""Plans: segments until all is known, files that come back, walls and wishes that cannot be had."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.app.commands import command, document, refused
from tests.conftest import hurry

from towtank import InputError, load_vehicle
from towtank.app.sequences import TOPIC, write_sequence
from towtank.planning import PAUSE, RATE, Plan, Segment, Space, plan, read_plan, write_plan
from towtank.planning.segments import FORMS, changed, commands_of, drawn_segment
from towtank.readers import read
from towtank.report.verdict import plan_notes
from towtank.vehicle import Vehicle, allocatable_axes, thruster_wrench


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return load_vehicle("bluerov2_heavy")


@pytest.fixture(scope="module")
def made(vehicle: Vehicle) -> Plan:
    with hurry():
        return plan(vehicle, space=Space.from_text("5x5x2.5"), minutes=0.3, accuracy=0.02, tries=6, draws=2)


def test_it_ends_with_the_time_and_says_what_is_missing(made: Plan) -> None:
    assert made.manoeuvring == 16.0
    assert not made.met
    assert len(made.expected) == 12
    for each in made.expected:
        assert each.after < each.before
        assert 0.0 < each.low <= each.high
        assert (each.reason == "") == (each.after <= 0.02)
    assert any(each.reason.startswith("no better than 2.") for each in made.expected)
    assert all(0.0 <= each.leaves <= 1.0 for each in made.segments)


def test_it_ends_when_all_is_known(vehicle: Vehicle) -> None:
    found = plan(vehicle, accuracy=0.3, want=("X_udot", "X_uu"), tries=3, draws=1, minutes=2.0)
    assert found.met
    assert len(found.segments) == 1
    assert [each.name for each in found.expected] == ["X_udot", "X_uu"]
    assert all(each.reason == "" for each in found.expected)
    assert found.segments[0].leaves == 0.0  # open water has no walls


def test_it_comes_back_from_its_file(made: Plan, tmp_path: Path) -> None:
    write_plan(made, tmp_path / "plan.toml")
    back = read_plan(tmp_path / "plan.toml")
    assert back.segments == made.segments
    assert back.expected == made.expected
    assert back.space == made.space
    assert back == made
    assert made.room is not None
    assert 0.0 < made.leaves < 1.0


def test_commands_keep_within_the_thrusters_and_rest_between_segments(made: Plan, vehicle: Vehicle) -> None:
    commands = made.commands(vehicle)
    segment, pause = round(8.0 * RATE), round(PAUSE * RATE)
    assert commands.shape == (2 * segment + pause, 8)
    for k, thruster in enumerate(vehicle.thrusters):
        low, high = thruster.curve.limits or (-np.inf, np.inf)
        assert np.all((commands[:, k] >= low) & (commands[:, k] <= high))
        assert np.all(commands[segment : segment + pause, k] == thruster.curve.rest)


@pytest.mark.parametrize("form", FORMS)
def test_a_segment_is_what_its_numbers_say(vehicle: Vehicle, form: str) -> None:
    chance = np.random.default_rng(2)
    found = drawn_segment(vehicle, chance, duration=9.0, form=form)  # type: ignore[arg-type]
    wrench = found.wrench
    assert wrench.shape == (225, 6)
    for row, amplitude in zip(found.rows, found.amplitude, strict=True):
        assert np.abs(wrench[:, row]).max() == pytest.approx(amplitude, rel=0.05)
        assert np.ptp(np.sign(wrench[:, row])) == 2.0
    axes = list(allocatable_axes(vehicle))
    made = thruster_wrench(vehicle, commands_of(found, vehicle))[:, axes]
    asked = wrench[:, axes]
    along = np.einsum("ni,ni->n", made, asked) / (np.linalg.norm(made, axis=1) * np.linalg.norm(asked, axis=1) + 1e-9)
    assert np.median(along) > 0.98
    other = changed(found, chance)
    assert other != found
    assert sum(a != b for a, b in zip(other.switches, found.switches, strict=True)) <= 1


def test_a_telegraph_turns_at_its_switches() -> None:
    found = Segment("telegraph", 8.0, (0,), (5.0,), ((1.0, 3.0),), ((1.0,),))
    x = found.wrench[:, 0]
    t = np.arange(200) / RATE
    np.testing.assert_array_equal(x, np.where((t >= 1.0) & (t < 3.0), -5.0, 5.0))


def test_few_thrusters_are_told_what_they_cannot_have() -> None:
    found = plan(load_vehicle("lauv"), minutes=0.15, tries=3, draws=1)
    reasons = {each.name: each.reason for each in found.expected}
    assert not found.met
    assert reasons["Y_vv"] == "no thruster moves the vehicle in sway; one that pushes along y would"
    assert reasons["X_udot"] == "" or reasons["X_udot"].startswith("would take")


@pytest.mark.usefixtures("hurried")
def test_the_command_and_the_simulation_of_its_plan(tmp_path: Path) -> None:
    place, run = tmp_path / "plan.toml", tmp_path / "run.csv"
    asked = ("plan", "bluerov2_heavy", "--space", "5x5x2.5", "--minutes", 0.15, "--want", "X_udot,X_uu", "-o", place)
    found = document(*asked)
    assert set(found["expected"]) == {"X_udot", "X_uu"}
    assert len(found["segments"]) == 1
    shown = command(*asked)
    assert "8 s of manoeuvring" in " ".join(shown.out.split())
    assert command("simulate", "bluerov2_heavy", place, "-o", run, "--sensors", "mocap").code == 0
    log = read(run)
    assert log.duration == pytest.approx(8.0, abs=0.02)
    assert np.ptp(log["x"].values) > 0.05


def test_a_guarded_plan_keeps_off_the_walls(made: Plan, tmp_path: Path) -> None:
    """Driven twice as far as there is room, else it would not be asked."""
    small = replace(made, space=Space.from_text("2x2x2"))
    write_plan(small, tmp_path / "plan.toml")
    asked = ("simulate", "bluerov2_heavy", tmp_path / "plan.toml", "-o", tmp_path / "run.csv", "--disturbance", 0.5)
    found = document(*asked, "--guard")
    assert found["guard"]["touched"] is False
    assert found["guard"]["nearest_m"] > 0.0
    assert 0.0 < found["guard"]["changed"] <= 1.0
    kept = read(tmp_path / "run.csv")
    radius = Space.from_text("2x2x2").require_room(load_vehicle("bluerov2_heavy"))
    for name in "xy":
        assert np.abs(kept[name].values).max() + radius < 1.0
    assert document(*asked)["guard"] is None
    free = read(tmp_path / "run.csv")
    assert max(np.abs(free[name].values).max() for name in "xy") + radius > 1.0
    assert "is no plan" in refused("simulate", "bluerov2_heavy", "surge-square", "-o", tmp_path / "a.csv", "--guard")
    assert "100 Hz" in refused(*asked, "--guard", "--rate", 50)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--space", "1x1x1"], "needs 1.4 m along x"),
        (["--space", "5x5"], "5x5x2.5"),
        (["--space", "5x5x2.5", "--start", "9,0,1"], "start"),
        (["--start", "0,0,1"], "needs --space"),
        (["--sensors", "sonar"], "there are pose, dvl, gyro-depth"),
        (["--accuracy", "five"], "expected a share such as 5%"),
        (["--want", "X_uuu"], 'did you mean "X_uu"'),
        (["--sequence", "run.bag"], "one without a suffix for the folder of a ROS 2 bag"),
        (["--sequence", "nowhere/run.csv"], "does not exist"),
        (["--minutes", "0"], "--minutes"),
        (["-o", "plan.txt"], ".toml"),
    ],
)
def test_wishes_that_cannot_be_had_are_one_clear_line(words: list[str], said: str) -> None:
    assert said in refused("plan", "bluerov2_heavy", *words)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["rexrov", "--space", "2x2x2"], "m along x with 0.2 m to each wall and 0.4 m to move, found 2 m"),
        (["rexrov", "--space", "2x2x2"], "m at least"),
        (["lauv", "--want", "Y_vv,M_q", "--minutes", 0.1], "Y_vv cannot be had: no thruster moves the vehicle in sway"),
        (
            ["vlbv300", "--sensors", "gyro-depth", "--want", "X_uu", "--minutes", 0.1],
            "X_uu cannot be had: gyro and depth do not measure surge; pose or dvl would",
        ),
    ],
)
@pytest.mark.usefixtures("hurried")
def test_nothing_to_be_had_is_one_clear_line(words: list[str], said: str) -> None:
    assert said in refused("plan", *words)


def test_a_vehicle_of_three_thrusters_is_told_which_are_missing(vehicle: Vehicle) -> None:
    first = vehicle.thrusters[0]
    places = (
        ((-0.2, -0.1, 0.0), (1.0, 0.0, 0.0)),
        ((-0.2, 0.1, 0.0), (1.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    )
    three = tuple(
        first.model_copy(update={"name": f"t{k}", "position": place, "direction": way})
        for k, (place, way) in enumerate(places)
    )
    made = plan(vehicle.model_copy(update={"thrusters": three}), minutes=0.15, tries=3, draws=1)
    notes = plan_notes(made)
    assert "Y_vv: no thruster moves the vehicle in sway; one that pushes along y would" in notes
    assert "K_pp: no thruster moves the vehicle in roll; one that pushes along y or z, off the x axis would" in notes
    assert not any(f"vehicle in {axis};" in each for each in notes for axis in ("surge", "heave", "yaw"))
    assert {each.name for each in made.expected if each.needs < np.inf} >= {"X_udot", "Z_wdot", "N_rdot"}


def test_the_time_that_it_takes_is_foreseen(vehicle: Vehicle) -> None:
    """What a short plan says it would take, a longer one does take."""
    asked = {"want": ("X_uu", "Y_vv"), "accuracy": 0.029, "tries": 6, "draws": 1}
    short, long = (plan(vehicle, minutes=minutes, **asked) for minutes in (0.15, 2.0))  # type: ignore[arg-type]
    foreseen = max(each.needs for each in short.expected)
    assert not short.met
    assert long.met
    assert long.manoeuvring / 1.6 <= foreseen <= 1.6 * long.manoeuvring


def test_what_no_time_makes_known_is_said(vehicle: Vehicle) -> None:
    found = plan(vehicle, want=("X_udot",), accuracy=0.01, minutes=0.15, tries=3, draws=1).expected[0]
    assert "in any time: the thrusters' force is known no better" in found.reason
    assert found.needs == np.inf


@pytest.mark.usefixtures("hurried")
def test_without_a_pose_segments_are_short_and_gentle(vehicle: Vehicle) -> None:
    space = Space.from_text("3x3x2")
    asked = {"space": space, "want": ("X_udot", "Z_wdot"), "tries": 4, "draws": 1, "minutes": 0.1}
    seen, unseen = (plan(vehicle, pose=pose, **asked) for pose in (True, False))  # type: ignore[arg-type]
    assert [each.segment.duration for each in unseen.segments] == [6.0]
    assert (seen.pause, unseen.pause) == (PAUSE, 15.0)
    assert unseen.leaves < seen.leaves
    largest = [max(np.abs(each.segments[0].segment.wrench).max(axis=0)) for each in (seen, unseen)]
    assert largest[1] < largest[0]


@pytest.mark.parametrize("name", ["run.csv", "run.parquet", "run.mcap", "bag"])
def test_a_sequence_is_read_back_and_makes_the_same_motion(
    name: str, made: Plan, vehicle: Vehicle, tmp_path: Path
) -> None:
    write_plan(made, tmp_path / "plan.toml")
    write_sequence(made.sequence(vehicle), vehicle, tmp_path / name)
    mapping = []
    if name == "bag":
        fields = ", ".join(f'"{TOPIC}.data[{k}]"' for k in range(len(vehicle.thrusters)))
        (tmp_path / "map.toml").write_text(f"thrusters = [{fields}]\n")
        mapping = ["--map", tmp_path / "map.toml"]
    else:
        np.testing.assert_allclose(
            np.column_stack([read(tmp_path / name)[f"cmd_{each.name}"].values for each in vehicle.thrusters]),
            made.commands(vehicle),
            atol=1e-6,
        )
    planned, played = tmp_path / "planned.csv", tmp_path / "played.csv"
    assert command("simulate", "bluerov2_heavy", tmp_path / "plan.toml", "-o", planned).code == 0
    ran = command("simulate", "bluerov2_heavy", tmp_path / name, "-o", played, *mapping)
    assert ran.code == 0, ran.err
    first, second = read(planned), read(played)
    assert second.duration == pytest.approx(first.duration, abs=0.011)
    for axis in "uvwpqr":
        n = min(len(first[axis]), len(second[axis]))
        np.testing.assert_allclose(first[axis].values[:n], second[axis].values[:n], atol=1e-5)


@pytest.mark.usefixtures("hurried")
def test_the_command_writes_a_sequence_and_replaces_its_own_bag(tmp_path: Path) -> None:
    asked = ("plan", "bluerov2_heavy", "--minutes", 0.1, "--want", "X_udot", "--sequence", tmp_path / "bag")
    for _ in range(2):
        assert command(*asked).code == 0
    assert {each.name for each in (tmp_path / "bag").iterdir()} == {"bag.db3", "metadata.yaml"}
    (tmp_path / "mine").mkdir()
    assert "is no ROS 2 bag" in refused(*asked[:-1], tmp_path / "mine")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "this is no plan"),
        ("a = [", "not valid TOML"),
        ("segments = []\n[expected]", "this is no plan|found no segments"),
    ],
)
def test_what_is_no_plan_is_said(text: str, said: str, tmp_path: Path, made: Plan) -> None:
    place = tmp_path / "plan.toml"
    place.write_text(text)
    with pytest.raises(InputError, match=said):
        read_plan(place)
    with pytest.raises(InputError, match="no such file"):
        read_plan(tmp_path / "none.toml")
    write_plan(made, place)
    for old, new in (('form = "telegraph"', 'form = "waltz"'), ("duration = 8.0", "duration = -1.0"), ("0.", "nan.")):
        write_plan(made, place)
        place.write_text(place.read_text().replace(old, new, 1))
        with pytest.raises(InputError, match=str(place)):
            read_plan(place)


def test_a_plan_of_another_vehicle_is_driven_and_said(made: Plan, tmp_path: Path) -> None:
    write_plan(replace(made, segments=made.segments[:1]), tmp_path / "plan.toml")
    ran = command("simulate", "bluerov2_heavy_wu", tmp_path / "plan.toml", "-o", tmp_path / "run.csv")
    assert ran.code == 0
    assert "planned for bluerov2_heavy, driven by bluerov2_heavy_wu" in ran.err
