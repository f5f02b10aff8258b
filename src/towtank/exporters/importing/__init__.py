"""Importing: vehicles out of simulators' files."""
