"""One clear line from a validation error: the place in the file, what was found, what was expected."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError
from pydantic_core import PydanticCustomError

from towtank.errors import nearest
from towtank.vehicle.base import described

__all__ = ["first_line"]

_KINDS = ("polynomial", "table", "quadratic")
_EXPECTED = {
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "dict_type": "a table",
    "model_type": "a table",
    "model_attributes_type": "a table",
    "tuple_type": "a list",
    "list_type": "a list",
    "too_short": "at least one number",
}


def first_line(error: ValueError, data: Any = None) -> str:
    """Return `place: found, expected` of the first error, and how many more there are.

    Args:
        error: a pydantic ValidationError, or any ValueError, whose text is then returned.
        data: what was validated, to name the thruster by its name.
    """
    if isinstance(error, PydanticCustomError) and error.type == "misplaced":
        context = error.context or {}
        return f"{context['place']}: {context['text']}"
    if not isinstance(error, ValidationError):
        return str(error)
    errors = error.errors(include_url=False)
    place, text = _one(dict(errors[0]))
    more = f" (and {len(errors) - 1} more)" if len(errors) > 1 else ""
    line = f"{place}: {text}" if place else text
    return f"{line}{_thruster(errors[0]['loc'], data)}{more}"


def _one(error: dict[str, Any]) -> tuple[str, str]:
    loc, kind, context = list(error["loc"]), error["type"], error.get("ctx", {})
    found = described(error["input"])
    if kind == "misplaced":
        below = context["place"]
        return _place(loc) + (below if below.startswith("[") or not loc else f".{below}"), context["text"]
    if kind == "value_error":
        text = str(context.get("error", error["msg"]))
    elif kind == "missing":
        text = "missing"
    elif kind == "union_tag_not_found":
        loc.append("kind")
        text = f"missing; expected {', '.join(_KINDS)}"
    elif kind == "union_tag_invalid":
        loc.append("kind")
        text = f'found "{context["tag"]}", expected {", ".join(_KINDS)}{nearest(str(context["tag"]), _KINDS)}'
    elif kind in _EXPECTED:
        text = f"found {found}, expected {_EXPECTED[kind]}"
    else:
        text = f"found {found}: {error['msg']}"
    return _place(loc), text


def _place(loc: list[Any]) -> str:
    """Return `thrusters[0].curve.limits[1]`; the kind that pydantic puts behind `curve` is no part of the file."""
    out = ""
    previous = None
    for part in loc:
        if isinstance(part, int):
            out += f"[{part}]"
        elif not (previous == "curve" and part in _KINDS):
            out += f".{part}" if out else str(part)
        previous = part
    return out


def _thruster(loc: tuple[Any, ...], data: Any) -> str:
    """Return ` (thruster "aft_port")` where the place is inside a thruster that has a name."""
    if len(loc) < 2 or loc[0] != "thrusters" or not isinstance(loc[1], int) or not isinstance(data, dict):
        return ""
    try:
        name = data["thrusters"][loc[1]]["name"]
    except (KeyError, IndexError, TypeError):
        return ""
    return f' (thruster "{name}")' if isinstance(name, str) else ""
