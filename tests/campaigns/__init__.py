"""Campaigns: what there is to do, where it is kept, and who does it."""
