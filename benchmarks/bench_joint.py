"""The joint estimator: microseconds per sample of a 100 Hz pose stream, everything plausible unknown.

    python benchmarks/bench_joint.py [--json]
    python benchmarks/bench_joint.py --hour

First the stream must find every inertia within 2 % and every coefficient within four of its deviations. One core.
"pass" is the filter alone over rows that are all there. "stream" is `Learner.run` from the first sample on, with its
re-estimations, per sample of the whole: of five minutes, and of the first minute, in which it looks back most;
"watched" the latter with the watch over changes of the vehicle. "log" is all passes over that minute as a log, beside
passes that take every single sample; both must come to the same within a fifth of a deviation.
Beside it, a Kalman filter of the same size in NumPy: covariance by matrix products, six updates by scalars, and no
model at all.

--hour: `towtank learn` on a CSV of one hour at 100 Hz, nothing known of the vehicle; seconds and peak memory.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from figures import Figure, interleaved, report

from towtank.identification import Learner
from towtank.identification.kalman.passes import joint_fit, one_pass
from towtank.identification.kalman.problem import JointFit, JointProblem
from towtank.identification.offline.joint import LearningRequest, joint_problem
from towtank.recording import Recording, write_csv
from towtank.simulation import manoeuvre, simulate
from towtank.simulation.tank import DISTURBANCE, FREE, MOCAP, tank_session
from towtank.vehicle import Vehicle, save_vehicle

DURATION, LONG = 60.0, 300.0  # s
LIMIT = 150.0  # us per sample
INERTIA, DEVIATIONS, SAME = 0.02, 4.0, 0.2
HOUR, HOUR_LIMIT, MEMORY_LIMIT = 3600.0, 180.0, 500.0  # s, s, MB


def proved(learner: Learner, truth: Vehicle) -> None:
    """Raise where the stream did not find the vehicle."""
    found = learner.estimate
    for name in FREE:
        away = found[name].value - truth.coefficient(name)
        limit = DEVIATIONS * found[name].std
        if name.endswith("dot"):
            i = "XYZKMN".index(name[0])
            limit = INERTIA * (truth.rigid_body_matrix[i, i] - truth.coefficient(name))
        if not abs(away) <= limit:
            raise SystemExit(f"{name}: found {found[name].value:.5g}, {away:+.2g} off, expected {limit:.2g} at most")


def session(duration: float = DURATION) -> tuple[Vehicle, Vehicle, Recording]:
    """Return the truth, what is known of it, and telegraph signals on all axes."""
    tank = tank_session(2.0)
    commands = manoeuvre("all-telegraph", tank.truth, duration=duration, dt=0.01, seed=1).commands
    start = (0.0, 0.0, 3.0, 0.0, 0.0, 0.0)
    run = simulate(tank.truth, commands=commands, dt=0.01, eta0=start, sensors=MOCAP, disturbance=DISTURBANCE, seed=1)
    return tank.truth, tank.known, run


def peer(rows: int, size: int) -> None:
    """Run a Kalman filter of this size in NumPy over as many rows of six numbers."""
    P, F, Q = np.eye(size), np.eye(size) + 1e-3, 1e-6 * np.eye(size)
    for _ in range(rows):
        P = F @ P @ F.T + Q
        for k in range(6):
            g = P[:, k]
            P = P - np.outer(g, g) / (g[k] + 1e-6)
        P *= 0.5


def with_all_rows(problem: JointProblem) -> JointFit:
    """Learn from every single sample."""
    return joint_fit(problem.of_each)


def require_same(one: JointFit, other: JointFit) -> None:
    """Raise where two fits differ by more than a share of their deviations."""
    away = np.abs(one.theta - other.theta) / one.std
    if not away.max() <= SAME:
        k = int(np.argmax(away))
        raise SystemExit(f"{one.free.names[k]}: {away[k]:.2f} deviations apart, expected {SAME} at most")


def measured() -> Sequence[Figure]:
    truth, known, recording = session()
    problem = joint_problem(LearningRequest(known, [recording]))
    theta, levels = problem.prior.mean, problem.of_each.rough
    learner = Learner(known)
    learner.run(recording)
    proved(learner, truth)
    require_same(joint_fit(problem), with_all_rows(problem))
    each_sample = problem.of_each
    rows, size, long = len(each_sample.samples[0]), 36 + len(problem.free), session(LONG)[2]
    took = interleaved(
        {
            "pass": lambda: one_pass(each_sample, theta, levels),
            "stream": lambda: Learner(known, changes=False).run(long),
            "minute": lambda: Learner(known, changes=False).run(recording),
            "watched": lambda: Learner(known).run(recording),
            "log": lambda: joint_fit(problem),
            "all rows": lambda: with_all_rows(problem),
            "peer": lambda: peer(rows // 10, size),
        },
        repeats=3,
    )
    each = {name: 1e6 * seconds / rows for name, seconds in took.items()}
    each["peer"] *= 10.0
    each["stream"] *= DURATION / LONG
    note = f"{len(problem.free)} unknowns, {size} states at most"
    return (
        Figure("joint_pass_us_per_sample", each["pass"], "us", LIMIT, note=note),
        Figure("joint_stream_us_per_sample", each["stream"], "us", LIMIT, note="with re-estimation, 300 s"),
        Figure("joint_minute_us_per_sample", each["minute"], "us", note="the first minute of it"),
        Figure("joint_watched_us_per_sample", each["watched"], "us", note="that, with the watch over changes"),
        Figure("joint_log_us_per_sample", each["log"], "us", note="all passes over that minute"),
        Figure("joint_log_ratio", each["log"] / each["all rows"], "", note="of passes that take every single sample"),
        Figure("joint_numpy_peer_us_per_sample", each["peer"], "us", note="NumPy, same size, without the model"),
        Figure("joint_ratio_to_numpy_peer", each["peer"] / each["pass"], "", note="times faster than the peer"),
    )


def write_recordings(known: Path, short: Path, long: Path) -> None:
    save_vehicle(tank_session(10.0).known, known)
    for path, seconds in ((short, 10.0), (long, HOUR)):
        write_csv(tank_session(seconds).recording, path)


def hour() -> Sequence[Figure]:
    with tempfile.TemporaryDirectory() as folder:
        known, short, long = (Path(folder) / name for name in ("known.toml", "short.csv", "hour.csv"))
        # in a process of its own: a child's peak counts from that of the process which starts it
        writing = get_context("spawn").Process(target=write_recordings, args=(known, short, long))
        writing.start()
        writing.join()
        command = [sys.executable, "-m", "towtank", "learn", "--vehicle", known]
        subprocess.run([*command, short], check=True, stdout=subprocess.DEVNULL)  # compile
        start = time.perf_counter()
        pid = subprocess.Popen([*command, long], stdout=subprocess.DEVNULL).pid
        _, status, usage = os.wait4(pid, 0)  # of this process alone
        took = time.perf_counter() - start
        if os.waitstatus_to_exitcode(status):
            raise RuntimeError("towtank learn failed")
    memory = usage.ru_maxrss * 1024.0 / 1e6
    return (
        Figure("joint_hour_seconds", took, "s", HOUR_LIMIT, note="towtank learn, one hour at 100 Hz, all to be found"),
        Figure("joint_hour_peak_memory_mb", memory, "MB", MEMORY_LIMIT, note="of that process"),
    )


def main(argv: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if argv is None else argv)
    if "--hour" in words:
        words.remove("--hour")
        return report("joint estimator, one hour", hour, words)
    return report("joint estimator", measured, words)


if __name__ == "__main__":
    sys.exit(main())
