"""Parquet: exact round trips with units, frames, notes; the same checks as CSV."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from towtank.errors import InputError
from towtank.recording import Channel, ColumnMapping, Content, Recording, Repairs, read_parquet, standard_channel

FLOATS = st.floats(-1e4, 1e4)  # what every unit can be
INSTANTS = st.integers(-(10**15), 10**15).map(lambda ns: 1e-9 * ns)
TIMES = st.lists(INSTANTS, min_size=4, max_size=12, unique=True).map(sorted)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    TIMES, TIMES, st.data(), st.text(max_size=5), st.dictionaries(st.text(max_size=3), st.text(max_size=3), max_size=2)
)
def test_round_trip_is_exact(
    tmp_path: Path, slow: list[float], fast: list[float], data: st.DataObject, note: str, attributes: dict[str, str]
) -> None:
    def channel(name: str, t: list[float]) -> Channel:
        times = np.array(t) + 0.0
        return standard_channel(name, times, [data.draw(FLOATS) for _ in t])

    other = Channel("pressure", np.array(slow) + 0.0, slow, "Pa", "water")
    channels = [channel("u", slow), channel("cmd_port", fast), other]
    repairs = Repairs(spikes=3, dead=("r",), details=("3 spikes in u",))
    run = Recording({c.name: c for c in channels}, "tank", (note,), attributes, repairs)
    path = tmp_path / "a.parquet"
    run.write(path)
    again = read_parquet(path)
    assert again == run
    assert again.names == run.names


def test_unit_and_frame_stand_in_the_column_metadata(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    Recording.from_table(np.arange(5.0), {"psi": np.arange(5.0)}).write(path)
    schema = pq.read_schema(path)
    assert schema.field("psi").metadata == {b"unit": b"rad", b"frame": b"NED-FRD"}
    assert schema.field("t").metadata == {b"unit": b"s"}


def store(folder: Path, columns: dict[str, object], units: dict[str, str] | None = None) -> Path:
    table = pa.table(columns)
    for name, unit in (units or {}).items():
        i = table.schema.get_field_index(name)
        table = table.set_column(i, table.schema.field(i).with_metadata({"unit": unit}), table.column(i))
    path = folder / "foreign.parquet"
    pq.write_table(table, path)
    return path


def test_a_foreign_table_reads(tmp_path: Path) -> None:
    columns = {
        "t": [0, 1, 2, 3, 4],
        "u": [0, 1, None, 3, 4],
        "v": [0.0, np.nan, np.inf, 1.0, 2.0],
        "mode": list("abcde"),
    }
    run = read_parquet(store(tmp_path, columns))
    assert np.array_equal(run["u"].t, [0, 1, 3, 4])
    assert np.array_equal(run["v"].t, [0, 3, 4])
    assert run.repairs.infinities == 1
    assert run.notes == ("ignored columns: mode",)


@pytest.mark.parametrize(
    ("columns", "units", "message"),
    [
        ({"u": [1.0] * 5}, {}, 'no column "t"'),
        ({"t": [0.0, 1.0, 2.0], "u": [1.0] * 3}, {}, "found 3 samples, expected at least 4"),
        ({"t": list(range(5)), "u": list("abcde")}, {}, 'column "u" holds string, expected numbers'),
        ({"t": list(range(5)), "psi": [1.0] * 5}, {"psi": "deg"}, r'column "psi" is in "deg" .*expected "rad"'),
        ({"t": list(range(5)), "psi": [1.0] * 5}, {"t": "us"}, r'column "t" is in "us" .*expected "s"'),
    ],
)
def test_bad_tables(tmp_path: Path, columns: dict[str, object], units: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_parquet(store(tmp_path, columns, units))


def test_a_mapping_works_on_parquet_too(tmp_path: Path) -> None:
    path = store(tmp_path, {"time": list(range(5)), "yaw": [90.0] * 5}, {"yaw": "deg"})
    mapping = ColumnMapping.model_validate({"columns": {"t": "time", "psi": {"from": "yaw", "scale": np.pi / 180}}})
    assert np.allclose(read_parquet(path, mapping)["psi"].values, np.pi / 2)


def test_what_is_not_parquet(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    path.write_text("t,u\n0,1\n")
    with pytest.raises(InputError, match=r"a\.parquet: not a readable Parquet file"):
        read_parquet(path)
    with pytest.raises(InputError, match="no such file"):
        read_parquet(tmp_path / "b.parquet")
    with pytest.raises(InputError, match="this is a folder"):
        read_parquet(tmp_path)
    Recording.from_table(np.arange(500.0), {"u": np.arange(500.0)}).write(path)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(InputError, match="not a readable Parquet file"):
        read_parquet(path)


def test_contents_are_kept(tmp_path: Path) -> None:
    contents = (Content("IMU[0]", "DataFlash", 5, 25.0, ("p",), "rates: why"), Content("PM", "DataFlash", 1, None))
    t = np.arange(5.0)
    run = Recording({"p": standard_channel("p", t, t)}, source="log", repairs=Repairs(damaged=3), contents=contents)
    run.write(tmp_path / "a.parquet")
    assert read_parquet(tmp_path / "a.parquet") == run
