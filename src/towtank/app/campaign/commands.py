"""`towtank campaign ...`: many logs or simulated runs, on one machine or many, into one table."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from towtank.app.commands.arguments import Json, output_place
from towtank.app.terminal.guard import PlainCommand
from towtank.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from towtank.app.terminal.output import Output, Progress
    from towtank.campaigns.run import Engine, Pace

__all__ = ["commands"]

commands = typer.Typer(
    help="Many logs, many machines, one table: run, status, table, pool, compact.", rich_markup_mode=None
)
_OFTEN = 10.0  # s between two lines of progress where there is no terminal
_STORE = Annotated[
    str, typer.Argument(metavar="STORE", help="Folder, s3://BUCKET/FOLDER or gs://BUCKET/FOLDER of a campaign.")
]


@commands.command("run", cls=PlainCommand)
def run(
    campaign: Annotated[
        Path,
        typer.Argument(metavar="CAMPAIGN.toml", help="What to do, and with which logs."),
    ],
    store: Annotated[
        str,
        typer.Option(
            "--store", metavar="URI", help="Where results are kept: a folder, s3://BUCKET/FOLDER or gs://BUCKET/FOLDER."
        ),
    ],
    engine: Annotated[
        str,
        typer.Option(
            "--engine",
            metavar="ENGINE",
            help="local: processes of this machine, local:N so many of them; tcp://HOST:8786: the workers of a dask "
            "scheduler.",
        ),
    ] = "local",
    limit: Annotated[
        int | None, typer.Option("--limit", metavar="N", help="Do at most N tasks now; the next run does the rest.")
    ] = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Try once more what failed before; without it, only what is missing.")
    ] = False,
    json: Json = False,
) -> None:
    """Do what a campaign asks for and its store does not hold yet. Interrupted, the same command does the rest.

    Exit code 1 where anything failed, with a list.

    \b
    Example:
      towtank campaign run campaign.toml --store results --engine local:2
    """
    if limit is not None and limit < 1:
        raise InputError(f"--limit: found {limit}, expected 1 or more")

    from towtank.app.campaign.views import show_summary, summary_document
    from towtank.app.terminal.output import Output
    from towtank.campaigns import Store, read_campaign, run_campaign, tasks_of

    output = Output(json=json)
    who = _engine(engine, output)
    asked = read_campaign(campaign)
    with output.progress("looking at store and logs") as progress:
        kept = Store.at(store)
        tasks = tasks_of(asked)
        kept.begin(asked, tasks)

        from towtank.app.campaign.work import perform

        done = run_campaign(
            tasks, kept, who, perform, limit=limit, again=retry_failed, progress=_told(progress, output)
        )
    show_summary(done, kept.place.name, output)
    output.document(summary_document(done, kept.place.name, asked.kind))
    if done.failures:
        raise typer.Exit(1)


@commands.command("status", cls=PlainCommand)
def status(store: _STORE, json: Json = False) -> None:
    """Say what of a campaign is done, what failed and why, and what is left.

    \b
    Example:
      towtank campaign status results
    """
    from towtank.app.campaign.views import show_status, status_document
    from towtank.app.terminal.output import Output
    from towtank.campaigns import Store

    output = Output(json=json)
    with output.progress("reading"):
        found = status_document(Store.opened(store))
    show_status(found, output)
    output.document(found)


@commands.command("table", cls=PlainCommand)
def table(
    store: _STORE,
    file: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="All rows as .parquet or .csv; without it, a summary."),
    ] = None,
    json: Json = False,
) -> None:
    """Put all results of a campaign into one table: a row for each coefficient of each run.

    \b
    Example:
      towtank campaign table results -o results.parquet
    """
    output_place("--output", file, (".parquet", ".csv"))

    from towtank.app.campaign.views import show_table, table_document, write_table
    from towtank.app.terminal.output import Output
    from towtank.campaigns import Store

    output = Output(json=json)
    with output.progress("reading"):
        rows = Store.opened(store).table()
    if file is not None:
        write_table(rows, file)
    show_table(rows, output)
    if file is not None:
        output.line()
        output.line(f"{rows.num_rows} rows written to {file}")
    output.document(table_document(rows, file))


@commands.command("pool", cls=PlainCommand)
def pool(
    store: _STORE,
    file: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FLEET.toml", help="What to suppose of a new vehicle, for --prior."),
    ] = None,
    klass: Annotated[
        str | None,
        typer.Option("--class", metavar="NAME", help="Class that FLEET.toml is of, where there are several."),
    ] = None,
    json: Json = False,
) -> None:
    """Say what all runs say together: the class, the spread between vehicles and between runs, outliers.

    \b
    Example:
      towtank campaign pool results -o fleet.toml
    """
    output_place("--output", file, (".toml",))
    if klass is not None and file is None:
        raise InputError("--class: needs -o FLEET.toml, the file that is of that class")

    from towtank.app.campaign.views import show_fleet
    from towtank.app.terminal.output import Output
    from towtank.campaigns import Store
    from towtank.campaigns.likelihood import Run
    from towtank.campaigns.pooling import pool as pooled

    output = Output(json=json)
    with output.progress("reading models") as progress:
        opened = Store.opened(store)
        models = opened.models()
        if not models:
            raise InputError(
                f"{opened.place.name}: holds no model yet; towtank campaign status says what is left, and what failed"
            )
        runs = []
        for k, each in enumerate(models):
            progress("reading models", 0.3 * k / len(models))
            about = each.vehicle, each.klass, each.label
            runs.append(Run(*about, each.load(), each.learned_from(), each.prior()))
        progress("pooling", 0.3)
        fleet = pooled(runs)
        if file is not None:
            fleet.write(file, klass)
    show_fleet(fleet, output)
    if file is not None:
        output.line()
        output.line(f"written to {file}")
        output.line("Next: towtank learn LOG --vehicle VEHICLE --prior " + str(file), "dim")
    output.document({"store": opened.place.name, "file": file, **fleet.document()})


@commands.command("compact", cls=PlainCommand)
def compact(store: _STORE, json: Json = False) -> None:
    """Put the parts of a store into one file, so that it is quickly listed and read. Nothing is lost.

    \b
    Example:
      towtank campaign compact results
    """
    from towtank.app.terminal.output import Output
    from towtank.campaigns import Store

    output = Output(json=json)
    with output.progress("compacting") as progress:
        before, after = Store.opened(store).compact(progress)
    output.line(f"{before} files of rows are now {after}")
    output.document({"store": Store.opened(store).place.name, "files_before": before, "files_after": after})


def _engine(text: str, output: Output) -> Engine:
    """Return who performs the tasks. Raises InputError."""
    from towtank.campaigns.engines.local import Local

    if text == "local":
        return Local.usual()
    kind, _, rest = text.partition(":")
    if kind == "local":
        if not rest.isdecimal() or not 1 <= int(rest) <= 1024:
            raise InputError(f'--engine: found "{text}", expected local:N with N processes, as local:4')
        return Local(int(rest))
    if kind in ("tcp", "tls") and rest.startswith("//"):
        from towtank.campaigns.engines.cluster import Cluster

        return Cluster.at(text, output.say)
    raise InputError(
        f'--engine: found "{text}", expected local, local:N or the address of a scheduler, tcp://HOST:8786'
    )


def _told(progress: Progress, output: Output) -> Callable[[Pace], None]:
    """Return what tells of a run's pace: the bar of a terminal, else a line now and then."""
    said = time.monotonic()

    def tell(pace: Pace) -> None:
        nonlocal said
        failed = f", {pace.failed} failed" if pace.failed else ""
        text = f"{pace.done} of {pace.total}{failed}, {pace.rate:.3g}/s"
        progress(text, pace.done / pace.total)
        if not output.console.is_terminal and time.monotonic() - said >= _OFTEN:
            said = time.monotonic()
            output.say(f"{text}, {_duration(pace.left)} left")

    return tell


def _duration(seconds: float) -> str:
    """Return a time in words.

    >>> _duration(75.0), _duration(9000.0)
    ('1 min', '2.5 h')
    """
    if seconds < 60.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
