"""The command `towtank`: its commands in the order in which a newcomer meets them.

What a process frees of large arrays goes back to the system, and its linear algebra takes one thread: the matrices are
small, and threads that wait for each other by spinning take half as much time again.
"""

from __future__ import annotations

import atexit
import ctypes
import gc
import os
import signal
import sys
from types import FrameType
from typing import Annotated, NoReturn

import typer

from towtank.app.campaign import commands as campaign
from towtank.app.commands import config, demo, exchange, inspect, learn, live, plan, simulate, validate, vehicle
from towtank.app.terminal.guard import Commands, PlainCommand
from towtank.app.terminal.page_option import PagedCommand

__all__ = ["app", "main"]

_MMAP_THRESHOLD = -3  # M_MMAP_THRESHOLD of mallopt(3)
_LARGE = 1 << 20  # bytes
_TERMINATED = 143
app = typer.Typer(
    name="towtank",
    cls=Commands,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["--help", "-h"]},
)


def return_what_is_free() -> None:
    """Keep arrays of a megabyte and more in mappings of their own, which end when they do.

    The C library of Linux raises that limit to 32 MB as such arrays are freed, and then keeps what is free between
    others for itself: of an hour at 100 Hz some 30 MB. Elsewhere, and with other libraries, nothing happens.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_MMAP_THRESHOLD, _LARGE)


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


app.command("demo", cls=PagedCommand)(demo.demo)


app.add_typer(vehicle.commands, name="vehicle")


app.add_typer(simulate.commands, name="manoeuvre")


app.command("plan", cls=PlainCommand)(plan.plan)


app.command("simulate", cls=PlainCommand)(simulate.simulate)


app.command("inspect", cls=PlainCommand)(inspect.inspect)


app.command("learn", cls=PlainCommand)(learn.learn)


app.command("live", cls=PagedCommand)(live.live)


app.command("validate", cls=PlainCommand)(validate.validate)


app.add_typer(campaign.commands, name="campaign")


app.add_typer(config.commands, name="config")


app.command("convert", cls=PlainCommand)(exchange.convert)


app.command("export", cls=PlainCommand)(exchange.export)


app.command("import", cls=PlainCommand)(exchange.import_)


def main() -> NoReturn:
    """Run the command line of this process and exit."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    signal.signal(signal.SIGTERM, _terminated)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when NumPy is imported, which no module has done by now
    atexit.register(gc.freeze)  # else the interpreter looks for cycles in all that is loaded: 0.2 s after the last word
    return_what_is_free()
    app()
    sys.exit(0)


def _terminated(signum: int, frame: FrameType | None) -> NoReturn:
    """End in order, so that no temporary file is left."""
    raise SystemExit(_TERMINATED)
