"""Recordings as MCAP files, written whole or while they are made."""
