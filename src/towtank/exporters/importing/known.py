"""What is known or looks to be wrong in public models: numbers by which they are recognised, and signs.

The numbers were read in the models' files; where each comes from stands with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from towtank.digits import short
from towtank.vehicle import Vehicle, index
from towtank.vehicle.matrices import damping_matrices

__all__ = ["doubts_of"]

_CLOSE = 2e-3  # relative


class _Known(NamedTuple):
    values: Mapping[str, float]
    words: str


_KNOWN = (
    _Known(
        {"X_udot": -1.7182, "Z_wdot": -5.468, "M_qdot": -1.2481, "N_rdot": -0.4006},
        "added mass is that of the Desistek SAGA (uuvsimulator/desistek_saga), whose sway and roll are zero, whatever"
        " vehicle the file names",
    ),
    _Known(
        {"X_u": -11.7391, "Y_v": -20.0, "Z_w": -31.8678, "K_p": -25.0, "M_q": -44.9085, "N_r": -5.0},
        "damping is that of the Desistek SAGA (uuvsimulator/desistek_saga), whatever vehicle the file names",
    ),
    _Known(
        {"X_uu": -33.732, "Y_vv": -54.16, "Z_ww": -73.225},
        "drag of bluerov2_gz: estimated from the frontal area of a box, moments made up; added mass is left out there",
    ),
    _Known(
        {"X_uu": -58.42, "Y_vv": -55.137, "Z_ww": -124.818},
        "drag of the heavy frame in bluerov2_gz and blue: estimated from the frontal area of a box, moments made up;"
        " added mass is left out there",
    ),
    _Known(
        {"X_udot": -779.79, "Y_vdot": -1222.0, "Z_wdot": -3659.9},
        "added mass of RexROV (Berg 2012): Z_rdot and N_wdot differ in the last digit there, 10.774 and 10.775",
    ),
    _Known(
        {"X_udot": -8.10, "Y_vdot": -12.69, "Z_wdot": -38.02},
        "added mass is RexROV's times 0.01039 (seabotix_alpha), not this vehicle's",
    ),
    _Known(
        {"X_udot": -5.5, "Y_vdot": -12.7, "Z_wdot": -14.57, "K_pdot": -0.12},
        "the BlueROV2 Heavy of Wu (2018): its drag is five to ten times below von Benzon's (2022); do not mix them",
    ),
    _Known(
        {"X_udot": -2.6, "Y_vdot": -18.5, "Z_wdot": -13.3},
        "the BlueROV2 of ViktorNfa: its author notes that the signs of X_udot and Y_vdot were wrong in the experiments",
    ),
    _Known(
        {"X_udot": -19.519, "Z_wdot": -21.3776},
        "the vLBV300 as its makers of the model print it: Y_vdot positive and Y_vv six times below surge, row suspect",
    ),
    _Known(
        {"X_udot": -27.08, "Y_vdot": -25.952, "Z_wdot": -68.576},
        "the Seamor of Chen: added inertia of 62 and 79 kg m^2 in roll and pitch is not plausible for 20 kg",
    ),
    _Known(
        {"X_udot": -1.0, "Y_vdot": -16.0, "Z_wdot": -16.0, "M_qdot": -1.3},
        "the LAUV of uuv_simulator: couplings of its quadratic damping stand in the file and act on nothing there",
    ),
)


def doubts_of(vehicle: Vehicle) -> list[str]:
    """Return a line for what is known or looks to be wrong about the coefficients of an imported vehicle."""
    found = [each.words for each in _KNOWN if _is(vehicle, each.values)]
    for name, each in vehicle.hydrodynamics.items():
        kind, i, j = index(name)
        if i == j and kind in ("mass", "linear", "quadratic") and each.value > 0.0:
            does = "a negative added mass" if kind == "mass" else "drag that drives"
            found.append(f"{name} = {short(each.value, 6)}: positive, {does}; a sign turned in the file?")
    found += _without_damping(vehicle)
    M = vehicle.added_mass_matrix
    if not np.any(M):
        found.append("no added mass: this vehicle accelerates as in air")
    elif np.all(np.diag(M) >= 0.0):
        scale = np.sqrt(np.where(np.diag(M) > 0.0, np.diag(M), 1.0))
        if np.linalg.eigvalsh(M / np.outer(scale, scale))[0] < -1e-9:
            found.append("couplings of added mass are larger than a flow around a body allows")
    return found


def _is(vehicle: Vehicle, values: Mapping[str, float]) -> bool:
    return all(abs(vehicle.coefficient(name) - value) <= _CLOSE * abs(value) for name, value in values.items())


def _without_damping(vehicle: Vehicle) -> list[str]:
    linear, quadratic = damping_matrices({name: each.value for name, each in vehicle.hydrodynamics.items()})
    bare = [
        word
        for i, word in enumerate(("surge", "sway", "heave", "roll", "pitch", "yaw"))
        if linear[i, i] == 0.0 and quadratic[i, i] == 0.0
    ]
    return [f"no damping of {', '.join(bare)}"] if bare else []
