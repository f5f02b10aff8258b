"""towtank: a towing tank in software.

Feed it what an underwater vehicle is told to do and how it moves; it learns the vehicle's 6-DOF hydrodynamic
model, says how sure it is of every coefficient, and hands the model to simulators and controllers.

The names below are the public interface. Each is imported on first use: `import towtank` alone costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from towtank.app.tasks import inspect, learn, validate
    from towtank.errors import InputError
    from towtank.exporters import export, import_vehicle
    from towtank.identification import Learner, RecursiveLeastSquares
    from towtank.readers import read
    from towtank.recording import Recording
    from towtank.simulation import simulate, simulate_batch
    from towtank.vehicle import (
        Vehicle,
        forward_dynamics,
        inverse_dynamics,
        load_vehicle,
        save_vehicle,
        thruster_wrench,
    )

__all__ = [
    "InputError",
    "Learner",
    "Recording",
    "RecursiveLeastSquares",
    "Vehicle",
    "__version__",
    "export",
    "forward_dynamics",
    "import_vehicle",
    "inspect",
    "inverse_dynamics",
    "learn",
    "load_vehicle",
    "read",
    "save_vehicle",
    "simulate",
    "simulate_batch",
    "thruster_wrench",
    "validate",
]

__version__ = "0.1.0"

_HOMES = {
    "InputError": "errors",
    "Learner": "identification",
    "Recording": "recording",
    "RecursiveLeastSquares": "identification",
    "Vehicle": "vehicle",
    "export": "exporters",
    "forward_dynamics": "vehicle",
    "import_vehicle": "exporters",
    "inspect": "app.tasks",
    "inverse_dynamics": "vehicle",
    "learn": "app.tasks",
    "load_vehicle": "vehicle",
    "read": "readers",
    "save_vehicle": "vehicle",
    "simulate": "simulation",
    "simulate_batch": "simulation",
    "thruster_wrench": "vehicle",
    "validate": "app.tasks",
}


def __getattr__(name: str) -> object:
    """Import a public name on first use (PEP 562) and keep it."""
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(importlib.import_module(f"{__name__}.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, imported or not."""
    return sorted({*globals(), *__all__})
