"""Calls exported models in CasADi, in an environment that has it and not towtank: python casadi_run.py FOLDER.

Reads NAME.py and NAME_in.npz (x, u, tau, current, voltage, commands, start, dt) of the folder for every name of
runs.json; writes NAME.npz with what the module's functions give for each row.
"""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path

import casadi as ca
import numpy as np


def loaded(path: Path):
    """Return a module that was exported."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def each_row(function: ca.Function, *inputs: np.ndarray) -> np.ndarray:
    """Return the values (n, ...) of a function's first output for rows of its inputs."""
    n = len(inputs[0])
    return np.array([np.array(function(*(each[k] for each in inputs))) for k in range(n)]).reshape(n, -1)


def answered(module, given: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return what the functions give."""
    n = len(given["x"])
    p = np.tile(np.array(module.parameters()).ravel(), (n, 1))
    nu, q = given["x"][:, 7:13], given["x"][:, 3:7]
    out = {
        "M": np.array(module.M(p[0])),
        "forward": each_row(module.forward_dynamics, q, nu, given["tau"], p),
        "inverse": each_row(module.inverse_dynamics, q, nu, given["tau"], p),
        "dynamics": each_row(module.dynamics, given["x"][:, :13], given["tau"], given["current"], p),
        "rate": each_row(module.rate, given["x"], given["u"], given["current"], given["voltage"], p),
        "f": each_row(module.f, given["x"], given["u"]),
        "forces": each_row(module.thruster_forces, given["u"], given["voltage"]),
    }
    slopes = [module.jacobian(x, u) for x, u in zip(given["x"], given["u"], strict=True)]
    out["A"] = np.array([np.array(A) for A, _ in slopes])
    out["B"] = np.array([np.array(B) for _, B in slopes])
    x, states = given["start"], []
    for row in given["commands"]:
        x = np.array(module.step(x, row, given["dt"], given["current"][0], 0.0, p[0])).ravel()
        states.append(x)
    out["states"] = np.array(states)
    return out


if __name__ == "__main__":
    place = Path(sys.argv[1])
    print(f"CasADi {ca.__version__}")
    for name in json.loads((place / "runs.json").read_text()):
        with np.load(place / f"{name}_in.npz") as stored:
            np.savez(place / f"{name}.npz", **answered(loaded(place / f"{name}.py"), dict(stored)))
