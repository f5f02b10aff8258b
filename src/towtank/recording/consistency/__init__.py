"""Whether a recording agrees with itself."""

from towtank.recording.consistency.agreement import Finding, inconsistencies

__all__ = ["Finding", "inconsistencies"]
