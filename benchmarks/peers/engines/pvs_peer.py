"""The Python file in the loop of T. I. Fossen's Python Vehicle Simulator, beside the simulator.

    make engines          (or: python benchmarks/peers/engines/pvs_peer.py [SRC])

SRC is the folder src of a clone of github.com/cybergalactic/PythonVehicleSimulator, which is on no package index; `make
engines PVS=SRC` passes it on. Without it the loop is one of the same form, and that is said.

Must hold: 20 s of each vehicle in a current; its distance from `simulate` halves with the step, as Euler's must.
"""

from __future__ import annotations

import importlib.util
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from towtank import export, load_vehicle, simulate

VEHICLES, STEPS, SECONDS = ("bluerov2_heavy", "lauv", "rexrov"), (0.02, 0.01, 0.005), 20.0
SPEED, DIRECTION = 0.3, 30.0  # of the current [m/s, deg]


def loop(count: int, h: float, vehicle: Any) -> tuple[np.ndarray, np.ndarray]:
    """Go through steps: input, dynamics, the pose by the new velocity; return times (n,), rows [eta nu ..] (n, -)."""
    eta, nu, u_actual, rows = np.zeros(6), vehicle.nu, vehicle.u_actual, []
    for i in range(count + 1):
        u_control = vehicle.stepInput(i * h)
        rows.append(np.concatenate([eta, nu, u_control, u_actual]))
        nu, u_actual = vehicle.dynamics(eta, nu, u_actual, u_control, h)
        (c1, c2, c3), (s1, s2, s3) = np.cos(eta[3:]), np.sin(eta[3:])
        yaw = np.array([[c3, -s3, 0.0], [s3, c3, 0.0], [0.0, 0.0, 1.0]])
        pitch = np.array([[c2, 0.0, s2], [0.0, 1.0, 0.0], [-s2, 0.0, c2]])
        roll = np.array([[1.0, 0.0, 0.0], [0.0, c1, -s1], [0.0, s1, c1]])
        tilt = np.array([[1.0, 0.0, -s2], [0.0, c1, c2 * s1], [0.0, -s1, c2 * c1]])
        eta = eta + h * np.concatenate([yaw @ pitch @ roll @ nu[:3], np.linalg.solve(tilt, nu[3:])])
    return np.arange(count + 1) * h, np.array(rows)


def their_loop(folder: str) -> Callable[[int, float, Any], tuple[np.ndarray, np.ndarray]]:
    """Return the simulator's own loop."""
    sys.path.insert(0, folder)
    from python_vehicle_simulator.lib import simulate as their_simulate

    return their_simulate


def module_of(path: Path) -> ModuleType:
    """Return the exported module."""
    specification = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(specification)
    sys.modules[path.stem] = module
    specification.loader.exec_module(module)
    return module


def main() -> int:
    """Export, go through the loop, compare; return 1 where a bound fails."""
    theirs = len(sys.argv) > 1 and sys.argv[1] != ""
    run_loop = their_loop(sys.argv[1]) if theirs else loop
    print("the Python Vehicle Simulator's own loop" if theirs else "no clone of it is there: a loop of the same form")
    print(f"{'vehicle':20} {'gone, m':>8}" + "".join(f" {f'h = {h:g} s':>12}" for h in STEPS) + f" {'ratio':>6}")
    failed = 0
    direction = np.radians(DIRECTION)
    current = SPEED * np.array([np.cos(direction), np.sin(direction), 0.0])
    for name in VEHICLES:
        vehicle, away = load_vehicle(name), []
        with tempfile.TemporaryDirectory() as folder:
            module = module_of(export(vehicle, "python", Path(folder) / f"{name}.py").files[0])
        for h in STEPS:
            made = getattr(module, name)("stepInput", V_current=SPEED, beta_current=DIRECTION)
            count = round(SECONDS / h)
            _, rows = run_loop(count, h, made)
            commands = np.array([made.stepInput(k * h) for k in range(count)])
            run = simulate(vehicle, commands=commands, dt=h, current=current, delay=0.0)
            path = np.column_stack([run[axis].values for axis in "xyz"])
            away.append(float(np.abs(rows[:, :3] - path).max()))
        ratio = away[-1] / away[-2]
        gone = float(np.linalg.norm(path[-1]))
        print(f"{name:20} {gone:8.1f}" + "".join(f" {each:10.4f} m" for each in away) + f" {ratio:6.3f}")
        failed += not 0.45 < ratio < 0.55 or away[0] > 0.3
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
