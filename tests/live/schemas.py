"""A validator of the part of JSON Schema that the schemas of a session use; anything else in a schema is an error."""

from __future__ import annotations

from typing import Any

__all__ = ["faults"]

_TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,), "array": (list,), "string": (str,), "number": (int, float), "integer": (int,),
    "boolean": (bool,), "null": (type(None),),
}  # fmt: skip
_KNOWN = {"type", "properties", "required", "items", "enum", "additionalProperties", "description", "title"}


def faults(schema: dict[str, Any], value: Any, place: str = "") -> list[str]:
    """Return what is wrong with a value."""
    assert set(schema) <= _KNOWN, set(schema) - _KNOWN
    found: list[str] = []
    kinds = schema.get("type", [])
    kinds = kinds if isinstance(kinds, list) else [kinds]
    if kinds and not any(_is(value, kind) for kind in kinds):
        found.append(f"{place}: {value!r} is not {kinds}")
    if "enum" in schema and value not in schema["enum"]:
        found.append(f"{place}: {value!r} is not among {schema['enum']}")
    if isinstance(value, dict):
        found += [f"{place}: lacks {name}" for name in schema.get("required", ()) if name not in value]
        for name, each in value.items():
            inner = schema.get("properties", {}).get(name, schema.get("additionalProperties"))
            found += faults(inner, each, f"{place}.{name}") if isinstance(inner, dict) else []
    if isinstance(value, list) and "items" in schema:
        for k, each in enumerate(value):
            found += faults(schema["items"], each, f"{place}[{k}]")
    return found


def _is(value: Any, kind: str) -> bool:
    return isinstance(value, _TYPES[kind]) and (kind == "boolean") == isinstance(value, bool)
