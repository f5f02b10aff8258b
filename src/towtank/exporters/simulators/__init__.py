"""Targets that are files of simulators: XML and what stands beside it."""
