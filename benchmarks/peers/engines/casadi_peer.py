"""Exported models in CasADi beside the package: dynamics, thrusters, derivatives, and a run.

    make engines        (or: python benchmarks/peers/engines/casadi_peer.py PYTHON, that of an environment with CasADi)

Must hold, for vehicles of the catalog and one with every kind of term: every number within 1e-9 of the largest of its
column. Derivatives are compared with seven-point differences of the package's kernels, which are exact there up to
rounding, since forces are of second degree in the velocity; those by commands only where two widths of the differences
agree, that is off the edges of dead bands, limits and tables.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[3]))

from tests.exporters.reference import derivative, random_full_states, rate_of_commands, rate_of_wrench
from tests.exporters.whole import random_commands, random_states, whole_vehicle

from towtank import export, forward_dynamics, inverse_dynamics, load_vehicle, simulate
from towtank.core.attitude import eulers_from_quaternions
from towtank.vehicle import Vehicle, thruster_forces

STATES, BOUND = 500, 1e-9
VEHICLES = ("bluerov2_heavy", "rexrov", "lauv", "vlbv300", "whole")
CURRENT, DT = np.array([0.3, -0.2, 0.1]), 0.02


def vehicle_of(name: str, lagged: bool = True) -> Vehicle:
    """Return a vehicle without delay and, where it is asked for, without the lag of its thrusters."""
    vehicle = whole_vehicle() if name == "whole" else load_vehicle(name)
    thrusters = vehicle.thrusters
    if not lagged:
        thrusters = tuple(each.model_copy(update={"time_constant": 0.0}) for each in thrusters)
    return vehicle.model_copy(update={"command_delay": 0.0, "thrusters": thrusters})


def given_to(vehicle: Vehicle) -> dict[str, np.ndarray]:
    """Return rows of inputs, and a run from rest."""
    x, _ = random_full_states(vehicle, STATES)
    lagged = x.shape[1] - 13
    return {
        "x": x,
        "u": random_commands(vehicle, STATES, seed=3),
        "tau": random_states(vehicle, STATES).tau,
        "current": np.tile(CURRENT, (STATES, 1)),
        "voltage": np.full(STATES, 14.2),
        "commands": np.repeat(random_commands(vehicle, 20, seed=2), 25, axis=0),
        "start": np.concatenate([np.zeros(3), [1.0, 0.0, 0.0, 0.0], -CURRENT, np.zeros(3 + lagged)]),
        "dt": np.array(DT),
    }


def expected_of(vehicle: Vehicle, given: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return what the package gives for the same rows."""
    x, u, still = given["x"], given["u"], np.zeros((STATES, 3))
    eta = np.hstack([x[:, :3], eulers_from_quaternions(np.ascontiguousarray(x[:, 3:7]))])
    run = simulate(vehicle, commands=given["commands"], dt=DT, current=CURRENT)
    _, steps = random_full_states(vehicle, STATES)
    return {
        "M": vehicle.mass_matrix,
        "forward": forward_dynamics(vehicle, eta, x[:, 7:13], given["tau"]),
        "inverse": inverse_dynamics(vehicle, eta, x[:, 7:13], given["tau"]),
        "dynamics": rate_of_wrench(vehicle, x, given["tau"], given["current"]),
        "rate": rate_of_commands(vehicle, x, u, given["current"], 14.2),
        "f": rate_of_commands(vehicle, x, u, still),
        "forces": thruster_forces(vehicle, u, 14.2),
        "A": derivative(lambda at: rate_of_commands(vehicle, at, u, still), x, steps),
        "states": np.column_stack([run[each].values[1:] for each in "xyzpqr"]),
    }


def by_commands(vehicle: Vehicle, given: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives (n, rows, thrusters) by commands, and where they are smooth."""
    x, u, still = given["x"], given["u"], np.zeros((STATES, 3))
    widths = np.array([np.ptp(u[:, k]) for k in range(u.shape[1])])
    wide, narrow = (
        derivative(lambda at: rate_of_commands(vehicle, x, at, still), u, share * widths) for share in (3e-3, 1e-3)
    )
    scale = np.abs(narrow).max()
    return narrow, np.abs(wide - narrow) <= 1e-10 * scale


def apart(found: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest difference as a share of the largest number of its column; of the row of a derivative."""
    over = (0, 2) if expected.ndim == 3 else (0,)
    scale = np.maximum(np.abs(expected).max(axis=over, keepdims=True), 1e-3)
    return float((np.abs(found - expected) / scale).max())


def main() -> int:
    """Export, let CasADi answer, compare; return 1 where the bound fails."""
    with tempfile.TemporaryDirectory() as name:
        folder, vehicles, given = Path(name), {}, {}
        for vehicle_name in VEHICLES:
            for lagged in (True, False):
                run = f"{vehicle_name}{'' if lagged else '_without_lag'}"
                vehicles[run] = vehicle_of(vehicle_name, lagged)
                given[run] = given_to(vehicles[run])
                export(vehicles[run], "casadi", folder / f"{run}.py")
                np.savez(folder / f"{run}_in.npz", **given[run])
        (folder / "runs.json").write_text(json.dumps(list(vehicles)))
        said = subprocess.run(
            [sys.argv[1], str(Path(__file__).with_name("casadi_run.py")), name],
            check=True,
            stdout=subprocess.PIPE,
            text=True,
        )
        print(said.stdout.strip())
        titles = ("M", "forward", "inverse", "dynamics", "rate", "f", "forces", "A", "B", "states")
        print(f"{'':28}" + "".join(f"{each:>9}" for each in titles) + f"{'B seen':>8}")
        failed = False
        for run, vehicle in vehicles.items():
            found, expected = dict(np.load(folder / f"{run}.npz")), expected_of(vehicle, given[run])
            if found["A"].shape[1] > 13:  # `simulate` takes lags exactly, `step` by Runge-Kutta
                del expected["states"]
            else:
                found["states"] = found["states"][:, [0, 1, 2, 10, 11, 12]]
            away = {each: apart(found[each], value) for each, value in expected.items()}
            slopes, smooth = by_commands(vehicle, given[run])
            away["B"] = apart(np.where(smooth, found["B"], slopes), slopes)
            numbers = "".join(f"{away[each]:9.0e}" if each in away else f"{'':>9}" for each in titles)
            print(f"{run:28}{numbers}{smooth.mean():8.0%}")
            failed |= not max(away.values()) <= BOUND
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
