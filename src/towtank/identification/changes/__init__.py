"""Changes of the vehicle: branches of the filter, the evidence for a change, hypotheses, detector, events."""
