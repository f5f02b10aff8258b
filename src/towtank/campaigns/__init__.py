"""Campaigns: many logs or simulated runs, on one machine or many, into one table.

What a task does is given to a campaign as a function. Here stand what there is to do, where it is kept, who does it,
and what many vehicles say together. The names below are imported on first use: a dask scheduler needs hardly anything
of this package.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from towtank.campaigns.configuration import Campaign, read_campaign
    from towtank.campaigns.fleet import Fleet, FleetClass, Outlier, Pooled
    from towtank.campaigns.likelihood import Run
    from towtank.campaigns.pooling import pool
    from towtank.campaigns.run import Outcome, Summary, run_campaign
    from towtank.campaigns.store import Failure, Result, Store, StoredModel
    from towtank.campaigns.tasks import Task, tasks_of

__all__ = [
    "Campaign",
    "Failure",
    "Fleet",
    "FleetClass",
    "Outcome",
    "Outlier",
    "Pooled",
    "Result",
    "Run",
    "Store",
    "StoredModel",
    "Summary",
    "Task",
    "pool",
    "read_campaign",
    "run_campaign",
    "tasks_of",
]

_HOMES = {
    "configuration": ("Campaign", "read_campaign"),
    "fleet": ("Fleet", "FleetClass", "Outlier", "Pooled"),
    "likelihood": ("Run",),
    "pooling": ("pool",),
    "run": ("Outcome", "Summary", "run_campaign"),
    "store": ("Failure", "Result", "Store", "StoredModel"),
    "tasks": ("Task", "tasks_of"),
}


def __getattr__(name: str) -> object:
    """Import a public name on first use (PEP 562) and keep it."""
    for home, names in _HOMES.items():
        if name in names:
            value: object = getattr(importlib.import_module(f"{__name__}.{home}"), name)
            globals()[name] = value
            return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
