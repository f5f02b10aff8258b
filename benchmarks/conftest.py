"""Lets the benchmarks find `figures` when pytest runs them; as scripts they find it by themselves."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
