"""`towtank manoeuvre list` and `towtank simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from towtank.app.commands.arguments import Json, Map, numbers, output_place, positive_option
from towtank.app.terminal.completion import manoeuvres, sensor_sets, vehicles
from towtank.app.terminal.guard import PlainCommand
from towtank.errors import InputError

if TYPE_CHECKING:
    from towtank.app.terminal.output import Output, Progress
    from towtank.core.arrays import Array
    from towtank.planning import GuardedRun
    from towtank.simulation import BuiltIn, Manoeuvre, OrnsteinUhlenbeck
    from towtank.vehicle import Vehicle

__all__ = ["commands", "simulate"]

commands = typer.Typer(help="Built-in manoeuvres.", rich_markup_mode=None)
_LONGEST_STEP = 0.01  # s, of the integration
_MOST_STEPS = 20_000_000
_DEFAULT_RATE = 100.0


@commands.command("list", cls=PlainCommand)
def list_manoeuvres(json: Json = False) -> None:
    """List the built-in manoeuvres.

    \b
    Example:
      towtank manoeuvre list
    """
    from towtank.app.terminal.output import Output
    from towtank.digits import short
    from towtank.simulation import AXES, FORMS, MANOEUVRES, SENSORS

    output = Output(json=json)
    table = output.table("FORM", "What AXIS does, for a minute unless --duration says otherwise", wrap="What AXIS does")
    for form, shape in FORMS.items():
        table.add_row(form, shape.description)
    output.line("AXIS-FORM, where AXIS is one of " + ", ".join((*AXES, "all")))
    output.line("example: yaw-stairs")
    output.line()
    output.show(table)
    output.heading("Others")
    others = output.table("Manoeuvre", ">Usual s", "What it does", wrap="What it does")
    for name, found in MANOEUVRES.items():
        if name.partition("-")[0] not in (*AXES, "all"):
            others.add_row(name, short(found.duration), found.description)
    output.show(others)
    output.line()
    output.line(f"sensors to simulate it with (--sensors): {', '.join(SENSORS)}")
    output.line("Next: towtank simulate VEHICLE MANOEUVRE -o log.csv", "dim")
    entries = [{"name": name, **_entry(found)} for name, found in MANOEUVRES.items()]
    output.document({"manoeuvres": entries, "sensors": list(SENSORS)})


def _entry(found: BuiltIn) -> dict[str, object]:
    return {
        "description": found.description,
        "axes": found.axes,
        "form": found.form,
        "duration_s": found.duration,
    }


def simulate(
    vehicle: Annotated[
        str, typer.Argument(metavar="VEHICLE", autocompletion=vehicles, help="Catalog name or vehicle file.")
    ],
    manoeuvre: Annotated[
        str,
        typer.Argument(
            metavar="MANOEUVRE",
            autocompletion=manoeuvres,
            help="Built-in name, a plan (.toml), or a file of commands or wrenches over time.",
        ),
    ],
    file: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="Log to write, .csv, .parquet or .mcap.")
    ],
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="Duration in seconds; default: the manoeuvre's own.")
    ] = None,
    rate: Annotated[
        float, typer.Option("--rate", metavar="HZ", help="Rate of the commands and of perfect sensors.")
    ] = _DEFAULT_RATE,
    sensors: Annotated[
        str,
        typer.Option(
            "--sensors",
            metavar="NAME",
            autocompletion=sensor_sets,
            help="Sensors: perfect measures everything exactly; mocap is motion capture; ins is an IMU with DVL and "
            "depth; manoeuvre list names all.",
        ),
    ] = "perfect",
    seed: Annotated[int, typer.Option("--seed", metavar="N", help="The same seed gives the same file.")] = 0,
    delay: Annotated[
        float | None,
        typer.Option(
            "--delay", metavar="S", help="Delay from command to thruster, in seconds; default: the vehicle's."
        ),
    ] = None,
    current: Annotated[
        str | None, typer.Option("--current", metavar="N,E,D", help="Velocity of the water in m/s: north, east, down.")
    ] = None,
    disturbance: Annotated[
        float | None,
        typer.Option("--disturbance", metavar="N", help="Standard deviation of a random force on X, Y and Z."),
    ] = None,
    waves: Annotated[
        str | None,
        typer.Option(
            "--waves",
            metavar="RMS,PERIOD[,BEGIN]",
            help="Waves: velocity of the water in m/s (standard deviation), period, and when they come up, in s.",
        ),
    ] = None,
    guard: Annotated[
        bool, typer.Option("--guard", help="Of a plan in a tank: keep the vehicle off the walls, by what it measures.")
    ] = False,
    mapping: Map = None,
    json: Json = False,
) -> None:
    """Simulate a vehicle through a manoeuvre, as its sensors see it.

    \b
    Example:
      towtank simulate vlbv300 surge-square -o surge.csv --duration 60 --sensors mocap --seed 1
    """
    from towtank.app.files import read_vehicle
    from towtank.app.terminal.output import Output

    output_place("--output", file, (".csv", ".parquet", ".mcap"))
    positive_option("--duration", duration)
    positive_option("--rate", rate)
    positive_option("--delay", delay, zero=True)
    positive_option("--disturbance", disturbance, zero=True)
    water = numbers("--current", current, 3, "three numbers N,E,D in m/s, as 0.2,0,0")
    three = waves is not None and waves.count(",") == 2
    swell = numbers("--waves", waves, 3 if three else 2, "RMS,PERIOD in m/s and s, as 0.05,6, or RMS,PERIOD,BEGIN")
    if seed < 0:
        raise InputError(f"--seed: found {seed}, expected 0 or more")
    if duration is not None and duration * rate > _MOST_STEPS:
        raise InputError(
            f"--duration {duration:g} s at --rate {rate:g} Hz: found {duration * rate:.3g} samples, expected at most "
            f"{_MOST_STEPS:g}"
        )
    output = Output(json=json)
    with output.progress("simulating") as progress:
        found = read_vehicle(vehicle, output)
        progress("simulating", 0.0)
        from towtank.simulation import OrnsteinUhlenbeck, Waves
        from towtank.simulation import simulate as run
        from towtank.simulation.sensors.presets import sensors_named

        watch = sensors_named(sensors)
        push = OrnsteinUhlenbeck(std=disturbance) if disturbance else None
        start, kept = None, None
        if Path(manoeuvre).suffix == ".toml":
            if guard and (rate != _DEFAULT_RATE or water or swell or delay is not None):
                raise InputError("--guard: works at 100 Hz, in still water and with the vehicle's own delay")
            inputs, start, kept = _planned(Path(manoeuvre), found, duration, 1.0 / rate, push, guard, seed, output)
        elif guard:
            raise InputError(
                f"--guard: {manoeuvre} is no plan; give one for a tank (towtank plan VEHICLE --space LxWxH)"
            )
        else:
            inputs = _inputs(manoeuvre, found, mapping, duration, 1.0 / rate, seed, progress)
        recording = run(
            found,
            **inputs.inputs,
            eta0=start,
            current=water or (0.0, 0.0, 0.0),
            sensors=watch,
            disturbance=push,
            waves=None if swell is None else Waves(swell[0], swell[1], begin=swell[2] if three else 0.0),
            delay=delay,
            seed=seed,
            substeps=max(1, round(inputs.dt / _LONGEST_STEP)),
            progress=lambda done, n: progress("simulating", 0.9 * done / n),
        )
        progress(f"writing {file.name}", 0.9)
        recording.write(file)
    samples = max(len(channel) for channel in recording.channels.values())
    output.line(
        f"{found.name}, {inputs.name}: {recording.duration:g} s, {samples} samples at {rate:g} Hz, {sensors} sensors"
    )
    if kept is not None:
        output.line(
            f"the guard changed what was wanted for {100.0 * kept.changed:.0f} % of the time; nearest to a wall"
            f" {kept.clearance.min():.2f} m"
        )
    output.line(f"channels: {' '.join(recording.names)}")
    output.line(f"written to {file}")
    output.line()
    output.line(f"Next: towtank learn {file} --vehicle {vehicle} -o learned.toml", "dim")
    output.document(
        {
            "vehicle": found.name,
            "manoeuvre": inputs.name,
            "file": file,
            "duration_s": recording.duration,
            "rate_hz": rate,
            "samples": samples,
            "sensors": sensors,
            "seed": seed,
            "delay_s": found.command_delay if delay is None else delay,
            "current": water or (0.0, 0.0, 0.0),
            "disturbance_n": disturbance or 0.0,
            "waves": None
            if swell is None
            else {"rms_m_s": swell[0], "period_s": swell[1], "begin_s": swell[2] if three else 0.0},
            "guard": None
            if kept is None
            else {"changed": kept.changed, "nearest_m": float(kept.clearance.min()), "touched": kept.touch is not None},
            "channels": recording.names,
            "warnings": output.warnings,
        }
    )


def _inputs(
    name: str, vehicle: Vehicle, mapping: Path | None, duration: float | None, dt: float, seed: int, progress: Progress
) -> Manoeuvre:
    """Return the inputs of a built-in manoeuvre, or those of a file."""
    from towtank.app.files import read_logs
    from towtank.recording import bind_thrusters
    from towtank.simulation import MANOEUVRES, manoeuvre, manoeuvre_from_recording

    path = Path(name)
    if name in MANOEUVRES or not (path.suffix or path.exists()):
        return manoeuvre(name, vehicle, duration=duration, dt=dt, seed=seed)
    recording = read_logs([path], mapping, progress)[0]
    if mapping is not None:
        recording = bind_thrusters(recording, [thruster.name for thruster in vehicle.thrusters])
    return manoeuvre_from_recording(recording, vehicle, dt=dt, duration=duration)


def _planned(
    path: Path,
    vehicle: Vehicle,
    duration: float | None,
    dt: float,
    push: OrnsteinUhlenbeck | None,
    guard: bool,
    seed: int,
    output: Output,
) -> tuple[Manoeuvre, Array | None, GuardedRun | None]:
    """Return the inputs of a plan, at rest between its segments, its start, and what its guard made of it."""
    import numpy as np

    from towtank.planning import RATE, guarded_commands, read_plan
    from towtank.recording import Recording
    from towtank.simulation import manoeuvre_from_recording

    found = read_plan(path)
    if found.vehicle != vehicle.name:
        output.warn(f"{path}: planned for {found.vehicle}, driven by {vehicle.name}: other forces, another promise")
    commands, kept = found.commands(vehicle), None
    if duration is not None:
        commands = commands[: max(1, round(duration * RATE))]
    if guard:
        if found.space is None:
            raise InputError(f"--guard: {path} is a plan for open water, which has no walls; plan with --space")
        kept = guarded_commands(vehicle, found.space, commands, disturbance=push, seed=seed)
        commands = kept.commands
    columns = dict(zip((f"cmd_{each.name}" for each in vehicle.thrusters), commands.T, strict=True))
    recording = Recording.from_table(np.arange(len(commands)) / RATE, columns, source=path.name)
    start = None if found.space is None else found.space.eta0
    return manoeuvre_from_recording(recording, vehicle, dt=dt, duration=duration), start, kept
