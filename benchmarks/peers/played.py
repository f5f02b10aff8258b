"""The vehicle that every peer plays: simulated once, with sensor noise, a line of JSON for each instant.

`write_trajectory` needs towtank; `paced` is for the peers, which have nothing but Python.
"""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

VEHICLE = "bluerov2_heavy"
SECONDS = 75.0
LEAD = 10.0  # s without thrust before: discovery, questions for rates and parameters
NEUTRAL = 1500.0  # us
STEP = 0.02  # s
FREE = "X_udot,X_u,X_uu,Y_vdot,Y_vv,Z_wdot,Z_w,Z_ww,K_pdot,K_pp,M_qdot,M_q,M_qq,N_rdot,N_rr"
NOISE = {"xyz": 1e-3, "phi": 1e-3, "uvw": 5e-3, "pqr": 2e-3}  # m, rad, m/s, rad/s


def write_trajectory(path: Path, *, by_wrench: bool) -> None:
    """Simulate the vehicle: commands in whole microseconds as an autopilot puts them out, or the wrench itself."""
    import numpy as np

    from towtank import load_vehicle, thruster_wrench
    from towtank.simulation import manoeuvre, simulate

    vehicle = load_vehicle(VEHICLE)
    driven = np.rint(np.asarray(manoeuvre("all-multisine", vehicle, duration=SECONDS, dt=STEP, seed=5).commands))
    commands = np.vstack((np.full((round(LEAD / STEP), driven.shape[1]), NEUTRAL), driven))
    wrench = np.asarray(thruster_wrench(vehicle, commands))
    given = {"wrench": wrench} if by_wrench else {"commands": commands}
    run = simulate(vehicle, dt=STEP, seed=5, **given)
    rng = np.random.default_rng(5)
    motion = {name: run[name].values for name in ("x", "y", "z", "phi", "theta", "psi", *"uvwpqr")}
    sizes = [NOISE[key] for key in ("xyz", "phi", "uvw", "pqr") for _ in range(3)]
    noisy = np.column_stack(list(motion.values())) + rng.normal(0.0, sizes, (len(run["x"].t), 12))
    with path.open("w", encoding="utf-8") as file:
        for k in range(len(commands)):
            row = noisy[k].tolist()
            line = {
                "t": k * STEP,
                "eta": row[:6],
                "nu": row[6:],
                "cmd": commands[k].tolist(),
                "tau": wrench[k].tolist(),
            }
            file.write(json.dumps(line) + "\n")


def paced(path: str) -> Iterator[tuple[float, dict[str, Any]]]:
    """Yield each instant when it is its time, with the seconds since the start."""
    began = time.monotonic()
    for line in Path(path).read_text(encoding="utf-8").splitlines():
        frame = json.loads(line)
        time.sleep(max(began + frame["t"] - time.monotonic(), 0.0))
        yield frame["t"], frame


def free_port() -> int:
    """Return a UDP port of this machine that nobody holds."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        return int(link.getsockname()[1])
