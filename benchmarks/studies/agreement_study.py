"""Agreement on real water: recordings of one vehicle, learned apart, must agree within what they state.

    python benchmarks/studies/agreement_study.py [--output agreement.json]

Pairs of pool runs of one kind, the halves of the run at sea, and pairs of the boat's straight logs. Counted are the
unknowns that both recordings of a pair identify, in the coordinates in which they are Gaussian, by the deviation that
both have in common. Nothing is tuned; recordings from `$TOWTANK_DATA`, else `shared/data` beside the repository.
"""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from real_cases import BOAT_HALVES, SPINS, asked, boat, pool, sea
from report import checks_table, show
from runner import write_json
from summary import Check

from towtank.identification import LogLearning, learn_recordings
from towtank.identification.model.terms import AXES

_KINDS = (("yaw_1", "yaw_2", "yaw_3"), ("pitch_roll_1", "pitch_roll_2"), ("all_2", "all_3"))
_WITHIN, _FAR = 1.96, 4.0
Pair = tuple[str, LogLearning, LogLearning]


def pairs(data: Path) -> list[Pair]:
    """Return every pair of recordings learned apart."""
    runs, out = pool(data), list[Pair]()
    for kind in _KINDS:
        for a, b in itertools.combinations(kind, 2):
            out.append((f"pool {a}, {b}", runs.learn(a), runs.learn(b)))
    vehicle, halves = sea(data)
    first, second = (learn_recordings(vehicle, [half]) for half in halves)
    out.append(("sea, halves", first, second))
    boats = boat(data)
    straight = [name for half in BOAT_HALVES for name in half if name not in SPINS]
    for a, b in zip(straight[::2], straight[1::2], strict=False):
        out.append((f"boat {a}, {b}", boats.learn(a), boats.learn(b)))
    return out


def straight_logs(data: Path) -> list[float]:
    """Return by how many common deviations every two of the boat's straight logs differ in each coefficient."""
    boats = boat(data)
    learned = [boats.learn(name) for half in BOAT_HALVES for name in half if name not in SPINS]
    return [z for one, other in itertools.combinations(learned, 2) for z in apart(one, other).values()]


def apart(one: LogLearning, other: LogLearning) -> dict[str, float]:
    """Return by how many common deviations two learnings differ, by the name of what both have identified."""
    out = {}
    posteriors = (one.model.posterior, other.model.posterior)
    for name in one.estimate.names:
        if not (name in other.estimate and one.estimate[name].identified and other.estimate[name].identified):
            continue
        found = [(p.mean[p.names.index(name)], p.std[p.names.index(name)]) for p in posteriors if p is not None]
        (a, s), (b, t) = found
        out[name] = (a - b) / math.hypot(s, t)
    return out


def implausible(learnings: Sequence[LogLearning]) -> list[str]:
    """Return the identified total inertias that are less than the rigid body's or above five times that."""
    out = []
    for each in learnings:
        rigid = np.diag(each.vehicle.rigid_body_matrix)
        for axis in AXES:
            for total in each.estimate.sums:
                share = total.value / float(rigid[axis.index])
                if total.name == axis.sum_name and not 1.0 <= share <= 5.0:
                    out.append(f"{total.name} {share:.2f}")
    return out


def main(arguments: Sequence[str] | None = None) -> int:
    """Show the agreement of every pair and of all together; 1 where a limit does not hold."""
    output, data = asked(__doc__, arguments)
    if data is None:
        return 0
    found = pairs(data)
    all_z: list[float] = []
    table = {}
    for name, one, other in found:
        z = apart(one, other)
        table[name] = z
        all_z += list(z.values())
        far = ", ".join(f"{key} {value:+.1f}" for key, value in z.items() if abs(value) > _WITHIN) or "none"
        inside = sum(abs(value) <= _WITHIN for value in z.values())
        show(f"{name} ({one.method}, {other.method}): {inside} of {len(z)} agree; apart: {far}")
    size, every = np.abs(np.array(all_z)), np.abs(np.array(straight_logs(data)))
    far = f"{np.sum(every <= _WITHIN)} within {_WITHIN}, the furthest {every.max():.1f}" if every.size else "none apart"
    show(f"boat, every pair of its straight logs: {every.size} coefficients known twice, {far}")
    at_sea = [each.estimate["BG_z"] for name, *both in found if name.startswith("sea") for each in both]
    odd = implausible([each for _, one, other in found for each in (one, other)])
    checks = [
        Check("within 1.96 common deviations", float(np.mean(size <= _WITHIN)), low=0.80, note=f"of {size.size}"),
        Check("beyond 4 deviations", float(np.mean(size > _FAR)), high=0.05),
        Check("total inertias beyond 1 to 5 rigid bodies", float(len(odd)), high=0.0, note=", ".join(odd)),
        Check(
            "BG_z at sea beyond 0.3 to 10 N m",
            float(sum(each.identified and not 0.3 <= each.value <= 10.0 for each in at_sea)),
            high=0.0,
        ),
    ]
    show(checks_table("must hold", checks))
    write_json(output, {"study": "agreement", "pairs": table, "checks": [check.document() for check in checks]})
    return 0 if all(check.met for check in checks) else 1


if __name__ == "__main__":
    sys.exit(main())
