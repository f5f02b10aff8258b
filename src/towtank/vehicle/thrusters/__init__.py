"""Thrusters: curves, the wrench that they give together, and fits to bench data."""
