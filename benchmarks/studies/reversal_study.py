"""What the pool's thrusters do when they are reversed: nothing for a moment, one way and not the other?

    python benchmarks/studies/reversal_study.py [--output reversal.json]          (five minutes)

In each run, and in those that are predicted, commands are put to neutral for a time after a thruster is told to push
ahead that pushed astern, or the other way. By how much likelier the filter finds the run so, what it takes for delay,
lag and inertia then, and how well unseen runs are predicted. `answer_study.py` shows the answer itself.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from real_cases import POOL, Learned, asked, pool, real_fit
from report import show
from rich.table import Table
from runner import write_json

from towtank.core.arrays import Array
from towtank.identification import learn_recordings
from towtank.identification.data.samples import prepared
from towtank.identification.kalman.passes import joint_fit
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.recording import Recording, held_at, standard_channel
from towtank.vehicle import Thruster, curve_force

PAUSES = ((0.0, 0.0), (0.2, 0.0), (0.0, 0.2), (0.15, 0.15))  # s: to ahead, to astern
RUNS, INERTIA = ("yaw_1", "yaw_2", "yaw_3", "pitch_roll_1"), "N_rdot"


def with_pauses(recording: Recording, thrusters: Sequence[Thruster], ahead: float, astern: float) -> Recording:
    """Return a recording whose commands are neutral for so long [s] after each reversal."""
    channels = {name: recording[name] for name in recording.names}
    for thruster in thrusters:
        name = f"cmd_{thruster.name}"
        known = recording[name].measured
        t, values = _paused(known.t, known.values, thruster, ahead, astern)
        channels[name] = standard_channel(name, t, values)
    return Recording(channels, recording.source)


def _paused(t: Array, values: Array, thruster: Thruster, ahead: float, astern: float) -> tuple[Array, Array]:
    way = np.sign(curve_force(thruster.curve, values, None))
    pushes = np.flatnonzero(way)
    reversed_at = pushes[1:][np.diff(way[pushes]) != 0.0]
    begins = t[reversed_at]
    ends = begins + np.where(way[reversed_at] > 0.0, ahead, astern)
    stamps = np.unique(np.concatenate([t, ends]))
    held = held_at(t, values[:, None], stamps)[:, 0]
    for begin, end in zip(begins, ends, strict=True):
        held[(begin <= stamps) & (stamps < end)] = thruster.curve.rest
    return stamps, held


def found(runs: Learned, name: str, recording: Recording) -> dict[str, float | str]:
    """Return what the joint filter finds in a run."""
    fit = joint_fit(joint_problem(LearningRequest(runs.vehicle, [recording])))
    at = {each: (float(x), float(s)) for each, x, s in zip(fit.free.names, fit.theta, fit.std, strict=True)}
    inertia, std = np.exp(at[INERTIA][0]), at[INERTIA][1]  # the logarithm of the total
    numbers = {"likelihood": fit.likelihood, "delay": at["delay"][0], "lag": at["lag"][0]}
    return {"run": name, **numbers, "inertia": float(inertia), "inertia_std": float(inertia * std)}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study."""
    output, data = asked(__doc__, arguments)
    return 0 if data is None else _study(data, output)


def _study(data: Path, output: Path | None) -> int:
    runs, rows, usual = pool(data), list[dict[str, float | str]](), dict[str, float]()
    table = Table(title="Commands neutral after a reversal to ahead, to astern")
    for head in ("s", "run", "log likelihood gained", "delay s", "lag s", "I_z - N_rdot kg m^2"):
        table.add_column(head, justify="left" if head in ("s", "run") else "right")
    predicted = Table(title="Unseen runs, explained %")
    cases = POOL[:4]
    for head in ("s", *(f"{case.name}: {case.least[0][0]}" for case in cases)):
        predicted.add_column(head)
    for ahead, astern in PAUSES:
        names = {name for case in cases for name in (*case.learned, case.judged)} | {*RUNS}
        ready = {
            name: with_pauses(prepared(runs.read(name), runs.vehicle), runs.vehicle.thrusters, ahead, astern)
            for name in sorted(names)
        }
        for name in RUNS:
            row = found(runs, name, ready[name])
            gained = float(row["likelihood"]) - usual.setdefault(name, float(row["likelihood"]))
            rows.append({"ahead": ahead, "astern": astern, **row, "gained": gained})
            inertia = f"{row['inertia']:.2f} ± {row['inertia_std']:.2f}"
            table.add_row(
                f"{ahead:g}, {astern:g}", name, f"{gained:+.0f}", f"{row['delay']:.3f}", f"{row['lag']:.3f}", inertia
            )
        fits = []
        for case in cases:
            learning = learn_recordings(runs.vehicle, [ready[name] for name in case.learned])
            fits.append(real_fit(learning, ready[case.judged], case.horizon)[case.least[0][0]])
        predicted.add_row(f"{ahead:g}, {astern:g}", *(f"{fit:.1f}" for fit in fits))
        rows.append(
            {"ahead": ahead, "astern": astern, **{case.name: fit for case, fit in zip(cases, fits, strict=True)}}
        )
    show(table, predicted)
    write_json(output, {"rows": rows})
    return 0


if __name__ == "__main__":
    sys.exit(main())
