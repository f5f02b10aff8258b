"""Fleets put to the test: 40 runs of 5 vehicles are pooled, and a sixth vehicle is learned from 10 s.

    python benchmarks/studies/pool_study.py [--runs 200] [--seed 1] [--workers 2] [--real 3] [--boat] [--output FILE]

Every coefficient of a class of BlueROV2 Heavies is drawn about what physics says. Vehicles differ from their class by
10 % (each total inertia by its logarithm, all else as a share of the class), runs of one by 3 %, thrusters
by 2 %, and the scale of thrust is drawn once for the class, as uncertain as its prior. What a run of 60 s makes known,
with a DVL, gyro and depth, is the information of the joint filter along a manoeuvre (`planning.forecast`), over all
unknowns together; half of the runs drive one axis alone. The posterior that learning would give is drawn from it: with
the prior in it, delay, latencies and constant forces drawn anew for each run. It is written as a learned model, and
`pool` reads that. So 200 fleets of 40 runs take minutes, not the days that learning would.

--real N: a fleet of 8 simulated logs of 20 s of 4 vehicles, and N further vehicles from their first 10 s, without the
fleet and with it, all by `learn` itself; the models then predict 20 s that they have not seen. 5 s a log, hence 0 by
default. --boat: the boat's eight logs of `real_cases.py`, each learned by itself, then pooled; all of them, and without
the two in which it spins.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from real_cases import BOAT_HALVES, SPINS, boat, data_folder
from report import checks_table, show
from rich.table import Table
from runner import over, write_json
from summary import Check

from towtank import load_vehicle, simulate
from towtank.campaigns import Fleet, Run, pool
from towtank.campaigns.pooling import per_thrust, thrust_undone
from towtank.core.arrays import Array
from towtank.identification import learn_recordings
from towtank.identification.model.parameters import GAIN_PREFIX
from towtank.identification.model.prior import Prior, prior_of
from towtank.identification.posterior.result import with_posterior
from towtank.planning import RATE, Outlook, forecast
from towtank.recording import Recording
from towtank.simulation import Ins, OrnsteinUhlenbeck, manoeuvre
from towtank.validation import validate
from towtank.vehicle import COEFFICIENTS, Vehicle, index
from towtank.vehicle.posterior import with_coordinates

NAME, SENSORS = "bluerov2_heavy", "dvl"
VEHICLES, RUNS, SECONDS, FIRST = 5, 8, 60.0, 10.0
BETWEEN, WITHIN, THRUSTERS = 0.10, 0.03, 0.02
MANOEUVRES = (
    *(("all-multisine", seed) for seed in (1, 2, 3, 4)),
    *((f"{a}-multisine", 5) for a in ("surge", "sway", "heave", "yaw")),
)
JUDGED = tuple(f"{r}_{c}{end}" for end in ("dot", "", "@") for r, c in zip("XYZKMN", "uvwpqr", strict=True))
JUDGED = tuple(name.replace(f"{name[2]}@", 2 * name[2]) for name in JUDGED)
DRAWN, COUPLED = 0.5, 0.2  # how far the class is from physics: of a logarithm of damping, of the deviation of couplings


class Template(NamedTuple):
    """What a run makes known (n, n), about theta (n,) of the file."""

    information: Array
    theta: Array


@dataclass(frozen=True, eq=False)
class Outcome:
    """Of one fleet, a number for each judged coefficient (k,): whether the interval of the class held it, spreads as
    shares of the truth (NaN where not shown), errors of the new vehicle as shares of its coefficient, without and with.
    """

    held: Array
    between: Array
    within: Array
    without: Array
    with_fleet: Array
    stated: Array


@cache
def outlook() -> Outlook:
    """Return what is known of the vehicle: rigid body and thrusters, and of the rest what physics says."""
    file = load_vehicle(NAME)
    return Outlook.of(
        Vehicle(name=NAME, rigid_body=file.rigid_body, buoyancy=file.buoyancy, thrusters=file.thrusters), SENSORS
    )


@cache
def templates() -> tuple[Template, ...]:
    """Return what each manoeuvre makes known, and the first 10 s of a new vehicle last."""
    known = outlook().known
    middle = outlook().vehicle.with_coefficients(known.vehicle_values)
    drives = [(name, SECONDS, seed) for name, seed in MANOEUVRES] + [("all-multisine", FIRST, 9)]
    out = []
    for name, seconds, seed in drives:
        commands = manoeuvre(name, middle, duration=seconds, dt=1.0 / RATE, seed=seed).commands
        found = forecast(outlook(), middle, np.asarray(commands))
        root = np.linalg.cholesky(known.covariance)
        white = np.linalg.solve(root, np.linalg.solve(root, found.covariance).T)
        shares, axes = np.linalg.eigh(0.5 * (white + white.T))
        back = np.linalg.solve(root.T, axes)
        out.append(Template((back * np.maximum(1.0 / shares - 1.0, 0.0)) @ back.T, found.theta))
    return tuple(out)


def posterior(prior: Prior, template: Template, theta: Array, chance: np.random.Generator) -> tuple[Array, Array]:
    """Return mean (n,) and covariance (n, n) of what a run of a vehicle at theta (n,) teaches.

    The template's information is that on multiples of the thrust. Learning is linearised about its own answer.
    """
    back = np.linalg.inv(per_thrust(prior.free, template.theta)[1])
    information = back.T @ template.information @ back
    values, axes = np.linalg.eigh(0.5 * (information + information.T))
    noise = axes @ (np.sqrt(np.maximum(values, 0.0)) * chance.standard_normal(values.size))
    score = information @ per_thrust(prior.free, theta)[0] + noise
    mean = theta
    for _ in range(4):
        q, turn = per_thrust(prior.free, mean)
        near, covariance = prior.seen_from(mean)
        before, data = np.linalg.inv(covariance), turn.T @ information @ turn
        after = np.linalg.inv(before + data)
        after = 0.5 * (after + after.T)
        mean = after @ (before @ near + data @ mean + turn.T @ (score - information @ q))
    return mean, after


def learned(prior: Prior, mean: Array, covariance: Array) -> Vehicle:
    """Return the model that learning makes of a posterior."""
    at = np.where(prior.free.signs < 0.0, prior.free.rigid - mean, mean)
    at = np.where(kinds(prior)["damping"], np.minimum(at, 0.0), at)
    at = np.where(np.array(prior.names) == "delay", np.maximum(at, 0.0), at)
    return with_posterior(with_coordinates(outlook().vehicle, prior.names, at), prior, mean, covariance)


@cache
def kinds(prior: Prior) -> dict[str, Array]:
    """Return masks (n,) of the unknowns: those of a run, gains, total inertias, damping on the diagonal."""
    names = prior.names
    of_a_run = [
        n == "delay" or n.startswith(("latency", "imu")) or (n in COEFFICIENTS and index(n)[0] == "constant")
        for n in names
    ]
    damping = [
        n in COEFFICIENTS and index(n)[0] in ("linear", "quadratic") and index(n)[1] == index(n)[2] for n in names
    ]
    return {
        "run": np.array(of_a_run),
        "gain": np.array([n.startswith(GAIN_PREFIX) for n in names]),
        "inertia": np.array([n.endswith("dot") and index(n)[1] == index(n)[2] for n in names]),
        "damping": np.array(damping),
    }


def drawn_class(prior: Prior, chance: np.random.Generator) -> Array:
    """Return theta (n,) of a class."""
    kind = kinds(prior)
    away = np.clip(chance.standard_normal(len(prior.mean)), -1.5, 1.5)
    share = np.select([kind["gain"], kind["inertia"]], [1.0, 1.0], COUPLED)
    return np.where(kind["damping"], prior.mean * np.exp(DRAWN * away), prior.mean + share * prior.std * away)


def moved(prior: Prior, theta: Array, share: float, thrusters: float, chance: np.random.Generator) -> Array:
    """Return theta (n,) of a vehicle of the class, or of a run of the vehicle, that differs by a share."""
    kind = kinds(prior)
    q, _ = per_thrust(prior.free, theta)
    size = np.where(kind["inertia"], 1.0, np.abs(q))
    std = np.where(kind["gain"], thrusters, np.where(kind["run"], 0.0, share * size))
    return thrust_undone(prior.free, q + std * chance.standard_normal(q.size))[0]


def perform(seed: int) -> Outcome:
    """Pool one fleet."""
    chance = np.random.default_rng(seed)
    prior, (*drives, first) = outlook().known, templates()
    kind = kinds(prior)
    middle = drawn_class(prior, chance)
    runs = []
    for v in range(VEHICLES):
        vehicle = moved(prior, middle, BETWEEN, THRUSTERS, chance)
        for r in range(RUNS):
            theta = moved(prior, vehicle, WITHIN, 0.0, chance)
            theta = np.where(kind["run"], prior.mean + prior.std * chance.standard_normal(theta.size), theta)
            mean, covariance = posterior(prior, drives[r], theta, chance)
            runs.append(Run(f"vehicle {v}", NAME, f"{v}-{r}", learned(prior, mean, covariance), outlook().vehicle))
    fleet = pool(runs)
    return outcome(fleet, middle, first, chance)


def outcome(fleet: Fleet, middle: Array, first: Template, chance: np.random.Generator) -> Outcome:
    """Compare what a fleet says with its truth, and let it help a new vehicle."""
    prior, found = outlook().known, fleet[NAME]
    values = prior.free.values(middle)
    truth = {name: float(values[k]) for k, name in enumerate(prior.names)}
    slopes = np.abs(prior.free.slopes(middle))
    sizes = {n: float(slopes[k] if n.endswith("dot") else abs(values[k])) for k, n in enumerate(prior.names)}
    held, between, within = [], [], []
    for name in JUDGED:
        each = found[name]
        held.append(each.low <= truth[name] <= each.high)
        for out, spread, true in ((between, each.between, BETWEEN), (within, each.within, WITHIN)):
            out.append(np.nan if spread is None else spread / each.size / true)
    new = moved(prior, middle, float(np.hypot(BETWEEN, WITHIN)), THRUSTERS, chance)
    new = np.where(kinds(prior)["run"], prior.mean + prior.std * chance.standard_normal(new.size), new)
    late = [name for name in prior.names if name.startswith("latency")]
    helped = prior_of(outlook().vehicle, more=late, beside=found.vehicle)
    seed = int(chance.integers(1 << 30))
    errors, stated = [], np.empty(0)
    for each in (prior, helped):
        mean, covariance = posterior(each, first, new, np.random.default_rng(seed))
        rows = [each.names.index(name) for name in JUDGED]
        size = np.array([1.0 if name.endswith("dot") else sizes[name] for name in JUDGED])
        errors.append((mean - new)[rows] / size)
        stated = np.sqrt(np.diag(covariance)[rows]) / size
    return Outcome(np.array(held, dtype=np.float64), np.array(between), np.array(within), errors[0], errors[1], stated)


def rms(errors: Array, axis: int | None = None) -> Array:
    return np.sqrt(np.mean(errors**2, axis=axis))


def table(found: Sequence[Outcome]) -> tuple[Table, list[Check]]:
    """Return what is seen of each coefficient, and what must hold."""
    made = Table(title=f"{len(found)} fleets of {VEHICLES * RUNS} runs of {VEHICLES} vehicles", title_justify="left")
    heads = (
        "Coefficient",
        "class within 95 %",
        "vehicles ± / truth",
        "runs ± / truth",
        "10 s without %",
        "with %",
        "ratio",
    )
    for head in (*heads, "new one within 95 %"):
        made.add_column(head, justify="left" if head == "Coefficient" else "right")
    held = np.array([each.held for each in found])
    between, within = (np.array([getattr(each, key) for each in found]) for key in ("between", "within"))
    without, helped = (np.array([getattr(each, key) for each in found]) for key in ("without", "with_fleet"))
    covered = np.abs(helped) <= 1.96 * np.array([each.stated for each in found])
    medians = [np.nanmedian(each, axis=0) for each in (between, within)]
    for k, name in enumerate(JUDGED):
        errors = float(rms(without[:, k])), float(rms(helped[:, k]))
        made.add_row(
            name, f"{held[:, k].mean():.3f}", *(f"{each[k]:.2f}" for each in medians),
            *(f"{100.0 * each:.1f}" for each in errors), f"{errors[1] / errors[0]:.2f}", f"{covered[:, k].mean():.3f}",
        )  # fmt: skip
    shares, ratio = held.mean(axis=0), float(rms(helped) / rms(without))
    checks = [
        Check("class within 95 %: least share", float(shares.min()), 0.90, 0.98, JUDGED[int(shares.argmin())]),
        Check("class within 95 %: largest share", float(shares.max()), 0.90, 0.98, JUDGED[int(shares.argmax())]),
    ]
    for key, middle, all_of in (("vehicles", medians[0], between), ("runs", medians[1], within)):
        shown = float(np.isfinite(all_of).mean())
        note = f"shown in {100.0 * shown:.0f} %; mean over seeds {np.nanmean(all_of, axis=0).min():.2f}"
        note += f" .. {np.nanmean(all_of, axis=0).max():.2f}"
        checks.append(Check(f"spread of {key} / truth: least median", float(middle.min()), 0.7, 1.3, note))
        checks.append(Check(f"spread of {key} / truth: largest median", float(middle.max()), 0.7, 1.3))
    checks.append(Check("new vehicle, 10 s: error with / without", ratio, high=0.7))
    return made, checks


# -- by learning itself

CHANNELS = ("u", "v", "w", "p", "q", "r")


def driven(prior: Prior, theta: Array, seconds: float, seed: int) -> Recording:
    """Return a log of a vehicle at theta (n,): DVL, inertial sensors and depth, a random force of 0.3 N."""
    file = outlook().vehicle
    kept = [k for k, name in enumerate(prior.names) if not name.startswith("latency")]
    at = np.where(prior.free.signs < 0.0, prior.free.rigid - theta, theta)[kept]
    vehicle = with_coordinates(file, [prior.names[k] for k in kept], at)
    push = OrnsteinUhlenbeck(std=(0.3,) * 3 + (0.03,) * 3, time_constant=2.0)
    commands = manoeuvre("all-multisine", file, duration=seconds, dt=0.01, seed=seed).commands
    return simulate(vehicle, commands=commands, dt=0.01, sensors=Ins(), disturbance=push, seed=seed)


def by_learning(new: int, seed: int) -> Table:
    """Return errors of new vehicles learned from 10 s, without and with a fleet that was learned from logs."""
    chance, prior = np.random.default_rng(seed), outlook().known
    kind, file = kinds(prior), outlook().vehicle
    middle = np.where(kind["inertia"] | kind["damping"] | kind["gain"], drawn_class(prior, chance), prior.mean)
    runs = []
    for v in range(4):
        vehicle = moved(prior, middle, BETWEEN, THRUSTERS, chance)
        for r in range(2):
            theta = moved(prior, vehicle, WITHIN, 0.0, chance)
            model = learn_recordings(file, [driven(prior, theta, 20.0, 100 * seed + 10 * v + r)]).model
            runs.append(Run(f"vehicle {v}", NAME, f"{v}-{r}", model, file))
    fleet = pool(runs)[NAME].vehicle
    made = Table(title=f"learned from {FIRST:g} s, by learn itself", title_justify="left")
    heads = (
        "vehicle",
        "coefficients, error without %",
        "with %",
        "ratio",
        "20 s unseen, error without %",
        "with %",
        "ratio",
    )
    for head in heads:
        made.add_column(head, justify="right")
    for k in range(new):
        theta = moved(prior, middle, float(np.hypot(BETWEEN, WITHIN)), THRUSTERS, chance)
        first, unseen = (
            driven(prior, theta, seconds, 7000 + 100 * seed + 10 * k + i) for i, seconds in ((0, FIRST), (1, 20.0))
        )
        truth = dict(zip(prior.names, prior.free.values(theta), strict=True))
        size = [np.exp(theta[prior.names.index(n)]) if n.endswith("dot") else abs(truth[n]) for n in JUDGED]
        row = []
        for beside in (None, fleet):
            model = learn_recordings(file, [first], prior=beside).model
            away = [(model.coefficient(n) - truth[n]) / each for n, each in zip(JUDGED, size, strict=True)]
            fit = validate(model, [unseen]).fit
            missed = np.mean([1.0 - (fit[name] or 0.0) / 100.0 for name in CHANNELS])
            row.append((float(rms(np.array(away))), float(missed)))
        cells = [
            cell
            for i in (0, 1)
            for cell in (f"{100 * row[0][i]:.1f}", f"{100 * row[1][i]:.1f}", f"{row[1][i] / row[0][i]:.2f}")
        ]
        made.add_row(str(k + 1), *cells)
    return made


def of_the_boat() -> list[Table]:
    """Return what the boat's logs say together, all eight of them and the six with surge."""
    data = data_folder()
    if data is None:
        return []
    logs = boat(data)
    names = [name for half in BOAT_HALVES for name in half]
    runs = {name: Run("boat", "blueboat_2024", name, logs.learn(name).model, logs.vehicle) for name in names}
    out = []
    for title, chosen in (("all eight logs", names), ("six logs", [name for name in names if name not in SPINS])):
        found = pool([runs[name] for name in chosen])
        made = Table(title=f"the boat, {title}", title_justify="left")
        for head in found.HEADS:
            made.add_column(head.lstrip(">"), justify="right" if head.startswith(">") else "left")
        for row in found.classes[0].rows():
            made.add_row(*row)
        made.caption = "; ".join(each.text for each in found.classes[0].outliers) or "no outlier"
        out.append(made)
    return out


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; return 1 where something does not hold."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200, help="fleets (default 200)")
    parser.add_argument("--seed", type=int, default=1, help="of the first fleet (default 1)")
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--real", type=int, default=0, help="new vehicles learned from real logs (default 0)")
    parser.add_argument("--boat", action="store_true", help="pool the boat's eight logs")
    parser.add_argument("--output", type=Path, help="JSON file to write")
    options = parser.parse_args(argv)
    if options.real:
        show(by_learning(options.real, options.seed))
    if options.boat:
        show(*of_the_boat())
    if not options.runs:
        return 0
    found = over("fleets", perform, [(options.seed + k,) for k in range(options.runs)], options.workers)
    made, checks = table(found)
    show(made)
    show(checks_table("must hold", checks))
    outcomes = {key: np.array([getattr(each, key) for each in found]) for key in Outcome.__dataclass_fields__}
    document = {"study": "pool", "judged": JUDGED, "checks": [each.document() for each in checks], **outcomes}
    write_json(options.output, document)
    return 0 if all(each.met for each in checks) else 1


if __name__ == "__main__":
    sys.exit(main())
