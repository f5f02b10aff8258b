"""Which source of a quantity is used, which outputs are thrusters, which pressure is the water's."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.readers.ardupilot.frame import frame_of
from towtank.readers.ardupilot.thruster_outputs import command_source, command_sources, thruster_outputs
from towtank.readers.ardupilot.water_pressure import Pressure, depth_sources
from towtank.readers.common.sources import Source, choose


def source(table: str, samples: int, distance: int = 0, refused: str = "") -> Source:
    t = np.linspace(0.0, 10.0, samples)
    return Source(table, "rates", t, {"p": np.zeros(samples)}, distance, refused)


@pytest.mark.parametrize(
    ("sources", "chosen", "reasons"),
    [
        ([source("near", 100), source("far", 300, 1)], "near", {"far": "near is nearer the sensor"}),
        ([source("near", 100), source("far", 500, 1)], "far", {"near": "far is faster"}),
        ([source("near", 100), source("far", 500, 2)], "near", {"far": "near is nearer the sensor"}),
        ([source("first", 100), source("second", 105)], "first", {"second": "first is used"}),
        ([source("first", 100), source("second", 200)], "second", {"first": "second has more samples"}),
        ([source("bad", 900, refused="why"), source("good", 9)], "good", {"bad": "why"}),
        ([source("few", 3), source("good", 9, 3)], "good", {"few": "3 samples, fewer than 4"}),
    ],
)
def test_nearest_the_sensor_unless_much_slower(sources: list[Source], chosen: str, reasons: dict[str, str]) -> None:
    choice = choose(sources)
    assert [each.table for each in choice.used] == [chosen]
    assert {each.table: why for each, why in choice.reasons} == reasons


def test_one_source_of_each_quantity_in_a_fixed_order() -> None:
    t = np.arange(5.0)
    volt = Source("BAT", "voltage", t, {"voltage": t})
    depth = Source("BARO", "depth", t, {"z": t})
    empty = Source("XKF1", "velocity", t, {"vn": np.full(5, np.nan)})
    choice = choose([volt, empty, depth])
    assert [each.table for each in choice.used] == ["BARO", "BAT"]
    assert [why for _, why in choice.reasons] == ["no value"]


OUTPUTS = {n: np.array([1500.0, 1500.0 + n]) for n in range(1, 7)} | {7: np.zeros(2), 8: np.array([1100.0, 1900.0])}


def test_motors_by_their_functions() -> None:
    parameters = {"SERVO1_FUNCTION": 34.0, "SERVO2_FUNCTION": 33.0, "SERVO8_FUNCTION": 59.0, "SERVO9_FUNCTION": 82.0}
    parameters |= {"MOT_1_DIRECTION": -1.0, "MOT_2_DIRECTION": 1.0}
    found = thruster_outputs(parameters, OUTPUTS)
    assert (found.outputs, found.mirrored) == ({1: 2, 2: 1, 9: 9}, {1})
    assert "thruster 1 turns the other way" in found.note
    assert "outputs 3, 4, 5, 6 move" in found.note
    source = command_source("RCOU", np.arange(2.0), OUTPUTS, found)
    assert source is not None
    assert {name: values.tolist() for name, values in source.channels.items()} == {
        "cmd_1": [1500.0, 1498.0],
        "cmd_2": [1500.0, 1501.0],
    }


def test_throttles_of_a_surface_craft() -> None:
    found = thruster_outputs({"SERVO3_FUNCTION": 74.0, "SERVO1_FUNCTION": 73.0, "SERVO5_FUNCTION": np.nan}, OUTPUTS)
    assert found.outputs == {1: 1, 2: 3}
    assert "left throttle" in found.note


def test_a_reversed_throttle_is_mirrored_so_that_more_is_ahead() -> None:
    parameters = {"SERVO1_FUNCTION": 74.0, "SERVO3_FUNCTION": 73.0, "SERVO1_REVERSED": 1.0, "SERVO3_REVERSED": 0.0}
    found = thruster_outputs(parameters, OUTPUTS)
    assert (found.outputs, found.mirrored) == ({1: 3, 2: 1}, {2})
    assert "right with pulses mirrored about 1500" in found.note


def test_the_frame_is_known_by_its_number() -> None:
    assert frame_of({"FRAME_CONFIG": 2.0}) == {"ardusub_frame": "VECTORED_6DOF"}
    assert frame_of({"FRAME_CONFIG": 7.0}) == frame_of({}) == frame_of({"FRAME_CONFIG": np.nan}) == {}


def test_outputs_that_move_where_nothing_is_known() -> None:
    found = thruster_outputs({}, OUTPUTS)
    assert found.outputs == {n: n for n in range(1, 7)}
    assert "outputs 1 to 6, which move" in found.note
    assert thruster_outputs({}, {1: np.array([1500.0, 1500.0])}).outputs == {}
    assert command_source("RCOU", np.arange(2.0), {}, found) is None


def test_twelve_motors_have_functions_of_their_own_and_other_functions_are_none() -> None:
    functions = [*range(33, 41), *range(82, 86)]
    parameters = {f"SERVO{n}_FUNCTION": float(kind) for n, kind in enumerate([32, *functions, 41, 81, 86], 20)}
    assert thruster_outputs(parameters, {}).outputs == {n: 20 + n for n in range(1, 13)}
    assert thruster_outputs({"SERVO32_FUNCTION": 33.0, "SERVO33_FUNCTION": 34.0}, {}).outputs == {1: 32}


def test_what_is_said_of_motors() -> None:
    functions = {f"SERVO{n}_FUNCTION": 32.0 + n for n in range(1, 4)}
    moving = {n: OUTPUTS[n] for n in range(1, 4)}
    assert thruster_outputs(functions, moving).note == (
        "no MOT_n_DIRECTION among the parameters: no thruster is mirrored"
    )
    assert thruster_outputs(functions | {"MOT_2_DIRECTION": 1.0}, moving).note == ""
    turned = thruster_outputs(functions | {"MOT_1_DIRECTION": -1.0, "MOT_3_DIRECTION": -1.0}, moving)
    assert turned.note == (
        "thrusters 1, 3 turn the other way (MOT_n_DIRECTION -1): pulses mirrored about 1500, as ArduPilot means them"
    )
    alone = thruster_outputs({}, {1: OUTPUTS[1]})
    assert alone.note.endswith("output 1, which moves, is taken for the thrusters in order, none mirrored")
    both = thruster_outputs({"SERVO1_FUNCTION": 73.0, "SERVO1_REVERSED": 1.0, "SERVO2_FUNCTION": 74.0}, {})
    assert both.note.endswith("; left with pulses mirrored about 1500 (SERVOn_REVERSED), so that more is ahead")


def test_outputs_of_two_tables_are_joined_to_one() -> None:
    functions = {f"SERVO{n}_FUNCTION": 32.0 + n for n in (1, 2, 17)} | {"MOT_17_DIRECTION": 1.0, "MOT_1_DIRECTION": 1.0}
    functions["SERVO17_FUNCTION"] = 35.0
    t, later = np.array([0.0, 1.0, 2.0]), np.array([0.5, 1.0, 3.0])
    first = {1: 1500.0 + t, 2: 1600.0 + t}
    main, other = command_sources([("RCO2", later, {17: 1700.0 + later}), ("RCOU", t, first)], functions)
    assert (main.table, list(main.channels), main.t.tolist()) == (
        "RCOU",
        ["cmd_1", "cmd_2", "cmd_3"],
        [0, 0.5, 1, 2, 3],
    )
    np.testing.assert_array_equal(main.channels["cmd_1"], [1500.0, np.nan, 1501.0, 1502.0, np.nan])
    np.testing.assert_array_equal(main.channels["cmd_3"], [np.nan, 1700.5, 1701.0, np.nan, 1703.0])
    assert main.note == "thrusters of RCO2 are joined to those of RCOU"
    assert (other.table, other.refused, other.note) == ("RCO2", "joined to RCOU", "")


def test_outputs_of_three_tables_are_joined_as_well() -> None:
    functions = {f"SERVO{n}_FUNCTION": 32.0 + n for n in (1, 2, 3)}
    t = np.array([0.0, 1.0, 2.0])
    parts = [(name, t, {n: 1500.0 + n + t}) for n, name in enumerate(("A", "B", "C"), 1)]
    main, *others = command_sources(parts, functions)
    assert list(main.channels) == ["cmd_1", "cmd_2", "cmd_3"]
    assert [each.refused for each in others] == ["joined to A", "joined to A"]
    assert "thrusters of B, C are joined to those of A" in main.note


def test_outputs_of_two_tables_stay_apart_where_they_overlap_or_have_no_times() -> None:
    functions = {f"SERVO{n}_FUNCTION": 32.0 + n for n in (1, 2)}
    t = np.array([0.0, 1.0, 2.0])
    one, both = {1: 1500.0 + t}, {1: 1500.0 + t, 2: 1600.0 + t}
    for parts in ([("A", t, one), ("B", t, both)], [("A", t, {2: t}), ("B", np.array([0.0, np.nan, 2.0]), one)]):
        found = command_sources(parts, functions)
        assert [each.refused for each in found] == ["", ""]
    assert [each.table for each in command_sources([("A", t, one), ("B", t, both)], functions)] == ["B", "A"]
    assert [each.table for each in command_sources([("A", t, both)], functions)] == ["A"]


def test_no_output_is_no_command() -> None:
    pulses = {1: np.array([0.0, 1500.0, 65535.0, 1600.0])}
    source = command_source("RCOU", np.arange(4.0), pulses, thruster_outputs({}, pulses))
    assert source is not None
    np.testing.assert_array_equal(source.channels["cmd_1"], [np.nan, 1500.0, np.nan, 1600.0])


@pytest.mark.parametrize(
    ("parameters", "span", "used"),
    [
        ({"BARO_PRIMARY": 0.0}, 400.0, "a"),
        ({"GND_PRIMARY": 0.0}, 400.0, "a"),
        ({"BARO_PRIMARY": 0.0}, 40_000.0, "b"),  # dives, while the primary one does not
        ({}, 400.0, "b"),
        ({"BARO_PRIMARY": 7.0}, 400.0, "b"),
        ({"BARO_PRIMARY": np.nan}, 400.0, "b"),
    ],
)
def test_the_pressure_of_the_water(parameters: dict[str, float], span: float, used: str) -> None:
    t = np.linspace(0.0, 1.0, 5)
    spans = {"a": 10.0, "b": span, "c": 0.0}
    sensors = [Pressure(i, name, t, 1e5 + each * t, t) for i, (name, each) in enumerate(spans.items())]
    assert [each.table for each in depth_sources(sensors, parameters) if not each.refused] == [used]


def test_without_the_pressure_at_the_surface_there_is_no_depth() -> None:
    t = np.arange(5.0)
    [found] = depth_sources([Pressure(1, "SCALED_PRESSURE2", t, 1e5 + t, None)], {})
    assert "BAROn_GND_PRESS" in found.refused
