"""Fixtures for all tests."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest
import typer.main
import typer.testing

REPOSITORY = Path(__file__).resolve().parent.parent

# The commands are made from their functions once, not for every call: that takes as long as many a command does.
typer.main.get_command = typer.testing._get_command = cache(typer.main.get_command)  # type: ignore[attr-defined]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Look for no garbage while tests are collected: what is made there stays, and looking took a third of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of real recordings: `$TOWTANK_DATA`, else `shared/data` beside the repository, else skip."""
    named = os.environ.get("TOWTANK_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real recordings: {folder} is not a folder (set TOWTANK_DATA to where they are)")
    return folder


@contextmanager
def hurry() -> Iterator[None]:
    """Search for plans and judge them with a tenth of the effort: for tests of what is done with a plan."""
    from towtank.planning import plan
    from towtank.planning.unsteered import unsteered

    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(plan.__kwdefaults__, "tries", 4)
        patch.setitem(unsteered.__kwdefaults__, "vehicles", 150)
        yield


@pytest.fixture
def hurried() -> Iterator[None]:
    """Plans are made in a hurry."""
    with hurry():
        yield
