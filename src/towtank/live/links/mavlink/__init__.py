"""A vehicle that speaks MAVLink."""
