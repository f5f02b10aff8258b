"""The methods of learning, by name: of recordings, and of streams. Here, so that options need not load an estimator."""

from __future__ import annotations

__all__ = ["METHODS", "STREAMING_METHODS"]

METHODS = ("joint", "output-error", "paper")
STREAMING_METHODS = ("joint", "paper")
