"""Target `fmu`: a functional mock-up unit for co-simulation, FMI 2.0 or 3.0, made of the C header.

Sources always; a Linux binary beside them where a C compiler is at hand. Inputs are the thrusters' commands, a wrench
beside them, the current and the supply voltage; every coefficient is a tunable parameter under its SNAME name.
"""

from __future__ import annotations

import io
import platform
import re
import shutil
import subprocess
import tempfile
import uuid
import zipfile
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import NamedTuple

from towtank.errors import InputError
from towtank.exporters.heading import Heading
from towtank.exporters.programs import c99
from towtank.exporters.request import Kept, Request
from towtank.exporters.templates import filled, template
from towtank.vehicle import Vehicle, describe, unit
from towtank.vehicle.records import dimensions

__all__ = ["Variable", "kept", "variables", "written"]

_STEP = 0.01  # s, the longest step of integration unless the parameter says otherwise
_BUILT = (1980, 1, 1, 0, 0, 0)  # the time of every file: the same model gives the same bytes
_PLATFORMS = {"x86_64": ("linux64", "x86_64-linux"), "aarch64": ("aarch64-linux", "aarch64-linux")}  # FMI 2.0, 3.0
_COMPILERS = ("cc", "gcc", "clang")
_FLAGS = ("-std=c99", "-O1", "-fPIC", "-shared", "-fvisibility=hidden", "-Wl,--build-id=none", "-s")
_NAMESPACE = uuid.UUID("6f8f4a3e-7a1c-5d0b-9a53-0e4c2f3f7c11")
_POSE = ("x", "y", "z", "phi", "theta", "psi")
_VELOCITY = ("u", "v", "w", "p", "q", "r")
_RIGID = {
    "m": "mass",
    **dict.fromkeys(("I_x", "I_y", "I_z"), "inertia about the centre of gravity"),
    **dict.fromkeys(("I_xy", "I_xz", "I_yz"), "product of inertia, with the sign of the tensor"),
    **dict.fromkeys(("x_G", "y_G", "z_G"), "place of the centre of gravity, body FRD"),
}


class Variable(NamedTuple):
    """A variable of the unit; its value reference is its place in the list. No start: it is computed."""

    name: str
    kind: str  # input, fixed, tunable, output
    unit: str
    start: float | None
    words: str


def kept(request: Request) -> Kept:
    """Return what the unit keeps: all but the delay of the commands."""
    without = () if _compiler() else ("a binary: no C compiler was found, the sources are there",)
    return Kept(c99.kept(request).vehicle, without)


def written(request: Request, heading: Heading) -> dict[str, bytes]:
    """Return the unit."""
    vehicle, major = request.vehicle, int(request.version[0])
    name = c99.prefix_of(vehicle)
    header = "/*\n" + heading.commented(" * ") + " */\n" + c99.header_text(vehicle)
    every = tuple(variables(vehicle))
    text = template("fmu.c")
    token = "{" + str(uuid.uuid5(_NAMESPACE, f"{request.version}\n{header}\n{text}")) + "}"
    values = {
        "fields": str(len(c99.FIELDS)),
        "defaults": ",\n".join(f"    {each.start or 0.0!r} /* {each.name} */" for each in every),
        "has_thrusters": str(int(bool(vehicle.thrusters))),
        "token": token,
    }
    code = filled(text, values)
    code = re.sub(r"\bTT_", f"{name.upper()}_", re.sub(r"\btt_", f"{name}_", code))
    code = f"#define FMI {major}\n{code}"
    description = (_description_2 if major == 2 else _description_3)(vehicle, name, token, every)
    opening = f'<?xml version="1.0" encoding="UTF-8"?>\n{heading.xml}'
    contents = {
        "modelDescription.xml": (opening + description).encode(),
        "sources/model.h": header.encode(),
        "sources/fmu.c": code.encode(),
    }
    if major == 3:
        contents["sources/buildDescription.xml"] = _build_description(name).encode()
    binary = _binary(header, code)
    if binary is not None:
        contents[f"binaries/{_PLATFORMS[platform.machine()][major - 2]}/{name}.so"] = binary
    return {f"{name}.fmu": _zipped(contents)}


def variables(vehicle: Vehicle) -> Iterator[Variable]:
    """Yield the variables of a vehicle's unit in the order of their value references."""
    for thruster in vehicle.thrusters:
        yield Variable(f"cmd_{thruster.name}", "input", "", thruster.curve.rest, "command, in the unit of its curve")
    yield Variable("voltage", "input", "V", 0.0, "of the supply; 0: that of the thrusters' curves")
    for row in "XYZKMN":
        words = f"{'force' if row in 'XYZ' else 'moment'} beside the thrusters, body FRD"
        yield Variable(row, "input", "N" if row in "XYZ" else "N m", 0.0, words)
    for axis in ("north", "east", "down"):
        yield Variable(f"current_{axis}", "input", "m/s", 0.0, "velocity of the water")
    yield Variable("step", "fixed", "s", _STEP, "longest step of integration")
    for name in (*_POSE, *_VELOCITY):
        yield Variable(f"{name}_0", "fixed", _unit_of_motion(name), 0.0, "at the start")
    for name, value in c99.values_of(vehicle).items():
        if name in _RIGID:
            yield Variable(name, "tunable", c99.unit_of_field(name), value, _RIGID[name])
        else:
            yield Variable(name, "tunable", unit(name), value, describe(name))
    for name in _POSE:
        yield Variable(name, "output", _unit_of_motion(name), None, "pose, NED")
    for name in ("qw", "qx", "qy", "qz"):
        yield Variable(name, "output", "", None, "quaternion, body to NED")
    for name in _VELOCITY:
        yield Variable(name, "output", _unit_of_motion(name), None, "velocity over ground, body FRD")
    for thruster in vehicle.thrusters:
        yield Variable(f"force_{thruster.name}", "output", "N", None, "force of the thruster without loss by inflow")


def _unit_of_motion(name: str) -> str:
    if name in _POSE:
        return "m" if name in "xyz" else "rad"
    return "m/s" if name in "uvw" else "rad/s"


# -- descriptions


def _start(each: Variable) -> str:
    return "" if each.start is None else f" start={_quoted(repr(float(each.start) + 0.0))}"


def _unit_attribute(each: Variable) -> str:
    return f" unit={_quoted(each.unit)}" if each.unit else ""


def _units(every: tuple[Variable, ...]) -> str:
    lines = ["  <UnitDefinitions>"]
    for name in sorted({each.unit for each in every if each.unit}):
        kg, m, s = (1, 2, -3) if name == "V" else dimensions(name)
        exponents = {"kg": kg, "m": m, "s": s, "A": -1 if name == "V" else 0, "rad": int(name == "rad")}
        base = "".join(f' {base}="{power}"' for base, power in exponents.items() if power)
        lines.append(f"    <Unit name={_quoted(name)}><BaseUnit{base}/></Unit>")
    return "\n".join([*lines, "  </UnitDefinitions>", *_LOGS])


_LOGS = (
    "  <LogCategories>",
    '    <Category name="logStatusDiscard"/>',
    '    <Category name="logStatusError"/>',
    "  </LogCategories>",
    f'  <DefaultExperiment startTime="0.0" stepSize="{_STEP}"/>',
)
_KINDS = {
    "input": 'causality="input" variability="continuous"',
    "fixed": 'causality="parameter" variability="fixed" initial="exact"',
    "tunable": 'causality="parameter" variability="tunable" initial="exact"',
    "output": 'causality="output" variability="continuous" initial="calculated"',
}


def _root(vehicle: Vehicle, version: str, token: str) -> str:
    """Return the opening tag; `token` is the attribute with it."""
    name, description = (_quoted(_plain(text)) for text in (vehicle.name, vehicle.description))
    return (
        f'<fmiModelDescription fmiVersion="{version}" modelName={name} {token} description={description}'
        ' generationTool="towtank" variableNamingConvention="flat">'
    )


def _description_2(vehicle: Vehicle, name: str, token: str, every: tuple[Variable, ...]) -> str:
    lines = [
        _root(vehicle, "2.0", f'guid="{token}"'),
        f'  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="true"'
        ' canGetAndSetFMUstate="true" canSerializeFMUstate="true" canNotUseMemoryManagementFunctions="true">',
        '    <SourceFiles><File name="fmu.c"/></SourceFiles>',
        "  </CoSimulation>",
        _units(every),
        "  <ModelVariables>",
    ]
    for reference, each in enumerate(every):
        lines.append(
            f'    <ScalarVariable name={_quoted(each.name)} valueReference="{reference}" {_KINDS[each.kind]}'
            f" description={_quoted(each.words)}><Real{_unit_attribute(each)}{_start(each)}/></ScalarVariable>"
        )
    outputs = [k + 1 for k, each in enumerate(every) if each.kind == "output"]
    lines += ["  </ModelVariables>", "  <ModelStructure>"]
    for section in ("Outputs", "InitialUnknowns"):
        lines += [f"    <{section}>", *(f'      <Unknown index="{k}"/>' for k in outputs), f"    </{section}>"]
    return "\n".join([*lines, "  </ModelStructure>", "</fmiModelDescription>", ""])


def _description_3(vehicle: Vehicle, name: str, token: str, every: tuple[Variable, ...]) -> str:
    time = f'name="time" valueReference="{len(every)}" causality="independent" variability="continuous" unit="s"'
    lines = [
        _root(vehicle, "3.0", f'instantiationToken="{token}"'),
        f'  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="true"'
        ' canGetAndSetFMUState="true" canSerializeFMUState="true"/>',
        _units(every),
        "  <ModelVariables>",
        f"    <Float64 {time}/>",
    ]
    for reference, each in enumerate(every):
        lines.append(
            f'    <Float64 name={_quoted(each.name)} valueReference="{reference}" {_KINDS[each.kind]}'
            f" description={_quoted(each.words)}{_unit_attribute(each)}{_start(each)}/>"
        )
    outputs = [k for k, each in enumerate(every) if each.kind == "output"]
    lines += ["  </ModelVariables>", "  <ModelStructure>"]
    for element in ("Output", "InitialUnknown"):
        lines += [f'    <{element} valueReference="{k}"/>' for k in outputs]
    return "\n".join([*lines, "  </ModelStructure>", "</fmiModelDescription>", ""])


def _build_description(name: str) -> str:
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiBuildDescription fmiVersion="3.0">\n'
        f'  <BuildConfiguration modelIdentifier="{name}">\n    <SourceFileSet language="C99">\n'
        '      <SourceFile name="fmu.c"/>\n    </SourceFileSet>\n  </BuildConfiguration>\n</fmiBuildDescription>\n'
    )


def _quoted(text: str) -> str:
    """Return an attribute's value; `xml.sax.saxutils` would load all of the network for it."""
    return f'"{escape(text)}"'


def _plain(text: str) -> str:
    return "".join(each if each.isprintable() else " " for each in text)


# -- files


def _compiler() -> str | None:
    """Return a C compiler for this machine's binaries; None where there is none, or this is no Linux that FMI names."""
    if platform.system() != "Linux" or platform.machine() not in _PLATFORMS:
        return None
    return next((found for each in _COMPILERS if (found := shutil.which(each))), None)


def _binary(header: str, code: str) -> bytes | None:
    """Return the shared library of the sources; None where there is no compiler."""
    compiler = _compiler()
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "model.h").write_text(header, encoding="utf-8")
        Path(folder, "fmu.c").write_text(code, encoding="utf-8")
        command = [compiler, *_FLAGS, "fmu.c", "-o", "fmu.so", "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, timeout=120)
        if done.returncode != 0:
            said = (done.stderr or done.stdout).strip().splitlines()
            raise InputError(f"{compiler} cannot compile the unit: {said[0] if said else 'it does not say why'}")
        return Path(folder, "fmu.so").read_bytes()


def _zipped(contents: dict[str, bytes]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        for name, content in contents.items():
            entry = zipfile.ZipInfo(name, _BUILT)
            entry.external_attr = (0o755 if name.endswith(".so") else 0o644) << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content)
    return buffer.getvalue()
