"""World, body and sensor frames: everything brought to NED, FRD and the body origin."""
