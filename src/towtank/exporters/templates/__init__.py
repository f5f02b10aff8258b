"""Texts of generated programs: what stands between two @ is put in."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib.resources import files

__all__ = ["filled", "template"]


def template(name: str) -> str:
    """Return a text of this folder."""
    return (files("towtank.exporters") / "templates" / name).read_text(encoding="utf-8")


def filled(text: str, values: Mapping[str, str]) -> str:
    """Return a text with the value in place of every @name@. Raises KeyError where a value is missing."""
    return re.sub(r"@(\w+)@", lambda match: values[match[1]], text)
