"""Target `urdf-hydrodynamics`: the URDF element and YAML of blue and auv_controllers (ROS 2).

The element knows a diagonal: of added mass, of damping, and of the inertia, which it takes about the body origin.
Frames are `base_link_fsd` (forward, starboard, down) and `odom_ned`, as in vehicle files: nothing is turned.
Sources: auv_controllers, hydrodynamics and thruster controllers, November 2026.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import lru_cache
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from towtank.core.arrays import Array
from towtank.digits import short
from towtank.exporters.frames import parallel_axes
from towtank.exporters.heading import Heading, at_least
from towtank.exporters.request import Kept, Request, rounded, stem_of, with_plain_buoyancy
from towtank.vehicle import (
    Coefficient,
    Curve,
    RigidBody,
    TableCurve,
    Vehicle,
    configuration_matrix,
    curve_force,
    index,
)
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = ["PLACE", "kept", "written"]

PLACE = "    # {name} at [{position}] m, pushing along [{direction}]"  # in the YAML; an import reads it back
_DEGREE = {True: 9, False: 5}  # of the polynomial, at most: where thrust goes both ways, and where it goes one
_SAMPLES = 401
_DENSE = 33  # points of a table from which on it is taken at its points: that of an import is a polynomial's
_PWM = (1500.0, 400.0)  # us: rest and reach of commands that are not in us themselves
_PULSES = (900.0, 2100.0)  # us: a neutral command within is a pulse
_DIGITS = 4  # decimals [us] to which each power's share at full thrust is rounded
_FLAT = (0.05, 0.3, 1.0)  # least weights of a pulse, of the largest: the more, the less a polynomial turns back
_EXACT = 1e-6  # of the largest thrust: what a polynomial may be off and is still called exact
_WORDS = {"y", "n", "yes", "no", "on", "off", "true", "false", "null"}  # that YAML takes for something else than text


def kept(request: Request) -> Kept:
    """Return what the controllers keep: diagonals, those of forward speed at the speed that is asked for."""
    vehicle = rounded(with_plain_buoyancy(request.vehicle))
    values = {name: Coefficient(value=value) for name, value in _diagonal(vehicle, request.at_speed or 0.0).items()}
    for name, each in values.items():
        std = vehicle.deviation(name)
        if std is not None and each.value == vehicle.coefficient(name):
            values[name] = Coefficient(value=each.value, std=std)
    body = vehicle.rigid_body
    r_G = np.array(body.centre_of_gravity)
    tensor = np.diag(_about_origin(body)) - parallel_axes(body.mass, r_G)
    plain = not np.any(tensor - np.diag(np.diag(tensor)))
    inertia = tuple(np.diag(tensor).tolist()) if plain else tuple(tuple(row) for row in tensor.tolist())
    remarks = []
    if request.at_speed and any(index(name)[0] == "forward" for name in vehicle.hydrodynamics):
        remarks.append(
            f"forward-speed terms: as linear damping at {short(request.at_speed)} m/s, their couplings absent"
        )
    if np.abs(tensor - body.tensor).max() > 1e-9 * np.trace(body.tensor):
        remarks.append("products of inertia about the origin: zero, the controllers fill the upper triangle alone")
    remarks += _remarks(vehicle)
    changes = {
        "hydrodynamics": values,
        "rigid_body": body.model_copy(update={"inertia": inertia}),
        "command_delay": 0.0,
        "thrusters": tuple(each.model_copy(update={"time_constant": 0.0}) for each in vehicle.thrusters),
    }
    return Kept(rounded(vehicle.model_copy(update=changes)), tuple(remarks))


def _about_origin(body: RigidBody) -> Array:
    """Return the moments of inertia (3,) about the body origin, a digit shorter than those about the centre."""
    moments = np.diag(body.tensor + parallel_axes(body.mass, np.array(body.centre_of_gravity)))
    return np.round(moments, 10 - math.floor(math.log10(float(moments.sum()))))


def _diagonal(vehicle: Vehicle, speed: float) -> dict[str, float]:
    values: dict[str, float] = {}
    for k in range(6):
        row, column = ROWS[k], COLUMNS[k]
        along = vehicle.coefficient(f"{row}_u{column}") if k else 0.0
        linear = vehicle.coefficient(f"{row}_{column}") + along * speed
        each = vehicle.coefficient(f"{row}_{column}dot"), linear, vehicle.coefficient(f"{row}_{column * 2}")
        values |= dict(zip((f"{row}_{column}dot", f"{row}_{column}", f"{row}_{column * 2}"), each, strict=True))
    return {name: value for name, value in values.items() if value != 0.0}


def written(request: Request, heading: Heading) -> dict[str, bytes]:
    """Return the URDF, and the controllers' YAML where there are thrusters."""
    keeps = kept(request).vehicle
    files = {f"{stem_of(request.vehicle)}.urdf": _urdf(keeps, stem_of(request.vehicle), heading)}
    if keeps.thrusters:
        files["thrusters.yaml"] = _yaml(request.vehicle, heading)
    return {name: text.encode() for name, text in files.items()}


def _attributes(values: Mapping[str, float]) -> str:
    return " ".join(f'{name}="{float(value) + 0.0!r}"' for name, value in values.items())


def _urdf(vehicle: Vehicle, name: str, heading: Heading) -> str:
    body, diagonal = vehicle.rigid_body, _diagonal(vehicle, 0.0)
    r_G, r_B = (dict(zip("xyz", each, strict=True)) for each in (body.centre_of_gravity, vehicle.buoyancy.centre))
    inertia = {f"i{axis * 2}": value for axis, value in zip("xyz", _about_origin(body), strict=True)}

    def row(tags: tuple[str, ...], suffix: str) -> str:
        names = (f"{ROWS[k]}_{COLUMNS[k] * 2 if suffix == 'square' else COLUMNS[k] + suffix}" for k in range(6))
        return _attributes({tag: diagonal.get(each, 0.0) for tag, each in zip(tags, names, strict=True)})

    added = row(("Xdu", "Ydv", "Zdw", "Kdp", "Mdq", "Ndr"), "dot")
    linear = row(tuple(a + b for a, b in zip(ROWS, COLUMNS, strict=True)), "")
    quadratic = row(tuple(a + b * 2 for a, b in zip(ROWS, COLUMNS, strict=True)), "square")
    return f"""<?xml version="1.0"?>
{heading.xml}<robot name={quoteattr(name)}>
  <hydrodynamics>
    <inertial>
      <mass {_attributes({"value": body.mass})}/>
      <!-- About the body origin, as the controllers use it. -->
      <inertia {_attributes(inertia)} ixy="0.0" ixz="0.0" iyz="0.0"/>
      <center_of_gravity {_attributes(r_G)}/>
      <added_mass {added}/>
    </inertial>
    <damping>
      <linear {linear}/>
      <quadratic {quadratic}/>
    </damping>
    <hydrostatics>
      <buoyancy {_attributes({"value": vehicle.buoyant_force})}/>
      <center_of_buoyancy {_attributes(r_B)}/>
    </hydrostatics>
  </hydrodynamics>
</robot>
"""


# -- thrusters


class _Polynomial(NamedTuple):
    """Thrust [N] to pulse [us], lowest power first, with its ranges and its largest error [N] on the way back."""

    coefficients: tuple[float, ...]
    thrust: tuple[float, float]
    neutral: int
    dead_band: int
    error: float


def _remarks(vehicle: Vehicle) -> list[str]:
    """Return what is lost of the thrusters' curves, a line for all that lose as much."""
    lost: dict[str, list[str]] = {}
    for each in vehicle.thrusters:
        found = _polynomial(each.curve, each.gain)
        if found.error > _EXACT * max(map(abs, found.thrust)):
            lost.setdefault(at_least(found.error, 2), []).append(each.name)
    out = [
        f"curve of {', '.join(names)}: one polynomial of thrust for both ways, up to {error} N off"
        for error, names in lost.items()
    ]
    if any(each.curve.voltage is not None for each in vehicle.thrusters):
        out.append("supply voltage: the thrusters push as at their nominal one")
    return out


@lru_cache(64)  # one export asks thrice for each curve
def _polynomial(curve: Curve, gain: float) -> _Polynomial:
    """Return the polynomial that is least off, of those that rise or fall all the way.

    A higher degree must be worth it. Coefficients are rounded so that a table of its points has the same ones again.
    """
    commands, forces, rest = _samples(curve, gain)
    neutral, dead_band = round(rest), round(_reach(curve) * curve.dead_band)
    thrust = _twelve(min(0.0, float(forces.min()))), _twelve(max(0.0, float(forces.max())))
    driven = _driven(commands, forces, rest)
    best = _Polynomial((float(neutral),), thrust, neutral, dead_band, max(map(abs, thrust)))
    for degree in range(1, min(_DEGREE[min(thrust) < 0.0 < max(thrust)], int(driven.sum()) - 1) + 1):
        for flat in _FLAT:
            found = _fitted(commands[driven], forces[driven], thrust, degree, flat)
            if found is not None and found[1] < best.error - _EXACT * max(map(abs, thrust)):
                best = _Polynomial(found[0], thrust, neutral, dead_band, found[1])
    return best


def _fitted(
    commands: Array, forces: Array, thrust: tuple[float, float], degree: int, flat: float
) -> tuple[tuple[float, ...], float] | None:
    """Return coefficients from thrust to pulse, and the largest error [N] on the way back; None where it turns back.

    A pulse that is wrong weighs by what that is in thrust, the curve's slope, and at least by `flat` of the largest.
    """
    scale = max(map(abs, thrust))
    powers = (forces[:, None] / scale) ** np.arange(degree + 1)
    slopes = np.abs(np.gradient(forces, commands))
    weights = slopes / max(float(slopes.max()), 1e-300) + flat
    solution = np.linalg.lstsq(weights[:, None] * powers, weights * commands, rcond=None)[0]
    shares = np.round(solution, _DIGITS)
    steps = np.diff(np.polynomial.polynomial.polyval(np.linspace(*thrust, _SAMPLES) / scale, shares))
    if not (np.all(steps > 0.0) or np.all(steps < 0.0)):
        return None
    back = np.interp(powers @ shares, commands, forces)
    coefficients = np.trim_zeros(shares / scale ** np.arange(degree + 1), "b")
    return tuple(map(_twelve, coefficients)), float(np.abs(back - forces).max())


def _samples(curve: Curve, gain: float) -> tuple[Array, Array, float]:
    """Return pulses (n,) [us] over a curve's range, the thrust (n,) [N] that each gives, and the pulse at rest."""
    low, high = (curve.rest - 1.0, curve.rest + 1.0) if curve.limits is None else curve.limits
    commands = np.linspace(low, high, _SAMPLES)
    if isinstance(curve, TableCurve):
        ends = curve.command[0], curve.command[-1]
        low, high = ends if curve.limits is None else (max(low, ends[0]), min(high, ends[1]))
        dense = len(curve.command) >= _DENSE
        commands = np.array(curve.command) if dense else np.linspace(low, max(low, high), _SAMPLES)
    forces = np.asarray(curve_force(curve, commands)) * gain
    if _PULSES[0] <= curve.rest <= _PULSES[1]:
        return commands, forces, curve.rest
    return _PWM[0] + _reach(curve) * (commands - curve.rest), forces, _PWM[0]


def _reach(curve: Curve) -> float:
    """Return how many us of a pulse a command of 1 is: the widest command above 1 is full reach."""
    if _PULSES[0] <= curve.rest <= _PULSES[1]:
        return 1.0
    ends = [*(curve.limits or ()), *(curve.command if isinstance(curve, TableCurve) else ())]
    return _PWM[1] / max(1.0, *(abs(float(each) - curve.rest) for each in (curve.rest, *ends)))


def _driven(commands: Array, forces: Array, rest: float) -> NDArray[np.bool_]:
    """Return which samples (n,) serve: those with thrust, for each way on the side of neutral that gives most of it."""
    served = np.zeros(len(forces), dtype=np.bool_)
    for sign in (1.0, -1.0):
        pushing = sign * forces > 0.0
        if np.any(pushing):
            best = commands[np.argmax(sign * forces)]
            served |= pushing & ((commands >= rest) == (best >= rest))
    return served


def _twelve(value: float) -> float:
    return float(f"{float(value) + 0.0:.12g}")


def _float(value: float) -> str:
    """Return a number that YAML and ROS 2 take for one with a point: lists there may not mix it with whole ones."""
    text = repr(float(value) + 0.0)
    return text if "." in text else text.replace("e", ".0e")


def _name(text: str) -> str:
    """Return a name as YAML takes it for text."""
    plain = text.replace("_", "").isalnum() and not text[0].isdigit() and text.lower() not in _WORDS
    return text if plain else f'"{text}"'  # letters, digits, _ . - alone: nothing to escape


def _floats(values: Iterable[float]) -> str:
    return ", ".join(map(_float, values))


def _yaml(vehicle: Vehicle, heading: Heading) -> str:
    T = configuration_matrix(vehicle)
    rows = ("x", "y", "z", "rx", "ry", "rz")
    lines = [
        "thruster_allocation_matrix_controller:",
        "  ros__parameters:",
        f"    thrusters: [{', '.join(_name(each.name) for each in vehicle.thrusters)}]",
        "    tam:",
        *(f"      {row}: [{_floats(map(_twelve, T[k]))}]" for k, row in enumerate(rows)),
        *(
            PLACE.format(name=each.name, position=_floats(each.position), direction=_floats(each.direction))
            for each in vehicle.thrusters
        ),
    ]
    for each in vehicle.thrusters:
        found = _polynomial(each.curve, each.gain)
        lines += [
            "",
            f"{_name(f'{each.name}_controller')}:",
            "  ros__parameters:",
            f"    thruster: {_name(each.name)}",
            f"    thrust_curve_coefficients: [{_floats(found.coefficients)}]  # thrust [N] to pulse [us]",
            f"    min_thrust: {_float(found.thrust[0])}",
            f"    max_thrust: {_float(found.thrust[1])}",
            f"    min_deadband_pwm: {found.neutral - found.dead_band}",
            f"    max_deadband_pwm: {found.neutral + found.dead_band}",
            f"    neutral_pwm: {found.neutral}",
        ]
    return heading.commented("# ") + "\n" + "\n".join(lines) + "\n"
