"""Learning from a stream, sample by sample."""
