"""Learning from a stream, sample by sample: the joint filter with its re-estimations, and least squares."""
