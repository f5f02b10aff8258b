"""What every record of a vehicle file shares: frozen, no unknown keys, finite numbers, tuples.

One clear line from a validation error: the place in the file, what was found, what was expected.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from towtank.errors import nearest

__all__ = [
    "Finite",
    "NonNegative",
    "Numbers",
    "Pair",
    "Positive",
    "Record",
    "Share",
    "Vector",
    "described",
    "first_line",
    "listed",
    "misplaced",
    "unknown_key",
]

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


def described(value: object) -> str:
    """Return a short phrase for a value found in a file, as `the text "abc"`."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'the text "{value[:40]}{"..." if len(value) > 40 else ""}"'
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list | tuple):
        return f"a list of {len(value)}"
    if value is None:
        return "nothing"
    return f"{value!r}"[:60]


def misplaced(place: str, text: str) -> PydanticCustomError:
    """Return the error `text` for a place below the one being validated, as `limits` or `[0][1]`."""
    return PydanticCustomError("misplaced", "{text}", {"place": place, "text": text})


def unknown_key(key: str, known: list[str]) -> PydanticCustomError:
    """Return the error for a key that the schema does not have."""
    hint = nearest(key, known) or f"; known here: {', '.join(known[:12])}"
    return misplaced(key, f"unknown key{hint}")


class Record(BaseModel):
    """A frozen record with no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _known_keys_only(cls, data: Any) -> Any:
        if isinstance(data, Mapping):
            for key in data:
                if key not in cls.model_fields:
                    raise unknown_key(str(key), list(cls.model_fields))
        return data


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ValueError(f"found {described(value)}, expected a number")
    try:
        number = float(value)
    except OverflowError:
        raise ValueError("found a number too large for a double, expected a finite number") from None
    if not math.isfinite(number):
        raise ValueError(f"found {number}, expected a finite number")
    return number


def _positive(value: float) -> float:
    if value <= 0.0:
        raise ValueError(f"found {value:g}, expected a number above 0")
    return value


def _non_negative(value: float) -> float:
    if value < 0.0:
        raise ValueError(f"found {value:g}, expected 0 or more")
    return value


def listed(value: Any, expected: str) -> list[Any]:
    """Return the items of a list, tuple or array; otherwise raise ValueError that says what was expected."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if not isinstance(value, list | tuple):
        raise ValueError(f"found {described(value)}, expected {expected}")
    return list(value)


def _exactly(count: int, expected: str) -> BeforeValidator:
    def check(value: Any) -> list[Any]:
        items = listed(value, expected)
        if len(items) != count:
            raise ValueError(f"found {len(items)} numbers, expected {expected}")
        return items

    return BeforeValidator(check)


def _share(value: float) -> float:
    if not 0.0 <= value < 1.0:
        raise ValueError(f"found {value:g}, expected a share of 0 or more and below 1, as 0.05 for 5 %")
    return value


Finite = Annotated[float, BeforeValidator(_number)]


Positive = Annotated[Finite, AfterValidator(_positive)]


NonNegative = Annotated[Finite, AfterValidator(_non_negative)]


Share = Annotated[Finite, AfterValidator(_share)]


Vector = Annotated[tuple[Finite, Finite, Finite], _exactly(3, "3 numbers [x, y, z]")]


Pair = Annotated[tuple[Finite, Finite], _exactly(2, "2 numbers [lowest, highest]")]


Numbers = Annotated[tuple[Finite, ...], BeforeValidator(lambda value: listed(value, "a list of numbers"))]


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
