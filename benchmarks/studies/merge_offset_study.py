"""How well the offset between two clocks is found, and whether its deviation is honest.

    python benchmarks/studies/merge_offset_study.py [--runs 100] [--seed 0] [--only mrad]

A vehicle turns about all axes (sums of random sines, slower than 0.4 Hz) and goes up and down. One file has its gyro
or its depth, the other its attitude or depth with noise of its own, on a clock that lies anywhere and, where it says
so, drifts. For each case: the root mean square error, the mean deviation that was told [ms], the share of the 95 %
intervals that hold the truth, and how many runs were refused.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np

from towtank.errors import InputError
from towtank.recording import Recording
from towtank.recording.merging.offset import clock_offset


class Case(NamedTuple):
    """What both files measure: seconds in common, rates [Hz], size of the motion, noise, drift of the second clock."""

    name: str
    seconds: float = 60.0
    gyro: float = 100.0
    attitude: float = 100.0
    size: float = 0.2  # rad/s, of yaw; half of it of roll and pitch
    gyro_noise: float = 2e-3  # rad/s
    attitude_noise: float = 2e-3  # rad
    depth_only: bool = False
    drift: float = 0.0


CASES = (
    Case("gyro 100 Hz, mocap 100 Hz, 60 s"),
    Case("the same, 20 s", seconds=20.0),
    Case("the same, 300 s, clock 50 ppm slow", seconds=300.0, drift=50e-6),
    Case("the same, 300 s, clock 400 ppm slow", seconds=300.0, drift=400e-6),
    Case("attitude of 10 mrad noise", attitude_noise=0.01),
    Case("attitude of 10 Hz", attitude=10.0),
    Case("gyro 25 Hz, attitude 4 Hz", gyro=25.0, attitude=4.0),
    Case("gentle: 0.03 rad/s of yaw", size=0.03),
    Case("gentle, attitude of 10 mrad noise", size=0.03, attitude_noise=0.01),
    Case("depth 10 Hz and 20 Hz, 1 cm of noise", depth_only=True, seconds=120.0),
)


def motion(rng: np.random.Generator, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies [rad/s], phases and amplitudes (4, 12) of roll, pitch, yaw [rad] and depth [m]."""
    omega = 2.0 * np.pi * rng.uniform(0.02, 0.4, (4, 12))
    sizes = size * np.array([[0.5], [0.5], [1.0], [1.0]])
    return omega, rng.uniform(0.0, 2.0 * np.pi, (4, 12)), sizes / np.sqrt(6.0) / omega


def values(how: tuple[np.ndarray, np.ndarray, np.ndarray], t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roll, pitch, yaw and depth (n, 4), and their rates."""
    omega, phase, size = how
    angle = omega[:, :, None] * t + phase[:, :, None]
    return (size[:, :, None] * np.sin(angle)).sum(1).T, ((size * omega)[:, :, None] * np.cos(angle)).sum(1).T


def pair(case: Case, rng: np.random.Generator) -> tuple[Recording, Recording, float]:
    """Two files of one run, and the offset in the middle of what they share [s]."""
    how = motion(rng, case.size)
    offset = float(rng.uniform(-500.0, 500.0))
    before, after = rng.uniform(0.0, 0.3, 2) * case.seconds  # of the second file, that the first one lacks
    rates = (10.0, 20.0) if case.depth_only else (case.gyro, case.attitude)
    t = np.arange(0.0, case.seconds, 1.0 / rates[0]) + rng.uniform(0.0, 1.0 / rates[0])
    t2 = np.arange(-before, case.seconds + after, 1.0 / rates[1]) + rng.uniform(0.0, 1.0 / rates[1])
    (x, rate), (x2, _) = values(how, t), values(how, t2)
    if case.depth_only:
        one = {"z": x[:, 3] + 0.01 * rng.normal(size=t.size)}
        two = {"z": x2[:, 3] + 0.01 * rng.normal(size=t2.size)}
    else:
        phi, theta = x[:, 0], x[:, 1]
        body = (
            rate[:, 0] - np.sin(theta) * rate[:, 2],
            np.cos(phi) * rate[:, 1] + np.cos(theta) * np.sin(phi) * rate[:, 2],
            -np.sin(phi) * rate[:, 1] + np.cos(theta) * np.cos(phi) * rate[:, 2],
        )
        one = {
            name: column + case.gyro_noise * rng.normal(size=t.size) for name, column in zip("pqr", body, strict=True)
        }
        angles = x2[:, :3] + case.attitude_noise * rng.normal(size=(t2.size, 3))
        two = dict(zip(("phi", "theta", "psi"), angles.T, strict=True))
    middle = 0.5 * (t[0] + t[-1])
    own = (t2 - middle) / (1.0 + case.drift) + middle - offset
    return Recording.from_table(t, one, source="a"), Recording.from_table(own, two, source="b"), offset


def main() -> None:
    """Print a line for each case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="cases whose name holds this")
    given = parser.parse_args()
    print(f"{'case':42}  rms ms  told ms  in 95 %  refused  drift ppm: rms, told")
    for case in (each for each in CASES if given.only in each.name):
        rng = np.random.default_rng(given.seed)
        errors, stds, drifts, refused = [], [], [], 0
        for _ in range(given.runs):
            first, second, offset = pair(case, rng)
            try:
                found = clock_offset(first, second)
            except InputError:
                refused += 1
                continue
            errors.append(found.offset - offset)
            stds.append(found.std)
            drifts.append((found.drift - case.drift, found.drift_std))
        if not errors:
            print(f"{case.name:42}  all refused")
            continue
        error, std, (off, told) = np.array(errors), np.array(stds), np.array(drifts).T
        held = 100.0 * np.mean(np.abs(error) < 1.96 * std)
        drift = f"{1e6 * np.sqrt(np.mean(off**2)):7.1f} {1e6 * told.mean():7.1f}" if told.any() else ""
        print(
            f"{case.name:42}  {1e3 * np.sqrt(np.mean(error**2)):6.2f}  {1e3 * std.mean():7.2f}  {held:7.0f}  "
            f"{refused:7d}  {drift}"
        )


if __name__ == "__main__":
    main()
