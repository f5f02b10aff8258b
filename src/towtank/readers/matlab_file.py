"""The variables of a .mat file as nested dictionaries: arrays, texts, structs, and lists for arrays of structs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from towtank.errors import InputError
from towtank.readers.matlab5 import load_5

__all__ = ["load_variables"]

_HDF5 = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK = 512  # bytes that MATLAB writes before HDF5 begins
_LARGEST = 1 << 27  # numbers of one variable
_MOST = 4096  # elements of an array of structs or cells
_DEEPEST = 16
_NUMBERS = "biuf"


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
        raise InputError(f"{path}: {error}; save it in MATLAB with -v7") from error


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
        text = (str(error).strip() or type(error).__name__).splitlines()[0][:200]
        raise InputError(f"{path}: not a readable MATLAB file of version 7.3 ({text})") from error


def _item(h5py: Any, file: Any, item: Any, depth: int) -> Any:
    """Return a group or a data set of HDF5."""
    if depth > _DEEPEST:
        return None
    if isinstance(item, h5py.Group):
        return _struct({name: _item(h5py, file, item[name], depth + 1) for name in item})
    if not isinstance(item, h5py.Dataset) or not item.size or item.size > _LARGEST or "MATLAB_empty" in item.attrs:
        return None
    if item.dtype == object:
        references = list(np.ravel(item[()]))[:_MOST]
        return [_item(h5py, file, file[reference], depth + 1) for reference in references if reference]
    values = np.asarray(item[()])
    kind = item.attrs.get("MATLAB_class", b"")
    if kind in (b"char", "char"):
        return "".join(chr(int(code)) for code in values.T.ravel()[:_MOST] if code)
    return np.atleast_2d(values.T) if values.dtype.kind in _NUMBERS else None


def _struct(fields: dict[str, Any]) -> Any:
    """Return a struct; an array of structs, which HDF5 holds field by field, as a list of structs."""
    if fields and all(isinstance(value, list) for value in fields.values()):
        lengths = {len(value) for value in fields.values()}
        if len(lengths) == 1:
            return [dict(zip(fields, each, strict=True)) for each in zip(*fields.values(), strict=True)]
    return fields
