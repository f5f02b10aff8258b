"""The one JSON document of a command: NaN and infinity become null, arrays lists, paths text."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

__all__ = ["json_text", "plain"]


def plain(value: Any) -> Any:
    """Return `value` as dictionaries, lists, numbers, texts and None.

    >>> plain({"std": float("nan"), "window": (0.0, 1.0)})
    {'std': None, 'window': [0.0, 1.0]}
    """
    if value is None or isinstance(value, str | bool):
        return value
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # arrays and scalars of NumPy
        return plain(value.tolist())
    if hasattr(value, "model_dump"):
        return plain(value.model_dump())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, int):
        return value
    raise TypeError(f"found {type(value).__name__}, which has no place in a JSON document")


def json_text(document: Mapping[str, Any]) -> str:
    """Return the document as JSON, pure ASCII, indented."""
    return json.dumps(plain(document), indent=2, allow_nan=False)
