"""Proofs of the estimators, from one regression row to whole recordings."""

from __future__ import annotations

__all__: list[str] = []
