"""Dead reckoning is refused as velocity and position, whatever tells of it; depth stays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from towtank.readers import read
from towtank.readers.ardupilot.aiding import Evidence, aided, aiding_of
from towtank.readers.ardupilot.dvl import displacement_source
from towtank.readers.common.sources import Source

from .encoders import DataFlashWriter, dive_bin

AIDED, RELATIVE, HELD, DEAD = 0b111111, 0b101111, 0b10100111, 0b111111 | 1 << 18
T = np.arange(10.0)


def velocity(t: np.ndarray = T) -> Source:
    return Source("XKF1", "velocity", t, {name: np.ones(t.size) for name in ("vn", "ve", "vd")}, 2)


def reports(*flags: int) -> Evidence:
    each = np.repeat(np.array(flags, dtype=float), 10 // len(flags))
    return Evidence(t=np.linspace(0.0, 9.0, each.size), flags=each)


@pytest.mark.parametrize(
    ("flags", "speed", "place"),
    [(AIDED, True, True), (RELATIVE, True, False), (HELD, False, False), (DEAD, False, False), (0, False, False)],
)
def test_by_the_filters_own_reports(flags: int, speed: bool, place: bool) -> None:
    aiding = aiding_of(reports(flags))
    assert (not aided(velocity(), aiding).refused) is speed
    assert (not aided(velocity(), aiding, position=True).refused) is place
    if not speed:
        assert aided(velocity(), aiding).refused.startswith("dead reckoning, the filter reports")


def test_only_where_it_is_aided() -> None:
    found = aided(velocity(), aiding_of(reports(AIDED, HELD)))
    assert np.isfinite(found.channels["vn"]).tolist() == [True] * 5 + [False] * 5
    assert found.note == "XKF1: velocity left out in 50 % of it, where it is dead reckoning"


@pytest.mark.parametrize(
    ("evidence", "refused"),
    [
        (Evidence(), "no sensor of velocity or position aids it"),
        (Evidence(velocity=("VISO",)), ""),
        (Evidence(position=("VISP",)), ""),
        (Evidence(satellites=True), ""),  # a surface craft
        (Evidence(satellites=True, depth_t=T, depth=np.full(10, 0.1)), ""),
        (Evidence(satellites=True, depth_t=T, depth=np.full(10, 3.0)), "satellites alone"),
        (Evidence(satellites=True, velocity=("VISO",), depth_t=T, depth=np.full(10, 3.0)), ""),
    ],
)
def test_by_the_sensors_that_are_heard(evidence: Evidence, refused: str) -> None:
    found = aided(velocity(), aiding_of(evidence))
    assert refused in found.refused
    assert bool(found.refused) is bool(refused)


def test_satellites_until_the_dive() -> None:
    aiding = aiding_of(Evidence(satellites=True, depth_t=T, depth=np.where(T < 4.0, 0.0, 5.0)))
    assert np.isfinite(aided(velocity(), aiding).channels["vn"]).sum() == 4


@pytest.mark.parametrize(("flags", "taken"), [(AIDED, True), (HELD, False)])
def test_in_a_log(tmp_path: Path, flags: int, taken: bool) -> None:
    path = tmp_path / "dive.BIN"
    path.write_bytes(dive_bin(dvl=False, flags=flags).data)
    run = read(path)
    assert ("vn" in run, "x" in run, "z" in run) == (taken, taken, True)
    if not taken:
        reason = next(content.reason for content in run.contents if content.name == "XKF1[0]")
        assert reason.startswith("position, velocity: dead reckoning, the filter reports that nothing aids it")


def test_the_primary_core_is_believed(tmp_path: Path) -> None:
    log = DataFlashWriter()
    log.define("XKF1", "QBccCffffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD")
    log.define("XKF4", "QBIb", "TimeUS,C,SS,PI")
    for k in range(50):
        for core in (0, 1):
            log.add("XKF1", 100_000 * k, core, 1.0, 2.0, 3.0, core, 0, 0, 0, 0, core)
            log.add("XKF4", 100_000 * k, core, AIDED if core else HELD, 1)
    path = tmp_path / "dive.BIN"
    path.write_bytes(log.data)
    run = read(path)
    assert set(run["vn"].values) == {1.0}
    assert set(run["z"].values) == {1.0}


def test_a_dvl_tells_a_speed_where_time_has_passed_and_the_bottom_is_seen() -> None:
    t = np.arange(6.0)
    ahead, side, down = np.array([0.1, 0.1, 0.1, 0.1, 0.0, 0.2]), np.zeros(6), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.1])
    dt = np.array([0.1, 0.0, -0.5, np.nan, 0.1, 0.2])
    confidence = np.array([50.0, 50.0, 50.0, 50.0, 0.0, 0.0])
    found = displacement_source("VISO", t, (ahead, side, down), dt, confidence)
    nan = np.nan
    np.testing.assert_allclose(found.channels["u"], [1.0, nan, nan, nan, nan, 1.0])
    np.testing.assert_allclose(found.channels["w"], [0.0, nan, nan, nan, nan, 0.5])
    whole = displacement_source("VISO", t, (ahead, side, down), dt, None)
    np.testing.assert_allclose(whole.channels["u"], [1.0, nan, nan, nan, 0.0, 1.0])


def test_an_unbelievable_report_aids_nothing() -> None:
    evidence = Evidence(t=np.array([1.0, 0.0]), flags=np.array([1e30, float(AIDED)]))
    found = aided(velocity(np.array([0.0, 1.0])), aiding_of(evidence))
    assert np.isfinite(found.channels["vn"]).tolist() == [True, False]
