"""CSV: exact round trips, every kind of bad input in one clear line, repairs counted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.pace import within

from towtank.errors import InputError
from towtank.recording import Recording, read_csv, standard_channel

FLOATS = st.floats(-1e4, 1e4)  # what every unit can be
INSTANTS = st.integers(-(10**15), 10**15).map(lambda ns: 1e-9 * ns)
TIMES = st.lists(INSTANTS, min_size=4, max_size=12, unique=True).map(sorted)


def write(folder: Path, text: str | bytes, name: str = "dive.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def rows(n: int = 5) -> str:
    return "".join(f"{i / 10},{i},{-i}\n" for i in range(n))


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    channels = []
    shared = np.array(draw(TIMES)) + 0.0
    for name in draw(st.lists(st.sampled_from(["u", "psi", "X", "cmd_a b,c", "voltage"]), min_size=1, unique=True)):
        t = shared if draw(st.booleans()) else np.array(draw(TIMES)) + 0.0
        channels.append(standard_channel(name, t, [draw(FLOATS) for _ in t]))
    return Recording({channel.name: channel for channel in channels})


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(recordings())
def test_round_trip_is_exact(tmp_path: Path, run: Recording) -> None:
    path = tmp_path / "round.csv"
    run.write(path)
    again = read_csv(path)
    assert dict(again.channels) == dict(run.channels)
    assert again.names == run.names
    assert not again.repairs.disorder + again.repairs.duplicates + again.repairs.infinities
    for name in run:
        assert np.array_equal(np.signbit(again[name].values), np.signbit(run[name].values))


def test_what_is_written_is_plain(tmp_path: Path) -> None:
    run = Recording.from_table([0.0, 0.1, 0.2, 0.3], {"u": [0.1, np.nan, 1e-7, 3.0], "v": [1.0, 2.0, 3.0, 4.0]})
    run.write(tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text() == "t,u,v\n0,0.1,1\n0.1,,2\n0.2,1e-7,3\n0.3,3,4\n"
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


def test_writing_elsewhere_is_refused(tmp_path: Path) -> None:
    run = Recording.from_table([0.0, 1.0], {"u": [0.0, 1.0]})
    with pytest.raises(InputError, match=r'cannot write "\.xlsx" files; expected one of \.csv, \.parquet'):
        run.write(tmp_path / "a.xlsx")
    with pytest.raises(InputError, match="does not exist"):
        run.write(tmp_path / "none" / "a.csv")


# ruff: disable[E501]
BAD = {
    "empty": ("", "{p}: the file is empty, expected a line of column names"),
    "header only": ("t,u,v\n", "{p}: found 0 samples, expected at least 4"),
    "three samples": ("t,u,v\n" + rows(3), "{p}: found 3 samples, expected at least 4"),
    "no t": ("time,u,v\n" + rows(), '{p}:1: no column "t" (time in s); found time, u, v; name the columns with --map FILE.toml'),
    "no channel": ("t,a,b\n" + rows(), "{p}:1: no column with a standard name (u, psi, cmd_..., ...); found t, a, b"),
    "text": ("t,u,v\n" + rows() + "0.5,1,abc\n", '{p}:7:3: found "abc" in column "v", expected a number (empty or NaN where not measured)'),
    "text after blank lines": ("t,u,v\n\n\n" + rows() + "x,1,2\n", '{p}:9:1: found "x" in column "t"'),
    "text after a quoted line break": ('t,note,v\n0,"a\nb",1\n1,,x\n', '{p}:4:3: found "x" in column "v"'),
    "underscore": ("t,u,v\n" + rows() + "0.5,1_0,2\n", '{p}:7:2: found "1_0" in column "u"'),
    "truth value": ("t,u,v\n" + rows() + "0.5,True,2\n", '{p}:7:2: found "True" in column "u"'),
    "ragged": ("t,u,v\n" + rows() + "0.5,1\n", "{p}:7: found 2 cells, expected 3 (one for each name in the first line)"),
    "ragged, long": ("t,u,v\n0,1,2,3\n" + rows(), "{p}:2: found 4 cells, expected 3"),
    "cut off": ("t,u,v\n" + rows() + "0.5,1", "{p}:7: found 2 cells, expected 3 (one for each name in the first line); the last line is cut off: delete it"),
    "decimal comma": ("t,u,v\n0,0,1,0,2,0\n", "{p}:2: found 6 cells, expected 3 (one for each name in the first line); decimals take a point, not a comma"),
    "quoted decimal comma": ('t,u,v\n0,"0,5",2\n', '{p}:2:2: found "0,5" in column "u", expected a number (empty or NaN where not measured); decimals take a point'),
    "semicolons": ("t;u;v\n0,0;1,0;2,0\n", "{p}:1: the columns are separated by semicolons, expected commas (and decimal points)"),
    "tabs": ("t\tu\tv\n0\t1\t2\n", "{p}:1: the columns are separated by tabs"),
    "twice": ("t,u,u\n" + rows(), '{p}:1: column "u" stands 2 times, expected once'),
    "t twice": ("t,t,u\n" + rows(), '{p}:1: column "t" stands 2 times'),
    "no header": (rows(), '{p}:1: the first line holds numbers ("0.0,0,0"), expected the names of the columns'),
    "blank header": ("\nt,u,v\n" + rows(), "{p}:1: the first line is blank"),
    "all blank": ("t,u,v\n0,,\n1,,\n2,,\n3,,\n", "{p}: no column holds any value"),
    "no times": ("t,u,v\n" + ",1,2\n" * 9, "{p}: found 0 samples, expected at least 4"),
    "utf-16": ("t,u,v\n".encode("utf-16"), "{p}: not a text file in UTF-8"),
    "damaged": (b"t,u,v\n" + rows().encode() + b"0.5,\0\0,1\n", "{p}:7: found a NUL character"),
    "one long line": ("x" * 200_000 + "\n" + rows(), "{p}:1: found a line of 200000 characters that names no columns"),
    "lines ended by CR": ("t,u,v\r0,1,2\r1,2,3\r", "{p}:1: found a line of 17 characters that names no columns, expected names with commas between them, the line ended by LF or CR LF"),
    "open quote": ('t,u,v\n0,1,2\n1,"2,3\n' + rows(), "{p}:3: found "),
}  # fmt: skip
# ruff: enable[E501]


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_named_by_file_and_place(tmp_path: Path, case: str) -> None:
    text, message = BAD[case]
    path = write(tmp_path, text)
    with pytest.raises(InputError) as error:
        read_csv(path)
    assert str(error.value).startswith(message.format(p=path)), str(error.value)
    assert "\n" not in str(error.value)


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.csv: no such file"):
        read_csv(tmp_path / "none.csv")
    with pytest.raises(InputError, match="this is a folder"):
        read_csv(tmp_path)


@pytest.mark.parametrize(
    "text",
    [
        "t,u,v\n" + rows(),
        "\ufefft,u,v\n" + rows(),
        ("t,u,v\n" + rows()).replace("\n", "\r\n"),
        "t, u ,v\n" + rows().replace(",", " , "),
        '"t","u","v"\n' + rows(),
        "t,u,v\n\n" + rows() + "\n\n",
        "t,u,v\n" + rows().rstrip("\n"),
        "t,u,v\n" + rows().replace("0.1,1", "+0.1,+1"),
        ("t,u,v,\n" + rows()).replace("\n", ",\n").replace(",,\n", ",\n", 1),
    ],
)
def test_harmless_varieties_read_the_same(tmp_path: Path, text: str) -> None:
    run = read_csv(write(tmp_path, text))
    assert run.names == ("u", "v")
    assert np.array_equal(run["u"].t, np.arange(5) / 10)
    assert np.array_equal(run["v"].values, -np.arange(5.0))
    assert not run.repairs


def test_other_columns_are_ignored_and_noted(tmp_path: Path) -> None:
    text = "t,mode,u\n" + "".join(f"{i},HOLD,{i}\n" for i in range(5))
    assert read_csv(write(tmp_path, text)).notes == ("ignored columns: mode",)
    latin = text.replace("HOLD", "Tiefe größer").encode("latin-1")
    assert len(read_csv(write(tmp_path, latin))["u"]) == 5


def test_missing_values_in_all_spellings(tmp_path: Path) -> None:
    run = read_csv(write(tmp_path, "t,u,v\n0,1,1\n1,nan,2\n2,NaN,3\n3,,4\n4,5,5\n5,6,6\n6,7,7\n7,8,8\n"))
    assert np.array_equal(run["u"].t, [0, 4, 5, 6, 7])
    assert np.array_equal(run["v"].t, np.arange(8))
    assert run.repairs.nan == 3


def test_infinities_count_as_missing(tmp_path: Path) -> None:
    run = read_csv(write(tmp_path, "t,u,v\n0,1,1\n1,inf,2\n2,-Infinity,3\ninf,1,3\n3,4,4\n4,5,5\n"))
    assert np.array_equal(run["u"].values, [1, 4, 5])
    assert run.repairs.infinities == 2
    assert run.repairs.untimed == 1
    assert '2 infinite in "u"' in run.repairs.summary


def test_an_unmeasured_channel_is_dropped_with_a_note(tmp_path: Path) -> None:
    run = read_csv(write(tmp_path, "t,u,v\n" + "".join(f"{i},{i},NaN\n" for i in range(5))))
    assert run.names == ("u",)
    assert run.notes == ('channel "v" holds no value; left out',)


def test_disorder_is_sorted_and_counted(tmp_path: Path) -> None:
    run = read_csv(write(tmp_path, "t,u,v\n0,0,0\n2,2,2\n1,1,1\n3,3,3\n4,4,4\n"))
    assert np.array_equal(run["u"].t, np.arange(5))
    assert np.array_equal(run["u"].values, np.arange(5))
    assert run.repairs.disorder == 1
    assert run.repairs.duplicates == 0
    backwards = read_csv(write(tmp_path, "t,u\n" + "".join(f"{-i},{i}\n" for i in range(50))))
    assert backwards.repairs.disorder == 49
    assert np.array_equal(backwards["u"].values, np.arange(50.0)[::-1])


def test_repeated_stamps_merge_and_the_last_value_wins(tmp_path: Path) -> None:
    run = read_csv(write(tmp_path, "t,u,v\n0,0,0\n1,1,1\n1,9,\n2,2,2\n3,3,3\n"))
    assert np.array_equal(run["u"].values, [0, 9, 2, 3])
    assert np.array_equal(run["v"].values, [0, 1, 2, 3])
    assert run.repairs.duplicates == 1


def test_interleaved_rates_are_no_fault(tmp_path: Path) -> None:
    text = "t,u,cmd_a\n" + "".join(f"{i / 10},{i},\n" + (f"{i / 10},,{i}\n" if i % 5 == 0 else "") for i in range(20))
    run = read_csv(write(tmp_path, text))
    assert len(run["u"]) == 20
    assert np.array_equal(run["cmd_a"].t, [0, 0.5, 1.0, 1.5])
    assert not run.repairs
    blocks = "t,u,v\n" + "".join(f"{i / 10},{i},\n" for i in range(100)) + "".join(f"{i / 10},,1\n" for i in range(100))
    assert not read_csv(write(tmp_path, blocks)).repairs


def test_a_clock_that_restarts_is_refused(tmp_path: Path) -> None:
    text = "t,u\n" + "".join(f"{i / 10},{i}\n" for i in [*range(100), *range(50)])
    with pytest.raises(InputError, match=r"dive\.csv: the clock restarts at data row 101 .*split it there"):
        read_csv(write(tmp_path, text))
    swapped = "t,u\n" + "".join(f"{i / 10},{i}\n" for i in [*range(100, 200), *range(100)])
    assert read_csv(write(tmp_path, swapped)).repairs.disorder == 100


def test_a_long_file_reads_fast(tmp_path: Path) -> None:
    n = 100_000
    values = np.random.default_rng(0).normal(size=n)
    run = Recording.from_table(np.arange(n) / 100, dict.fromkeys("uvwpqr", values))
    run.write(tmp_path / "long.csv")
    with within(1.0):
        assert len(read_csv(tmp_path / "long.csv")["u"]) == n


def test_a_last_line_that_is_cut_off_is_said_to_be(tmp_path: Path) -> None:
    for text, cut in (("t,u\n0,1\n1", True), ("t,u\n0,1\n1\n", False), ("t,u\n0,1\n1\n2,3\n", False)):
        with pytest.raises(InputError, match=r"dive\.csv:3: found 1 cells, expected 2") as raised:
            read_csv(write(tmp_path, text))
        assert str(raised.value).endswith("; the last line is cut off: delete it") is cut
