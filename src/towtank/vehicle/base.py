"""What every record of a vehicle file shares: frozen, no unknown keys, finite numbers, tuples."""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, model_validator
from pydantic_core import PydanticCustomError

from towtank.errors import nearest

__all__ = ["Finite", "NonNegative", "Numbers", "Pair", "Positive", "Record", "Share", "Vector", "described"]


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
