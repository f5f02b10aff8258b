"""Exports: the C header's dynamics beside the compiled kernel, and how long an export takes.

    python benchmarks/bench_export.py [--json]

First both must give the same accelerations. Then the time of forward dynamics for one state: the header compiled by gcc
(-O2) in double and in single precision, and the package's kernel over the same states. An export is a process of its
own, from the command to the file, warm: kernels compiled by an earlier one.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from figures import Figure, interleaved, report

sys.path.append(str(Path(__file__).resolve().parents[1]))

from tests.exporters.compiled import Compiled, built
from tests.exporters.whole import random_states

from towtank import load_vehicle
from towtank.core.attitude import quaternions_from_eulers
from towtank.core.dynamics import forward_dynamics
from towtank.exporters import TARGETS

STATES = 100_000
RUNS = 5
VEHICLE = "rexrov"  # full matrices


def _processor() -> float:
    """Return the seconds that ended child processes have used, those of the system for them as well."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def measured() -> list[Figure]:
    """Prove parity, then measure."""
    vehicle = load_vehicle(VEHICLE)
    eta, nu, tau = random_states(vehicle, STATES)
    q = quaternions_from_eulers(np.ascontiguousarray(eta[:, 3:]))
    p = np.array(vehicle.parameters)[None, :]
    figures = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        headers = {}
        for word, single in (("double", False), ("float", True)):
            place = folder / word
            place.mkdir()
            headers[word] = Compiled(built(vehicle, place, single=single), single=single)
        truth = forward_dynamics(p, q, nu, tau)
        found = headers["double"].call("forward", [q, nu, tau], 6)[0]
        if np.abs(found - truth).max() > 1e-12 * np.abs(truth).max():
            raise SystemExit("the header does not give the package's accelerations")
        halves = [each.astype(np.float32) for each in (q, nu, tau)]
        times = interleaved(
            {
                "kernel": lambda: forward_dynamics(p, q, nu, tau),
                "double": lambda: headers["double"].call("forward", [q, nu, tau], 6),
                "float": lambda: headers["float"].call("forward", halves, 6),
            }
        )
        beside = f"the compiled kernel: {times['kernel'] / STATES * 1e6:.3f} us"
        for word in ("double", "float"):
            figures.append(Figure(f"c_forward_{word}", times[word] / STATES * 1e6, "us", 0.25, note=beside))
        for target in TARGETS:
            command = [sys.executable, "-m", "towtank", "export", VEHICLE, "--to", target.name]
            place = folder / f"out_{target.name}{target.suffix}"
            seconds, busy = [], []
            for _ in range(RUNS):
                began, before = time.perf_counter(), _processor()
                subprocess.run([*command, "-o", str(place)], check=True, capture_output=True)
                seconds.append(time.perf_counter() - began)
                busy.append(_processor() - before)
            note = f"a process, warm; best of {RUNS}; {min(busy):.2f} s of the processor"
            figures.append(Figure(f"export_{target.name}", min(seconds), "s", 1.5, note=note))
    return figures


if __name__ == "__main__":
    sys.exit(report("Exports", measured))
