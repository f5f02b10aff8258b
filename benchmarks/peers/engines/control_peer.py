"""The linear model in python-control, beside the simulator.

    make engines          (or: python benchmarks/peers/engines/control_peer.py PYTHON, that of an environment with it)

Must hold: python-control has the file's matrices and names; its response to small steps of the inputs comes nearer to
`simulate` with the square of the step, as a model of first order must; its poles are the matrix's eigenvalues.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from towtank import export, load_vehicle, simulate
from towtank.exporters.programs.matrices import STATES, linearised
from towtank.vehicle import Vehicle, configuration_matrix

STEP, SECONDS = 0.005, 3.0
PLANTS = {"bluerov2_heavy": 0.5, "rexrov": 0.5, "lauv": 1.5, "vlbv300": 0.0}
SHARES = (1e-3, 5e-4)  # of the weight, as a step of the wrench
INSIDE = """
import importlib.util, json, sys
from pathlib import Path
import control, numpy as np
folder = Path(sys.argv[1])
said = {}
for each in json.loads((folder / "plants.json").read_text()):
    spec = importlib.util.spec_from_file_location(each["name"], each["file"])
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    plant, pushed = module.state_space(), module.state_space("wrench")
    t = np.arange(each["steps"] + 1) * each["step"]
    out = []
    for tau in each["wrenches"]:
        response = control.forced_response(pushed, T=t, U=np.tile(np.array(tau)[:, None], len(t)))
        out.append(response.outputs)
    np.savez(folder / (each["name"] + ".npz"), A=plant.A, B=plant.B, outputs=np.array(out), poles=pushed.poles())
    rank = int(np.linalg.matrix_rank(control.ctrb(plant.A[6:, 6:], plant.B[6:])))
    said[each["name"]] = {"states": plant.state_labels, "inputs": plant.input_labels, "rank": rank,
                          "version": control.__version__}
(folder / "said.json").write_text(json.dumps(said))
"""


def wrenches_of(vehicle: Vehicle) -> list[list[float]]:
    """Return steps of the wrench, one direction at two sizes: forces and moments that the thrusters can make."""
    B = configuration_matrix(vehicle)
    way = B @ np.random.default_rng(5).uniform(-1.0, 1.0, B.shape[1])
    return [(share * vehicle.weight * way / np.linalg.norm(way)).tolist() for share in SHARES]


def nonlinear(vehicle: Vehicle, speed: float, tau: list[float]) -> np.ndarray:
    """Return the deviation (12, steps + 1) from the trim, by the simulator."""
    trim = linearised(vehicle, speed)
    steps = round(SECONDS / STEP)
    run = simulate(
        vehicle, wrench=np.tile(trim.wrench + tau, (steps, 1)), dt=STEP, nu0=[speed, 0, 0, 0, 0, 0], delay=0.0
    )
    found = np.array([run[name].values for name in STATES])
    found[0] -= speed * run["x"].t
    found[6] -= speed
    return found


def main() -> int:
    """Export, let python-control respond, compare; return 1 where a bound fails."""
    python, failed = sys.argv[1], 0
    with tempfile.TemporaryDirectory() as place:
        folder, plants = Path(place), []
        for name, speed in PLANTS.items():
            file = export(name, "state-space", folder / f"{name}.py", at_speed=speed).files[0]
            wrenches = wrenches_of(load_vehicle(name))
            numbers = {"step": STEP, "steps": round(SECONDS / STEP), "wrenches": wrenches}
            plants.append({"name": name, "file": str(file), **numbers})
        folder.joinpath("plants.json").write_text(json.dumps(plants))
        subprocess.run([python, "-c", INSIDE, str(folder)], check=True, stdout=sys.stderr)
        said = json.loads(folder.joinpath("said.json").read_text())
        print(f"python-control {next(iter(said.values()))['version']}, steps of {SECONDS:g} s")
        print(f"{'plant':20} {'u0, m/s':>8} {'A, B':>10} {'away':>10} {'by the half':>12} {'controllable':>13}")
        for plant in plants:
            name, speed = plant["name"], PLANTS[plant["name"]]
            vehicle, found = load_vehicle(name), np.load(folder / f"{name}.npz")
            trim = linearised(vehicle, speed)
            same = max(np.abs(found["A"] - trim.A).max(), np.abs(found["B"] - trim.B).max())
            away = [
                np.abs(out - nonlinear(vehicle, speed, tau)).max() / np.abs(out).max()
                for out, tau in zip(found["outputs"], plant["wrenches"], strict=True)
            ]
            poles = np.sort_complex(np.linalg.eigvals(trim.A_wrench))
            spread = np.abs(np.poly(found["poles"]) - np.poly(poles)).max() / np.abs(np.poly(poles)).max()
            ratio = away[1] / away[0]
            print(f"{name:20} {speed:8g} {same:10.1e} {away[1]:10.1e} {ratio:12.3f} {said[name]['rank']:11d}/6")
            failed += same > 1e-12 or spread > 1e-6 or not 0.4 < ratio < 0.6 or away[1] > 0.1
            failed += said[name]["states"] != list(STATES) or len(said[name]["inputs"]) != len(vehicle.thrusters)
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
