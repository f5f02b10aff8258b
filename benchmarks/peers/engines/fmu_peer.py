"""Functional mock-up units by independent masters beside the simulator: FMPy and Ecos, and for FMI 2.0 libcosim.

    make engines          (or: python benchmarks/peers/engines/fmu_peer.py PYTHON, that of an environment with all)

Must hold: validation finds nothing; the masters agree to 1e-12, and each with `simulate` to 1e-9 at the same step.
"""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from towtank import export, load_vehicle, simulate
from towtank.vehicle import Vehicle

STEP, SECONDS = 0.01, 20.0
VEHICLES, VERSIONS = ("bluerov2_heavy", "rexrov", "lauv"), ("2.0", "3.0")
MASTERS = ("FMPy", "Ecos", "libcosim")
CURRENT = {"current_north": 0.3, "current_east": -0.2, "current_down": 0.1}
OUTPUTS = ("x", "y", "z", "phi", "theta", "psi", "u", "v", "w", "p", "q", "r")


def commands_of(vehicle: Vehicle) -> np.ndarray:
    """Return commands (steps, thrusters) that change every half second, within a third of the limits."""
    chance = np.random.default_rng(8)
    rows = np.empty((round(SECONDS / 0.5), len(vehicle.thrusters)))
    for k, thruster in enumerate(vehicle.thrusters):
        low, high = thruster.curve.limits or (thruster.curve.rest - 1.0, thruster.curve.rest + 1.0)
        rest = thruster.curve.rest
        rows[:, k] = chance.uniform(rest + (low - rest) / 3.0, rest + (high - rest) / 3.0, len(rows))
    return np.repeat(rows, round(0.5 / STEP), axis=0)


def main() -> int:
    """Export, let the masters run, compare; return 1 where a bound fails."""
    python = sys.argv[1]
    with tempfile.TemporaryDirectory() as name:
        folder, runs, truth = Path(name), [], {}
        for vehicle_name in VEHICLES:
            vehicle = load_vehicle(vehicle_name).model_copy(update={"command_delay": 0.0})
            commands = commands_of(vehicle)
            run = simulate(vehicle, commands=commands, dt=STEP, current=tuple(CURRENT.values()))
            for version in VERSIONS:
                unit = export(
                    vehicle, "fmu", folder / f"{vehicle_name}_{version[0]}.fmu", target_version=version
                ).files[0]
                truth[unit.stem] = np.column_stack([run[each].values[1:] for each in OUTPUTS])
                given = {f"cmd_{each.name}": commands[:, k].tolist() for k, each in enumerate(vehicle.thrusters)}
                runs.append(
                    {
                        "name": unit.stem,
                        "unit": str(unit),
                        "version": version,
                        "step": STEP,
                        "commands": given,
                        "start": CURRENT,
                        "outputs": OUTPUTS,
                    }
                )
        (folder / "runs.json").write_text(json.dumps(runs))
        subprocess.run([python, str(Path(__file__).with_name("fmu_master.py")), name], check=True, stdout=sys.stderr)
        said = json.loads((folder / "said.json").read_text())
        failed = 0
        print(f"{'unit':20} {'validation':20} {' '.join(f'{each} - simulate'.rjust(19) for each in MASTERS)}     apart")
        for unit_name, expected in truth.items():
            with np.load(folder / f"{unit_name}.npz") as found:
                motions = {master: found[master] for master in MASTERS if master in found}
            away = {master: apart(motion, expected) for master, motion in motions.items()}
            between = max(apart(one, other) for one, other in itertools.combinations(motions.values(), 2))
            words = "; ".join(said[unit_name]) or "No problems found"
            each = (f"{away[master]:.1e}" if master in away else "knows FMI 2.0 only" for master in MASTERS)
            print(f"{unit_name:20} {words:20} {' '.join(text.rjust(19) for text in each)} {between:9.1e}")
            failed += bool(said[unit_name]) or not max(away.values()) <= 1e-9 or not between <= 1e-12
    return int(failed > 0)


def apart(first: np.ndarray, second: np.ndarray) -> float:
    """Return the largest difference, angles taken round."""
    away = first - second
    away[:, 3:6] = np.angle(np.exp(1j * away[:, 3:6]))
    return float(np.abs(away).max())


if __name__ == "__main__":
    sys.exit(main())
