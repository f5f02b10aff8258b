"""Exported models in MuJoCo beside the simulator: 60 s, Runge-Kutta of 5 ms, all thrusters, in a current.

    make engines        (or: python benchmarks/peers/engines/mujoco_peer.py PYTHON, that of an environment with MuJoCo)

Must hold: positions within 1e-7 m and angles within 1e-7 rad of `simulate` at the same step, for vehicles of the
catalog and one with every kind of term; and a contact carries what presses on it. The same vehicles without the lag of
their thrusters, which the simulator takes exactly and MuJoCo by Runge-Kutta, say how much of the difference that is.
The last column is what the step costs either of them: `simulate` beside itself with eight times as many.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[3]))

from tests.exporters.whole import whole_vehicle

from towtank import export, load_vehicle, simulate
from towtank.vehicle import Vehicle

STEP, SECONDS, BOUND = 0.005, 60.0, 1e-7
VEHICLES = ("bluerov2_heavy", "rexrov", "lauv", "vlbv300", "whole")
CURRENT = (0.3, -0.2, 0.1)
POSE = ("x", "y", "z", "phi", "theta", "psi")


def vehicle_of(name: str, lagged: bool) -> Vehicle:
    """Return a vehicle without delay and, where it is asked for, without the lag of its thrusters."""
    vehicle = whole_vehicle() if name == "whole" else load_vehicle(name)
    thrusters = vehicle.thrusters
    if not lagged:
        thrusters = tuple(each.model_copy(update={"time_constant": 0.0}) for each in thrusters)
    return vehicle.model_copy(update={"command_delay": 0.0, "thrusters": thrusters})


def commands_of(vehicle: Vehicle) -> np.ndarray:
    """Return commands (steps, thrusters) that change every half second, within a third of the limits."""
    chance = np.random.default_rng(8)
    rows = np.empty((round(SECONDS / 0.5), len(vehicle.thrusters)))
    for k, thruster in enumerate(vehicle.thrusters):
        rest = thruster.curve.rest
        low, high = thruster.curve.limits or (rest - 1.0, rest + 1.0)
        rows[:, k] = chance.uniform(rest + (low - rest) / 3.0, rest + (high - rest) / 3.0, len(rows))
    return np.repeat(rows, round(0.5 / STEP), axis=0)


def simulated(vehicle: Vehicle, commands: np.ndarray, substeps: int) -> np.ndarray:
    """Return the poses (steps, 6) of the simulator."""
    run = simulate(vehicle, commands=commands, dt=STEP, current=CURRENT, substeps=substeps)
    return np.column_stack([run[each].values[1:] for each in POSE])


def apart(first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Return the largest difference of positions [m] and of angles [rad], taken round."""
    away = first - second
    away[:, 3:] = np.angle(np.exp(1j * away[:, 3:]))
    return float(np.abs(away[:, :3]).max()), float(np.abs(away[:, 3:]).max())


def main() -> int:
    """Export, let MuJoCo run, compare; return 1 where the bound fails."""
    with tempfile.TemporaryDirectory() as name:
        folder, runs, truth, truncation = Path(name), [], {}, {}
        for vehicle_name in VEHICLES:
            for lagged in (True, False):
                vehicle = vehicle_of(vehicle_name, lagged)
                commands, run = commands_of(vehicle), f"{vehicle_name}{'' if lagged else ' without lag'}"
                export(vehicle, "mujoco", folder / run)
                np.savez(folder / f"{run}_in.npz", commands=commands)
                truth[run] = simulated(vehicle, commands, 1)
                truncation[run] = max(apart(truth[run], simulated(vehicle, commands, 8)))
                pressed = vehicle_name == "bluerov2_heavy"
                runs.append({"name": run, "files": str(folder / run), "current": CURRENT, "pressed": pressed})
        (folder / "runs.json").write_text(json.dumps(runs))
        said = subprocess.run(
            [sys.argv[1], str(Path(__file__).with_name("mujoco_run.py")), name],
            check=True,
            stdout=subprocess.PIPE,
            text=True,
        )
        print(said.stdout.strip())
        print(f"{'':28} {'position [m]':>13} {'angles [rad]':>13} {'step [us]':>10} {'step itself':>12}")
        failed = False
        for run, expected in truth.items():
            found = np.load(folder / f"{run}.npz")
            position, angle = apart(found["poses"], expected)
            print(f"{run:28} {position:13.1e} {angle:13.1e} {1e6 * found['seconds']:10.0f} {truncation[run]:12.1e}")
            failed |= not max(position, angle) <= BOUND
            if not np.isnan(found["contact"]):
                print(f"{'  pressed on the ground':28} {30.0:13.6f} N, the contact carries {found['contact']:.6f} N")
                failed |= not abs(found["contact"] - 30.0) <= 1e-4
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
