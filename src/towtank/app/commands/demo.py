"""`towtank demo`: the main job on a simulated tank session."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from towtank.app.commands.arguments import Json, positive_option
from towtank.app.terminal.page_option import PageOption

__all__ = ["demo"]


def demo(
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="Folder for model and figures.")] = Path(
        "demo-output"
    ),
    seconds: Annotated[
        float | None, typer.Option("--seconds", metavar="S", help="Length of the session in simulated seconds.")
    ] = None,
    fast: Annotated[bool, typer.Option("--fast", help="Run as fast as possible, not in real time.")] = False,
    browser: Annotated[
        bool,
        typer.Option(
            "--browser/--no-browser", help="Open the live page in a browser, or the page of figures at the end."
        ),
    ] = True,
    payload: Annotated[
        bool,
        typer.Option("--payload", help="Add 60 s in which all axes move at once and the vehicle takes up a payload."),
    ] = False,
    page: PageOption = None,
    json: Json = False,
) -> None:
    """Learn a simulated vehicle live, sample by sample.

    A small ROV is driven along one axis after the other under a motion capture system with noise and dropped markers.
    A table shows truth, estimate and deviation of every coefficient as they settle. With --payload the vehicle becomes
    heavier; the learner detects this, reports it and learns the new values.

    \b
    Example:
      towtank demo --fast --no-browser --output demo-output
      towtank demo --page --payload
    """
    from towtank.app.demo.run import run_demo
    from towtank.app.terminal.output import Output, TextConsole

    positive_option("--seconds", seconds)
    out = Output(json=json)
    console = TextConsole(stderr=json)
    document = run_demo(
        output,
        seconds=seconds,
        fast=fast,
        browser=browser,
        page=page,
        payload=payload,
        console=console,
        json_output=json,
    )
    out.document(document)
