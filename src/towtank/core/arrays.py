"""Array types and the compiler switch shared by all kernels.

Numba keeps the machine code of a kernel as long as the kernel's own file is unchanged, although code from other files
was compiled into it. So a fingerprint is added to what it compares: of the kernel's own file and of every file with
kernels that it imports, directly or not. A change compiles anew what it reaches, and nothing else.
"""

from __future__ import annotations

import hashlib
import pickle
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
import numpy as np
from numpy.typing import NDArray

__all__ = ["Array", "fingerprint", "inlined_kernel", "kernel", "parallel_kernel"]

Array = NDArray[np.float64]
_F = TypeVar("_F", bound=Callable[..., Any])
# Contraction lets the compiler fuse multiply and add. Reassociation is left out: it would cancel the x - x of isfinite.
_FAST = {"contract", "nsz"}


_ROOT = Path(__file__).parent.parent
_IMPORT = re.compile(rb"^\s*from towtank\.?([\w.]*) import (\([^)]*\)|[^#\n]*)", re.MULTILINE)


@cache
def _source(path: Path) -> tuple[bytes, tuple[Path, ...]]:
    """Return the source of a file of this package and the files of this package that it imports."""
    text = path.read_bytes()
    found = []
    for package, names in _IMPORT.findall(text):
        place = _ROOT.joinpath(*package.decode().split(".")) if package else _ROOT
        inside = [place / f"{name}.py" for name in re.findall(r"\w+", names.decode())] if place.is_dir() else []
        found += [place.with_suffix(".py"), place / "__init__.py", *inside]
    return text, tuple(each for each in dict.fromkeys(found) if each.is_file())


@cache
def fingerprint(module: str) -> str:
    """Return a digest of a module of this package and of all files with kernels that it imports, directly or not."""
    waiting, seen = [_ROOT.joinpath(*module.split(".")[1:]).with_suffix(".py")], set[Path]()
    while waiting:
        path = waiting.pop()
        if path not in seen and path.is_file():
            seen.add(path)
            waiting += _source(path)[1]
    digest = hashlib.sha256()
    for path in sorted(seen):
        source = _source(path)[0]
        if b"kernel" in source or path.parent.name == "core":
            digest.update(path.relative_to(_ROOT).as_posix().encode() + b"\0" + source)
    return digest.hexdigest()


def bind_cache(compiled: Any) -> None:
    """Make the disk cache of a compiled function depend on the fingerprint; nothing where it has no disk cache.

    An index that cannot be read, as one that names records which have moved since, counts as none.
    """
    file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if file is None:
        return
    file._source_stamp = (file._source_stamp, fingerprint(compiled.py_func.__module__))
    load = file._load_index

    def load_index() -> Any:
        try:
            return load()
        except (ImportError, AttributeError, EOFError, ValueError, TypeError, pickle.UnpicklingError):
            return {}

    file._load_index = load_index


def kernel(function: _F) -> _F:
    """Compile `function` on first use and keep the machine code on disk; other threads run beside it."""
    compiled: _F = numba.njit(cache=True, error_model="numpy", fastmath=_FAST, nogil=True)(function)
    bind_cache(compiled)
    return compiled


def parallel_kernel(function: _F) -> _F:
    """As `kernel`, with `numba.prange` loops spread over all processor cores."""
    compiled: _F = numba.njit(cache=True, error_model="numpy", fastmath=_FAST, parallel=True)(function)
    bind_cache(compiled)
    return compiled


def inlined_kernel(function: _F) -> _F:
    """As `kernel`, always inlined: array shapes that are constant in the caller become constants here."""
    compiled: _F = numba.njit(cache=True, error_model="numpy", fastmath=_FAST, forceinline=True, nogil=True)(function)
    bind_cache(compiled)
    return compiled
