"""Vehicles and a reference solution for the tests of the simulator.

Orders and small errors are proved with linear damping: u|u| has a kink in its slope where a velocity passes zero, and
there any integration of fourth order falls to the third.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from towtank.core.attitude import euler_rates_matrix, rotation_from_euler
from towtank.vehicle import QuadraticCurve, Thruster, Vehicle, forward_dynamics

COUPLED = {
    "X_udot": -8.0, "Y_vdot": -12.0, "Z_wdot": -15.0, "K_pdot": -0.2, "M_qdot": -0.3, "N_rdot": -0.25, "Y_rdot": 0.3,
    "X_u": -4.0, "Y_v": -6.0, "Z_w": -5.0, "K_p": -0.3, "M_q": -0.3, "N_r": -0.2,
    "X_uu": -30.0, "Y_vv": -60.0, "Z_ww": -70.0, "K_pp": -1.0, "M_qq": -1.0, "N_rr": -0.8,
}  # fmt: skip

_INSIDE = 1e-10  # s: an interval is integrated just short of the switches at its ends

LINEAR = {name: value for name, value in COUPLED.items() if name[2:] not in ("uu", "vv", "ww", "pp", "qq", "rr")}


def thruster(name: str, position: Sequence[float], direction: Sequence[float], lag: float = 0.0) -> Thruster:
    curve = QuadraticCurve(forward=0.01, reverse=0.008, dead_band=4.0, limits=(-100.0, 100.0))
    return Thruster(name=name, position=position, direction=direction, curve=curve, time_constant=lag)


def vessel(*, lags: Sequence[float] = (0.0,) * 6, delay: float = 0.0, **more: Any) -> Vehicle:
    """A small ROV with six thrusters that command all but pitch, and its centre of buoyancy 3 cm above the other."""
    c, h = np.cos(np.pi / 4.0), 0.2
    places = [(-h, -h, 0.0), (-h, h, 0.0), (h, -h, 0.0), (h, h, 0.0), (0.0, -h, 0.0), (0.0, h, 0.0)]
    ways = [(c, -c, 0.0), (c, c, 0.0), (c, c, 0.0), (c, -c, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 1.0)]
    names = ("ap", "as", "fp", "fs", "vp", "vs")
    fields: dict[str, Any] = {
        "name": "vessel",
        "rigid_body": {"mass": 12.0, "inertia": (0.2, 0.3, 0.35)},
        "buoyancy": {"centre": (0.0, 0.0, -0.03)},
        "hydrodynamics": COUPLED,
        "thrusters": tuple(thruster(*parts) for parts in zip(names, places, ways, lags, strict=True)),
        "command_delay": delay,
    }
    return Vehicle(**{**fields, **more})


def reference(vehicle: Vehicle, wrench: Callable[[float], np.ndarray], times: Any, start: np.ndarray) -> np.ndarray:
    """Pose and velocity (len(times), 12) by DOP853 in Euler angles, restarted at every one of `times`."""

    def rate(t: float, s: np.ndarray) -> np.ndarray:
        phi, theta, psi = s[3:6]
        position = rotation_from_euler(phi, theta, psi) @ s[6:9]
        angles = euler_rates_matrix(phi, theta) @ s[9:12]
        return np.concatenate([position, angles, forward_dynamics(vehicle, s[:6], s[6:], wrench(t))])

    found = [np.array(start)]
    for a, b in pairwise(times):
        solution = solve_ivp(rate, (a + _INSIDE, b - _INSIDE), found[-1], method="DOP853", rtol=1e-11, atol=1e-12)
        found.append(solution.y[:, -1])
    return np.array(found)


def table(run: Any, names: Sequence[str] = ("x", "y", "z", "phi", "theta", "psi", "u", "v", "w", "p", "q", "r")) -> Any:
    """The channels of a recording side by side (n, len(names))."""
    return np.column_stack([run[name].values for name in names])
