"""Source `uuv-simulator`: a URDF, or an SDF of Gazebo classic, with the plugins of uuv_simulator.

Its hydrodynamic numbers are FRD: the plugin turns velocities and forces. Links, joints, centre of buoyancy and
thrusters are FLU. Only the diagonal of quadratic damping acts there, whatever the file holds.
Sources: uuv_gazebo_plugins HydrodynamicModel.cc, BuoyantObject.cc, ThrusterPlugin.cc, ThrusterConversionFcn.cc.
"""

from __future__ import annotations

from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from towtank.core.arrays import Array
from towtank.errors import InputError
from towtank.exporters.frames import turned_vector
from towtank.exporters.importing.bodies import pose, rigid_body_of
from towtank.exporters.importing.guarded import Imported, number, numbers
from towtank.exporters.importing.gz_sim import added_mass_coefficients, thruster_name, tree_of_model
from towtank.exporters.importing.known import doubts_of
from towtank.exporters.importing.urdf import Tree, tree_of
from towtank.vehicle import (
    COEFFICIENTS,
    Buoyancy,
    PolynomialCurve,
    QuadraticCurve,
    TableCurve,
    Thruster,
    Vehicle,
    index,
)
from towtank.vehicle.matrices import GRAVITY
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = ["imported", "recognises"]

_DENSITY = 1028.0  # kg/m^3, that of the plugin where nothing is said
_MODEL = {
    *("type", "added_mass", "linear_damping", "linear_damping_forward_speed", "quadratic_damping"),
    *("scaling_added_mass", "offset_added_mass", "scaling_damping", "offset_linear_damping"),
    *("offset_lin_forward_speed_damping", "offset_nonlin_damping", "scaling_volume", "volume"),
}
_UNCHANGED = {"scaling_added_mass": 1.0, "scaling_damping": 1.0, "scaling_volume": 1.0}
_LINK = {"neutrally_buoyant", "volume", "box", "center_of_buoyancy", "hydrodynamic_model", "pose", "metacentric_width"}
_THRUSTER = {
    *("linkName", "jointName", "thrusterID", "gain", "clampMin", "clampMax", "thrust_efficiency", "dynamics"),
    *("propeller_efficiency", "conversion", "robotNamespace"),
}


def recognises(root: Element) -> bool:
    """Return whether a file has the hydrodynamic model of uuv_simulator."""
    return root.tag in ("robot", "sdf") and next(root.iter("hydrodynamic_model"), None) is not None


def imported(root: Element, text: str, place: str) -> Imported:
    """Return the vehicle of a URDF of uuv_simulator, or of an SDF with its plugins.

    Raises:
        InputError: no hydrodynamic model, a number that is none, a body that is none.
    """
    del text
    wet = [each for each in root.iter("link") if each.find("hydrodynamic_model") is not None]
    if not wet:
        raise InputError(f"{place}: found no <hydrodynamic_model>, expected a link with one")
    link, left, doubts = wet[0], list[str](), list[str]()
    name = link.get("name", "")
    left += [f"hydrodynamic_model of link {each.get('name')}" for each in wet[1:]]
    left += [f"link {name}: {each.tag}" for each in link if each.tag not in _LINK]
    tree, unsure = _tree(root, _matching(root, name), place)
    left += tree.left
    doubts += unsure
    body = rigid_body_of(tree.body, place)
    model = link.find("hydrodynamic_model")
    values = _hydrodynamics(link if model is None else model, f"{place}: link {name}", left, doubts)
    found = Vehicle(
        name=_name(root) or "vehicle",
        rigid_body=body,
        buoyancy=_buoyancy(root, link, f"{place}: link {name}"),
        hydrodynamics=values,
        thrusters=_thrusters(root, tree, place, left),
    )
    if any(body.centre_of_gravity):
        doubts.append(
            "center_of_buoyancy is read from the link's origin; Gazebo classic counts it from the centre of gravity"
        )
    left += [f"plugin {each.get('filename', '')[:60]}" for each in root.iter("plugin") if not _read(each)]
    return Imported(found, "uuv-simulator", (*doubts, *doubts_of(found)), tuple(left))


def _name(root: Element) -> str:
    models = [each for each in root.iter("model") if next(each.iter("hydrodynamic_model"), None) is not None]
    return (models or [root])[0].get("name", "")


def _read(plugin: Element) -> bool:
    file = plugin.get("filename", "")
    return "thruster" in file or next(plugin.iter("hydrodynamic_model"), None) is not None


def _tree(root: Element, base: str, place: str) -> tuple[Tree, tuple[str, ...]]:
    return (tree_of(root, base, place), ()) if root.tag == "robot" else tree_of_model(root, base, place)


def _matching(root: Element, name: str) -> str:
    """Return the URDF's link that the plugin's name stands for: namespaces may be missing on one side."""
    names = [each.get("name", "") for each in root.findall("link" if root.tag == "robot" else ".//model/link")]
    last = name.rpartition("/")[2]
    return next((each for each in names if each == name or each.rpartition("/")[2] == last), name)


def _buoyancy(root: Element, link: Element, place: str) -> Buoyancy:
    text = link.findtext("center_of_buoyancy")
    centre = (0.0, 0.0, 0.0) if text is None else numbers(text, 3, f"{place}: center_of_buoyancy")
    x, y, z = turned_vector(np.array(centre)).tolist()
    neutral = (link.findtext("neutrally_buoyant") or "").strip().lower() in ("1", "true")
    if neutral or link.find("volume") is None:
        return Buoyancy(centre=(x, y, z))
    stated = next(root.iter("fluid_density"), None)
    density = _DENSITY if stated is None else number(stated.text, f"{place}: fluid_density")
    volume = number(link.findtext("volume"), f"{place}: volume")
    return Buoyancy(force=abs(density * GRAVITY * volume), centre=(x, y, z))


def _hydrodynamics(model: Element, place: str, left: list[str], doubts: list[str]) -> dict[str, float]:
    left += [f"hydrodynamic_model: {each.tag}" for each in model if each.tag not in _MODEL]
    for each in model:
        if each.tag.startswith(("scaling", "offset")):
            value = number(each.text, f"{place}: {each.tag}")
            if value != _UNCHANGED.get(each.tag, 0.0):
                left.append(f"hydrodynamic_model: {each.tag} = {value:g}, the numbers are taken as they stand")
    kind = (model.findtext("type") or "fossen").strip()
    if kind != "fossen":
        left.append(f"hydrodynamic_model: type {kind[:40]}, read as fossen")
    M = _matrix(model, "added_mass", place)
    if np.abs(M - M.T).max() > 1e-3 * max(np.abs(M).max(), 1e-300):
        doubts.append("added_mass is not symmetric; the vehicle takes the mean of each couple")
    values = added_mass_coefficients(M)
    linear = _matrix(model, "linear_damping", place)
    quadratic = _matrix(model, "quadratic_damping", place)
    forward = _matrix(model, "linear_damping_forward_speed", place)
    for i, j in np.ndindex(6, 6):
        if linear[i, j] != 0.0:
            values[f"{ROWS[i]}_{COLUMNS[j]}"] = float(linear[i, j])
        if quadratic[i, j] != 0.0 and i == j:
            values[f"{ROWS[i]}_{COLUMNS[j] * 2}"] = float(quadratic[i, j])
        elif quadratic[i, j] != 0.0:
            left.append(f"quadratic_damping {ROWS[i]}_{COLUMNS[j] * 2} = {quadratic[i, j]:g}: acts on nothing there")
    for name in COEFFICIENTS:
        kind, i, j = index(name)
        if kind == "forward" and forward[i, j] != 0.0:
            values[name] = float(forward[i, j])
            forward[i, j] = 0.0
    if forward[0, 0] != 0.0:
        values["X_u2"], forward[0, 0] = float(forward[0, 0]), 0.0
        doubts.append("linear_damping_forward_speed of surge: pushes back whichever way it goes, as X_u2 does")
    left += [
        f"linear_damping_forward_speed {ROWS[i]} of {COLUMNS[j]} = {forward[i, j]:g}: no such term in a vehicle"
        for i, j in np.argwhere(forward != 0.0)
    ]
    return values


def _matrix(model: Element, name: str, place: str) -> Array:
    """Return 36 numbers as a matrix, or 6 as its diagonal; zeros where there are none."""
    text = model.findtext(name)
    if text is None:
        return np.zeros((6, 6))
    parts = text.split()
    if len(parts) not in (6, 36):
        raise InputError(f"{place}: {name}: found {len(parts)} numbers, expected 6 or 36")
    values = np.array([number(each, f"{place}: {name}") for each in parts])
    return np.diag(values) if len(parts) == 6 else values.reshape(6, 6)


# -- thrusters


def _thrusters(root: Element, tree: Tree, place: str, left: list[str]) -> tuple[Thruster, ...]:
    found: list[dict[str, Any]] = []
    for plugin in root.iter("plugin"):
        if "thruster" not in plugin.get("filename", ""):
            continue
        name = (plugin.findtext("linkName") or "").strip()
        where = f"{place}: thruster {name[:60]}"
        link = _matching(root, name)
        if link not in tree.frames:
            left.append(f"thruster {name[:60]}: its link hangs on nothing")
            continue
        left += [f"thruster {name}: {each.tag}" for each in plugin if each.tag not in _THRUSTER]
        frame = tree.frames[link]
        joint = (plugin.findtext("jointName") or "").strip()
        along = _axis(root, joint, where)
        if not np.any(along):
            raise InputError(f"{where}: found an axis of length 0, expected a direction")
        direction = frame.R @ along
        curve, sign = _curve(plugin, where, left)
        found.append(
            {
                "name": thruster_name(name.rpartition("/")[2]),
                "position": tuple(turned_vector(frame.p).tolist()),
                "direction": tuple(turned_vector(sign * direction).tolist()),
                "curve": curve,
                "time_constant": _lag(plugin, where, left),
            }
        )
    names = [each["name"] for each in found]
    for k, each in enumerate(found):
        each["name"] = each["name"] if names.count(each["name"]) == 1 else f"{each['name']}_{k + 1}"
    return tuple(Thruster.model_validate(each) for each in found)


def _axis(root: Element, name: str, place: str) -> Array:
    """Return the axis (3,) of a joint, within the link that it turns."""
    joint = next((each for each in root.iter("joint") if each.get("name") == name), None)
    axis = None if joint is None else joint.find("axis")
    if joint is None or axis is None:
        return np.array([1.0, 0.0, 0.0])
    if root.tag == "robot":
        return np.array(numbers(axis.get("xyz", "1 0 0"), 3, f"{place}: axis"))
    placed = joint.findtext("pose")
    R = np.eye(3) if not placed else pose(numbers(placed, 6, f"{place}: joint {name}: pose")).R
    return np.asarray(R @ np.array(numbers(axis.findtext("xyz") or "0 0 1", 3, f"{place}: axis")))


def _lag(plugin: Element, place: str, left: list[str]) -> float:
    dynamics = plugin.find("dynamics")
    kind = "" if dynamics is None else (dynamics.findtext("type") or "").strip()
    if dynamics is None or kind == "ZeroOrder":
        return 0.0
    if kind == "FirstOrder":
        return abs(number(dynamics.findtext("timeConstant"), f"{place}: timeConstant"))
    left.append(f"{place.partition(': ')[2]}: dynamics {kind[:40]}")
    return 0.0


def _curve(plugin: Element, place: str, left: list[str]) -> tuple[object, float]:
    """Return the curve of a thruster, and the sense of its direction."""
    gain = _value(plugin, "gain", 1.0, place) * _value(plugin, "propeller_efficiency", 1.0, place)
    share = _value(plugin, "thrust_efficiency", 1.0, place)
    low, high = _value(plugin, "clampMin", -np.inf, place), _value(plugin, "clampMax", np.inf, place)
    limits = (low, high) if np.isfinite(low) and np.isfinite(high) and low < high and low <= 0.0 <= high else None
    conversion = plugin.find("conversion")
    kind = "Basic" if conversion is None else (conversion.findtext("type") or "").strip()
    if conversion is None or gain == 0.0:
        raise InputError(f"{place}: found no <conversion> or a gain of 0, expected what its command comes to")
    sign = 1.0 if gain > 0.0 else -1.0
    scale = 1.0 / abs(gain)
    if kind == "Basic":
        constant = share * gain * abs(gain) * number(conversion.findtext("rotorConstant"), f"{place}: rotorConstant")
        return QuadraticCurve(forward=abs(constant), limits=limits), 1.0 if constant >= 0.0 else -1.0
    if kind == "Bessa":
        names = ("rotorConstantL", "rotorConstantR", "deltaL", "deltaR")
        k_L, k_R, delta_L, delta_R = (number(conversion.findtext(each), f"{place}: {each}") for each in names)
        ahead, astern = (-k_R * delta_R, 0.0, k_R), (k_L * delta_L, 0.0, k_L)
        curve = PolynomialCurve(
            coefficients=tuple(share * each for each in ahead),
            reverse=tuple(share * each for each in astern),
            scale=scale,
            limits=limits,
        )
        return curve, sign
    if kind == "LinearInterp":
        given, forces = (
            [number(each, f"{place}: {name}") for each in (conversion.findtext(name) or "").split()]
            for name in ("inputValues", "outputValues")
        )
        if len(given) != len(forces) or len(given) < 2 or len(set(given)) != len(given):
            raise InputError(
                f"{place}: found {len(given)} input and {len(forces)} output values, expected as many, rising"
            )
        pairs = sorted(zip(given, forces, strict=True))
        commands, values = [a * scale for a, _ in pairs], [share * b for _, b in pairs]
        return TableCurve(command=tuple(commands), force=tuple(values), limits=limits), sign
    raise InputError(f'{place}: found a conversion "{kind[:40]}", expected Basic, Bessa or LinearInterp')


def _value(plugin: Element, name: str, unsaid: float, place: str) -> float:
    text = plugin.findtext(name)
    return unsaid if text is None else number(text, f"{place}: {name}")
