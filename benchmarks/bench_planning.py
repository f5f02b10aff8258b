"""Planning: what a forecast costs beside the simulation of the same run, a segment's search, and a step of the guard.

    python benchmarks/bench_planning.py [--json]

First the forecast must be what learning states: `tests/planning/test_forecast.py` proves that. Then the time of a
forecast of 14 s at 25 Hz with everything unknown, of the design of a segment, and of a guard's step that passes and
that bends.
"""

from __future__ import annotations

import sys

import numpy as np
from figures import Figure, interleaved, report

from towtank import load_vehicle, simulate
from towtank.planning import RATE, Guard, Outlook, Space, design, diagonal, drawn_around, forecast
from towtank.simulation import manoeuvre

VEHICLE, SECONDS = "vlbv300", 14.0


def measured() -> list[Figure]:
    """Measure."""
    vehicle = load_vehicle(VEHICLE)
    outlook, space = Outlook.of(vehicle), Space.from_text("5x5x2.5")
    commands = manoeuvre("all-multisine", vehicle, duration=SECONDS, dt=1.0 / RATE, seed=2).commands
    guard = Guard.of(vehicle, space, drawn_around(vehicle, 19, 0.3))
    free, bent = (guard.brake.inverse[:, 0] * size for size in (1.0, 40.0))
    at_rest = guard_state(space, 0.0)
    fast = guard_state(space, 0.6)
    times = interleaved(
        {
            "forecast": lambda: forecast(outlook, vehicle, commands),
            "simulate": lambda: simulate(vehicle, commands=commands, dt=1.0 / RATE, substeps=2),
            "free": lambda: guard.step(at_rest, free),
            "bent": lambda: guard.step(fast, bent),
        }
    )
    search = interleaved({"design": lambda: design(outlook, diagonal(outlook), space=space, tries=40, draws=3)}, 3)
    beside = f"simulate alone: {1e3 * times['simulate']:.1f} ms"
    return [
        Figure("forecast_14_s", 1e3 * times["forecast"], "ms", note=beside),
        Figure("design_segment", search["design"], "s", 3.0, note="40 segments, 3 vehicles each"),
        Figure("guard_step_free", 1e3 * times["free"], "ms", note="a period has 40 ms"),
        Figure("guard_step_bent", 1e3 * times["bent"], "ms", note="a period has 40 ms"),
    ]


def guard_state(space: Space, speed: float) -> np.ndarray:
    """Return the state (13,) of a vehicle in the middle that goes ahead [m/s]."""
    out = np.zeros(13)
    out[:3], out[3], out[7] = space.middle, 1.0, speed
    return out


if __name__ == "__main__":
    sys.exit(report("Planning", measured))
