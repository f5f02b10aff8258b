"""The command `towtank`: its commands in the order in which a newcomer meets them."""

from __future__ import annotations

import signal
import sys
from types import FrameType
from typing import Annotated, NoReturn

import typer

from towtank.app import (
    config_commands,
    convert_command,
    demo_command,
    inspect_command,
    learn_command,
    live_command,
    simulate_command,
    validate_command,
    vehicle_commands,
)
from towtank.app.guard import Commands, PlainCommand
from towtank.app.memory import return_what_is_free
from towtank.app.page_option import PagedCommand

__all__ = ["app", "main"]

_TERMINATED = 143

app = typer.Typer(
    name="towtank",
    cls=Commands,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from towtank import __version__

        typer.echo(f"towtank {__version__}")
        raise typer.Exit


@app.callback()
def towtank(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Learn the 6-DOF hydrodynamic model of an underwater vehicle from its commands and its motion.

    \b
    Example, from a simulated log to a model that has proved itself on another one:
      towtank simulate vlbv300 tank-session -o tank.csv --sensors mocap --seed 1
      towtank learn tank.csv --vehicle vlbv300 -o learned.toml
      towtank validate learned.toml another.csv
    """


app.command("demo", cls=PagedCommand)(demo_command.demo)
app.add_typer(vehicle_commands.commands, name="vehicle")
app.add_typer(simulate_command.commands, name="manoeuvre")
app.command("simulate", cls=PlainCommand)(simulate_command.simulate)
app.command("inspect", cls=PlainCommand)(inspect_command.inspect)
app.command("learn", cls=PlainCommand)(learn_command.learn)
app.command("live", cls=PagedCommand)(live_command.live)
app.command("validate", cls=PlainCommand)(validate_command.validate)
app.add_typer(config_commands.commands, name="config")
app.command("convert", cls=PlainCommand)(convert_command.convert)


def main() -> NoReturn:
    """Run the command line of this process and exit."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    signal.signal(signal.SIGTERM, _terminated)
    return_what_is_free()
    app()
    sys.exit(0)


def _terminated(signum: int, frame: FrameType | None) -> NoReturn:
    """End in order, so that no temporary file is left."""
    raise SystemExit(_TERMINATED)
