"""The live page: what a session learns and how it fares, in a browser, for several viewers at once."""

from towtank.dashboard.access import DEFAULT_PAGE, Address
from towtank.dashboard.feed import About, Feed, Instant, Link, Now, RecordingFile

__all__ = ["DEFAULT_PAGE", "About", "Address", "Feed", "Instant", "Link", "Now", "RecordingFile"]
