"""Source `gz-sim`: a model of Gazebo (SDF), its rigid body, added mass, damping, buoyancy and thrusters.

What the numbers mean is read as Gazebo's systems read them (see `towtank.exporters.simulators.gz_sim`); where they
count a thing twice or wrongly, that is said.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.exporters.frames import folded, turned_bilinear, turned_matrix, turned_vector
from towtank.exporters.heading import heading_of
from towtank.exporters.importing.bodies import IDENTITY, Placed, Solid, composite, pose, rigid_body_of, volume_of
from towtank.exporters.importing.guarded import Imported, number, numbers
from towtank.exporters.importing.known import doubts_of
from towtank.exporters.importing.urdf import Tree
from towtank.exporters.simulators.gz_sim import DENSITY, bilinear_of_added_mass
from towtank.vehicle import COEFFICIENTS, Buoyancy, PolynomialCurve, QuadraticCurve, Thruster, Vehicle, index
from towtank.vehicle.matrices import GRAVITY
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = ["added_mass_coefficients", "imported", "recognises", "thruster_name", "tree_of_model"]

_FORCES, _VELOCITIES, _ADDED = "xyzkmn", "UVWPQR", "xyzpqr"
_TERM = re.compile(r"^([xyzkmn])([UVWPQR])(abs)?([UVWPQR])?$")
_MASS = re.compile(r"^([xyzkmn])Dot([UVWPQR])$")
_PLAIN = {  # elements of links and models that do not move them, and such as have been read
    *("pose", "inertial", "collision", "visual", "sensor", "self_collide", "enable_wind", "kinematic", "gravity"),
    *("static", "link", "joint", "plugin", "light", "must_be_base_link"),
}
_OURS = {"link_name", "water_density", "disable_coriolis", "disable_added_mass", "namespace"}
_UNSAID_MASS = 1.0  # kg and kg m^2: what SDF takes where nothing is said
_MOST_THRUST = 1000.0  # N


def recognises(root: Element) -> bool:
    """Return whether this is an SDF file, and none of Gazebo classic with the plugins of uuv_simulator."""
    return root.tag == "sdf" and next(root.iter("hydrodynamic_model"), None) is None


def imported(root: Element, text: str, place: str) -> Imported:
    """Return the vehicle of an SDF file's model.

    Raises:
        InputError: no model, a number that is none, a body that is none.
    """
    return _Reading(root, place, ours=heading_of(text) is not None).vehicle()


def tree_of_model(root: Element, base: str, place: str) -> tuple[Tree, tuple[str, ...]]:
    """Return the links of an SDF model, in the frame of one of them and as one body (FLU); and doubts."""
    reading = _Reading(root, place, base=base)
    body = composite([reading.solid(name) for name in reading.links])
    return Tree(reading.frames, body, tuple(reading.left)), tuple(reading.doubts)


class _Reading:
    """A model being read."""

    def __init__(self, root: Element, place: str, *, ours: bool = False, base: str = "") -> None:
        self.ours = ours  # towtank wrote it
        self.place, self.left, self.doubts = place, list[str](), list[str]()
        models = [*root.findall("model"), *root.findall("world/model")]
        if not models:
            raise InputError(f"{place}: found no <model>, expected an SDF file with a vehicle")
        moved = [each for each in models if any(_moves(plugin) for plugin in each.findall("plugin"))]
        self.model = (moved or models)[0]
        self.left += [f"model {each.get('name')}" for each in models if each is not self.model and moved]
        self.density = self._density(root)
        self.links = {each.get("name", f"link {k}"): each for k, each in enumerate(self.model.findall("link"))}
        self.joints = {each.get("name", ""): each for each in self.model.findall("joint")}
        if not self.links:
            raise InputError(f"{place}: found a model without links, expected one with <link>")
        self.base = base if base in self.links else self._base()
        here = self._frame(self.base).inverse
        self.frames = {name: self._frame(name).within(here) for name in self.links}

    def vehicle(self) -> Imported:
        """Return what was read."""
        body = rigid_body_of(composite([self.solid(name) for name in self.links]), self.place)
        values = self._hydrodynamics()
        thrusters = [self._thruster(each) for each in self._plugins("Thruster")]
        names = [each["name"] for each in thrusters]
        for k, each in enumerate(thrusters):
            each["name"] = each["name"] if names.count(each["name"]) == 1 else f"{each['name']}_{k + 1}"
        found = Vehicle(
            name=self.model.get("name") or "vehicle",
            rigid_body=body,
            buoyancy=self._buoyancy(body.mass),
            hydrodynamics=values,
            thrusters=tuple(Thruster.model_validate(each) for each in thrusters),
        )
        self._rest()
        return Imported(found, "gz-sim", (*self.doubts, *doubts_of(found)), tuple(self.left))

    # -- frames and bodies

    def _density(self, root: Element) -> float:
        for each in root.iter("uniform_fluid_density"):
            return number(each.text, f"{self.place}: uniform_fluid_density")
        return DENSITY

    def _base(self) -> str:
        for plugin in self._plugins("Hydrodynamics"):
            name = (plugin.findtext("link_name") or "").strip()
            if name in self.links:
                return name
            raise InputError(f'{self.place}: Hydrodynamics: found link_name "{name[:40]}", expected one of the links')
        weighted = [name for name, each in self.links.items() if each.find("inertial/fluid_added_mass") is not None]
        return (weighted or list(self.links))[0]

    def _plugins(self, kind: str) -> list[Element]:
        return [each for each in self.model.findall("plugin") if _name(each).rpartition("::")[2] == kind]

    def _pose(self, element: Element, place: str) -> Placed:
        found = element.find("pose")
        if found is None or not (found.text or "").strip():
            return IDENTITY
        values = numbers(found.text, 6, f"{self.place}: {place}: pose")
        return pose(values, degrees=found.get("degrees", "false").lower() in ("true", "1"))

    def _frame(self, name: str, seen: tuple[str, ...] = ()) -> Placed:
        """Return a link's frame within the model's."""
        link = self.links[name]
        found = link.find("pose")
        base = "" if found is None else found.get("relative_to", "")
        own = self._pose(link, f"link {name}")
        if base in ("", "__model__"):
            return own
        if base not in self.links or name in seen:
            raise InputError(f'{self.place}: link {name}: pose relative to "{base}", expected another link')
        return own.within(self._frame(base, (*seen, name)))

    def solid(self, name: str) -> Solid:
        """Return the body of a link, in the frame of the base."""
        inertial, frame, place = self.links[name].find("inertial"), self.frames[name], f"{self.place}: link {name}"
        if inertial is None:
            self.doubts.append(f"link {name}: no inertial, Gazebo takes 1 kg and 1 kg m^2")
            return Solid(_UNSAID_MASS, frame.p, _UNSAID_MASS * np.eye(3))
        mass = _child(inertial, "mass", _UNSAID_MASS, place)
        tensor = np.zeros((3, 3))
        for i in range(3):
            for j in range(i, 3):
                unsaid = _UNSAID_MASS if i == j else 0.0
                value = _child(inertial, f"inertia/i{'xyz'[i]}{'xyz'[j]}", unsaid, place)
                tensor[i, j] = tensor[j, i] = value
        within = self._pose(inertial, f"link {name}: inertial").within(frame)
        return Solid(mass, within.p, within.R @ tensor @ within.R.T)

    def _buoyancy(self, mass: float) -> Buoyancy:
        """Return the displaced volumes' lift and its centre; that of a body as heavy as water where none is known."""
        total, moment, unknown = 0.0, np.zeros(3), list[str]()
        for name, link in self.links.items():
            for each in link.findall("collision"):
                kind, sizes = self._shape(each, f"link {name}")
                volume = volume_of(kind, sizes)
                if volume is None and kind != "plane":
                    unknown.append(f"volume of the {kind or 'shape'} of link {name}")
                frame = self._pose(each, f"link {name}: collision").within(self.frames[name])
                total += volume or 0.0
                moment += (volume or 0.0) * frame.p
        self.left += unknown
        if total <= 0.0 and self.ours:
            return Buoyancy(force=0.0)
        if total <= 0.0:
            self.doubts.append("no volume to displace water: taken as neutral, lifted at the centre of gravity")
            centre = composite([self.solid(name) for name in self.links]).centre
            return Buoyancy(centre=tuple(turned_vector(centre).tolist()))
        lift = self.density * GRAVITY * total
        if lift > 1.5 * mass * GRAVITY or lift < 0.5 * mass * GRAVITY:
            self.doubts.append(f"the collisions displace {total:.4g} m^3 for {mass:.4g} kg")
        return Buoyancy(force=lift, centre=tuple(turned_vector(moment / total).tolist()))

    def _shape(self, collision: Element, place: str) -> tuple[str, tuple[float, ...]]:
        geometry = collision.find("geometry")
        shape = None if geometry is None else next(iter(geometry), None)
        if shape is None:
            return "", ()
        place = f"{self.place}: {place}: {shape.tag}"
        match shape.tag:
            case "box":
                return "box", numbers(shape.findtext("size"), 3, place)
            case "sphere":
                return "sphere", (number(shape.findtext("radius"), place),)
            case "cylinder" | "capsule":
                return shape.tag, (number(shape.findtext("radius"), place), number(shape.findtext("length"), place))
            case "ellipsoid":
                return "ellipsoid", numbers(shape.findtext("radii"), 3, place)
        return shape.tag, ()

    # -- forces of the water

    def _hydrodynamics(self) -> dict[str, float]:
        values: dict[str, float] = {}
        M = self._fluid_added_mass()
        linear, quadratic, terms, late = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 6, 6)), np.zeros((6, 6))
        coriolis = True
        for k, plugin in enumerate(self._plugins("Hydrodynamics")):
            if k:
                self.left.append(f"Hydrodynamics of link {plugin.findtext('link_name')}")
                continue
            coriolis = not _is_true(plugin.findtext("disable_coriolis"))
            for each in plugin:
                self._term(each, linear, quadratic, terms, late)
            if _is_true(plugin.findtext("disable_added_mass")):
                late[:] = 0.0
        if np.any(late):
            self._late(M, late, terms, coriolis=coriolis)
            M = M - late
        terms = turned_bilinear(terms)
        values |= added_mass_coefficients(turned_matrix(M))
        linear, quadratic = turned_matrix(linear), turned_matrix(quadratic)
        for i, j in np.ndindex(6, 6):
            if linear[i, j] != 0.0:
                values[f"{ROWS[i]}_{COLUMNS[j]}"] = float(linear[i, j])
            if quadratic[i, j] != 0.0:
                values[f"{ROWS[i]}_{COLUMNS[j] * 2}"] = float(quadratic[i, j])
        return values | self._even(terms)

    def _fluid_added_mass(self) -> Array:
        M = np.zeros((6, 6))
        for name, link in self.links.items():
            found = link.find("inertial/fluid_added_mass")
            if found is None:
                continue
            if name != self.base:
                self.left.append(f"fluid_added_mass of link {name}")
                continue
            for each in found:
                if len(each.tag) != 2 or not set(each.tag) <= set(_ADDED):
                    self.left.append(f"fluid_added_mass/{each.tag}")
                    continue
                i, j = (_ADDED.index(letter) for letter in each.tag)
                M[i, j] = M[j, i] = number(each.text, f"{self.place}: fluid_added_mass/{each.tag}")
        return M

    def _term(self, each: Element, linear: Array, quadratic: Array, terms: Array, late: Array) -> None:
        tag, place = each.tag, f"{self.place}: Hydrodynamics/{each.tag}"
        if (mass := _MASS.match(tag)) is not None:
            late[_FORCES.index(mass[1]), _VELOCITIES.index(mass[2])] = number(each.text, place)
            return
        term = _TERM.match(tag)
        if term is None or (term[3] and not term[4]):
            if tag not in _OURS:
                self.left.append(f"Hydrodynamics/{tag}")
            return
        i, j, value = _FORCES.index(term[1]), _VELOCITIES.index(term[2]), number(each.text, place)
        if term[4] is None:
            linear[i, j] = value
        elif term[3] is None:
            terms[i, j, _VELOCITIES.index(term[4])] = value
        elif term[2] == term[4]:
            quadratic[i, j] = value
        elif value != 0.0:
            self.left.append(f"Hydrodynamics/{tag} = {value:g}: a term of two velocities, one of them without its sign")

    def _late(self, M: Array, late: Array, terms: Array, *, coriolis: bool) -> None:
        """Say what is wrong about added mass by the plugin; take its Coriolis terms, written as damping, out."""
        if np.any(M):
            self.doubts.append("added mass stands in fluid_added_mass and in the plugin: Gazebo counts it twice")
        own = bilinear_of_added_mass(-late)
        scale = np.abs(own).max()
        once = folded(terms)
        if not coriolis and np.abs(np.where(own != 0.0, once - own, 0.0)).max() <= 1e-9 * scale:
            terms[:] = np.where(own != 0.0, 0.0, once)
        elif coriolis:
            self.doubts.append(
                "Gazebo's own Coriolis matrix of added mass knows the diagonal alone and has wrong signs in released"
                " versions; the vehicle has the right one"
            )

    def _even(self, terms: Array) -> dict[str, float]:
        """Return the terms u nu_j and nu_i^2 that a vehicle knows; the others are left."""
        once, values = folded(terms), {}
        for name in COEFFICIENTS:
            kind, i, j = index(name)
            at = (i, 0, j) if kind == "forward" else (i, i, i)
            if kind in ("forward", "asymmetric") and once[at] != 0.0:
                values[name] = float(once[at])
                once[at] = 0.0
        for i, j, k in np.argwhere(once != 0.0):
            tag = _FORCES[i] + _VELOCITIES[j] + _VELOCITIES[k]
            self.left.append(f"Hydrodynamics/{tag}: no such term in a vehicle")
        for axis in range(6):
            if f"{ROWS[axis]}_{COLUMNS[axis]}2" in values:
                tag = _FORCES[axis] + _VELOCITIES[axis] * 2
                self.doubts.append(
                    f"{tag} pushes the same way whichever way the vehicle moves; was"
                    f" {tag[:2]}abs{tag[2]} meant, as before gz-sim 7.5?"
                )
        return values

    # -- thrusters

    def _thruster(self, plugin: Element) -> dict[str, Any]:
        name = (plugin.findtext("joint_name") or "").strip()
        place, joint = f"{self.place}: Thruster {name}", self.joints.get(name)
        child = "" if joint is None else (joint.findtext("child") or "").strip()
        if joint is None or child not in self.frames:
            raise InputError(f'{self.place}: Thruster: found joint_name "{name[:40]}", expected a joint with its links')
        frame = self._pose(joint, f"joint {name}").within(self.frames[child])
        axis = joint.find("axis/xyz")
        if axis is not None and axis.get("expressed_in") not in (None, "", child):
            self.left.append(f"joint {name}: axis expressed in {axis.get('expressed_in')}, taken in the link's frame")
        direction = frame.R @ np.array(numbers("0 0 1" if axis is None else axis.text, 3, f"{place}: axis"))
        if not np.any(direction):
            raise InputError(f"{place}: found an axis of length 0, expected a direction")
        low = _child(plugin, "min_thrust_cmd", -_MOST_THRUST, place)
        high = _child(plugin, "max_thrust_cmd", _MOST_THRUST, place)
        if not low < high or low > 0.0 or high < 0.0:
            raise InputError(f"{place}: found a thrust of {low:g} to {high:g} N, expected a range around 0")
        curve: PolynomialCurve | QuadraticCurve
        if _is_true(plugin.findtext("use_angvel_cmd")):
            factor = self._factor(plugin, place)
            direction = direction if factor > 0.0 else -direction
            curve = QuadraticCurve(forward=abs(factor), limits=(low, high))
        else:
            dead_band = _child(plugin, "deadband", 0.0, place)
            curve = PolynomialCurve(coefficients=(0.0, 1.0), limits=(low, high), dead_band=abs(dead_band))
        return {
            "name": thruster_name(name),
            "position": tuple(turned_vector(self.frames[child].p).tolist()),
            "direction": tuple(turned_vector(direction).tolist()),
            "curve": curve,
        }

    def _factor(self, plugin: Element, place: str) -> float:
        """Return the thrust [N s^2/rad^2] of a propeller's speed squared."""
        coefficient = _child(plugin, "thrust_coefficient", 1.0, place)
        diameter, density = (
            _child(plugin, "propeller_diameter", 0.02, place),
            _child(plugin, "fluid_density", DENSITY, place),
        )
        factor = coefficient * density * diameter**4
        if factor == 0.0 or not np.isfinite(factor):
            raise InputError(f"{place}: found a thrust of {factor:g} N s^2/rad^2, expected one other than 0")
        if plugin.find("alpha_1") is not None or plugin.find("alpha_2") is not None:
            self.left.append(f"{place.partition(': ')[2]}: alpha_1, alpha_2 (thrust by the speed of advance)")
        return factor

    # -- what remains

    def _rest(self) -> None:
        for each in self.model:
            if each.tag not in _PLAIN:
                self.left.append(f"model: {each.tag}")
        for plugin in self.model.findall("plugin"):
            if _name(plugin).rpartition("::")[2] not in ("Hydrodynamics", "Thruster"):
                self.left.append(f"plugin {_name(plugin)[:60]}")
        driven = {(each.findtext("joint_name") or "").strip() for each in self._plugins("Thruster")}
        for name, joint in self.joints.items():
            if name not in driven and joint.get("type") != "fixed":
                self.left.append(f"joint {name}: taken as fixed")


def _name(plugin: Element) -> str:
    return plugin.get("name", "")


def _moves(plugin: Element) -> bool:
    return "Hydrodynamics" in _name(plugin) or next(plugin.iter("hydrodynamic_model"), None) is not None


def _is_true(text: str | None) -> bool:
    return (text or "").strip().lower() in ("true", "1", "1.0")


def _child(element: Element, path: str, unsaid: float, place: str) -> float:
    found = element.find(path)
    return unsaid if found is None else number(found.text, f"{place}: {path}")


def added_mass_coefficients(M_A: Array) -> dict[str, float]:
    """Return the derivatives of an added mass matrix (6, 6) in FRD; a couple that differs stays two."""
    values: Mapping[str, float] = {
        f"{ROWS[i]}_{COLUMNS[j]}dot": -float(M_A[i, j])
        for i, j in np.ndindex(6, 6)
        if M_A[i, j] != 0.0 and (i <= j or M_A[i, j] != M_A[j, i])
    }
    return dict(values)


def thruster_name(joint: str) -> str:
    """Return a joint's name as that of a thruster."""
    plain = re.sub(r"[^A-Za-z0-9_.-]+", "_", joint)
    plain = plain if plain == joint else plain.strip("_")
    return plain.removesuffix("_joint") or "thruster"
