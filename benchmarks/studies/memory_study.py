"""How long what disturbs a vehicle lasts: the filter supposes 2 s; what do real recordings ask for?

    python benchmarks/studies/memory_study.py [--output memory.json]          (six minutes)

Each run of the pool, both halves of the run at sea and some of the boat's logs are learned by the joint filter with
disturbances that forget in 0.1 to 6 s: by how much likelier that is than 2 s, and by how much windows then contradict
each other. Beside it, how well unseen runs of the pool are predicted by what is learned so.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

from real_cases import POOL, POOL_RUNS, Learned, asked, boat, pool, real_fit, sea
from report import show
from rich.table import Table
from runner import write_json

from towtank.identification import learn_recordings
from towtank.identification.data.samples import Samples, prepared
from towtank.identification.kalman.passes import joint_fit
from towtank.identification.kalman.problem import settings_for
from towtank.identification.kalman.state import FilterSettings
from towtank.identification.offline import joint
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.recording import Recording
from towtank.vehicle import Vehicle

MEMORIES, SUPPOSED = (0.1, 0.3, 1.0, 2.0, 6.0), 2.0  # s
PREDICTED = (0.1, 2.0)  # s, with which unseen runs are predicted
LOGS = ("222", "226", "234")  # of the boat


def asked_for(vehicle: Vehicle, recording: Recording) -> list[tuple[float, float]]:
    """Return the log likelihood with each memory, and the factor by which windows contradict each other."""
    problem = joint_problem(LearningRequest(vehicle, [prepared(recording, vehicle)]))
    fits = [
        joint_fit(replace(problem, settings=replace(problem.settings, time_constant=memory))) for memory in MEMORIES
    ]
    return [(fit.likelihood, fit.disagreement) for fit in fits]


def predictions(runs: Learned, memory: float) -> dict[str, float]:
    """Return how far [%] unseen runs of the pool are explained by what is learned with a memory."""

    def with_memory(samples: Sequence[Samples], settings: FilterSettings) -> FilterSettings:
        return replace(settings_for(samples, settings), time_constant=memory)

    found = {}
    with patch.object(joint, "settings_for", with_memory):
        for case in POOL[:4]:
            learning = learn_recordings(runs.vehicle, [runs.read(name) for name in case.learned])
            channel = case.least[0][0]
            found[f"{case.name}: {channel}"] = real_fit(learning, runs.read(case.judged), case.horizon)[channel]
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study."""
    output, data = asked(__doc__, arguments)
    return 0 if data is None else _study(data, output)


def _study(data: Path, output: Path | None) -> int:
    runs, craft, (vehicle, halves) = pool(data), boat(data), sea(data)
    every = [(f"pool {name}", runs.vehicle, runs.read(name)) for name in POOL_RUNS]
    every += [(f"sea, half {k}", vehicle, half) for k, half in enumerate(halves, 1)]
    every += [(f"boat {name}", craft.vehicle, craft.read(name)) for name in LOGS]
    table = Table(title="Log likelihood beside a memory of 2 s (factor by which windows contradict each other)")
    for head in ("recording", *(f"{memory:g} s" for memory in MEMORIES)):
        table.add_column(head, justify="left" if head == "recording" else "right")
    rows = []
    for name, known, recording in every:
        told = asked_for(known, recording)
        usual = told[MEMORIES.index(SUPPOSED)][0]
        table.add_row(name, *(f"{likelihood - usual:+.0f} ({apart:.2f})" for likelihood, apart in told))
        rows.append({"recording": name, "gained": [each - usual for each, _ in told], "apart": [x for _, x in told]})
    fits = {memory: predictions(runs, memory) for memory in PREDICTED}
    predicted = Table(title="Unseen runs, explained %")
    for head in ("", *(f"{memory:g} s" for memory in PREDICTED)):
        predicted.add_column(head, justify="right" if head else "left")
    for name in fits[SUPPOSED]:
        predicted.add_row(name, *(f"{fits[memory][name]:.1f}" for memory in PREDICTED))
    show(table, predicted)
    write_json(output, {"memories": MEMORIES, "rows": rows, "predictions": {str(k): fit for k, fit in fits.items()}})
    return 0


if __name__ == "__main__":
    sys.exit(main())
