"""Target `casadi`: the model as functions of CasADi in one Python module, parameters by SNAME names.

The code is a template (`templates/casadi_module.py.in`) that builds its matrices of the names themselves; here
stand the numbers that go into it.
"""

from __future__ import annotations

import numpy as np

from towtank.exporters.heading import Heading
from towtank.exporters.programs.c99 import prefix_of, unit_of_field, values_of
from towtank.exporters.python_text import matrix, number, thrusters_text
from towtank.exporters.request import Kept, Request
from towtank.exporters.templates import filled, template
from towtank.vehicle import Vehicle, configuration_matrix

__all__ = ["kept", "written"]

_FORCES = """
    thruster_forces(u, voltage)            steady forces [N] of commands, curves with limits, dead band and gain
    wrench_of_forces(nu, forces, p)        wrench of thrusters' forces, loss of thrust with inflow included"""


def kept(request: Request) -> Kept:
    """Return what the module keeps: all but the delay of the commands."""
    return Kept(request.vehicle.model_copy(update={"command_delay": 0.0}))


def written(request: Request, heading: Heading) -> dict[str, bytes]:
    """Return the module."""
    vehicle = request.vehicle
    values = {
        "heading": heading.commented("# ").rstrip(),
        "vehicle": prefix_of(vehicle),
        "state": _state(vehicle),
        "listed": _FORCES if vehicle.thrusters else "",
        "defaults": "\n".join(_default(name, value) for name, value in values_of(vehicle).items()),
        "configuration": matrix(configuration_matrix(vehicle) if vehicle.thrusters else np.zeros((6, 0))),
        "thrusters": thrusters_text(vehicle),
    }
    return {"model.py": filled(template("casadi_module.py.in"), values).encode()}


def _default(name: str, value: float) -> str:
    return f'    "{name}": {number(value)},  # {unit_of_field(name)}'


def _state(vehicle: Vehicle) -> str:
    """Return what inputs are, and what follows the 13 numbers of a state."""
    if not vehicle.thrusters:
        return "The input u is the wrench [X Y Z K M N] [N, N m]."
    said = f"The input u holds the commands of the thrusters: {', '.join(each.name for each in vehicle.thrusters)}."
    lagged = [each.name for each in vehicle.thrusters if each.time_constant > 0.0]
    if lagged:
        said += f"\nAfter the 13 numbers come the forces [N] in force of those with a lag: {', '.join(lagged)}."
    return said
