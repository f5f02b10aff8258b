"""What the vehicle of the experiments with changes becomes."""

from __future__ import annotations

from typing import Any

import numpy as np
from experiments import COUPLED_FREE, experiment

from towtank.vehicle import Vehicle

__all__ = ["FREE", "as_stored", "changed_vehicle", "heavier", "payload", "two_kilograms_more"]

FREE = (*COUPLED_FREE, "W_minus_B")


def heavier(truth: Vehicle, masses: tuple[str, ...], drags: tuple[str, ...]) -> Vehicle:
    """Return the vehicle with 2 kg more of some inertias and 30 % more of some drags."""
    return truth.with_coefficients(
        {
            **{name: truth.coefficient(name) - 2.0 for name in masses},
            **{name: 1.3 * truth.coefficient(name) for name in drags},
        }
    )


def two_kilograms_more(truth: Vehicle) -> Vehicle:
    """Return the vehicle with +2 kg in surge, sway and heave, and +30 % of their drags."""
    return heavier(truth, ("X_udot", "Y_vdot", "Z_wdot"), ("X_uu", "Y_vv", "Z_ww"))


def changed_vehicle(kind: str, random: np.random.Generator) -> tuple[Vehicle, str | None]:
    """Return the vehicle after a change of a kind, and the thruster that is to blame, if one is."""
    truth = experiment("coupled-pose").truth
    if kind == "payload":
        return two_kilograms_more(truth), None
    if kind == "ballast":
        return truth.with_coefficients({"W_minus_B": 2.0 * float(random.choice([-1, 1]))}), None
    if kind == "righting":
        return truth.with_coefficients({"BG_z": 0.75 * truth.coefficient("BG_z")}), None
    thrusters = list(truth.thrusters)
    k = int(random.integers(0, len(thrusters)))
    thrusters[k] = thrusters[k].model_copy(update={"gain": 0.6 * thrusters[k].gain})
    return truth.model_copy(update={"thrusters": tuple(thrusters)}), thrusters[k].name


def payload(random: np.random.Generator) -> Vehicle:
    """Return the vehicle with a payload drawn at random."""
    truth = experiment("coupled-pose").truth
    mass, drag = random.uniform(0.5, 5.0), random.uniform(1.0, 1.5, 3)
    turning = 1.0 + 0.03 * mass * random.random(3)
    rigid = np.diag(truth.rigid_body_matrix)
    changes = {name: truth.coefficient(name) - mass for name in ("X_udot", "Y_vdot", "Z_wdot")}
    for k, name in enumerate(("K_pdot", "M_qdot", "N_rdot"), 3):
        total = rigid[k] - truth.coefficient(name)
        changes[name] = rigid[k] - turning[k - 3] * total
    changes |= {name: f * truth.coefficient(name) for name, f in zip(("X_uu", "Y_vv", "Z_ww"), drag, strict=True)}
    changes["W_minus_B"] = random.uniform(-4.0, 4.0)
    changes["BG_z"] = truth.coefficient("BG_z") * random.uniform(0.7, 1.2)
    return truth.with_coefficients(changes)


def as_stored(vehicle: Vehicle, random: np.random.Generator) -> Vehicle:
    """Return a vehicle as it would be in a file once learned: off by its deviations."""
    changes: dict[str, Any] = {}
    for name in FREE:
        value = vehicle.coefficient(name)
        kind = name[1:]
        total = experiment("coupled-pose").quantity(name, value)
        std = 0.1 if name == "W_minus_B" else (0.005 if kind.endswith("dot") or name == "BG_z" else 0.02) * abs(total)
        changes[name] = {"value": value + std * random.standard_normal(), "std": std}
    return vehicle.with_coefficients(changes)
