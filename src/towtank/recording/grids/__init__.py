"""Recordings on one common grid of times."""
