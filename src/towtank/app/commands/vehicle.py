"""`towtank vehicle ...`: list, show and check vehicle files, what is supposed of them, fit thruster curves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from towtank.app.commands.arguments import Json, output_place, positive_option
from towtank.app.terminal.completion import catalog, vehicles
from towtank.app.terminal.guard import PlainCommand
from towtank.errors import InputError

__all__ = ["commands"]

commands = typer.Typer(
    help="Vehicle files: list, show, copy, check, prior; fit thruster curves.", rich_markup_mode=None
)
_FIGURES = (".png", ".svg", ".pdf")


@commands.command("list", cls=PlainCommand)
def list_vehicles(json: Json = False) -> None:
    """List the vehicles of the catalog.

    \b
    Example:
      towtank vehicle list
    """
    from towtank.app.tables.vehicles import catalog, show_catalog
    from towtank.app.terminal.output import Output

    output = Output(json=json)
    vehicles = catalog()
    show_catalog(vehicles, output)
    output.document({"vehicles": vehicles})


@commands.command("show", cls=PlainCommand)
def show(
    vehicle: Annotated[
        str, typer.Argument(metavar="NAME_OR_FILE", autocompletion=vehicles, help="Catalog name or vehicle file.")
    ],
    json: Json = False,
) -> None:
    """Show a vehicle: body, coefficients with their sources, thrusters, and doubts about them.

    \b
    Example:
      towtank vehicle show seamor
    """
    from towtank.app.files import read_vehicle
    from towtank.app.tables.vehicles import show_vehicle, vehicle_document
    from towtank.app.terminal.output import Output

    output = Output(json=json)
    found = read_vehicle(vehicle, output, silent=True)
    show_vehicle(found, output)
    output.document(vehicle_document(found))


@commands.command("copy", cls=PlainCommand)
def copy(
    name: Annotated[str, typer.Argument(metavar="NAME", autocompletion=catalog, help="Name in the catalog.")],
    file: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Vehicle file to write; default: NAME.toml in the working directory."
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an existing file that differs.")] = False,
    json: Json = False,
) -> None:
    """Copy a vehicle of the catalog into a file of your own, with every comment and source.

    \b
    Example:
      towtank vehicle copy bluerov2_heavy -o my-rov.toml
    """
    from towtank.app.terminal.output import Output
    from towtank.outputs import write_text
    from towtank.vehicle import catalog_text

    text, place = catalog_text(name), Path(f"{name}.toml") if file is None else file
    output_place("--output", place, (".toml",))
    if place.exists() and not force and place.read_bytes() != text.encode():
        raise InputError(f"{place}: there is such a file already, and it differs; choose another name, or add --force")
    write_text(place, text)
    output = Output(json=json)
    output.line(f"{name} copied to {place}")
    output.line(f"Next: put in what you know of yours, then towtank vehicle check {place}", "dim")
    output.document({"vehicle": name, "file": place})


@commands.command("prior", cls=PlainCommand)
def prior(
    vehicle: Annotated[
        str, typer.Argument(metavar="NAME_OR_FILE", autocompletion=vehicles, help="Catalog name or vehicle file.")
    ],
    json: Json = False,
) -> None:
    """Show the prior of a vehicle: what learning assumes before it has seen any data.

    Lists every unknown with its mean, deviation, 95 % interval and source: the vehicle file, physics, or earlier
    learning. A table [prior] in the file replaces single lines.

    \b
    Example:
      towtank vehicle prior bluerov2_heavy
    """
    from towtank.app.files import read_vehicle
    from towtank.app.tables.prior import prior_document, show_prior, supposed_of
    from towtank.app.terminal.output import Output

    output = Output(json=json)
    found = read_vehicle(vehicle, output, silent=True)
    supposed = supposed_of(found)
    show_prior(found, supposed, output)
    output.document(prior_document(found, supposed))


@commands.command("check", cls=PlainCommand)
def check(
    file: Annotated[
        str, typer.Argument(metavar="FILE", autocompletion=vehicles, help="Vehicle file (or catalog name).")
    ],
    json: Json = False,
) -> None:
    """Check a vehicle file: can it be read, is it physical?

    The exit code is 0 if the file can be read, even with warnings, and 2 if it cannot. In the JSON document `ok` is
    false if the vehicle is not physical.

    \b
    Example:
      towtank vehicle check mine.toml
    """
    from towtank.app.files import read_vehicle
    from towtank.app.terminal.output import Output
    from towtank.vehicle import doubts, faults

    output = Output(json=json)
    try:
        found = read_vehicle(file, output, silent=True)
    except InputError as error:
        output.document({"file": file, "ok": False, "error": str(error), "warnings": []})
        raise
    wrong, doubtful = faults(found), doubts(found)
    count = len(wrong) + len(doubtful)
    warnings = f"{count} warning{'s' if count > 1 else ''}" if count else "no warnings"
    output.line(f"{file}: can be read, {'not physical' if wrong else 'physical'}, {warnings}")
    for text in (*wrong, *doubtful):
        output.item(text)
    output.document({"file": file, "ok": not wrong, "warnings": [*wrong, *doubtful]})


@commands.command("fit-thruster", cls=PlainCommand)
def fit(
    bench: Annotated[Path, typer.Argument(metavar="BENCH.csv", help="Commands and forces, one measurement a line.")],
    output_files: Annotated[
        list[Path] | None,
        typer.Option(
            "--output", "-o", metavar="FILE", help="Write the curve (.toml) or the plot (.png, .svg, .pdf); repeatable."
        ),
    ] = None,
    plot: Annotated[Path | None, typer.Option("--plot", metavar="FILE.png", help="Write the plot.")] = None,
    kind: Annotated[
        Literal["polynomial", "table"], typer.Option("--kind", help="A polynomial for each direction, or a table.")
    ] = "polynomial",
    degree: Annotated[int, typer.Option("--degree", metavar="N", help="Degree of the polynomials.")] = 2,
    supply: Annotated[
        float | None,
        typer.Option(
            "--supply",
            metavar="V",
            help="Supply voltage to fit the curve for; default: the middle one of those measured.",
        ),
    ] = None,
    command: Annotated[str | None, typer.Option("--command", metavar="COLUMN", help="Column of the command.")] = None,
    force: Annotated[str | None, typer.Option("--force", metavar="COLUMN", help="Column of the force.")] = None,
    voltage: Annotated[
        str | None, typer.Option("--voltage", metavar="COLUMN", help="Column of the supply voltage.")
    ] = None,
    json: Json = False,
) -> None:
    """Fit a thruster curve to a bench test and print it as it goes into a vehicle file.

    The CSV has a column of commands (pwm, command, ...), one of forces (force_N, thrust_kgf, ...) and, where several
    were tried, one of supply voltages (voltage, ...).

    \b
    Example:
      towtank vehicle fit-thruster bench.csv --plot bench.png -o curve.toml
    """
    from towtank.app.tables.thrusters import fit_document, show_fit
    from towtank.app.terminal.output import Output
    from towtank.outputs import write_text
    from towtank.vehicle import curve_text, fit_thruster

    for path in output_files or ():
        output_place("--output", path, (".toml", *_FIGURES))
    output_place("--plot", plot, _FIGURES)
    curves = [path for path in output_files or () if path.suffix.lower() == ".toml"]
    figures = [path for path in (*(output_files or ()), *filter(None, [plot])) if path not in curves]
    positive_option("--supply", supply)
    output = Output(json=json)
    found = fit_thruster(
        bench, kind=kind, degree=degree, nominal_voltage=supply, command=command, force=force, voltage=voltage
    )
    show_fit(found, output)
    for path in curves:
        where = f"# {found.curve.source}; goes under [[thrusters]] of a vehicle file"
        write_text(path, f"{where}\n{curve_text(found.curve)}\n")
        output.line(f"curve written to {path}")
    for path in figures:
        from towtank.app.tables.thrusters import thruster_figure

        thruster_figure(found, path)
        output.line(f"plot written to {path}")
    output.document({**fit_document(found), "files": [*curves, *figures]})
