"""Accuracy of the demo's session over many seeds: noise, marker jumps and random forces differ, nothing else.

    python benchmarks/bench_demo.py [--seeds 30] [--seconds 180] [--streaming]

For every coefficient: mean, root mean square and largest error in percent of the truth, the same in the estimate's own
standard deviations, how many of the runs lie within three of them, and how many within the figure promised for it. The
demo itself runs seed 1.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from towtank.app.demo.progress import Quantity, quantities, readings
from towtank.app.demo.stream import pose_and_commands
from towtank.identification import Learner, learn_recordings
from towtank.simulation.tank import DURATION, tank_session


def promised(quantity: Quantity) -> float:
    """Return the accuracy [%] that the demo promises."""
    return 4.0 if quantity.kind == "drag" else 1.0


def errors(seed: int, seconds: float, streaming: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors [%] and the errors in deviations of one run, (n,) each, NaN where not identified."""
    session = tank_session(seconds, seed)
    if streaming:
        learner = Learner(session.known)
        for t, pose, commands in zip(*pose_and_commands(session), strict=True):
            learner.update(t, pose=pose, commands=commands)
        estimate = learner.estimate
    else:
        estimate = learn_recordings(session.known, [session.recording]).estimate
    learned = quantities(session.truth)
    values, std = readings(estimate, learned)
    truth = np.array([quantity.truth for quantity in learned])
    return 100.0 * (values - truth) / truth, (values - truth) / std


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description="Accuracy of the demo's session over many seeds.")
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--seconds", type=float, default=DURATION)
    parser.add_argument("--streaming", action="store_true", help="before the second pass over the recording")
    chosen = parser.parse_args(arguments)
    runs = [errors(seed, chosen.seconds, chosen.streaming) for seed in range(1, chosen.seeds + 1)]
    share, deviations = (np.array(part) for part in zip(*runs, strict=True))
    learned = quantities(tank_session(2.0).truth)
    write = sys.stdout.write
    write(f"{chosen.seeds} seeds, {chosen.seconds:g} s each\n")
    write(f"{'':14}{'error %':^24}{'in own std':^16}{'within':^22}\n")
    write(f"{'':14}{'mean':>8}{'rms':>8}{'worst':>8}{'rms':>8}{'worst':>8}{'3 std':>10}{'promised':>14}\n")
    for i, quantity in enumerate(learned):
        known = np.isfinite(share[:, i])
        e, z = share[known, i], deviations[known, i]
        if not e.size:
            write(f"{quantity.name:14}{'never identified':>24}\n")
            continue
        limit = promised(quantity)
        write(
            f"{quantity.name:14}{e.mean():8.2f}{np.sqrt((e**2).mean()):8.2f}{np.abs(e).max():8.2f}"
            f"{np.sqrt((z**2).mean()):8.2f}{np.abs(z).max():8.2f}"
            f"{int((np.abs(z) <= 3.0).sum()):6d}/{chosen.seeds}{int((np.abs(e) <= limit).sum()):6d}/{chosen.seeds}"
            f" ({limit:g} %)\n"
        )
    limits = np.array([promised(quantity) for quantity in learned])
    kept = (np.abs(share) <= limits).all(axis=1) & (np.abs(deviations) <= 3.0).all(axis=1)
    write(f"all promises kept in {int(kept.sum())} of {chosen.seeds} runs\n")


if __name__ == "__main__":
    main()
