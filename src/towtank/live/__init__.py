"""Live links: sources of samples, and the session that learns from them while it records them."""

from towtank.live.links.source import Raw, Sample, Source, SourceState
from towtank.live.links.urls import open_source

__all__ = ["Raw", "Sample", "Source", "SourceState", "open_source"]
