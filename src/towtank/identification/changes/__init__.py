"""Changes of the vehicle: branches of the filter, the evidence for them, and the events told of them."""
