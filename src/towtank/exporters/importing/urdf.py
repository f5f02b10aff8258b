"""Links and joints of a URDF, as one body; and source `urdf-hydrodynamics`: the element of blue and auv_controllers."""

from __future__ import annotations

from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.exporters.frames import parallel_axes
from towtank.exporters.importing.bodies import IDENTITY, Placed, Solid, composite, pose
from towtank.exporters.importing.guarded import Imported, number, numbers
from towtank.exporters.importing.known import doubts_of
from towtank.vehicle import Buoyancy, RigidBody, Vehicle
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = ["Tree", "attribute", "imported", "recognises", "tree_of"]

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
    vehicle = Vehicle(
        name=root.get("name") or "vehicle",
        rigid_body=_body(mass, tensor, r_G, place),
        buoyancy=Buoyancy(force=_below(statics, "buoyancy", "value", place), centre=tuple(r_B.tolist())),
        hydrodynamics={name: value for name, value in values.items() if value != 0.0},
    )
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
    if not mass > 0.0 or np.linalg.eigvalsh(tensor)[0] <= 0.0:
        raise InputError(
            f"{place}: found a mass of {mass:g} kg with moments of inertia about the centre of gravity of"
            f" {', '.join(f'{each:g}' for each in np.diag(tensor))} kg m^2, expected a body's"
        )
    plain = not np.any(tensor - np.diag(np.diag(tensor)))
    inertia: object = tuple(np.diag(tensor).tolist()) if plain else tuple(tuple(row) for row in tensor.tolist())
    return RigidBody(mass=mass, inertia=inertia, centre_of_gravity=tuple(r_G.tolist()))
