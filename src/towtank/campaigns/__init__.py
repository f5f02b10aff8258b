"""Campaigns: many logs of many vehicles, and what they say together."""

from towtank.campaigns.pooling import Fleet, FleetClass, Outlier, Pooled, Run, pool

__all__ = ["Fleet", "FleetClass", "Outlier", "Pooled", "Run", "pool"]
