"""Array types and the compiler switch shared by all kernels.

Numba keeps the machine code of a kernel as long as the kernel's own file is unchanged, although code from other files
was compiled into it. So a fingerprint is added to what it compares: of the kernel's own file and of every file with
kernels that it imports, directly or not. A change compiles anew what it reaches, and nothing else.

Numba optimises every function and makes machine code of it, and does so again in each function that calls it, level by
level; of the joint filter's 70 kernels, nested nine deep, that of one is used. Here a call from a kernel leads to a
twin of the callee that is typed and lowered, and no more: what Python calls is optimised with all that it calls, once.
Nor does a twin count references to arrays, atomically each time, unless it makes or gets some: they are its caller's.
"""

from __future__ import annotations

import hashlib
import pickle
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import ir, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import LoweringPass, register_pass
from numba.core.typed_passes import AnnotateTypes, NativeLowering
from numpy.typing import NDArray

__all__ = ["Array", "fingerprint", "inlined_kernel", "kernel", "parallel_kernel", "summing_kernel"]

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


class _WovenLibrary(JITCodeLibrary):  # type: ignore[misc]
    """Code to be linked into others: neither optimised as a whole nor made into machine code."""

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


@register_pass(mutates_CFG=False, analysis_only=False)
class _Announce(LoweringPass):  # type: ignore[misc]
    """Name the lowered function to its callers, under a key of its own in place of an address."""

    _name = "towtank_announce"

    def __init__(self) -> None:
        LoweringPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        key: Any = [].append  # a builtin, as Numba's tables ask for, and equal to no other
        state.targetctx.insert_user_function(key, state.cr.fndesc, [state.library])
        state["cr"] = state.cr._replace(cfunc=key)
        return True


_UNCOUNTED: dict[Any, Any] = {}  # functions of Numba's own, compiled without counting
_VIEWS = ("getitem", "static_getitem", "cast", "build_tuple", "exhaust_iter")


@register_pass(mutates_CFG=False, analysis_only=True)
class _Borrow(LoweringPass):  # type: ignore[misc]
    """Leave references uncounted in a function in which every array is an argument, or a view of one.

    What this does not know, a call that returns an array or an iteration, is taken to make one: it costs time alone.
    """

    _name = "towtank_borrow"

    def __init__(self) -> None:
        LoweringPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        def counted(each: Any) -> bool:
            return bool(state.targetctx.data_model_manager[each].contains_nrt_meminfo())

        def makes(expression: Any, signature: Any) -> bool:
            if isinstance(expression, ir.SetItem | ir.StaticSetItem):  # what overlaps is copied first
                return isinstance(signature.args[-1], types.Array)
            if signature is None or not isinstance(expression, ir.Expr) or not counted(signature.return_type):
                return False
            if expression.op == "call":
                called = state.typemap[expression.func.name]
                views = getattr(called, "typing_key", "") == "array.reshape"
                return not (views or isinstance(called, types.NamedTupleClass))
            return expression.op not in _VIEWS or any(isinstance(each, types.Array) for each in signature.args[1:])

        if counted(state.return_type) or any(makes(*each) for each in state.calltypes.items()):
            return False
        state.flags.nrt = False
        state.targetctx = state.targetctx.subtarget(enable_nrt=False)
        state.targetctx.cached_internal_func = _UNCOUNTED
        return False


class _Woven(CompilerBase):  # type: ignore[misc]
    """The compiler of a function that only other kernels call."""

    def define_pipelines(self) -> list[Any]:
        """Return the usual passes, which end before there is machine code."""
        state = self.state
        state.library = _WovenLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        passes = DefaultPassBuilder.define_nopython_pipeline(state)
        passes.add_pass_after(_Borrow, AnnotateTypes)
        passes.add_pass_after(_Announce, NativeLowering)
        passes.finalize()
        return [passes]


def _of_any_value(each: Any) -> Any:
    """Return the type of an argument, whatever its value: for each number and truth Numba would compile anew."""
    return each.literal_type if isinstance(each, types.IntegerLiteral | types.BooleanLiteral) else each


def _compiled(function: _F, **options: Any) -> _F:
    """Return the function compiled on first use, its machine code kept on disk; kernels that call it take a twin."""
    options = {"error_model": "numpy", "fastmath": _FAST} | options
    compiled: Any = numba.njit(cache=True, no_cfunc_wrapper=True, **options)(function)
    bind_cache(compiled)
    if compiled is not function:
        twin = numba.njit(pipeline_class=_Woven, no_cfunc_wrapper=True, no_cpython_wrapper=True, **options)(function)
        compiled.get_overload = twin.get_overload
        compiled.get_call_template = lambda args, kws: twin.get_call_template(
            tuple(map(_of_any_value, args)), {name: _of_any_value(each) for name, each in kws.items()}
        )
    return cast(_F, compiled)


def kernel(function: _F) -> _F:
    """Compile `function` on first use and keep the machine code on disk; other threads run beside it."""
    return _compiled(function, nogil=True)


def parallel_kernel(function: _F) -> _F:
    """As `kernel`, with `numba.prange` loops spread over all processor cores."""
    return _compiled(function, parallel=True)


def inlined_kernel(function: _F) -> _F:
    """As `kernel`, always inlined: array shapes that are constant in the caller become constants here."""
    return _compiled(function, forceinline=True, nogil=True)


def summing_kernel(function: _F) -> _F:
    """As `kernel`, whose sums are taken in the order that suits the processor; no x - x may be asked for."""
    return _compiled(function, nogil=True, fastmath=_FAST | {"reassoc"})
