"""Proofs of free-running prediction and of its scores."""

from __future__ import annotations

__all__: list[str] = []
