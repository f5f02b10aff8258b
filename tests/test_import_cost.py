"""`import towtank` is free: public names load on first use."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys

import pytest

import towtank

HEAVY = [
    *("h5py", "matplotlib", "mcap", "numba", "numpy", "pyarrow", "pydantic", "pymavlink", "rich", "rosbags", "scipy"),
    *("starlette", "tomlkit", "typer", "uvicorn", "websockets"),
]


def loaded_after(statement: str) -> set[str]:
    """Return the top-level modules that a fresh interpreter holds after `statement`."""
    code = f"{statement}\nimport sys\nprint(*sorted({{name.partition('.')[0] for name in sys.modules}}))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    return set(run.stdout.split())


def test_import_brings_nothing_heavy() -> None:
    loaded = loaded_after("import towtank; dir(towtank); towtank.__version__")
    assert "towtank" in loaded
    assert loaded.isdisjoint(HEAVY)


def test_errors_are_free_too() -> None:
    assert loaded_after("from towtank import InputError").isdisjoint(HEAVY)


def test_a_file_that_is_no_log_is_known_without_libraries() -> None:
    assert loaded_after("from towtank.readers import recognised").isdisjoint(HEAVY)


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'towtank' has no attribute 'simulat'"):
        _ = towtank.simulat


@pytest.mark.parametrize("name", towtank.__all__)
def test_every_public_name_resolves(name: str) -> None:
    assert getattr(towtank, name) is not None
    assert name in dir(towtank)


def test_type_checkers_and_interpreter_see_the_same_names() -> None:
    nodes = ast.walk(ast.parse(inspect.getsource(towtank)))
    imports = [(node.module or "", node.names) for node in nodes if isinstance(node, ast.ImportFrom)]
    seen = {
        alias.name: module.removeprefix("towtank.")
        for module, names in imports
        if module.startswith("towtank.")
        for alias in names
    }
    assert seen == towtank._HOMES
    assert {*seen, "__version__"} == set(towtank.__all__)
