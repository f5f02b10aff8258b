"""`towtank config ...`: the configurations of a vehicle, a folder of model files with names."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from towtank.app.commands.arguments import Json
from towtank.app.terminal.completion import vehicles
from towtank.app.terminal.guard import PlainCommand

__all__ = ["commands"]

commands = typer.Typer(
    help="Configurations of a vehicle: list, save, show, compare models that have names.", rich_markup_mode=None
)
_Folder = Annotated[
    Path,
    typer.Option(
        "--folder",
        metavar="DIR",
        envvar="TOWTANK_CONFIGURATIONS",
        show_envvar=False,
        help="Folder of the configurations; default: the environment variable TOWTANK_CONFIGURATIONS, else "
        "configurations.",
        show_default=False,
    ),
]
_FOLDER = Path("configurations")


@commands.command("list", cls=PlainCommand)
def list_configurations(folder: _Folder = _FOLDER, json: Json = False) -> None:
    """List the configurations, and what differs most between each and the first.

    \b
    Example:
      towtank config list --folder boats/rov7
    """
    from towtank.app.tables.configurations import list_document, show_list
    from towtank.app.terminal.output import Output
    from towtank.vehicle.configurations import Configurations

    output = Output(json=json)
    found = Configurations(folder).all()
    show_list(folder, found, output)
    output.document(list_document(folder, found))


@commands.command("save", cls=PlainCommand)
def save(
    model: Annotated[
        str, typer.Argument(metavar="MODEL.toml", autocompletion=vehicles, help="Vehicle file, as learn writes it.")
    ],
    name: Annotated[str, typer.Option("--name", metavar="NAME", help="Name of the configuration.")],
    note: Annotated[
        str, typer.Option("--note", metavar="TEXT", help="A note to keep with it.", show_default=False)
    ] = "",
    log: Annotated[
        list[Path] | None,
        typer.Option(
            "--log", metavar="FILE", help="Log that it was learned from, of which a hash is kept; may be repeated."
        ),
    ] = None,
    folder: _Folder = _FOLDER,
    json: Json = False,
) -> None:
    """Save a model under a name: a copy of its file, with note, time and hashes in the index.

    \b
    Example:
      towtank config save learned.toml --name "with gripper" --log surge.csv
    """
    from towtank import __version__
    from towtank.app.tables.configurations import configuration_document
    from towtank.app.terminal.output import Output
    from towtank.vehicle.configurations import Configurations

    output = Output(json=json)
    saved = Configurations(folder).save(model, name, note=note, logs=log or (), version=__version__)
    output.line(f'"{saved.name}" saved as {saved.path}')
    output.document(configuration_document(saved))


@commands.command("show", cls=PlainCommand)
def show(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name of the configuration, or of its file.")],
    folder: _Folder = _FOLDER,
    json: Json = False,
) -> None:
    """Show a configuration: its note, what it was learned from, and the vehicle.

    \b
    Example:
      towtank config show "with gripper"
    """
    from towtank.app.tables.configurations import configuration_document, show_configuration
    from towtank.app.tables.vehicles import show_vehicle, vehicle_document
    from towtank.app.terminal.output import Output
    from towtank.vehicle.configurations import Configurations

    output = Output(json=json)
    found = Configurations(folder).get(name)
    show_configuration(found, output)
    show_vehicle(found.vehicle, output)
    output.document({**configuration_document(found), "vehicle": vehicle_document(found.vehicle)})


@commands.command("compare", cls=PlainCommand)
def compare(
    base: Annotated[str, typer.Argument(metavar="A", help="Name of the configuration to compare with.")],
    others: Annotated[list[str], typer.Argument(metavar="B", help="Names of the others.")],
    folder: _Folder = _FOLDER,
    json: Json = False,
) -> None:
    """Compare configurations with the first: what differs, by how much, and whether that is significant.

    \b
    Example:
      towtank config compare bare "with gripper"
    """
    from towtank.app.tables.configurations import comparison_document, show_comparison
    from towtank.app.terminal.output import Output
    from towtank.vehicle.configurations import Configurations
    from towtank.vehicle.differences import differences

    output = Output(json=json)
    stored = Configurations(folder)
    first = stored.get(base)
    found = [(other, differences(first.vehicle, other.vehicle)) for other in map(stored.get, others)]
    for other, each in found:
        show_comparison(first, other, each, output)
    output.document(comparison_document(first, found))
