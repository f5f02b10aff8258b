"""Machine code kept on disk never outlives what it was made from, and outlives everything else."""

from __future__ import annotations

import importlib
import os
import pickle
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numba.core import event
from numba.core.runtime import _nrt_python, rtsys

from towtank.core import arrays

compiled = pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="there is no machine code")


def fresh(name: str) -> Any:
    """Import a module anew, as a new process does."""
    sys.modules.pop(name, None)
    return importlib.import_module(name)


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small package: `top` imports `core.below`; `aside` imports nothing."""
    (tmp_path / "core").mkdir()
    (tmp_path / "core" / "__init__.py").write_text("")
    (tmp_path / "core" / "below.py").write_text("kernel = 1\n")
    (tmp_path / "top.py").write_text("from towtank.core import (\n    below,\n)\nkernel = below\n")
    (tmp_path / "aside.py").write_text("kernel = 3\n")
    monkeypatch.setattr(arrays, "_ROOT", tmp_path)
    return tmp_path


def fingerprints() -> dict[str, str]:
    arrays._source.cache_clear()
    arrays.fingerprint.cache_clear()
    try:
        return {name: arrays.fingerprint(f"towtank.{name}") for name in ("top", "core.below", "aside")}
    finally:
        arrays._source.cache_clear()
        arrays.fingerprint.cache_clear()


def test_a_change_compiles_anew_what_imports_it_and_nothing_else(package: Path) -> None:
    before = fingerprints()
    (package / "core" / "below.py").write_text("kernel = 2\n")
    after = fingerprints()
    changed = {name for name in before if before[name] != after[name]}
    assert changed == {"top", "core.below"}


def test_a_change_above_leaves_what_is_below(package: Path) -> None:
    before = fingerprints()
    (package / "top.py").write_text("kernel = 4\n")
    after = fingerprints()
    assert {name for name in before if before[name] != after[name]} == {"top"}


def test_the_filter_answers_to_the_dynamics() -> None:
    files = set()
    waiting = [Path(arrays.__file__).parent.parent / "identification" / "kalman" / "filter.py"]
    while waiting:
        path = waiting.pop()
        if path not in files:
            files.add(path)
            waiting += arrays._source(path)[1]
    assert {"rk4.py", "linearisation.py", "zero_order_hold.py", "update.py"} <= {path.name for path in files}


@compiled
def test_an_index_of_machine_code_that_cannot_be_read_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "small.py").write_text("def double(x):\n    return 2.0 * x\n")
    monkeypatch.syspath_prepend(str(tmp_path))

    assert arrays.kernel(fresh("small").double)(2.0) == 4.0
    [index] = tmp_path.rglob("*.nbi")
    version = index.read_bytes()[: len(pickle.dumps(numba.__version__))]
    assert pickle.loads(version) == numba.__version__
    index.write_bytes(version + b"cgone_module\nGone\n.")
    assert arrays.kernel(fresh("small").double)(3.0) == 6.0


@compiled
def test_what_kernels_call_is_compiled_into_them_and_nowhere_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "nested.py").write_text(
        "from towtank.core.arrays import inlined_kernel, kernel\n"
        "@inlined_kernel\ndef below(x):\n    return 2.0 * x\n"
        "@kernel\ndef middle(x):\n    return below(x) + 1.0\n"
        "@kernel\ndef top(x):\n    return middle(x) + below(x)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))

    nested = fresh("nested")
    assert nested.top(3.0) == 13.0
    assert [path.name.partition("-")[0] for path in tmp_path.rglob("*.nbc")] == ["nested.top"]
    assert nested.middle(3.0) == 7.0, "what was woven into another is called by itself"
    again = fresh("nested")
    assert again.top(3.0) == 13.0
    assert sum(again.top.stats.cache_hits.values()) == 1


@compiled
def test_what_is_called_with_several_integers_is_compiled_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "numbered.py").write_text(
        "from towtank.core.arrays import kernel\n"
        "@kernel\ndef one(x, k):\n    return x[k]\n"
        "@kernel\ndef top(x):\n    total = one(x, 0) + one(x, 1) + one(x, k=2)\n"
        "    for k in range(3):\n        total += one(x, k)\n    return total\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    numbered = fresh("numbered")
    names = list[str]()

    class Heard(event.Listener):  # type: ignore[misc]
        def on_start(self, each: Any) -> None:
            names.append(each.data["dispatcher"].py_func.__name__)

        def on_end(self, each: Any) -> None:
            pass

    with event.install_listener("numba:compile", Heard()):
        assert numbered.top(np.array([1.0, 2.0, 4.0])) == 14.0
    assert names.count("one") == 1


@compiled
def test_what_borrows_its_arrays_counts_nothing_and_what_makes_some_gives_them_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "borrowed.py").write_text(
        "import numpy as np\n"
        "from towtank.core.arrays import kernel\n"
        "@kernel\ndef borrows(a, out):\n    row = a[1]\n    flat = a.reshape(a.size)\n"
        "    for j in range(3):\n        out[j] = row[j] + flat[0]\n"
        "@kernel\ndef copies(a, out):\n    out[:] = a[1]\n"
        "@kernel\ndef makes(a):\n    return a[0] + a[1]\n"
        "@kernel\ndef views(a):\n    return a[1]\n"
        "@kernel\ndef top(a, out):\n    for _ in range(1000):\n        copies(a, out)\n        borrows(a, out)\n"
        "        out += makes(a)\n        out -= views(a)\n    return makes(a)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    borrowed = fresh("borrowed")
    a, out = np.arange(6.0).reshape(2, 3), np.zeros(3)
    borrowed.top(a, out)  # compiled
    held = sys.getrefcount(a)
    _nrt_python.memsys_enable_stats()
    try:
        before = rtsys.get_allocation_stats()
        made = borrowed.top(a, out)
        assert made.tolist() == [3.0, 5.0, 7.0]
        del made
        after = rtsys.get_allocation_stats()
    finally:
        _nrt_python.memsys_disable_stats()
    assert out.tolist() == [3.0, 5.0, 7.0]  # a[1] and a[0, 0], then a[0] + a[1], less a[1]
    assert sys.getrefcount(a) == held
    assert after.alloc - before.alloc == after.free - before.free >= 1000, "an array that a kernel makes was not freed"
