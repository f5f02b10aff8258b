"""Outputs that a logger looks at now and then, while a hand moves on: are delay and inertia right all the same?

    python benchmarks/studies/looked_study.py [--runs 20] [--only held] [--output looked.json]

The VideoRay Pro 4, whose thrusters lag by 30 ms behind a delay of 20 ms, is driven for 40 s on all axes at once, in
water that pushes it, under an inertial unit, a DVL and depth. `held`: commands are given ten times in a second and
recorded as they are given. `20 Hz`, `10 Hz`, `5 Hz`, `2 Hz`: they are given a hundred times in a second (which makes
forces 5 ms later on the whole), and looked at so often. `repeated`: a table at 20 Hz repeats what was looked at ten
times in a second. Of every coefficient that is identified: how far from the truth, in deviations that are stated; of
the total inertias: how far, as a share; delay and lag together: how far. Beside it the same where every input is taken
for held until the next.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Sequence
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from by_case import by_case
from summary import Check
from undriven_study import errors, told

from towtank.identification import LogLearning, learn_recordings
from towtank.identification.offline import joint
from towtank.recording import Recording, standard_channel
from towtank.recording.standard import is_command
from towtank.simulation import Ins, OrnsteinUhlenbeck, manoeuvre, simulate
from towtank.vehicle import Vehicle, load_vehicle

DELAY, LAG, SECONDS = 0.02, 0.03, 40.0  # s
CASES = {  # commands given, looked at and written so often [Hz]
    "held": (10, 10, 10),
    "20 Hz": (100, 20, 20),
    "10 Hz": (100, 10, 10),
    "5 Hz": (100, 5, 5),
    "2 Hz": (100, 2, 2),
    "repeated": (100, 10, 20),
}
INERTIAS = ("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot")


class Found(NamedTuple):
    """Errors of what is identified, in deviations, of total inertias as shares, of delay and lag together [s]; whether
    inputs were taken to go on between two looks."""

    off: dict[str, float]
    inertias: list[float]
    late: float
    looked_at: bool


def driven(case: str, seed: int) -> tuple[Vehicle, Recording]:
    """Return a vehicle as it is, and its run as it was logged."""
    given, looked, written = CASES[case]
    vehicle = load_vehicle("vlbv300").model_copy(update={"command_delay": DELAY})
    late = tuple(each.model_copy(update={"time_constant": LAG}) for each in vehicle.thrusters)
    vehicle = vehicle.model_copy(update={"thrusters": late})
    plan = manoeuvre("all-multisine", vehicle, duration=SECONDS, dt=0.01, seed=seed)
    assert plan.commands is not None
    commands = np.repeat(plan.commands[:: 100 // given], 100 // given, axis=0)
    water = OrnsteinUhlenbeck((0.3, 0.3, 0.3, 0.02, 0.02, 0.02), 2.0, ("X", "Y", "Z", "K", "M", "N"))
    run = simulate(vehicle, commands=commands, dt=0.01, sensors=Ins(), disturbance=water, seed=seed)
    channels = []
    for name in filter(is_command, run.names):
        seen = run[name].measured
        at = np.arange(0, len(seen), 100 // written)
        last = at - at % (100 // looked)  # the latest look at each row
        channels.append(standard_channel(name, seen.t[at], seen.values[last]))
    return vehicle, run.replace(channels)


def found_of(truth: Vehicle, learning: LogLearning) -> Found:
    """Return what came of one log."""
    total, rigid = np.diag(truth.mass_matrix), np.diag(truth.rigid_body_matrix)
    pairs = zip(INERTIAS, total, rigid, strict=True)
    shares = [float((own - learning.estimate[name].value) / all_of_it - 1.0) for name, all_of_it, own in pairs]
    looked_at = learning.mode is not None and learning.mode.looked_at
    return Found(errors(truth, learning), shares, learning.delay + learning.lag - DELAY - LAG, looked_at)


def learned(case: str, seed: int) -> tuple[Found, Found]:
    """Return what comes of one log, and what would if every input were taken for held until the next."""
    truth, run = driven(case, seed)
    asked = found_of(truth, learn_recordings(told(truth), [run]))
    with patch.object(joint, "as_looked_at", return_value=None):
        return asked, found_of(truth, learn_recordings(told(truth), [run]))


def checks(case: str, found: Sequence[tuple[Found, Found]]) -> list[Check]:
    """Return what must hold of one case, and figures beside it."""
    asked, alone = zip(*found, strict=True)
    rightly = float(np.mean([each.looked_at == (case != "held") for each in asked]))
    return [
        Check(f"{case}: known for what it is", rightly, 0.95, math.inf),
        *_figures(case, asked, judged=True),
        *_figures(f"{case}, taken for held", alone, judged=False),
    ]


def _figures(case: str, found: Sequence[Found], *, judged: bool) -> list[Check]:
    off = np.abs([deviations for run in found for deviations in run.off.values()])
    least, most = (0.9, 0.005) if judged else (-math.inf, math.inf)
    return [
        Check(f"{case}: 95 % intervals that hold", float(np.mean(off < 1.96)), least, math.inf),
        Check(f"{case}: beyond 4 deviations", float(np.mean(off > 4.0)), -math.inf, most),
        Check(f"{case}: error of total inertias, median", float(np.median(np.abs([run.inertias for run in found])))),
        Check(f"{case}: error of delay and lag together, RMSE, s", math.sqrt(np.mean([run.late**2 for run in found]))),
    ]


def row(found: tuple[Found, Found]) -> dict[str, str]:
    """Return a run as its table shows it."""
    asked, alone = found
    return {
        "looked at": "yes" if asked.looked_at else "no",
        "identified": str(len(asked.off)),
        "root mean square, deviations": " / ".join(_size(each.off.values()) for each in found),
        "largest error of an inertia %": " / ".join(f"{100.0 * max(map(abs, each.inertias)):.1f}" for each in found),
        "delay and lag off ms": f"{1e3 * asked.late:+.1f} / {1e3 * alone.late:+.1f}",
    }


def _size(off: Iterable[float]) -> str:
    return f"{np.sqrt(np.mean(np.square(list(off)))):.2f}"


if __name__ == "__main__":
    sys.exit(by_case("looked", __doc__ or "", CASES, learned, row, checks))
