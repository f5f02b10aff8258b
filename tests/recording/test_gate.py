"""The gate behind all readers: what no vehicle and no clock yields is kept out, counted, and said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.readers import read
from towtank.recording.standard import STANDARD, STATES
from towtank.recording.tables.gate import LATEST, LIMITS, admitted, is_plausible, limit_of

T = 0.02 * np.arange(50)


def test_what_can_be_measured_passes_untouched() -> None:
    columns = {"u": np.sin(T), "p": np.where(T < 0.5, np.nan, 2000.0)}
    passed = admitted(T, columns, place="a.csv")
    assert passed.t is T
    assert all(passed.columns[name] is values for name, values in columns.items())
    assert (passed.untimed, passed.infinities, passed.beyond, passed.details) == (0, 0, 0, ())


@pytest.mark.parametrize("wrong", [1e308, -1e308, 1e12, 1.1e4])
def test_values_beyond_their_unit_are_not_measured(wrong: float) -> None:
    u = np.sin(T)
    u[3:6] = wrong
    passed = admitted(T, {"u": u, "voltage": u + 16.0}, place="a.csv")
    assert np.flatnonzero(np.isnan(passed.columns["u"])).tolist() == [3, 4, 5]
    assert np.array_equal(u[6:], passed.columns["u"][6:])
    assert passed.details[0] == '3 in "u" beyond 1e4 m/s'
    assert passed.beyond == (6 if abs(wrong) > 1e6 else 3)


def test_every_unit_has_a_limit_whose_square_and_cube_are_numbers() -> None:
    assert {known.unit for known in (*STANDARD.values(), *STATES.values())} | {"command"} == set(LIMITS)
    assert all(np.isfinite(1e6 * limit**3) for limit in LIMITS.values())
    assert limit_of("cmd_1") == LIMITS["command"]
    assert limit_of("a sensor of one's own") > 1e15


@pytest.mark.parametrize(
    ("name", "wrong_unit"), [("u", 1e3 * 5.0), ("p", 1e3 * 35.0), ("psi", 36_000.0), ("az", 9807.0)]
)
def test_a_wrong_unit_passes_so_that_it_can_be_named(name: str, wrong_unit: float) -> None:
    assert is_plausible(name, np.array([wrong_unit])).all()


def test_rows_without_a_time_that_can_be_are_dropped() -> None:
    t = T.copy()
    t[[4, 7, 9]] = np.nan, 9.2e18, -1e300
    passed = admitted(t, {"u": np.sin(T)}, place="a.csv")
    assert passed.untimed == 3
    assert passed.columns["u"].size == passed.t.size == 47
    assert passed.details == ("2 rows at times beyond the year 2100",)


def test_a_clock_that_is_set_within_the_log_keeps_the_longer_part() -> None:
    t = T.copy()
    t[40:] += 1.7e9
    passed = admitted(t, {"u": np.sin(T)}, place="a.csv")
    assert np.array_equal(passed.t, T[:40])
    assert passed.details == ("10 rows more than 30 days off the others (times span 53.9 years)",)
    assert admitted(np.where(T > 0.5, T + 86_400.0, T), {"u": T}, place="a").untimed == 0


@pytest.mark.parametrize("factor", [1e3, 1e6, 1e9])
def test_times_of_another_unit_are_refused_with_the_way_out(factor: float) -> None:
    with pytest.raises(InputError, match=r"a\.csv: found times from .* expected seconds.*scale = 0\.001"):
        admitted((1.7e9 + T) * factor, {"u": T}, place="a.csv")
    assert admitted(1.7e9 + T, {"u": T}, place="a.csv").untimed == 0
    assert admitted(np.array([0.0, LATEST - 1.0])[[0, 0, 1]], {"u": np.ones(3)}, place="a.csv").untimed == 1


def test_columns_of_unequal_length_are_refused() -> None:
    with pytest.raises(InputError, match=r'a\.parquet: "u" has 49 values for 50 times, expected one for each'):
        admitted(T, {"u": T[1:]}, place="a.parquet")


def test_times_less_than_a_nanosecond_apart_are_one() -> None:
    t = np.array([0.0, 5e-324, 1e-12, 0.5, 0.5 + 1e-11, 1.0])
    for order in ([0, 1, 2, 3, 4, 5], [0, 5, 3, 1, 4, 2]):  # neighbours in time need not be neighbours in the file
        assert np.unique(admitted(t[order], {"u": t}, place="a").t).tolist() == [0.0, 0.5, 1.0]


def test_what_the_gate_keeps_out_is_said_once_for_each_channel(tmp_path: Path) -> None:
    rows = [f"{0.02 * k},{'1e308' if k in (3, 9) else 0.1},{'inf' if k == 4 else 1.0}" for k in range(50)]
    (tmp_path / "a.csv").write_text("t,u,r\n" + "\n".join([*rows, "1e30,1,1"]), encoding="utf-8")
    run = read(tmp_path / "a.csv")
    assert (run.repairs.beyond, run.repairs.infinities, run.repairs.untimed) == (2, 1, 1)
    assert run.repairs.details == (
        "1 rows at times beyond the year 2100",
        '2 in "u" beyond 1e4 m/s',
        '1 infinite in "r"',
    )
    assert "2 values that cannot be (taken as missing)" in run.repairs.lines


def test_our_own_recordings_pass_the_gate_as_well(tmp_path: Path) -> None:
    """They are taken as they were written, to the bit, only where nothing is kept out."""
    from towtank.recording.mcap.format import Quantity
    from towtank.recording.mcap.log import McapLog

    with McapLog.open(tmp_path / "a.mcap") as log:
        log.source("dvl", [Quantity("u", "m/s", "FRD")])
        for k in range(50):
            log.write("dvl", 0.02 * k, 1e300 if k == 7 else 0.1 * k)
    run = read(tmp_path / "a.mcap")
    assert run.repairs.beyond == 1
    assert len(run["u"]) == 49


def test_our_own_recording_is_named_where_no_time_can_be_one(tmp_path: Path) -> None:
    from towtank.recording.mcap.format import Quantity
    from towtank.recording.mcap.log import McapLog

    with McapLog.open(tmp_path / "a.mcap") as log:
        log.source("dvl", [Quantity("u", "m/s", "FRD")])
        for k in range(50):
            log.write("dvl", 2.6e11 + 0.02 * k, 0.1 * k)
    with pytest.raises(InputError, match=r"a\.mcap: /dvl: found times from 2\.6e\+11"):
        read(tmp_path / "a.mcap")
