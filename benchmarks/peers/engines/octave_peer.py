"""The function file of MSS and the .mat file in GNU Octave, beside the package, for every vehicle of the catalog.

    make engines          (or: python benchmarks/peers/engines/octave_peer.py)

Must hold: rates over random states with thrusters, current and supply voltage within 1e-9; the .mat file's matrices the
same bits; 20 s by a Runge-Kutta loop in Octave, with current and lagging thrusters, within 1e-5 of `simulate`, whose
lag is exact where the loop's is of fourth order.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from scipy.io import loadmat, savemat

from towtank import export, forward_dynamics, load_vehicle, simulate
from towtank.core.attitude import euler_rates_matrix, quaternions_from_eulers, rotation_from_euler
from towtank.exporters.programs.matrices import linearised
from towtank.exporters.programs.mss import matrices_of
from towtank.exporters.programs.python_file import commands_ahead
from towtank.exporters.request import speed_range
from towtank.vehicle import Vehicle, catalog_names, configuration_matrix, thruster_forces

STATES, STEP, SECONDS = 500, 0.01, 20.0
DRIVEN = ("bluerov2_heavy", "lauv", "rexrov")
VC, BETA, WC, VOLTAGE, SPEED = 0.3, 0.7, 0.1, 15.0, 0.5
RATES = """
load('given.mat');
n = rows(X);
found = zeros(n, 12);
for k = 1:n
    found(k, :) = model(X(k, :), C(k, :), Vc, betaVc, w_c, [], voltage);
end
read = load('model.mat');
model_of = read.model; linear = read.linear; posterior = read.posterior;
save('-v6', 'found.mat', 'found', 'model_of', 'linear', 'posterior');
"""
DRIVE = """
load('driven.mat');
f = zeros(columns(C), 1);
path = zeros(rows(C), 13);
for k = 1:rows(C)
    [k1, ~, ~, ~, f1] = model(x, C(k, :), Vc, betaVc, w_c, f);
    [k2, ~, ~, ~, f2] = model(x + h / 2 * k1, C(k, :), Vc, betaVc, w_c, f + h / 2 * f1);
    [k3, ~, ~, ~, f3] = model(x + h / 2 * k2, C(k, :), Vc, betaVc, w_c, f + h / 2 * f2);
    [k4, ~, ~, ~, f4] = model(x + h * k3, C(k, :), Vc, betaVc, w_c, f + h * f3);
    x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4);
    f = f + h / 6 * (f1 + 2 * f2 + 2 * f3 + f4);
    x(10:13) = x(10:13) / norm(x(10:13));
    path(k, :) = x;
end
save('-v6', 'path.mat', 'path');
"""


def octave(folder: Path, script: str) -> None:
    """Run a script in a folder."""
    folder.joinpath("script.m").write_text(script)
    run = subprocess.run(
        ["octave-cli", "--norc", "--quiet", "script.m"], cwd=folder, capture_output=True, text=True, check=False
    )
    if run.returncode:
        raise RuntimeError(run.stderr)


def flow() -> np.ndarray:
    """Return the velocity of the water (3,) [m/s], NED."""
    return np.array([VC * np.cos(BETA), VC * np.sin(BETA), WC])


def commands_of(vehicle: Vehicle, count: int) -> np.ndarray:
    """Return commands (count, n) within the limits of the thrusters."""
    chance = np.random.default_rng(4)
    rest, ahead = commands_ahead(vehicle)
    reach = np.array([each.curve.limits or (0.0, 0.0) for each in vehicle.thrusters])
    spread = np.maximum(0.4 * (reach[:, 1] - reach[:, 0]), np.abs(ahead - rest)) if len(rest) else rest
    return rest + chance.uniform(-1.0, 1.0, (count, len(rest))) * spread


def rates(vehicle: Vehicle, eta: np.ndarray, nu: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """Return the package's derivative (n, 12) of [nu; eta]."""
    B, out = configuration_matrix(vehicle), np.empty((len(eta), 12))
    forces = thruster_forces(vehicle, commands, VOLTAGE)
    for k in range(len(eta)):
        R = rotation_from_euler(*eta[k, 3:])
        water = np.concatenate([R.T @ flow(), np.zeros(3)])
        loss = vehicle.coefficient("inflow_loss") * np.abs(forces[k]) * (B.T @ (nu[k] - water))
        nu_dot = forward_dynamics(vehicle, eta[k], nu[k] - water, B @ (forces[k] - loss))
        nu_dot[:3] -= np.cross(nu[k, 3:], water[:3])
        out[k] = np.concatenate([nu_dot, R @ nu[k, :3], euler_rates_matrix(eta[k, 3], eta[k, 4]) @ nu[k, 3:]])
    return out


def compared(vehicle: Vehicle, folder: Path) -> tuple[float, bool]:
    """Return the largest relative error of the rates, and whether the .mat file came back the same."""
    chance = np.random.default_rng(1)
    text = export(vehicle, "mss", folder / "model.m").files[0].read_text()
    word = re.search(r"^function \[.*?\] = (\w+)\(", text, re.MULTILINE)[1]
    folder.joinpath("model.m").write_text(re.sub(rf"\b{word}\b", "model", text[text.index("\nfunction ") :]))
    export(vehicle, "matlab", folder / "model.mat", at_speed=SPEED)
    eta = chance.uniform(-1.0, 1.0, (STATES, 6)) * [5.0, 5.0, 5.0, np.pi, 0.49 * np.pi, np.pi]
    nu = chance.uniform(-1.0, 1.0, (STATES, 6)) * speed_range(vehicle)
    commands = commands_of(vehicle, STATES)
    numbers = {"Vc": VC, "betaVc": BETA, "w_c": WC, "voltage": VOLTAGE}
    savemat(folder / "given.mat", {"X": np.hstack([nu, eta]), "C": commands, **numbers})
    octave(folder, RATES)
    found, expected = loadmat(folder / "found.mat", simplify_cells=True), rates(vehicle, eta, nu, commands)
    linear = linearised(vehicle, SPEED)
    pairs = [(found["model_of"][key], matrix) for key, matrix in matrices_of(vehicle).items()]
    pairs += [(found["model_of"]["M"], vehicle.mass_matrix)]
    pairs += [(found["linear"][key], getattr(linear, key)) for key in ("A", "B", "A_wrench", "B_wrench")]
    pairs += [(found["linear"]["trim_commands"], linear.commands), (found["linear"]["C"], np.eye(12))]
    same = all(np.array_equal(np.ravel(read), np.ravel(written)) for read, written in pairs)
    scale = 1.0 + np.abs(expected).max(axis=0)
    return float((np.abs(found["found"] - expected) / scale).max()), same


def driven(vehicle: Vehicle, folder: Path) -> float:
    """Return the largest difference [m] of 20 s in Octave from `simulate`."""
    steps = round(0.5 / STEP)
    commands = np.repeat(commands_of(vehicle, round(SECONDS / 0.5)) * 0.5, steps, axis=0)
    commands += 0.5 * commands_ahead(vehicle)[0]
    x = np.concatenate([np.zeros(9), quaternions_from_eulers(np.zeros((1, 3)))[0]])
    numbers = {"Vc": VC, "betaVc": BETA, "w_c": WC, "h": STEP}
    savemat(folder / "driven.mat", {"x": x, "C": commands, **numbers}, oned_as="column")
    octave(folder, DRIVE)
    run = simulate(vehicle, commands=commands, dt=STEP, current=flow(), delay=0.0)
    path = loadmat(folder / "path.mat")["path"]
    return float(max(np.abs(path[:, 6 + i] - run[axis].values[1:]).max() for i, axis in enumerate("xyz")))


def main() -> int:
    """Compare, print a line for each vehicle; return 1 where a bound fails."""
    if shutil.which("octave-cli") is None:
        print("GNU Octave is not there: apt-get install octave; nothing was compared")
        return 1
    failed = 0
    print(f"{'vehicle':32} {'rates':>10} {'.mat':>12} {'20 s, m':>10}")
    for name in catalog_names():
        vehicle = load_vehicle(name)
        if not vehicle.thrusters:
            continue
        with tempfile.TemporaryDirectory() as place:
            error, same = compared(vehicle, Path(place))
            away = driven(vehicle, Path(place)) if name in DRIVEN else None
        words = "same bits" if same else "DIFFERS"
        print(f"{name:32} {error:10.1e} {words:>12} {'' if away is None else f'{away:10.1e}'}")
        failed += error > 1e-9 or not same or (away or 0.0) > 1e-5
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
