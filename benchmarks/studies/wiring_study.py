"""Thrusters that push the other way than the file says, and outputs that are swapped: how often a log shows them.

    python benchmarks/studies/wiring_study.py [--runs 200] [--only VECTORED,SIMPLEROV_3] [--output wiring.json]

Each of ArduSub's frames, flown for 30 s by a pilot who pushes sticks while the autopilot holds roll and pitch where he
wants them; in the log are gyro and accelerometer (25 Hz), attitude, depth and commands (10 Hz), nothing else. Every
thruster turned by itself and every two outputs swapped must be found as they are (two wirings that make the same wrench
of the commands of a log are one); in `--runs` right logs nothing may be found, nor in as many of a vehicle that keeps
station for a minute: the autopilot holds depth and heading, too, against several times as much that pushes, the pilot
hardly touches the sticks, and a DVL (5 Hz) is in the log.

`--only real`, and without `--only` too where they are present: each recording of the boat, the pool and the run at sea,
with the file as it is, with thrusters turned one by one, some outputs swapped, and several thrusters turned. What is
found in part, or another wiring, is counted apart.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
from real_cases import BOAT_HALVES, POOL_RUNS, boat, data_folder, pool, sea
from report import checks_table, show
from rich.table import Table
from runner import arguments, over, write_json
from summary import Check

import towtank as tt
from towtank.identification.data.samples import prepared, samples_of
from towtank.identification.logs import as_wired
from towtank.identification.offline.joint import LearningRequest
from towtank.recording import Channel, Recording
from towtank.recording.standard import standard_of
from towtank.vehicle import Thruster, Vehicle, configuration_matrix
from towtank.vehicle.thrusters.ardusub import FRAMES, Frame
from towtank.vehicle.thrusters.wiring import Wiring, rewired

DURATION, KEEPING, DT = 30.0, 60.0, 0.02  # s
_ARMS = (0.15, 0.11, 0.2)  # m: ahead and beside of horizontal thrusters, beside of vertical ones
_RIGHTED = (0.0, 0.0, -0.03)  # m, centre of buoyancy: nobody drives a vehicle that tumbles when it goes ahead
_STICK, _TURNING = 0.5, 0.2  # of full thrust: 30 degrees of lean and 1.5 rad/s at most
_LEAN = 1.0  # rad of roll or pitch asked for by full stick
_STIFFNESS, _DAMPING = (0.1, 0.1), (0.04, 0.04, 0.05)  # of full thrust for 1 rad, and for 1 rad/s
_DEPTH, _SINKING, _HEADING = 0.4, 0.4, 0.2  # of full thrust for 1 m, 1 m/s and 1 rad, of a vehicle that keeps station
_BUSY, _SELDOM, _ROUGH = 0.5, 0.08, 4.0  # share of time in which sticks are pushed; disturbance beside the usual one
_BOTTOM = (0.004, 0.12)  # m/s, noise of the DVL; s by which it is late
_RIGHT = ("right", "keeping")  # kinds of logs in which nothing may be found


@dataclass(frozen=True)
class Found:
    """What a run came to: whether the wiring is taken as it is, and what was said."""

    frame: str
    kind: str
    right: bool
    said: str


def vehicle_of(frame: Frame) -> Vehicle:
    """A BlueROV2 Heavy's body with thrusters of which each does what the frame's table says of its motor."""
    base = tt.load_vehicle("bluerov2_heavy")
    curve = base.thrusters[0].curve
    thrusters = []
    for k, (X, Y, Z, K, M, N) in enumerate(frame.wrench.T):
        along = np.array([X, Y, Z]) / np.linalg.norm([X, Y, Z])
        if Z:
            place = (-np.sign(M * Z) * _ARMS[0], np.sign(K * Z) * _ARMS[2], 0.0)
        else:
            place = (N * np.sign(Y) * _ARMS[0], -N * np.sign(X) * _ARMS[1], -0.05 * np.sign(K * Y))
        direction = tuple(float(x) for x in along)
        where = tuple(float(x) for x in place)
        thrusters.append(
            Thruster(name=f"m{k + 1}", position=where, direction=direction, curve=curve, time_constant=0.05)
        )
    righted = base.buoyancy.model_copy(update={"centre": _RIGHTED})
    return base.model_copy(update={"thrusters": tuple(thrusters), "buoyancy": righted})


def flown(truth: Vehicle, frame: Frame, seed: int, *, keeping: bool = False) -> Recording:
    """A log under ArduSub's mixer, with sticks held for 0.7 to 3 s, half of them at rest, or nearly all (`keeping`)."""
    rng = np.random.default_rng(seed)
    n = round((KEEPING if keeping else DURATION) / DT)
    drives = np.abs(frame.wrench).sum(axis=1) > 0.0
    drives[3] &= frame.name not in ("BLUEROV1",)
    sticks = np.zeros((n, 6))
    for axis in np.flatnonzero(drives):
        k = 0
        while k < n:
            held = round(rng.uniform(0.7, 3.0) / DT)
            if rng.random() < (_SELDOM if keeping else _BUSY):
                most = _TURNING if axis == 5 else _STICK
                sticks[k : k + held, axis] = rng.choice((-1.0, 1.0)) * most * rng.uniform(0.3, 1.0)
            k += held
    eta, nu = np.array([0.0, 0.0, 3.0, 0.0, 0.0, rng.uniform(-3.0, 3.0)]), np.zeros(6)
    thrust, force = np.zeros(len(truth.thrusters)), np.zeros(6)
    level = (_ROUGH if keeping else 1.0) * np.array([0.5, 0.5, 0.5, 0.05, 0.05, 0.05])
    rows = {name: np.empty((n, 6)) for name in ("eta", "nu", "nu_dot")}
    pulses = np.empty((n, len(truth.thrusters)))
    signs = frame.wrench.T
    keep, heading = np.exp(-DT / 2.0), eta[5]
    for k in range(n):
        asked = sticks[k].copy()
        asked[3:5] = np.array(_STIFFNESS) * (_LEAN * asked[3:5] - eta[3:5])
        asked[3:] -= np.array(_DAMPING) * nu[3:]
        if keeping:
            asked[2] += _DEPTH * (3.0 - eta[2]) - _SINKING * nu[2]
            asked[5] += _HEADING * np.arctan2(np.sin(heading - eta[5]), np.cos(heading - eta[5]))
        asked[~drives] = 0.0
        pulses[k] = 1500.0 + 400.0 * np.clip(signs @ asked, -1.0, 1.0)
        thrust += DT / 0.1 * (pulses[k] - 1500.0 - thrust)
        force = keep * force + np.sqrt(1.0 - keep**2) * level * rng.standard_normal(6)
        tau = tt.thruster_wrench(truth, 1500.0 + thrust) + force
        rows["eta"][k], rows["nu"][k] = eta, nu
        half = nu + 0.5 * DT * tt.forward_dynamics(truth, eta, nu, tau)
        rows["nu_dot"][k] = tt.forward_dynamics(truth, eta, half, tau)
        nu = nu + DT * rows["nu_dot"][k]
        eta = eta + DT * _eta_dot(eta, nu)
    run = _logged(rows, pulses, rng)
    return run.replace(_bottom(rows["nu"], rng)) if keeping else run


def _bottom(nu: np.ndarray, rng: np.random.Generator) -> list[Channel]:
    """Speeds (n, 6) as a DVL shows them: over ground, in m/s along the body's axes (FRD), late."""
    noise, late = _BOTTOM
    shown = slice(0, None, 10)
    t = DT * np.arange(len(nu))[shown]
    return [
        _channel(name, t + late, nu[shown, j] + noise * rng.standard_normal(t.size)) for j, name in enumerate("uvw")
    ]


def _eta_dot(eta: np.ndarray, nu: np.ndarray) -> np.ndarray:
    from towtank.core.attitude import euler_rates_matrix, rotation_from_euler

    angles = euler_rates_matrix(eta[3], eta[4]) @ nu[3:]
    return np.concatenate([rotation_from_euler(*eta[3:]) @ nu[:3], angles])


def _logged(rows: dict[str, np.ndarray], pulses: np.ndarray, rng: np.random.Generator) -> Recording:
    t = DT * np.arange(len(pulses))
    fast, slow = slice(0, None, 2), slice(0, None, 5)
    phi, theta = rows["eta"][:, 3], rows["eta"][:, 4]
    gravity = 9.81 * np.column_stack([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
    turning = np.cross(rows["nu"][:, 3:], rows["nu"][:, :3])
    force = rows["nu_dot"][:, :3] + turning - gravity
    channels = []
    for j, name in enumerate("pqr"):
        noisy = rows["nu"][fast, 3 + j] + 0.005 * rng.standard_normal(t[fast].size)
        channels.append(_channel(name, t[fast], noisy))
    for j, name in enumerate(("ax", "ay", "az")):
        channels.append(_channel(name, t[fast], force[fast, j] + 0.1 * rng.standard_normal(t[fast].size)))
    for name, values, noise in (
        ("phi", phi, 0.005),
        ("theta", theta, 0.005),
        ("psi", np.angle(np.exp(1j * rows["eta"][:, 5])), 0.01),
        ("z", rows["eta"][:, 2], 0.01),
    ):
        channels.append(_channel(name, t[slow], values[slow] + noise * rng.standard_normal(t[slow].size)))
    channels += [_channel(f"cmd_m{k + 1}", t[slow], pulses[slow, k]) for k in range(pulses.shape[1])]
    return Recording({each.name: each for each in channels})


def _channel(name: str, t: np.ndarray, values: np.ndarray) -> Channel:
    return Channel(name, t, values, *standard_of(name)[:2])


def case(name: str, wiring: Wiring, seed: int, keeping: bool = False) -> Found:
    """Fly a frame, and look with a file whose wiring differs."""
    frame = next(each for each in FRAMES.values() if each.name == name)
    truth = vehicle_of(frame)
    supposed = rewired(truth, wiring)
    run = prepared(flown(truth, frame, seed, keeping=keeping), supposed)
    samples = samples_of(run, supposed)
    request, findings = as_wired(LearningRequest(supposed, [run], [samples]))
    found, as_it_is = (configuration_matrix(vehicle) for vehicle in (request.vehicle, truth))
    right = np.allclose(samples.input_force @ found.T, samples.input_force @ as_it_is.T, atol=1e-6)
    kind = "swapped" if wiring.swapped else "turned" if wiring.turned else "keeping" if keeping else "right"
    return Found(name, kind, right, "; ".join(finding.text for finding in findings))


@cache
def _recorded(name: str) -> tuple[Vehicle, tuple[Recording, ...]]:
    """A vehicle, wired as it is, with one of its real recordings in the body frame."""
    kind, _, which = name.partition(" ")
    data = data_folder() or Path()
    if kind == "sea":
        vehicle, runs = sea(data)
    else:
        learned = {"boat": boat, "pool": pool}[kind](data)
        vehicle, runs = learned.vehicle, [learned.read(which)]
    return vehicle, tuple(prepared(run, vehicle) for run in runs)


def real_case(name: str, wiring: Wiring) -> Found:
    """Look at a real recording with a file whose wiring differs."""
    vehicle, runs = _recorded(name)
    supposed = rewired(vehicle, wiring)
    samples = tuple(samples_of(run, supposed) for run in runs)
    request, findings = as_wired(LearningRequest(supposed, runs, samples))
    found, as_it_is = (configuration_matrix(each) for each in (request.vehicle, vehicle))
    right = all(np.allclose(each.input_force @ found.T, each.input_force @ as_it_is.T, atol=1e-6) for each in samples)
    kind = "right" if not wiring else "wrong"
    return Found(name.partition(" ")[0], kind, right, "; ".join(finding.text for finding in findings))


def real_wirings(n: int) -> list[Wiring]:
    """The file as it is, and ways in which it is made wrong on purpose."""
    some = [Wiring((k,)) for k in range(0, n, 2 if n > 6 else 1)]
    if n == 2:
        return [Wiring(), *some, Wiring((0, 1)), Wiring((), (0, 1))]
    swaps = [Wiring((), pair) for pair in (((0, 3), (1, 2), (2, 4)) if n == 6 else ((0, 3), (2, 4), (1, 6)))]
    return [Wiring(), *some, *swaps, Wiring(tuple(range(n))), *([Wiring((3, 4, 6, 7))] if n == 8 else [])]


def real_table(workers: int) -> tuple[Table, list[Found]]:
    """How real recordings are judged."""
    names = ["sea", *(f"pool {run}" for run in POOL_RUNS), *(f"boat {log}" for half in BOAT_HALVES for log in half)]
    tasks = [(name, way) for name in names for way in real_wirings(len(_recorded(name)[0].thrusters))]
    found = over("real recordings", real_case, tasks, workers)
    table = Table(title="real recordings, the file right, or made wrong on purpose", title_justify="left")
    for title in ("of", "right: not doubted", "wrong: found as it is", "nothing found", "in part or another"):
        table.add_column(title, justify="left" if title == "of" else "right")
    for kind in ("sea", "pool", "boat"):
        right = [each.right for each in found if each.frame == kind and each.kind == "right"]
        wrong = [each for each in found if each.frame == kind and each.kind == "wrong"]
        missed = sum(not each.right and not each.said for each in wrong)
        well = sum(each.right for each in wrong)
        table.add_row(
            kind,
            f"{sum(right)} of {len(right)}",
            f"{well} of {len(wrong)}",
            str(missed),
            str(len(wrong) - well - missed),
        )
    return table, found


def simulated_table(frames: Sequence[str], runs: int, seed: int, workers: int) -> tuple[Table, list[Found]]:
    """How simulated runs of ArduSub's frames are judged."""
    cases: list[tuple[str, Wiring, int, bool]] = []
    for k, frame in enumerate(each for each in FRAMES.values() if each.name in frames):
        n, B = len(frame.motors), configuration_matrix(vehicle_of(frame))
        wrong = [Wiring((i,)) for i in range(n)]
        wrong += [
            Wiring((), pair) for pair in combinations(range(n), 2) if not np.allclose(B[:, pair[0]], B[:, pair[1]])
        ]
        right = -(-runs // len(frames))
        for j, wiring in enumerate([*wrong, *([Wiring()] * right)]):
            cases.append((frame.name, wiring, seed + 1000 * k + j, False))
        cases += [(frame.name, Wiring(), seed + 1000 * k + j, True) for j in range(right)]
    found = over("wirings", case, cases, workers)
    table = Table(title="wirings found as they are, 30 s each (60 s keeping station)", title_justify="left")
    for name in ("frame", "turned", "swapped", "right", "right, keeping station"):
        table.add_column(name)
    for frame_name in frames:
        own = [each for each in found if each.frame == frame_name]
        cells = []
        for kind in ("turned", "swapped", "right", "keeping"):
            some = [each.right for each in own if each.kind == kind]
            cells.append(f"{sum(some)} of {len(some)}")
        table.add_row(frame_name, *cells)
    return table, found


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where everything that must hold holds."""
    options = arguments(__doc__ or "", 200, argv)
    only = options.only.split(",") if options.only else [*(frame.name for frame in FRAMES.values()), "real"]
    frames = [name for name in only if name != "real"]
    found: list[Found] = []
    checks: list[Check] = []
    if frames:
        table, found = simulated_table(frames, options.runs, options.seed, options.workers)
        show(table)
        share = float(np.mean([each.right for each in found if each.kind not in _RIGHT]))
        checks.append(Check("share of wrong wirings found", share, low=0.99))
    if "real" in only and data_folder() is not None:
        table, more = real_table(options.workers)
        show(table)
        found += more
    doubted = sum(not each.right for each in found if each.kind in _RIGHT)
    checks.append(Check("right logs with a find", float(doubted), high=0.0))
    show(checks_table("must hold", checks))
    rows = [{"frame": each.frame, "kind": each.kind, "right": each.right, "said": each.said} for each in found]
    write_json(options.output, {"study": "wiring", "runs": rows, "checks": [each.document() for each in checks]})
    return 0 if all(check.met for check in checks) else 1


if __name__ == "__main__":
    sys.exit(main())
