"""Proofs of the kernels. What a kernel is compared with is derived here, never imported from it."""

from __future__ import annotations

__all__: list[str] = []
