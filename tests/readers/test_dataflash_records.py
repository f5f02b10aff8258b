"""Records of a DataFlash log byte by byte, and what lies between them."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from towtank.readers.dataflash.records import FMT, LETTERS, MessageFormat, parse_fmt, scan

HEAD = b"\xa3\x95"


def stated(kind: int, name: str, letters: str, columns: str, length: int | None = None) -> bytes:
    size = 3 + sum(np.dtype(LETTERS[letter][0]).itemsize for letter in letters if letter in LETTERS)
    fields = struct.pack(
        "<BB4s16s64s", kind, size if length is None else length, name.encode(), letters.encode(), columns.encode()
    )
    return HEAD + b"\x80" + fields


def record(kind: int, layout: str, *values: float) -> bytes:
    return HEAD + bytes([kind]) + struct.pack("<" + layout, *values)


FORMAT = stated(10, "TST", "Qf", "TimeUS,A")
ROWS = [record(10, "Qf", 1000 * k, k + 0.5) for k in range(4)]


def values(data: bytes) -> list[float]:
    [(form, offsets)] = scan(data).records
    return [float(each) for each in form.rows(data, offsets)["f1"]]


def test_records_of_a_stated_format_are_found_in_order() -> None:
    data = FORMAT + b"".join(ROWS)
    found = scan(data)
    [(form, offsets)] = found.records
    assert (form.name, form.columns, form.length) == ("TST", ("TimeUS", "A"), 15)
    assert offsets.tolist() == [89, 104, 119, 134]
    assert values(data) == [0.5, 1.5, 2.5, 3.5]
    assert (found.damaged, found.skipped) == (0, 0)


@pytest.mark.parametrize("rubbish", [b"x", b"\xa3", b"\xa3\x95", b"\xa3\x95\x0a", b"y" * 300])
def test_bytes_between_records_are_one_damage_with_their_number(rubbish: bytes) -> None:
    data = FORMAT + ROWS[0] + rubbish + ROWS[1] + ROWS[2] + ROWS[3]
    found = scan(data)
    assert found.damaged >= 1
    assert values(data)[-2:] == [2.5, 3.5]
    lost = 4 - len(values(data))
    assert found.skipped == len(rubbish) + 15 * lost


@pytest.mark.parametrize("start", [b"\0\0", b"\xa3\0", b"\0\x95"])
def test_a_file_whose_first_bytes_are_damaged_is_read_from_the_next_record_on(start: bytes) -> None:
    data = start + stated(11, "OTH", "Qf", "TimeUS,B")[2:] + FORMAT + b"".join(ROWS)
    assert values(data) == [0.5, 1.5, 2.5, 3.5]
    assert (scan(data).damaged, scan(data).skipped) == (1, 89)


def test_what_fills_the_end_is_no_damage_and_what_is_cut_off_is() -> None:
    whole = FORMAT + b"".join(ROWS)
    for end, damaged in ((b"\0" * 99, 0), (b"\xff" * 99, 0), (b"\0\xff", 0), (b"abc", 1)):
        found = scan(whole + end)
        assert len(values(whole + end)) >= 3
        assert bool(found.damaged) is bool(damaged), end
    cut = scan(whole[:-1])
    assert (cut.damaged, len(cut.records[0][1])) == (1, 3)
    assert cut.skipped == 14


def test_a_type_that_is_stated_anew_stands_twice_and_up_to_eight_times() -> None:
    other = stated(10, "TST", "Qd", "TimeUS,B")
    data = FORMAT + ROWS[0] + other + record(10, "Qd", 5, 9.0) + FORMAT + ROWS[1]
    found = scan(data)
    assert [(form.columns[1], len(offsets)) for form, offsets in found.records] == [("A", 2), ("B", 1)]
    many = b"".join(stated(10, "TST", "Qf", f"TimeUS,C{k}") + ROWS[0] for k in range(10))
    found = scan(many)
    assert len(found.records) == 8
    assert found.damaged == 2
    assert found.skipped == 2 * 89


@pytest.mark.parametrize(
    ("kind", "name", "letters", "columns", "length"),
    [
        (10, "TST", "Q?", "TimeUS,A", 15),  # a letter that is none
        (10, "TST", "Qf", "TimeUS,A", 16),
        (10, "TST", "Qf", "TimeUS,A", 14),
        (10, "TST", "Qf", "TimeUS,A,B", 15),
        (10, "TST", "Qf", "A,A", 15),
        (10, "TST", "Qf", "TimeUS,A b", 15),
        (10, "T-T", "Qf", "TimeUS,A", 15),
        (10, "1ST", "Qf", "TimeUS,A", 15),
    ],
)
def test_a_format_that_does_not_fit_itself_is_none(
    kind: int, name: str, letters: str, columns: str, length: int
) -> None:
    bad = stated(kind, name, letters, columns, length)
    assert parse_fmt(bad, 0) is None
    found = scan(bad + FORMAT + ROWS[0])
    assert (found.damaged, found.skipped, len(found.records)) == (1, 89, 1)
    fewer = parse_fmt(stated(10, "TST", "Qf", "TimeUS"), 0)  # fields without a name are passed over
    assert fewer is not None
    assert list(fewer.places) == ["TimeUS"]


def test_letters_have_their_sizes_and_scales() -> None:
    form = MessageFormat(7, "ALL", 0, "aLcZB", ("A", "L", "C", "Z", "B"))
    assert form.dtype.itemsize == 64 + 4 + 2 + 64 + 1
    places = form.places
    assert [name for name in places if name.startswith("A")] == [f"A[{k}]" for k in range(32)]
    assert (places["A[31]"].element, places["L"].divisor, places["C"].divisor, places["B"].divisor) == (
        31,
        1e7,
        1e2,
        1.0,
    )
    assert "Z" not in places
    assert form.field("Z") == "f3"
    assert FMT.fits
