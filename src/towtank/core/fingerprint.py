"""A fingerprint of every kernel's source, so that machine code kept on disk never outlives what it was made from.

Numba keeps the machine code of a kernel as long as the kernel's own file is unchanged, although code from other files
was compiled into it. The fingerprint is added to what it compares: any change to any kernel compiles all of them anew.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

__all__ = ["FINGERPRINT", "bind_cache"]


def _fingerprint() -> str:
    package = Path(__file__).parent.parent
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if b"kernel" in source or path.parent.name == "core":
            digest.update(path.relative_to(package).as_posix().encode() + b"\0" + source)
    return digest.hexdigest()


FINGERPRINT = _fingerprint()


def bind_cache(compiled: Any) -> None:
    """Make the disk cache of a compiled function depend on the fingerprint; nothing where it has no disk cache."""
    file = getattr(getattr(compiled, "_cache", None), "_cache_file", None)
    if file is not None:
        file._source_stamp = (file._source_stamp, FINGERPRINT)
