"""Target `mujoco`: a body with its thrusters in MJCF, and a NumPy module for what MJCF cannot say.

MuJoCo knows neither added mass nor damping of matrices. The module's callback adds the one to MuJoCo's mass matrix,
which is its own copy in every stage, and the other as a force. Everything is written in the frame of MuJoCo, forward,
port, up: the turn stands here, once.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from towtank.core.arrays import Array
from towtank.core.inertia import rigid_body_mass
from towtank.exporters.frames import turned_matrix, turned_vector
from towtank.exporters.heading import Heading
from towtank.exporters.programs.c99 import prefix_of
from towtank.exporters.python_text import matrix, number, row, thrusters_text
from towtank.exporters.request import Kept, Request, with_plain_buoyancy
from towtank.exporters.templates import filled, template
from towtank.vehicle import Thruster, Vehicle, configuration_matrix, force_range
from towtank.vehicle.matrices import GRAVITY, damping_matrices, matrix_of
from towtank.vehicle.names import COLUMNS, ROWS

__all__ = ["kept", "written"]

_FLOAT = 1e-6  # of the mass, in the body that lifts at the centre of buoyancy
_FLOAT_RADIUS = 0.1  # m, of gyration
_SMALLEST = 0.1  # m, half side of the box that is drawn
_BARE = (
    "model.xml by itself: added mass, damping, forces that depend on speed, constant forces, currents, thruster curves"
    " and loss of thrust with inflow; all of them are there once towtank_mujoco.install was called"
)


class _Float(NamedTuple):
    """A light body at the centre of buoyancy whose weight is compensated by far more: mass [kg], centre (3,), share.

    It has no joint. With it MuJoCo keeps the whole block of the hull's mass matrix, of which it would otherwise leave
    out what is zero by symmetry, and with it the place for added mass.
    """

    mass: float
    centre: Array
    share: float

    @property
    def inertia(self) -> float:
        """Each of its moments of inertia [kg m^2]."""
        return self.mass * _FLOAT_RADIUS**2


class _Body(NamedTuple):
    """The rigid body as model.xml has it, in FLU: mass [kg], centre (3,), inertia about it (3, 3), what lifts it."""

    mass: float
    centre: Array
    inertia: Array
    light: _Float


def kept(request: Request) -> Kept:
    """Return what module and MJCF keep together: all but the delay of the commands."""
    vehicle = request.vehicle
    remarks = [_BARE]
    if _float(vehicle).share == 0.0:
        remarks.append("model.xml by itself: buoyancy and righting moment, for which it has no centre")
    tensor = vehicle.rigid_body.tensor
    if not np.array_equal(_realisable(tensor), tensor):
        remarks.append(
            "model.xml by itself: the moments of inertia, of which one is above the sum of the others; it has the"
            " nearest that MuJoCo takes"
        )
    return Kept(vehicle.model_copy(update={"command_delay": 0.0}), tuple(remarks))


def written(request: Request, heading: Heading) -> dict[str, bytes]:
    """Return the MJCF and the module."""
    vehicle = request.vehicle
    body = _body(vehicle)
    return {
        "model.xml": (heading.xml + _mjcf(vehicle, body)).encode(),
        "towtank_mujoco.py": _module(vehicle, body, heading).encode(),
    }


def _body(vehicle: Vehicle) -> _Body:
    rigid = vehicle.rigid_body
    inertia = turned_matrix(_realisable(rigid.tensor))
    return _Body(rigid.mass, turned_vector(rigid.centre_of_gravity), inertia, _float(vehicle))


def _float(vehicle: Vehicle) -> _Float:
    """Return what lifts the body; it lifts nothing where no centre of buoyancy could do."""
    force = vehicle.weight - vehicle.weight_minus_buoyancy
    mass = _FLOAT * vehicle.rigid_body.mass
    if force <= 0.0:
        return _Float(mass, np.zeros(3), 0.0)
    centre = turned_vector(with_plain_buoyancy(vehicle).buoyancy.centre)
    return _Float(mass, centre, (force / GRAVITY + mass) / mass)


def _realisable(tensor: Array) -> Array:
    """Return an inertia (3, 3) whose largest moment is at most the sum of the others, as MuJoCo demands.

    One that is so already is returned itself. The others are raised by as much as is missing.
    """
    moments, axes = np.linalg.eigh(tensor)
    short = moments[2] - moments[0] - moments[1]
    if short <= 1e-12 * moments[2] and moments[0] > 0.0:
        return tensor
    least = 1e-3 * moments[2]
    raised = np.maximum(moments, least)
    raised[:2] += max(raised[2] - raised[0] - raised[1], 0.0) * 0.5 * (1.0 + 1e-9)
    return np.asarray(axes @ np.diag(raised) @ axes.T)


# -- MJCF


def _mjcf(vehicle: Vehicle, body: _Body) -> str:
    I = body.inertia
    places = np.array([[_SMALLEST] * 3, *(np.abs(each.position) for each in vehicle.thrusters)])
    values = {
        "body": prefix_of(vehicle),
        "centre": _words(body.centre),
        "mass": number(body.mass),
        "inertia": _words([I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]]),
        "size": _words(np.round(places.max(axis=0), 3)),
        "sites": "\n".join(_site(each) for each in vehicle.thrusters),
        "float": _float_body(prefix_of(vehicle), body.light),
        "actuators": _actuators(vehicle),
    }
    text = filled(template("model.mjcf"), values)
    return "".join(f"{line}\n" for line in text.splitlines() if line.strip())


def _words(values: object) -> str:
    return " ".join(number(each) for each in np.asarray(values, dtype=np.float64))


def _site(thruster: Thruster) -> str:
    return f'      <site name="{thruster.name}" pos="{_words(turned_vector(thruster.position))}" size="0.02"/>'


def _float_body(name: str, light: _Float) -> str:
    moment = number(light.inertia)
    return (
        "      <!-- Lifts at the centre of buoyancy: a millionth of the mass, and all of the buoyancy. -->\n"
        f'      <body name="{name}_float" gravcomp="{number(light.share)}">\n'
        f'        <inertial pos="{_words(light.centre)}" mass="{number(light.mass)}"'
        f' diaginertia="{moment} {moment} {moment}"/>\n'
        "      </body>"
    )


def _actuators(vehicle: Vehicle) -> str:
    if not vehicle.thrusters:
        return ""
    lines = ["  <!-- ctrl is the steady force [N] of a thruster; towtank_mujoco.py makes it of commands. -->"]
    return "\n".join([*lines, "  <actuator>", *(_actuator(each) for each in vehicle.thrusters), "  </actuator>"])


def _actuator(thruster: Thruster) -> str:
    """Return the actuator of a thruster; what is limited by the supply voltage has a range, but is not clamped."""
    low, high = (each * thruster.gain for each in force_range(thruster.curve))
    ranged = np.isfinite([low, high]).all() and low < high
    limits = f' ctrlrange="{number(low)} {number(high)}"' if ranged else ""
    limits += f' ctrllimited="{"true" if ranged and thruster.curve.voltage is None else "false"}"'
    lag = f' dyntype="filter" dynprm="{number(thruster.time_constant)}"' if thruster.time_constant > 0.0 else ""
    gear = f"{_words(turned_vector(thruster.direction))} 0 0 0"
    return f'    <general name="{thruster.name}" site="{thruster.name}" gear="{gear}"{lag}{limits}/>'


# -- the module


def _module(vehicle: Vehicle, body: _Body, heading: Heading) -> str:
    values = {name: each.value for name, each in vehicle.hydrodynamics.items()}
    linear, quadratic = damping_matrices(values)
    light = body.light
    rigid = rigid_body_mass(body.mass, body.centre, body.inertia)
    rigid = rigid + rigid_body_mass(light.mass, light.centre, light.inertia * np.eye(3))
    lifted = light.mass * light.share
    columns = configuration_matrix(vehicle)
    texts = {
        "heading": heading.commented("# ").rstrip(),
        "vehicle": prefix_of(vehicle),
        "body": prefix_of(vehicle),
        "added": matrix(turned_matrix(vehicle.mass_matrix) - rigid),
        "linear": matrix(turned_matrix(linear)),
        "quadratic": matrix(turned_matrix(quadratic)),
        "forward": matrix(turned_matrix(matrix_of("forward", values))),
        "asymmetry": row(turned_vector([vehicle.coefficient(f"{i}_{j}2") for i, j in zip(ROWS, COLUMNS, strict=True)])),
        "constant": row(turned_vector([vehicle.coefficient(f"{axis}_0") for axis in ROWS])),
        "weight": number(vehicle.weight_minus_buoyancy),
        "moment": row(turned_vector(vehicle.restoring_moment)),
        "inflow": number(vehicle.coefficient("inflow_loss")),
        "heavy": number(body.mass + light.mass),
        "heavy_moment": row(body.mass * body.centre + light.mass * light.centre),
        "lifted": number(lifted),
        "lifted_moment": row(lifted * light.centre),
        "configuration": matrix(np.array([turned_vector(each) for each in columns.T]).reshape(-1, 6).T),
        "thrusters": thrusters_text(vehicle),
    }
    return filled(template("mujoco_module.py.in"), texts)
