"""The variables of a .mat file as nested dictionaries: arrays, texts, structs, and lists for arrays of structs.

Files of version 5 to 7 are read element by element, as far as they go: damaged ones bring down scipy and the
interpreter (`scipy.io.loadmat` looks up the type of an element in a table of fixed size without a check).
"""

from __future__ import annotations

import struct
import zlib
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from towtank.errors import InputError

__all__ = ["load_variables"]

_HEADER = 128
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXTS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MATRIX, _COMPRESSED = 14, 15
_CELL, _STRUCT, _OBJECT, _CHAR = 1, 2, 3, 4
_NUMERIC = range(6, 16)
_LARGEST = 1 << 30  # bytes that a variable may unpack to
_DEEPEST = 16
_MOST = 4096  # elements of an array of structs or cells that are read
_HDF5 = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK = 512  # bytes that MATLAB writes before HDF5 begins
_LARGEST_FILE = 1 << 27  # numbers of one variable
_NUMERIC_CLASSES = "biuf"


class _Element(NamedTuple):
    kind: int
    start: int
    size: int
    next: int


def load_5(data: bytes) -> tuple[dict[str, Any], int]:
    """Return the variables of a file, and how many could not be read.

    Numbers are arrays in MATLAB's order of rows and columns, texts are `str`, structs are dictionaries, arrays of
    structs and cells are lists; what is none of these is None.

    Raises:
        ValueError: this is no file of version 5 to 7.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None or len(data) < _HEADER:
        raise ValueError("no header of a MATLAB file of version 5 to 7")
    variables: dict[str, Any] = {}
    damaged, at = 0, _HEADER
    while at < len(data):
        try:
            element = _element(data, at, order, padded=False, cut=True)
        except (ValueError, struct.error):
            damaged += 1
            break
        whole = at + 8 + element.size <= len(data)
        at = element.next
        part = data[element.start : element.start + element.size]
        try:
            if element.kind == _COMPRESSED:
                unpacker = zlib.decompressobj()
                part = unpacker.decompress(part, _LARGEST)
                inner = _element(part, 0, order, cut=True)
                part = part[inner.start : inner.start + inner.size]
            if element.size:
                parser = _Parser(part, order)
                name, value = parser.variable()
                whole = whole and not parser.damaged
                if name:
                    variables[name] = value
        except (ValueError, IndexError, struct.error, zlib.error):
            whole = False
        damaged += not whole
    return variables, damaged


def _element(data: bytes, at: int, order: str, *, padded: bool = True, cut: bool = False) -> _Element:
    """Return the element that begins at `at`.

    Raises:
        ValueError, struct.error: the data end within it, unless it may be cut.
    """
    (word,) = struct.unpack_from(f"{order}I", data, at)
    if word >> 16:  # its data stand in its tag
        kind, size, start = word & 0xFFFF, word >> 16, at + 4
        following = at + 8
    else:
        kind, start = word, at + 8
        (size,) = struct.unpack_from(f"{order}I", data, at + 4)
        following = start + size + (-size % 8 if padded or kind != _COMPRESSED else 0)
    if start + size > len(data) and not cut:
        raise ValueError("the data end within an element")
    return _Element(kind, start, size, following)


class _Parser:
    """Reads one matrix element's content."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data, self._order, self._at = data, order, 0
        self.damaged = False  # whether fields of a struct are missing

    def variable(self, depth: int = 0) -> tuple[str, Any]:
        """Return name and value."""
        flags = self._next()
        (word,) = struct.unpack_from(f"{self._order}I", self._data, flags.start)
        kind = word & 0xFF
        if not (kind in _NUMERIC or kind in (_CELL, _STRUCT, _OBJECT, _CHAR)) or depth > _DEEPEST:
            return "", None  # sparse matrices, functions, objects of classes
        shape = tuple(int(size) for size in self._numbers(self._next()))
        if any(size < 0 for size in shape) or len(shape) < 2:
            raise ValueError("an array without a shape")
        name = self._text(self._next())
        if kind in _NUMERIC:
            return name, self._array(shape)
        if kind == _CHAR:
            return name, self._words()
        if kind == _CELL:
            return name, [self._inner(depth) for _ in range(min(prod(shape), _MOST))]
        if kind == _OBJECT:
            self._next()  # name of the class
        structs = self._structs(prod(shape), depth)
        return name, structs[0] if prod(shape) == 1 and structs else structs

    def _structs(self, count: int, depth: int) -> list[dict[str, Any]]:
        width = int(self._numbers(self._next())[0])
        names = self._next()
        if width <= 0 or names.size % width:
            raise ValueError("a struct without names")
        raw = self._data[names.start : names.start + names.size]
        fields = [raw[k : k + width].split(b"\0")[0].decode("latin-1") for k in range(0, len(raw), width)]
        structs: list[dict[str, Any]] = [{} for _ in range(min(count, _MOST))]
        try:
            for one in structs:
                for field in fields:
                    one[field] = self._inner(depth)
        except (ValueError, IndexError, struct.error):
            self.damaged = True
        return structs

    def _inner(self, depth: int) -> Any:
        element = self._next()
        if element.kind != _MATRIX:
            raise ValueError("an array is expected within an array")
        if not element.size:
            return None
        data = self._data[element.start : element.start + element.size]
        parser = _Parser(data, self._order)
        value = parser.variable(depth + 1)[1]
        self.damaged |= parser.damaged
        return value

    def _array(self, shape: tuple[int, ...]) -> Any:
        values = self._numbers(self._next())
        if values.size != prod(shape):
            raise ValueError("an array is not as large as its shape says")
        return values.reshape(shape, order="F")

    def _words(self) -> str:
        element = self._next()
        return self._text(element)

    def _next(self) -> _Element:
        element = _element(self._data, self._at, self._order)
        self._at = element.next
        return element

    def _numbers(self, element: _Element) -> Any:
        if element.kind not in _NUMBERS:
            raise ValueError(f"numbers of type {element.kind} are not known")
        dtype = np.dtype(self._order + _NUMBERS[element.kind])
        count = element.size // dtype.itemsize
        return np.frombuffer(self._data, dtype, count, element.start)

    def _text(self, element: _Element) -> str:
        if element.kind not in _TEXTS:
            raise ValueError(f"text of type {element.kind} is not known")
        raw = self._data[element.start : element.start + element.size]
        ending = "" if element.kind in (1, 2, 16) else "-le" if self._order == "<" else "-be"
        return raw.decode(_TEXTS[element.kind] + ending, errors="replace")


def load_variables(path: Path) -> tuple[dict[str, Any], int]:
    """Return the variables of a file of version 5 to 7.3, as `matlab5.load_5` gives them, and how many are damaged.

    Raises:
        InputError: the file is no .mat file, is damaged, or is of version 7.3 and h5py is not installed.
    """
    with path.open("rb") as stream:
        head = stream.read(_USER_BLOCK + len(_HDF5))
    if head.startswith(_HDF5) or head[_USER_BLOCK:] == _HDF5:
        return _load_73(path), 0
    try:
        return load_5(path.read_bytes())
    except ValueError as error:
        raise InputError(f"{path}: {error}; expected a .mat file; save it in MATLAB with -v7") from error


def _load_73(path: Path) -> dict[str, Any]:
    try:
        import h5py
    except ImportError as error:
        raise InputError(
            f"{path}: a MATLAB file of version 7.3, for which h5py is needed; pip install towtank[matlab], "
            "or save it with -v7"
        ) from error
    try:
        with h5py.File(path, "r") as file:
            return {name: _item(h5py, file, file[name], 0) for name in file if not name.startswith("#")}
    except Exception as error:  # h5py raises many kinds for damaged files
        raise InputError(
            f"{path}: not a readable MATLAB file of version 7.3: it is damaged or cut off, expected a whole one; "
            "copy it again"
        ) from error


def _item(h5py: Any, file: Any, item: Any, depth: int) -> Any:
    """Return a group or a data set of HDF5."""
    if depth > _DEEPEST:
        return None
    if isinstance(item, h5py.Group):
        return _struct({name: _item(h5py, file, item[name], depth + 1) for name in item})
    if not isinstance(item, h5py.Dataset) or not item.size or item.size > _LARGEST_FILE or "MATLAB_empty" in item.attrs:
        return None
    if item.dtype == object:
        references = list(np.ravel(item[()]))[:_MOST]
        return [_item(h5py, file, file[reference], depth + 1) for reference in references if reference]
    values = np.asarray(item[()])
    kind = item.attrs.get("MATLAB_class", b"")
    if kind in (b"char", "char"):
        return "".join(chr(int(code)) for code in values.T.ravel()[:_MOST] if code)
    return np.atleast_2d(values.T) if values.dtype.kind in _NUMERIC_CLASSES else None


def _struct(fields: dict[str, Any]) -> Any:
    """Return a struct; an array of structs, which HDF5 holds field by field, as a list of structs."""
    if fields and all(isinstance(value, list) for value in fields.values()):
        lengths = {len(value) for value in fields.values()}
        if len(lengths) == 1:
            return [dict(zip(fields, each, strict=True)) for each in zip(*fields.values(), strict=True)]
    return fields
