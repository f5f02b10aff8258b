"""What the Tab key offers: names of the catalog beside files, methods, manoeuvres. Quick: no library is loaded for it.

The shell asks the command itself; `towtank --install-completion` tells the shell of bash, zsh or fish to do so.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import towtank
from towtank.methods import METHODS, STREAMING_METHODS

__all__ = ["catalog", "manoeuvres", "methods", "sensor_sets", "streaming_methods", "vehicles"]

_CATALOG = Path(towtank.__file__).parent / "vehicle" / "catalog"


def catalog(incomplete: str) -> list[str]:
    """Return the names of the catalog that begin with a word."""
    return sorted(path.stem for path in _CATALOG.glob("*.toml") if path.stem.startswith(incomplete))


def vehicles(incomplete: str) -> list[str]:
    """Return the names of the catalog, and the vehicle files, that begin with a word."""
    return [*catalog(incomplete), *_paths(incomplete, lambda path: path.suffix.lower() == ".toml")]


def methods(incomplete: str) -> list[str]:
    """Return the methods of learning from logs."""
    return [name for name in METHODS if name.startswith(incomplete)]


def streaming_methods(incomplete: str) -> list[str]:
    """Return the methods of learning from streams."""
    return [name for name in STREAMING_METHODS if name.startswith(incomplete)]


def manoeuvres(incomplete: str) -> list[str]:
    """Return the built-in manoeuvres, and the files, that begin with a word."""
    from towtank.simulation.manoeuvres import MANOEUVRES

    names = [name for name in MANOEUVRES if name.startswith(incomplete)]
    return [*names, *_paths(incomplete, lambda path: path.suffix != ".py")]


def sensor_sets(incomplete: str) -> list[str]:
    """Return the sensors that a simulated vehicle may have, by the names of the sets."""
    from towtank.simulation import SENSORS

    return [name for name in SENSORS if name.startswith(incomplete)]


def _paths(incomplete: str, wanted: Callable[[Path], bool]) -> list[str]:
    """Return files that are wanted; none that is hidden, unless a word begins so. Folders the shell offers itself."""
    folder, slash, begin = incomplete.rpartition("/")
    try:
        entries = sorted(Path(f"{folder}{slash}" or ".").expanduser().iterdir())
    except (OSError, RuntimeError):  # no such folder, or no such user
        return []
    known = [entry for entry in entries if entry.name.startswith(begin) and entry.is_file() and wanted(entry)]
    hidden = begin.startswith(".")
    return [f"{folder}{slash}{entry.name}" for entry in known if hidden or not entry.name.startswith(".")]
