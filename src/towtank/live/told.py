"""Something told in JSON: a kind with its schema, and a message of it."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Form", "Told"]


@dataclass(frozen=True)
class Form:
    """A kind of message: its topic, and its schema as (name, encoding, text)."""

    topic: str
    schema: tuple[str, str, bytes]


@dataclass(frozen=True)
class Told:
    """One message: its kind, its time [s of the session], and itself."""

    form: Form
    t: float
    text: str
