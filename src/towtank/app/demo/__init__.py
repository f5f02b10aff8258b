"""`towtank demo`."""
