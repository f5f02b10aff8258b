"""Vehicles as nobody expects them: names that no file takes, curves that turn, forces and masses of any size."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from tests.exporters.whole import whole_vehicle

from towtank.vehicle import Vehicle

BODY: dict[str, Any] = {"mass": 11.5, "inertia": [0.16, 0.2, 0.25]}
DIAGONAL = {
    **{"X_udot": -5.5, "Y_vdot": -12.7, "Z_wdot": -14.57, "K_pdot": -0.12, "M_qdot": -0.13, "N_rdot": -0.14},
    **{"X_u": -4.03, "Y_v": -6.22, "Z_w": -5.18, "K_p": -0.07, "M_q": -0.08, "N_r": -0.09},
    **{"X_uu": -18.18, "Y_vv": -21.66, "Z_ww": -36.99, "K_pp": -1.55, "M_qq": -1.56, "N_rr": -1.57},
}
NAMES = {
    "unicode": "Tauchroboter \u00dc-7 \u6df1\u6d77 \u202e\u0301",
    "signs": 'O\'Brien "x" & <y> */ --> ]]> %{ \\ ${z} ?> #{ \t\r\n \'\'\' """ @name@',
    "no letter": "***",
    "digit": "7th of 9",
    "word": "class",
    "type": "double",
    "library": "numpy",
    "end": "end",
    "long": "a" * 300,
    "path": "../../etc/passwd",
    "format": "%s%d%n",
    "trigraph": "??/ ??=",
    "line": "\u2028 fish \U0001f41f",
    "directive": "#include <x>\n#error",
}
THRUSTER_NAMES = (
    *("for", "lambda", "int", "self", "nu", "u", "end", "True", "no", "on", "null"),
    *("a-b", "a.b", "a_b", "A_B", "1", "007", "1e3", "0x10", "-", "-a", "...", "__", "x" * 200),
)
CURVES: dict[str, dict[str, Any]] = {
    "table of pulses": {"kind": "table", "command": [1100, 1472, 1500, 1528, 1900], "force": [-40, 0, 0, 0, 51]},
    "table falling": {"kind": "table", "command": [-1, 0, 1], "force": [30, 0, -40]},
    "table one way": {"kind": "table", "command": [0, 1], "force": [0, 40.0]},
    "table without rest": {"kind": "table", "command": [0, 1], "force": [3.0, 40.0]},
    "table that turns": {"kind": "table", "command": [-1, -0.5, 0, 0.3, 0.6, 1], "force": [-20, -30, 0, 10, 5, 40.0]},
    "table, dense": {
        "kind": "table",
        "command": np.linspace(-1.0, 1.0, 201).tolist(),
        "force": (40.0 * np.linspace(-1.0, 1.0, 201) ** 3).tolist(),
    },
    "dead band": {"kind": "quadratic", "forward": 0.4, "reverse": 0.3, "dead_band": 3, "limits": [-10, 10]},
    "voltage": {
        **{"kind": "quadratic", "forward": 3e-4, "reverse": 2e-4, "neutral": 1500, "limits": [1100, 1900]},
        "voltage": {"nominal": 16, "exponent": 2, "reverse_exponent": 1.5},
    },
    "without limits": {"kind": "quadratic", "forward": 0.4},
    "one way": {"kind": "polynomial", "coefficients": [0, 30, 10], "odd": False, "limits": [0, 1]},
    "the same both ways": {"kind": "polynomial", "coefficients": [0, 0, 10], "odd": False, "limits": [-1, 1]},
    "turned": {"kind": "quadratic", "forward": -0.4, "limits": [-10, 10]},
    "ninth power": {
        **{"kind": "polynomial", "limits": [-1, 1], "odd": True},
        "coefficients": [0, 8.9, 0, 176.0, 0, -404.1, 0, 389.9, 0, -140.3],
    },
    "half a pulse": {
        **{"kind": "quadratic", "forward": 4e-4, "neutral": 1500.5, "dead_band": 28.4},
        "limits": [1100, 1900],
    },
}
IDLE: dict[str, dict[str, Any]] = {
    "table of zeros": {"kind": "table", "command": [-1, 0, 1], "force": [0, 0, 0]},
    "dead band beyond the limits": {"kind": "quadratic", "forward": 0.4, "dead_band": 30, "limits": [-10, 10]},
}


def thruster(name: str = "only", **changed: Any) -> dict[str, Any]:
    """A thruster askew."""
    curve = {"kind": "quadratic", "forward": 0.5, "limits": [-10, 10]}
    return {
        **{"name": name, "position": [-0.2, 0.1, 0.05], "direction": [1.0, 0.2, -0.3], "curve": curve},
        **changed,
    }


def odd(**changed: Any) -> Vehicle:
    """A plain vehicle with something changed."""
    plain = {"name": "plain", "rigid_body": BODY, "hydrodynamics": DIAGONAL, "thrusters": [thruster()]}
    return Vehicle.model_validate(plain | changed)


def _with(**coefficients: float) -> dict[str, Any]:
    return {"hydrodynamics": DIAGONAL | coefficients}


def _driven(curve: Mapping[str, Any]) -> Vehicle:
    beside = {"position": [0.1, -0.1, 0.2], "direction": [0.0, 0.6, 0.8], "gain": 0.7, "time_constant": 0.2}
    return odd(thrusters=[thruster("a", curve=curve), thruster("b", curve=curve, **beside)])


def _many(count: int) -> list[dict[str, Any]]:
    chance = np.random.default_rng(1)
    return [
        thruster(f"t{k}", position=chance.normal(0.0, 0.3, 3).tolist(), direction=chance.normal(0.0, 1.0, 3).tolist())
        for k in range(count)
    ]


VEHICLES: dict[str, Vehicle] = {
    **{f"name: {key}": odd(name=name) for key, name in NAMES.items()},
    **{f"curve: {key}": _driven(curve) for key, curve in CURVES.items()},
    "whole": whole_vehicle(),
    "in air": odd(hydrodynamics={}, thrusters=[]),
    "without thrusters": odd(thrusters=[]),
    "twenty thrusters": odd(thrusters=_many(20)),
    "names of thrusters": odd(thrusters=[thruster(name) for name in THRUSTER_NAMES]),
    "sinks": odd(
        rigid_body=BODY | {"centre_of_gravity": [0.1, -0.05, 0.2]}, restoring={"W_minus_B": 30.0, "BG_z": 4.0}
    ),
    "rises": odd(buoyancy={"centre": [0.1, 0.02, -0.3]}, restoring={"W_minus_B": -30.0}),
    "without buoyancy": odd(buoyancy={"force": 0.0}),
    "centres apart": odd(
        rigid_body=BODY | {"centre_of_gravity": [0.3, -0.2, 0.4]},
        buoyancy={"force": 100.0, "centre": [-0.3, 0.2, -0.1]},
    ),
    "tiny": odd(
        rigid_body={"mass": 1e-3, "inertia": [1e-8, 2e-8, 2.5e-8]},
        hydrodynamics={"X_u": -1e-7, "X_udot": -1e-9, "Y_vv": -1e-12},
        thrusters=[],
    ),
    "huge": odd(
        rigid_body={"mass": 1e7, "inertia": [1e9, 2e10, 2e10]},
        hydrodynamics={"X_u": -1e7, "X_udot": -1e8, "Y_vv": -1e9},
    ),
    "numbers near zero": odd(**_with(X_v=1e-300, Y_uv=-1e-17, N_v=5e-324)),
    "products of inertia": odd(
        rigid_body={
            "mass": 20.0,
            "inertia": [[0.5, 0.1, -0.2], [0.1, 0.8, 0.15], [-0.2, 0.15, 0.9]],
            "centre_of_gravity": [0.01, 0.02, 0.03],
        }
    ),
    "drag of its own astern": odd(**_with(X_u2=6.0, Y_v2=-3.0, K_p2=0.5)),
    "inflow": odd(**_with(inflow_loss=0.3), thrusters=_many(3)),
    "forward speed": odd(**_with(Y_uv=-8.0, Y_ur=1.5, N_uv=-2.0, N_ur=-3.0, K_up=-0.6, Z_uw=-9.0, M_uq=-2.0)),
    "trimmed": odd(**_with(X_0=1.0, N_0=-0.2)),
    "drag that drives": odd(**_with(X_u=5.0, Y_vv=8.0)),
    "late": odd(command_delay=0.25),
}
