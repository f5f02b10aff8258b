"""Learning from whole recordings."""
