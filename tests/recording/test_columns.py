"""Tables of columns: in order of time, one value a time, and what was repaired."""

from __future__ import annotations

import numpy as np
import pytest

from towtank.errors import InputError
from towtank.recording.columns import assemble, name_list

NAN = np.nan


def test_of_many_names_the_first_are_shown_and_the_others_counted() -> None:
    assert name_list(["a", "", "c"]) == 'a, "", c'
    assert name_list(["a", "b", "c"], 2) == "a, b and 1 more"
    assert name_list([str(k) for k in range(40)]).endswith("28, 29 and 10 more")
    assert name_list([str(k) for k in range(30)]).endswith("28, 29")


def test_late_and_repeated_rows_are_counted_once_however_many_columns_they_touch() -> None:
    t = np.array([0.0, 1.0, 3.0, 2.0, 3.0, 4.0])
    run = assemble(t, {"u": np.arange(6.0), "v": np.array([0.0, 1.0, NAN, 3.0, 4.0, 5.0])}, place="a", source="s")
    assert (run["u"].t.tolist(), run["u"].values.tolist()) == ([0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 3.0, 4.0, 5.0])
    assert run["v"].values.tolist() == [0.0, 1.0, 3.0, 4.0, 5.0]
    assert (run.repairs.disorder, run.repairs.duplicates, run.repairs.nan) == (1, 1, 0)
    only = assemble(t, {"v": np.array([0.0, 1.0, NAN, 3.0, 4.0, 5.0])}, place="a", source="s")
    assert (only.repairs.disorder, only.repairs.duplicates) == (0, 0)


def test_empty_cells_count_where_they_make_a_hole_in_a_channel_that_is_mostly_there() -> None:
    t = np.arange(20.0)
    u, v = np.arange(20.0), np.where(np.arange(20) % 2, NAN, 1.0)
    u[[5, 6, 12]] = NAN
    run = assemble(t, {"u": u, "v": v}, place="a", source="s")
    assert run.repairs.nan == 3
    assert (len(run["u"]), len(run["v"])) == (17, 10)
    v[1] = 1.0  # eleven of twenty: every other one is missing
    assert assemble(t, {"v": v}, place="a", source="s").repairs.nan == 9 - 9


def test_a_clock_that_restarts_is_told_from_late_rows() -> None:
    once = np.arange(30) / 10.0
    values = np.arange(60.0)

    def run(t: np.ndarray) -> int:
        return assemble(t, {"u": values[: t.size]}, place="a.csv", source="s").repairs.disorder

    with pytest.raises(InputError, match=r"a\.csv: the clock restarts at data row 31 \(2\.9 s back\)") as raised:
        run(np.concatenate([once, once]))
    assert '"u" is measured twice over 2.9 s; expected one run in a file: split it there' in str(raised.value)
    assert run(np.concatenate([once, once + 1.95])) == 10  # a second in common is an accident
    with pytest.raises(InputError, match=r"twice over 1\.1 s"):
        run(np.concatenate([once, once + 1.8]))
    assert run(np.concatenate([once, once[:19]])) == 19  # so is a short piece
    assert run(np.concatenate([once + 5.0, once])) == 30


def test_four_times_make_a_recording_and_a_value_a_channel() -> None:
    t = np.arange(4.0)
    run = assemble(t, {"u": t, "v": np.full(4, NAN)}, place="a", source="s", notes=["n"], attributes={"a": "b"})
    assert run.names == ("u",)
    assert run.notes == ("n", 'channel "v" holds no value; left out')
    assert (run.source, run.attributes) == ("s", {"a": "b"})
    with pytest.raises(InputError, match="a: found 3 samples, expected at least 4"):
        assemble(np.array([0.0, 1.0, 2.0, 2.0]), {"u": t}, place="a", source="s")
    with pytest.raises(InputError, match="a: no column holds any value"):
        assemble(t, {"u": np.full(4, NAN)}, place="a", source="s")
    with pytest.raises(InputError, match="a: no column with a measurement"):
        assemble(t, {}, place="a", source="s")
    other = assemble(t, {"salt": t}, place="a", source="s", units={"salt": ("g/kg", "")})
    assert other["salt"].unit == "g/kg"
