"""The vehicles that come with towtank: one TOML file each, with the provenance of every number."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

from towtank.errors import InputError, nearest

__all__ = ["catalog_names", "catalog_text"]


@cache
def catalog_names() -> tuple[str, ...]:
    """Return the names of the catalog, in alphabetical order."""
    folder = files("towtank.vehicle") / "catalog"
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml")))


def catalog_text(name: str) -> str:
    """Return the TOML text of a vehicle of the catalog. Raises InputError for an unknown name."""
    if name not in catalog_names():
        raise InputError(f'"{name}" is not in the catalog{nearest(name, catalog_names())}')
    return (files("towtank.vehicle") / "catalog" / f"{name}.toml").read_text(encoding="utf-8")
