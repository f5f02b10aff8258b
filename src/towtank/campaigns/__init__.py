"""Campaigns: many logs or simulated runs, on one machine or many, into one table.

What a task does is given to a campaign as a function. Here stand what there is to do, where it is kept, and who does
it.
"""

from towtank.campaigns.configuration import Campaign, read_campaign
from towtank.campaigns.run import Outcome, Summary, run_campaign
from towtank.campaigns.store import Failure, Result, Store, StoredModel
from towtank.campaigns.tasks import Task, tasks_of

__all__ = [
    "Campaign",
    "Failure",
    "Outcome",
    "Result",
    "Store",
    "StoredModel",
    "Summary",
    "Task",
    "read_campaign",
    "run_campaign",
    "tasks_of",
]
