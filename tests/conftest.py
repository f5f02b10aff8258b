"""Fixtures for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of real recordings: `$TOWTANK_DATA`, else `shared/data` beside the repository, else skip."""
    named = os.environ.get("TOWTANK_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real recordings: {folder} is not a folder (set TOWTANK_DATA to where they are)")
    return folder
