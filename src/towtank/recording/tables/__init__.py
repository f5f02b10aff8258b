"""Recordings as tables: CSV and Parquet."""
