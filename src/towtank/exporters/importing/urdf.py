"""Links and joints of a URDF, as one body; and source `urdf-hydrodynamics`: the element of blue and auv_controllers.

The thrusters of such a vehicle stand in YAML, the parameters of the controllers: `thrusters.yaml` beside the URDF.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.exporters.frames import parallel_axes
from towtank.exporters.importing.bodies import IDENTITY, Placed, Solid, composite, pose
from towtank.exporters.importing.guarded import Imported, number, numbers
from towtank.exporters.importing.known import doubts_of
from towtank.exporters.request import is_definite
from towtank.exporters.simulators.urdf import PLACE
from towtank.vehicle import Buoyancy, RigidBody, TableCurve, Thruster, Vehicle
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = ["Tree", "attribute", "imported", "recognises", "tree_of"]

_YAML = "thrusters.yaml"
_LARGEST = 1_000_000  # bytes of it
_OFF = 1e-3  # of the length 1 that a direction has
_POINTS = 129  # of a curve made of a polynomial
_ROWS = ("x", "y", "z", "rx", "ry", "rz")
_PLACE = re.compile(
    re.escape(PLACE).replace(r"\{name\}", r"(\S+)").replace(r"\{position\}", "(.+)").replace(r"\{direction\}", "(.+)")
)
_ADDED = ("Xdu", "Ydv", "Zdw", "Kdp", "Mdq", "Ndr")
_KNOWN = {
    "hydrodynamics": {"inertial", "damping", "hydrostatics"},
    "inertial": {"mass", "inertia", "center_of_gravity", "added_mass"},
    "damping": {"linear", "quadratic"},
    "hydrostatics": {"buoyancy", "center_of_buoyancy"},
}


class Tree(NamedTuple):
    """Links of a URDF within the frame of one: where each is, and all of them as one body (FLU)."""

    frames: dict[str, Placed]
    body: Solid
    left: tuple[str, ...]


def attribute(element: Element | None, name: str, place: str) -> float:
    """Return a number that an attribute holds. Raises InputError where it is not there or none."""
    return number(None if element is None else element.get(name), f"{place} {name}")


def tree_of(root: Element, base: str, place: str) -> Tree:
    """Return the links that hang on `base`, all joints taken as they stand at zero."""
    links = {each.get("name", ""): each for each in root.findall("link")}
    frames, left, waiting = {base: IDENTITY}, list[str](), [base]
    while waiting:
        parent = waiting.pop()
        for joint in root.findall("joint"):
            child = _end(joint, "child")
            if _end(joint, "parent") != parent or child in frames or child not in links:
                continue
            frames[child] = _origin(joint, f"{place}: joint {joint.get('name')}").within(frames[parent])
            waiting.append(child)
    solids = []
    for name, link in links.items():
        inertial = link.find("inertial")
        if inertial is None:
            continue
        if name not in frames:
            left.append(f"link {name}: hangs on nothing that hangs on {base}")
            continue
        solids.append(_solid(inertial, frames[name], f"{place}: link {name}"))
    if not solids:
        raise InputError(f"{place}: found no link with an <inertial> at {base}, expected the body's mass and inertia")
    return Tree(frames, composite(solids), tuple(left))


def _end(joint: Element, which: str) -> str:
    found = joint.find(which)
    return "" if found is None else found.get("link", "")


def _origin(element: Element, place: str) -> Placed:
    origin = element.find("origin")
    if origin is None:
        return IDENTITY
    xyz, rpy = (numbers(origin.get(name, "0 0 0"), 3, f"{place}: origin {name}") for name in ("xyz", "rpy"))
    return pose((*xyz, *rpy))


def _solid(inertial: Element, frame: Placed, place: str) -> Solid:
    mass = attribute(inertial.find("mass"), "value", f"{place}: mass")
    tensor, element = np.zeros((3, 3)), inertial.find("inertia")
    for i in range(3):
        for j in range(i, 3):
            name = f"i{'xyz'[i]}{'xyz'[j]}"
            if i != j and (element is None or element.get(name) is None):
                continue
            tensor[i, j] = tensor[j, i] = attribute(element, name, f"{place}: inertia")
    within = _origin(inertial, place).within(frame)
    return Solid(mass, within.p, within.R @ tensor @ within.R.T)


# -- the element of blue and auv_controllers


def recognises(root: Element) -> bool:
    """Return whether this is a URDF with the element <hydrodynamics>."""
    return root.tag == "robot" and root.find("hydrodynamics") is not None


def imported(root: Element, text: str, place: str) -> Imported:
    """Return the vehicle of the element <hydrodynamics>, which is in FRD.

    Raises:
        InputError: an attribute that is missing or no number, or a body that is none.
    """
    del text
    found = root.find("hydrodynamics")
    if found is None:
        raise InputError(f"{place}: found no <hydrodynamics>, expected that element below <robot>")
    left = [
        f"{each.tag}: {child.tag}"
        for each in found.iter()
        for child in each
        if each.tag in _KNOWN and child.tag not in _KNOWN[each.tag]
    ]
    left += [f"{each.tag} {each.get('name', '')}".strip() for each in root if each.tag != "hydrodynamics"]
    inertial, damping, statics = (found.find(name) for name in ("inertial", "damping", "hydrostatics"))
    values = {}
    for k in range(6):
        values[f"{ROWS[k]}_{COLUMNS[k]}dot"] = _below(inertial, "added_mass", _ADDED[k], place)
        values[f"{ROWS[k]}_{COLUMNS[k]}"] = _below(damping, "linear", ROWS[k] + COLUMNS[k], place)
        values[f"{ROWS[k]}_{COLUMNS[k] * 2}"] = _below(damping, "quadratic", ROWS[k] + COLUMNS[k] * 2, place)
    mass = _below(inertial, "mass", "value", place)
    r_G, r_B = (
        np.array([_below(where, name, axis, place) for axis in "xyz"])
        for where, name in ((inertial, "center_of_gravity"), (statics, "center_of_buoyancy"))
    )
    about_origin = np.diag([_below(inertial, "inertia", f"i{axis * 2}", place) for axis in "xyz"])
    products = [name for name in ("ixy", "ixz", "iyz") if _product(inertial, name, place)]
    doubts = []
    if products:
        doubts.append(f"{', '.join(products)}: the controllers fill the upper triangle alone, so that M is unsymmetric")
    tensor = about_origin - parallel_axes(mass, r_G)
    thrusters, unsure = _thrusters(Path(place).with_name(_YAML), left)
    doubts += unsure
    vehicle = Vehicle(
        name=root.get("name") or "vehicle",
        thrusters=thrusters,
        rigid_body=_body(mass, tensor, r_G, place),
        buoyancy=Buoyancy(force=_below(statics, "buoyancy", "value", place), centre=tuple(r_B.tolist())),
        hydrodynamics={name: value for name, value in values.items() if value != 0.0},
    )
    moments = np.linalg.eigvalsh(tensor)
    if moments[0] <= 0.0:
        said = f"moments of inertia about the centre of gravity of {', '.join(f'{each:g}' for each in moments)} kg m^2"
        if not is_definite(vehicle.mass_matrix):
            raise InputError(f"{place}: found a mass of {mass:g} kg with {said}, expected a body's")
        doubts.append(f"{said}: no body has them; are products of inertia missing?")
    if np.any(r_G):
        doubts.append(
            "inertia is taken about the origin, as the controllers do; was that about the centre of gravity meant?"
        )
    return Imported(vehicle, "urdf-hydrodynamics", (*doubts, *doubts_of(vehicle)), tuple(left))


def _below(element: Element | None, child: str, name: str, place: str) -> float:
    found = None if element is None else element.find(child)
    return attribute(found, name, f"{place}: hydrodynamics/{child}")


def _product(inertial: Element | None, name: str, place: str) -> float:
    element = None if inertial is None else inertial.find("inertia")
    return 0.0 if element is None or element.get(name) is None else attribute(element, name, f"{place}: inertia")


def _body(mass: float, tensor: Array, r_G: Array, place: str) -> RigidBody:
    if not mass > 0.0:
        raise InputError(f"{place}: found a mass of {mass:g} kg, expected one above 0")
    plain = not np.any(tensor - np.diag(np.diag(tensor)))
    inertia: object = tuple(np.diag(tensor).tolist()) if plain else tuple(tuple(row) for row in tensor.tolist())
    return RigidBody(mass=mass, inertia=inertia, centre_of_gravity=tuple(r_G.tolist()))


# -- thrusters, out of the controllers' parameters


def _thrusters(path: Path, left: list[str]) -> tuple[tuple[Thruster, ...], list[str]]:
    """Return the thrusters of the YAML, and doubts; none where there is no such file.

    The allocation matrix knows a line along which a thruster pushes, not where on it the thruster sits: that is taken
    from the comment of an export, else as the point next to the origin.
    """
    if not path.is_file():
        return (), []
    text = _text(path)
    parameters = list(_parameters(_parsed(text, path)))
    found = next((each for each in parameters if "tam" in each), None)
    if found is None:
        left.append(f"{path.name}: no thruster_allocation_matrix_controller with a tam")
        return (), []
    names = [str(each) for each in _list(found.get("thrusters"), f"{path}: thrusters")]
    rows = found["tam"] if isinstance(found["tam"], Mapping) else {}
    tam = np.array([_numbers(rows.get(row), len(names), f"{path}: tam: {row}") for row in _ROWS])
    curves = {str(each["thruster"]): each for each in parameters if "thrust_curve_coefficients" in each}
    left += [f"{path.name}: curve of {name}, which tam does not have" for name in curves if name not in names]
    places = {match[1]: match for match in map(_PLACE.fullmatch, text.splitlines()) if match is not None}
    out, doubts = [], []
    for k, name in enumerate(names):
        position, direction = _placed(tam[:, k], places.get(name), f"{path}: thruster {name[:60]}")
        if name not in curves:
            raise InputError(
                f"{path}: found no thrust_curve_coefficients of the thruster {name[:60]}, expected a curve"
            )
        curve, doubtful = _curve(curves[name], f"{path}: thruster {name[:60]}")
        doubts += [f"thruster {name[:60]}: {each}" for each in doubtful]
        out.append(Thruster(name=name, position=position, direction=direction, curve=curve))
    return tuple(out), doubts


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    if len(data) > _LARGEST:
        raise InputError(f"{path}: found {len(data)} bytes, expected at most {_LARGEST}")
    return data.decode("utf-8", "replace")


def _parsed(text: str, path: Path) -> object:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    try:
        return YAML(typ="safe", pure=True).load(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark
        place = path if mark is None else f"{path}:{mark.line + 1}:{mark.column + 1}"
        raise InputError(f"{place}: not valid YAML ({str(error.problem)[:80]})") from None
    except (YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid YAML ({str(error)[:80]})") from None


def _parameters(document: object) -> Iterator[Mapping[str, Any]]:
    """Yield the parameters of every node, however deep namespaces are."""
    waiting = [document]
    for _ in range(_LARGEST):
        if not waiting:
            return
        each = waiting.pop(0)
        if not isinstance(each, Mapping):
            continue
        if isinstance(each.get("ros__parameters"), Mapping):
            yield each["ros__parameters"]
        else:
            waiting += each.values()


def _list(value: object, place: str) -> list[Any]:
    if not isinstance(value, list):
        raise InputError(f"{place}: found {'nothing' if value is None else type(value).__name__}, expected a list")
    return value


def _number(value: object, place: str) -> float:
    return number(None if value is None or isinstance(value, bool) else str(value), place)


def _numbers(value: object, count: int | None, place: str) -> list[float]:
    found = [_number(each, place) for each in _list(value, place)]
    if count is not None and len(found) != count:
        raise InputError(f"{place}: found {len(found)} numbers, expected {count}, one for each thruster")
    return found


def _placed(column: Array, said: re.Match[str] | None, place: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return position and direction of a column of the allocation matrix: those of the comment where they fit it."""
    force, moment = column[:3], column[3:]
    size = float(np.linalg.norm(force))
    if not abs(size - 1.0) < _OFF:
        raise InputError(f"{place}: found a force of length {size:g} in tam, expected 1 N per newton of thrust")
    if said is not None:
        try:
            position, direction = (np.array(numbers(said[k].replace(",", " "), 3, place)) for k in (2, 3))
        except InputError:
            position = direction = np.zeros(3)
        if np.abs(np.concatenate([direction, np.cross(position, direction)]) - column).max() < 1e-9:
            return tuple(position.tolist()), tuple(direction.tolist())
    return tuple((np.cross(force, moment) / size**2).tolist()), tuple((force / size).tolist())


def _curve(parameters: Mapping[str, Any], place: str) -> tuple[TableCurve, list[str]]:
    """Return a curve from pulse to thrust, made of points of the polynomial from thrust to pulse; and doubts."""

    def of(name: str) -> float:
        return _number(parameters.get(name), f"{place}: {name}")

    powers = _numbers(parameters["thrust_curve_coefficients"], None, f"{place}: thrust_curve_coefficients")
    low, high, neutral = of("min_thrust"), of("max_thrust"), of("neutral_pwm")
    if not low <= 0.0 <= high or not powers:
        raise InputError(
            f"{place}: found a thrust of {low:g} to {high:g} N, expected a range around 0 and a polynomial"
        )
    bands = neutral - of("min_deadband_pwm"), of("max_deadband_pwm") - neutral
    doubts = []
    if bands[0] != bands[1]:
        doubts.append(f"the dead band reaches {bands[0]:g} us below neutral and {bands[1]:g} above: taken as the wider")
    scale = max(-low, high) or 1.0
    forces = np.unique(np.concatenate([np.linspace(low, high, _POINTS), [0.0]]))
    shares = np.array(powers) * scale ** np.arange(len(powers))
    pulses = np.polynomial.polynomial.polyval(forces / scale, shares)
    way = 1.0 if pulses[-1] >= pulses[0] else -1.0
    rising = np.concatenate([[True], way * pulses[1:] > np.maximum.accumulate(way * pulses)[:-1]])
    if rising.sum() < 2:
        return TableCurve(command=(neutral - 1.0, neutral + 1.0), force=(0.0, 0.0), neutral=neutral), doubts
    if not rising.all():
        doubts.append("its polynomial turns back: thrusts for which a pulse stands already are left out")
    order = np.argsort(pulses[rising])
    curve = TableCurve(
        command=tuple(pulses[rising][order].tolist()),
        force=tuple(forces[rising][order].tolist()),
        neutral=neutral,
        dead_band=max(*bands, 0.0),
    )
    return curve, doubts
