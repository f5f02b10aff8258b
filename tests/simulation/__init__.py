"""Proofs of the simulator, its sensors and its manoeuvres."""

from __future__ import annotations

__all__: list[str] = []
