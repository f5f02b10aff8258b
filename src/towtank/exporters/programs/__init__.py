"""Targets that are programs: source text, units of co-simulation, matrices."""
