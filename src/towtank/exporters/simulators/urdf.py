"""Target `urdf-hydrodynamics`: the URDF element and YAML of blue and auv_controllers (ROS 2).

The element knows a diagonal: of added mass, of damping, and of the inertia, which it takes about the body origin.
Frames are `base_link_fsd` (forward, starboard, down) and `odom_ned`, as in vehicle files: nothing is turned.
Sources: auv_controllers, hydrodynamics and thruster controllers, November 2026.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

import numpy as np

from towtank.core.arrays import Array
from towtank.digits import short
from towtank.exporters.frames import parallel_axes
from towtank.exporters.heading import Heading
from towtank.exporters.request import Kept, Request, rounded, stem_of, with_plain_buoyancy
from towtank.vehicle import Coefficient, RigidBody, Thruster, Vehicle, configuration_matrix, curve_force, index
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = ["kept", "written"]

_DEGREE = 5  # of the polynomial of thrust: one for both ways
_SAMPLES = 401
_PWM = (1500.0, 400.0)  # us: rest and reach of commands that are not in us themselves
_WIDE = 100.0  # commands over a wider range than this are in us


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
    if vehicle.thrusters:
        worst = max(_polynomial(each).error for each in vehicle.thrusters)
        remarks.append(
            f"curves of the thrusters: polynomials of thrust, one for both ways, up to {short(worst, 2)} N off"
        )
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

    coefficients: Array
    thrust: tuple[float, float]
    rest: float
    dead: tuple[float, float]
    error: float


def _polynomial(thruster: Thruster) -> _Polynomial:
    curve = thruster.curve
    low, high = (curve.rest - 1.0, curve.rest + 1.0) if curve.limits is None else curve.limits
    centre, reach = (0.0, 1.0) if high - low > _WIDE else _PWM
    offset = 0.0 if high - low > _WIDE else curve.rest
    commands = np.linspace(low, high, _SAMPLES)
    forces = np.asarray(curve_force(curve, commands)) * thruster.gain
    pulses = centre + reach * (commands - offset)
    driven = forces != 0.0
    if driven.sum() <= _DEGREE:
        rest = centre + reach * (curve.rest - offset)
        return _Polynomial(np.array([rest]), (0.0, 0.0), rest, (rest, rest), 0.0)
    scale = float(np.abs(forces).max())
    powers = (forces[driven, None] / scale) ** np.arange(_DEGREE + 1)
    solution = np.linalg.lstsq(powers, pulses[driven], rcond=None)[0]
    back = np.interp(powers @ solution, pulses, forces)
    rest, band = centre + reach * (curve.rest - offset), reach * curve.dead_band
    return _Polynomial(
        solution / scale ** np.arange(_DEGREE + 1),
        (float(forces.min()), float(forces.max())),
        rest,
        (rest - band, rest + band),
        float(np.abs(back - forces[driven]).max()),
    )


def _yaml(vehicle: Vehicle, heading: Heading) -> str:
    T = configuration_matrix(vehicle)
    rows = ("x", "y", "z", "rx", "ry", "rz")
    names = ", ".join(each.name for each in vehicle.thrusters)
    lines = [
        "thruster_allocation_matrix_controller:",
        "  ros__parameters:",
        f"    thrusters: [{names}]",
        "    tam:",
        *(f"      {row}: [{', '.join(f'{value + 0.0:.12g}' for value in T[k])}]" for k, row in enumerate(rows)),
    ]
    for each in vehicle.thrusters:
        found = _polynomial(each)
        coefficients = ", ".join(f"{value:.12g}" for value in found.coefficients)
        lines += [
            "",
            f"{each.name}_controller:",
            "  ros__parameters:",
            f"    thruster: {each.name}",
            f"    # thrust [N] to pulse [us]; back through the curve at most {short(found.error, 2)} N off",
            f"    thrust_curve_coefficients: [{coefficients}]",
            f"    min_thrust: {found.thrust[0]:.12g}",
            f"    max_thrust: {found.thrust[1]:.12g}",
            f"    min_deadband_pwm: {round(found.dead[0])}",
            f"    max_deadband_pwm: {round(found.dead[1])}",
            f"    neutral_pwm: {round(found.rest)}",
        ]
    return heading.commented("# ") + "\n" + "\n".join(lines) + "\n"
