"""Variables of MATLAB files element by element, as other programs and other machines write them."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from towtank.readers.matlab.variables import load_5, load_variables

CELL, STRUCT, OBJECT, CHAR, SPARSE, DOUBLE, UINT8 = 1, 2, 3, 4, 5, 6, 9


class Machine:
    """Writes elements in one order of bytes."""

    def __init__(self, order: str) -> None:
        self.order = order
        self.head = b"MATLAB 5.0 MAT-file".ljust(124) + (b"\0\1IM" if order == "<" else b"\1\0MI")

    def pack(self, letters: str, *numbers: float) -> bytes:
        return struct.pack(self.order + letters, *numbers)

    def element(self, kind: int, data: bytes) -> bytes:
        return self.pack("II", kind, len(data)) + data + bytes(-len(data) % 8)

    def small(self, kind: int, data: bytes) -> bytes:
        return self.pack("I", len(data) << 16 | kind) + data.ljust(4, b"\0")

    def array(self, name: str, shape: tuple[int, ...], content: bytes, kind: int = DOUBLE) -> bytes:
        flags = self.element(6, self.pack("II", kind, 0))
        sizes = self.element(5, self.pack(f"{len(shape)}i", *shape))
        return self.element(14, flags + sizes + self.element(1, name.encode()) + content)

    def numbers(self, name: str, *values: float) -> bytes:
        return self.array(name, (1, len(values)), self.element(9, self.pack(f"{len(values)}d", *values)))

    def structs(self, name: str, count: int, fields: dict[str, list[bytes]]) -> bytes:
        """`fields`: of each its values, one for each struct."""
        names = b"".join(each.encode().ljust(8, b"\0") for each in fields)
        inner = b"".join(fields[field][k] for k in range(count) for field in fields)
        return self.array(name, (1, count), self.small(5, self.pack("i", 8)) + self.element(1, names) + inner, STRUCT)

    def load(self, *variables: bytes) -> tuple[dict[str, Any], int]:
        return load_5(self.head + b"".join(variables))


LITTLE, BIG = Machine("<"), Machine(">")
orders = pytest.mark.parametrize("machine", [LITTLE, BIG], ids=["little", "big"])


@orders
def test_numbers_of_both_orders_of_bytes(machine: Machine) -> None:
    for kind, letter in {1: "b", 2: "B", 3: "h", 4: "H", 5: "i", 6: "I", 7: "f", 9: "d", 12: "q", 13: "Q"}.items():
        content = machine.element(kind, machine.pack(f"6{letter}", *range(1, 7)))
        found, damaged = machine.load(machine.array("x", (2, 3), content), machine.numbers("y", 7.0))
        assert damaged == 0
        assert found["x"].tolist() == [[1, 3, 5], [2, 4, 6]], kind
        assert found["y"].tolist() == [[7.0]]


@orders
@pytest.mark.parametrize(
    "kind, text, encoding",
    [
        *((1, "Tank é", "latin-1"), (2, "Tank é", "latin-1"), (16, "größer λ", "utf-8")),
        *((4, "größer λ", "utf-16"), (17, "größer λ", "utf-16"), (18, "größer λ", "utf-32")),
    ],
)
def test_texts_in_every_encoding(machine: Machine, kind: int, text: str, encoding: str) -> None:
    ending = "" if encoding in ("latin-1", "utf-8") else "-le" if machine.order == "<" else "-be"
    content = machine.element(kind, text.encode(encoding + ending))
    assert machine.load(machine.array("s", (1, len(text)), content, CHAR)) == ({"s": text}, 0)


@orders
def test_small_elements_hold_their_data_in_their_tag(machine: Machine) -> None:
    small = machine.small(2, b"\3\4")
    found, damaged = machine.load(machine.array("n", (1, 2), small, UINT8), machine.numbers("y", 7.0))
    assert (found["n"].tolist(), found["y"].tolist(), damaged) == ([[3, 4]], [[7.0]], 0)


@orders
def test_structs_cells_and_objects(machine: Machine) -> None:
    one = machine.structs("one", 1, {"a": [machine.numbers("", 1.0)], "b": [machine.numbers("", 2.0)]})
    two = machine.structs("two", 2, {"a": [machine.numbers("", float(k)) for k in (1, 2)]})
    cell = machine.array("cell", (1, 3), two + machine.numbers("", 5.0) + machine.element(14, b""), CELL)
    inner = (
        machine.element(1, b"klass") + machine.small(5, machine.pack("i", 8)) + machine.element(1, b"a".ljust(8, b"\0"))
    )
    thing = machine.array("thing", (1, 1), inner + machine.numbers("", 9.0), OBJECT)
    found, damaged = machine.load(one, two, cell, thing)
    assert damaged == 0
    assert {name: value.tolist() for name, value in found["one"].items()} == {"a": [[1.0]], "b": [[2.0]]}
    assert [each["a"].tolist() for each in found["two"]] == [[[1.0]], [[2.0]]]
    assert [each["a"].tolist() for each in found["cell"][0]] == [[[1.0]], [[2.0]]]
    assert (found["cell"][1].tolist(), found["cell"][2]) == ([[5.0]], None)
    assert found["thing"]["a"].tolist() == [[9.0]]


def test_what_is_not_known_is_left_out_and_what_stands_behind_it_is_read() -> None:
    sparse = LITTLE.array("s", (1, 1), LITTLE.element(9, LITTLE.pack("d", 1.0)), SPARSE)
    assert list(LITTLE.load(sparse, LITTLE.numbers("y", 7.0))[0]) == ["y"]
    assert LITTLE.load(sparse)[1] == 0
    assert LITTLE.load(LITTLE.element(14, b""), LITTLE.numbers("y", 7.0))[1] == 0


@pytest.mark.parametrize(
    "bad",
    [
        LITTLE.array("x", (2, 2), LITTLE.element(9, LITTLE.pack("3d", 1, 2, 3))),  # fewer than its shape says
        LITTLE.array("x", (3,), LITTLE.element(9, LITTLE.pack("3d", 1, 2, 3))),
        LITTLE.array("x", (-1, 1), b"", CELL),
        LITTLE.array("x", (-1, -3), LITTLE.element(9, LITTLE.pack("3d", 1, 2, 3))),
        LITTLE.array("x", (1, 3), LITTLE.element(8, LITTLE.pack("3d", 1, 2, 3))),  # of no type
        LITTLE.array("x", (1, 3), LITTLE.element(9, b"abc"), CHAR),  # a text of numbers
        LITTLE.array("x", (1, 1), LITTLE.small(5, LITTLE.pack("i", 0)) + LITTLE.element(1, b""), STRUCT),
        LITTLE.array("x", (1, 1), LITTLE.small(5, LITTLE.pack("i", 8)) + LITTLE.element(1, b"abc"), STRUCT),
        LITTLE.array("x", (1, 1), LITTLE.element(9, LITTLE.pack("d", 1.0)), CELL),  # no array within
        LITTLE.element(14, b"\6\0\0\0\xff\0\0\0"),  # ends within
        LITTLE.element(15, b"nonsense"),
    ],
)
def test_what_is_damaged_is_counted_and_what_stands_behind_it_is_read(bad: bytes) -> None:
    found, damaged = LITTLE.load(bad, LITTLE.numbers("y", 7.0))
    assert (list(found), damaged) == (["y"], 1)


def test_a_struct_whose_end_is_damaged_keeps_the_fields_before() -> None:
    fields = {"a": [LITTLE.numbers("", 1.0)], "b": [LITTLE.element(9, b"")]}
    found, damaged = LITTLE.load(LITTLE.structs("one", 1, fields), LITTLE.numbers("y", 7.0))
    assert damaged == 1
    assert {name: value.tolist() for name, value in found["one"].items()} == {"a": [[1.0]]}
    outer = LITTLE.structs("outer", 1, {"c": [LITTLE.structs("", 1, fields)]})
    found, damaged = LITTLE.load(outer)
    assert damaged == 1
    assert list(found["outer"]["c"]) == ["a"]


def test_variables_that_are_packed_or_cut() -> None:
    packed = zlib.compress(LITTLE.numbers("x", 1.0, 2.0))
    compressed = LITTLE.pack("II", 15, len(packed)) + packed  # not padded
    found, damaged = LITTLE.load(compressed, LITTLE.numbers("y", 7.0))
    assert (found["x"].tolist(), found["y"].tolist(), damaged) == ([[1.0, 2.0]], [[7.0]], 0)
    whole = LITTLE.head + LITTLE.numbers("x", 1.0) + LITTLE.numbers("y", 7.0)
    assert [list(load_5(whole[:end])[0]) for end in (len(whole), len(whole) - 1, 128 + 80, 128)] == [
        ["x", "y"],
        ["x"],
        ["x"],
        [],
    ]
    assert [load_5(whole[:end])[1] for end in (len(whole), len(whole) - 1, 128 + 80, 128)] == [0, 1, 1, 0]
    for wrong in (LITTLE.head[:127], LITTLE.head[:126] + b"XX", b""):
        with pytest.raises(ValueError, match="no header"):
            load_5(wrong)


def test_structs_within_structs_end_somewhere() -> None:
    deep = LITTLE.numbers("", 1.0)
    for _ in range(20):
        deep = LITTLE.structs("", 1, {"a": [deep]})
    found, _ = LITTLE.load(LITTLE.structs("x", 1, {"a": [deep]}))
    depth, node = 0, found["x"]
    while isinstance(node, dict):
        depth, node = depth + 1, node["a"]
    assert (depth, node) == (17, None)


def test_version_7_3_kind_by_kind(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["x"] = np.arange(6.0).reshape(3, 2)
        file["scalar"] = 4.0
        file["empty"] = np.zeros(2, dtype=np.uint64)
        file["empty"].attrs["MATLAB_empty"] = 1
        file["text"] = np.array([[ord(letter)] for letter in "größer"], dtype=np.uint16)
        file["text"].attrs["MATLAB_class"] = np.bytes_("char")
        file["complex"] = np.array([1 + 2j])
        file["s/a"] = np.ones((2, 1))
        file["s/name"] = np.array([[110]], dtype=np.uint16)
        file["s/name"].attrs["MATLAB_class"] = "char"
        file["#refs#/one"], file["#refs#/two"] = np.ones((1, 1)), np.full((1, 1), 2.0)
        references = [file["#refs#/one"].ref, file["#refs#/two"].ref]
        file.create_dataset("cell", data=np.array([references], dtype=h5py.ref_dtype))
        file.create_dataset("many/a", data=np.array([references], dtype=h5py.ref_dtype))
        file.create_dataset("many/b", data=np.array([references[::-1]], dtype=h5py.ref_dtype))
        file.create_dataset("odd/a", data=np.array([references], dtype=h5py.ref_dtype))
        file.create_dataset("odd/b", data=np.array([references[:1]], dtype=h5py.ref_dtype))
    found, damaged = load_variables(path)
    assert damaged == 0
    assert not any(name.startswith("#") for name in found)
    assert found["x"].tolist() == [[0.0, 2.0, 4.0], [1.0, 3.0, 5.0]]
    assert found["scalar"].tolist() == [[4.0]]
    assert (found["empty"], found["complex"], found["text"]) == (None, None, "größer")
    assert (found["s"]["a"].tolist(), found["s"]["name"]) == ([[1.0, 1.0]], "n")
    assert [each.tolist() for each in found["cell"]] == [[[1.0]], [[2.0]]]
    assert [(each["a"].item(), each["b"].item()) for each in found["many"]] == [(1.0, 2.0), (2.0, 1.0)]
    assert {name: len(each) for name, each in found["odd"].items()} == {"a": 2, "b": 1}
