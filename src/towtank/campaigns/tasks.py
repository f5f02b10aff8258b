"""Tasks: one log, or one simulated run, each with a name that says all that bears on its result.

The name is a hash of kind, configuration, version, content of the log, and seed. Whatever is the same has the same name
and is done once; whatever changes has another.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Any

import towtank
from towtank.campaigns.cache import digests_of
from towtank.campaigns.configuration import Campaign, Study, canonical, digest
from towtank.campaigns.places import Found, is_remote, logs_of, without_credentials
from towtank.errors import InputError

__all__ = ["Options", "Task", "tasks_of"]

_LENGTH = 32  # hexadecimal digits of a name


@dataclass(frozen=True)
class Options:
    """What all tasks of a campaign share.

    Attributes:
        mapping, prior: texts of TOML, empty where there is none. study: of simulated runs.
    """

    method: str = "joint"
    free: tuple[str, ...] = ()
    delay: float | None = None
    keep_all: bool = False
    horizon: float | None = None
    mapping: str = ""
    prior: str = ""
    study: Study | None = None


@dataclass(frozen=True)
class Task:
    """One thing to do.

    Attributes:
        id: its name. kind: of the campaign. label: what tables and messages call it. vehicle: which one made the log;
        klass: what is supposed of it, which several may share. text: of that vehicle's file.
        uri, content: of the log and its hash; both empty for a simulated run. number: (vehicle, run) of one that is.
        version: of the estimator.
    """

    id: str
    kind: str
    label: str
    vehicle: str
    klass: str
    text: str
    options: Options
    uri: str = ""
    content: str = ""
    number: tuple[int, int] = (0, 0)
    version: str = towtank.__version__


def tasks_of(campaign: Campaign) -> list[Task]:
    """Return everything that a campaign has to do, each once, in a lasting order.

    Raises:
        InputError: a pattern matches no log, a log lies in no folder that is known, no bucket or credentials.
        OSError: a remote log cannot be had.
    """
    file = campaign.file
    options = Options(
        file.method, file.free, file.delay, file.keep_all, file.horizon, campaign.mapping, campaign.prior, file.study
    )
    tasks = _of_logs(campaign, options) if file.study is None else _of_study(campaign, file.study, options)
    first: dict[str, Task] = {}
    for task in tasks:
        first.setdefault(task.id, task)
    return list(first.values())


def _of_logs(campaign: Campaign, options: Options) -> list[Task]:
    found: dict[str, Found] = {}
    for pattern in campaign.file.logs:
        logs = logs_of(pattern, campaign.folder)
        if not logs:
            shown = without_credentials(pattern) if is_remote(pattern) else pattern
            raise InputError(f'{campaign.place}: logs: no log matches "{shown}"; paths begin in {campaign.folder}')
        found |= {log.uri: log for log in logs}
    out = []
    known = [campaign.vehicle_of(log.label) for log in found.values()]
    contents = digests_of(list(found.values()))
    for log, (name, supposed), content in zip(found.values(), known, contents, strict=True):
        task = Task("", campaign.kind, log.label, name, supposed.name, supposed.text, options, log.uri, content)
        out.append(replace(task, id=_name(campaign, task)))
    return out


def _of_study(campaign: Campaign, study: Study, options: Options) -> list[Task]:
    [known] = campaign.vehicles.values()
    out = []
    for k in range(study.vehicles):
        name = f"{known.name}-{k + 1}"
        for r in range(study.runs):
            label = f"{name}/run-{r + 1}"
            task = Task("", campaign.kind, label, name, known.name, known.text, options, number=(k, r))
            out.append(replace(task, id=_name(campaign, task)))
    return out


def _name(campaign: Campaign, task: Task) -> str:
    """Return the name of a task."""
    settings: dict[str, Any] = {**campaign.settings, "vehicle": digest(task.text)}
    about = {"settings": settings, "version": task.version, "content": task.content, "number": list(task.number)}
    about |= {"vehicle": task.vehicle, "class": task.klass}
    return hashlib.sha256(canonical(about).encode()).hexdigest()[:_LENGTH]
