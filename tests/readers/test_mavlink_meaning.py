"""What single messages of MAVLink mean, in their units and from their fields."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.readers.ardupilot.aiding import Evidence, aiding_of
from towtank.readers.common.sources import Source
from towtank.readers.common.tables import Table
from towtank.readers.mavlink.meaning import pressures_of, pulses_of, sources_of_messages

T = np.arange(4.0)
SENSED = aiding_of(Evidence(velocity=("VISO",), position=("VISP",)))
ALONE = aiding_of(Evidence())


def table(name: str, **columns: float | list[float] | Array) -> Table:
    return Table(name, T, {each: np.asarray(values, dtype=float) + 0.0 * T for each, values in columns.items()})


def told(found: list[Source]) -> dict[str, dict[str, float]]:
    return {each.quantity: {name: float(values[0]) for name, values in each.channels.items()} for each in found}


XYZ = {"x": 1.0, "y": 2.0, "z": 3.0}
SPEED = {"vx": 4.0, "vy": 5.0, "vz": 6.0}
RATES = {"rollspeed": 0.1, "pitchspeed": 0.2, "yawspeed": 0.3}
PQR = {"p": 0.1, "q": 0.2, "r": 0.3}
GYRO = {"xgyro": 100.0, "ygyro": 200.0, "zgyro": 300.0}
ACC = {"xacc": 1000.0, "yacc": 2000.0, "zacc": -1000.0}
FORCE = {"ax": 9.80665, "ay": 19.6133, "az": -9.80665}


@pytest.mark.parametrize(
    ("message", "fields", "meant"),
    [
        ("SCALED_IMU2", GYRO | ACC, {"rates": PQR, "specific force": FORCE}),
        ("RAW_IMU", GYRO | ACC, {"rates": PQR, "specific force": FORCE}),
        ("HIGHRES_IMU", {"xgyro": 0.1, "ygyro": 0.2, "zgyro": 0.3}, {"rates": PQR}),
        (
            "ATTITUDE",
            {"roll": 1.0, "pitch": 2.0, "yaw": 3.0} | RATES,
            {"rates": PQR, "attitude": {"phi": 1.0, "theta": 2.0, "psi": 3.0}},
        ),
        (
            "LOCAL_POSITION_NED",
            XYZ | SPEED,
            {"velocity": {"vn": 4.0, "ve": 5.0, "vd": 6.0}, "position": {"x": 1.0, "y": 2.0}, "depth": {"z": 3.0}},
        ),
        (
            "GLOBAL_POSITION_INT",
            SPEED | {"relative_alt": -2500.0},
            {"velocity": {"vn": 0.04, "ve": 0.05, "vd": 0.06}, "depth": {"z": 2.5}},
        ),
        ("VISION_SPEED_ESTIMATE", XYZ, {"velocity": {"vn": 1.0, "ve": 2.0, "vd": 3.0}}),
        ("SYS_STATUS", {"voltage_battery": 15_200.0}, {"voltage": {"voltage": 15.2}}),
    ],
)
def test_messages_in_their_units(message: str, fields: dict[str, float], meant: dict[str, dict[str, float]]) -> None:
    found = told(sources_of_messages(table(message, **fields), SENSED, measured=False))
    assert found.keys() == meant.keys()
    for quantity, channels in meant.items():
        assert found[quantity] == pytest.approx(channels), quantity


def test_what_a_filter_estimates_is_dead_reckoning_where_nothing_aids_it() -> None:
    position = table("LOCAL_POSITION_NED", **XYZ, **SPEED)
    assert [bool(each.refused) for each in sources_of_messages(position, ALONE, measured=False)] == [True, True, False]
    odometry = table(
        "ODOMETRY", **XYZ, **SPEED, **RATES, **{f"q[{k}]": 0.5 for k in range(4)}, frame_id=1, child_frame_id=12
    )
    own, other = (sources_of_messages(odometry, ALONE, measured=measured) for measured in (False, True))
    assert {each.quantity for each in own if each.refused} == {"position", "velocity"}
    assert not any(each.refused for each in other)
    assert [{each.distance for each in some} for some in (own, other)] == [{2}, {1}]


@pytest.mark.parametrize(
    ("world", "body", "placed", "moving"),
    [(1, 12, True, True), (20, 12, True, True), (1, 16, True, False), (4, 12, False, True)],
)
def test_odometry_counts_in_frames_that_are_understood(world: int, body: int, placed: bool, moving: bool) -> None:
    q = {f"q[{k}]": value for k, value in enumerate((1.0, 0.0, 0.0, 0.0))}
    message = table("ODOMETRY", **XYZ, **SPEED, **RATES, **q, frame_id=world, child_frame_id=body)
    found = {
        each.quantity: bool(np.isfinite(next(iter(each.channels.values()))).all())
        for each in sources_of_messages(message, SENSED, measured=True)
    }
    assert found == {"position": placed, "depth": placed, "attitude": placed, "velocity": moving, "rates": moving}
    short = table("ODOMETRY", **XYZ)
    assert sources_of_messages(short, SENSED, measured=True) == []


def test_of_a_battery_that_tells_its_cells_the_sum_counts() -> None:
    cells = {f"voltages[{k}]": [4000.0, 4000.0, 65535.0, 0.0] if k < 3 else 65535.0 for k in range(10)}
    [found] = sources_of_messages(table("BATTERY_STATUS", **cells), SENSED, measured=False)
    np.testing.assert_array_equal(found.channels["voltage"], [12.0, 12.0, np.nan, np.nan])
    assert sources_of_messages(table("BATTERY_STATUS", **{"voltages[0]": 1.0}), SENSED, measured=False) == []


def test_outputs_beyond_sixteen_are_a_group_of_their_own() -> None:
    message = table(
        "SERVO_OUTPUT_RAW", port=[0.0, 1.0, 0.0, np.nan], servo1_raw=[1.0, 2.0, 3.0, 4.0], servo16_raw=5.0, x=1.0
    )
    found = pulses_of(message)
    assert sorted(found) == [1, 16, 17, 32]
    np.testing.assert_array_equal(found[1], [1.0, np.nan, 3.0, np.nan])
    np.testing.assert_array_equal(found[17], [np.nan, 2.0, np.nan, np.nan])
    assert sorted(pulses_of(table("SERVO_OUTPUT_RAW", servo3_raw=1.0))) == [3]


def test_depth_is_pressure_over_that_of_the_surface_by_the_weight_of_the_water() -> None:
    second = table("SCALED_PRESSURE2", press_abs=1500.0)
    parameters = {"BARO2_GND_PRESS": 100_000.0}
    [found] = pressures_of([second, table("SCALED_PRESSURE2"), table("ATTITUDE", press_abs=1.0)], parameters)
    assert (found.number, found.table) == (1, "SCALED_PRESSURE2")
    assert found.pressure[0] == 150_000.0
    assert found.depth is not None
    assert found.depth[0] == pytest.approx(50_000.0 / 9800.0)
    [salt] = pressures_of([second], parameters | {"BARO_SPEC_GRAV": 1.024, "GND_SPEC_GRAV": 9.0})
    assert salt.depth is not None
    assert salt.depth[0] == pytest.approx(50_000.0 / 9800.0 / 1.024)
    for wrong in ({}, {"BARO2_GND_PRESS": 0.0}, parameters | {"BARO_SPEC_GRAV": 0.0}):
        [unknown] = pressures_of([second], wrong)
        assert unknown.depth is None
