"""The drive, and what goes wrong: how soon thrust ends, and that nothing is sent afterwards.

    python benchmarks/studies/drive_study.py [--runs 1000] [--only faults,walls,sockets] [--output drive.json]

A simulated BlueROV2 Heavy under a simulated ArduSub (`simulated_sub.py`), 5 x 5 x 2.5 m. Never a real vehicle.

`faults`: `--runs` times a segment is begun and driven, and one of the faults of `drive_rig.py` befalls it at a moment
by chance; for a while by chance it stays, then all is well again, with the key held and the segment under way for one
more second. Simulated time; driver, interlock, guard, messages and their bytes are the real ones. Counted: the time
from the fault to the last command that was not neutral, and to sticks at rest in the vehicle; commands that were sent
after the stop was over.
`walls`: telegraphs on all axes up to the thrusters' limits, through sticks and mixer, by vehicles 30 % off their file,
a tenth as many runs of 8 s: how many touch a wall.
`sockets`: a live session over loopback UDP, learning all the while, in real time: each loss of `drive_link.py` three
times. These times are as long as the computer is busy.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cache

import numpy as np
from drive_link import ATTEMPTS, LOSSES, driven, lost, plan_of
from drive_rig import FAULTS, Rig, World
from guard_study import guard_of, scaled, telegraphs
from report import checks_table, show
from rich.table import Table
from runner import arguments, over, write_json
from simulated_sub import MANUAL, SimulatedSub
from summary import Check

from towtank.app.live.driving import helm_of
from towtank.core.arrays import Array
from towtank.live.driving.helm import Helm
from towtank.live.driving.interlock import PERIOD, Stage
from towtank.live.driving.sticks import Encoder, Way
from towtank.planning import Space
from towtank.readers.mavlink.senders import Sender
from towtank.vehicle import load_vehicle

SPACE, VEHICLE = "5x5x2.5", "bluerov2_heavy"
START = np.array([3.0, 1.0, 2.0, 0.0, 0.0, 1.0])  # of the link's own frame; the tank's is found at the switch
BATCH = 50  # faults of one rig
WALL_SECONDS = 8.0
WITHIN = 0.3  # s
LOSSES_EACH = 3


@dataclass(frozen=True)
class Stopped:
    """What came of one fault.

    Attributes:
        fault: its name. commands: from it to the last command that was not neutral [s]. thrust: to sticks at rest [s].
        after: commands sent after the stop was over. why: that was told.
    """

    fault: str
    commands: float
    thrust: float
    after: int
    why: str


@cache
def helm() -> Helm:
    return helm_of(load_vehicle(VEHICLE), Space.from_text(SPACE))


def gentle() -> Array:
    """Return a segment (n, 6) that stays near the start: surge, sway and yaw to and fro."""
    t = np.arange(200) / 25.0
    out = np.zeros((t.size, 6))
    out[:, 0], out[:, 1], out[:, 5] = (
        size * np.sign(np.sin(2.0 * math.pi * t / period)) for size, period in ((30.0, 1.1), (25.0, 0.9), (2.0, 0.7))
    )
    return out


def neutral_bytes(way: Way) -> tuple[bytes, ...]:
    """Return the payloads of a neutral command and of a release."""
    encoder = Encoder(way, 255, Sender(1, 1))
    return encoder.neutral()[10:-2], encoder.release()[10:-2]


def befall(rig: Rig, rng: np.random.Generator, number: int) -> Stopped:
    """Drive a segment, let one fault happen, and see what is sent."""
    fault = FAULTS[number % len(FAULTS)]
    sub = rig.sub
    rig.world, rig.sent[:] = World(key=False), []
    rig.starts, sub.armed, sub.mode, rig._still = math.inf, True, MANUAL, 0.0
    rig._frozen.clear()
    sub.place(START)
    rig.run(0.6)
    refused = rig.switch(True)
    rig.begin()
    rig.world.key = True
    rig.run(rig.lead + rng.uniform(0.2, 0.8))
    if refused or rig.stage is not Stage.DRIVING:
        raise RuntimeError(f"not driven before {fault.name}: {refused or rig.said[-1]}")
    began, still, thrust = sub.t, neutral_bytes(rig.way), math.nan
    fault.does(rig)
    for _ in range(round(rng.uniform(0.8, 1.2) / PERIOD)):
        rig.turn()
        if math.isnan(thrust) and not sub.thrusting:
            thrust = sub.t - began
    over_ = sub.t
    lasting = [t for t, data in rig.sent if t > began and data[10:-2] not in still]
    back, rig.world = rig.world.back, World(back=rig.world.back)
    sub.armed, sub.mode = True, MANUAL
    rig.run(1.0)
    rig.world.back = back
    after = sum(t > over_ for t, _ in rig.sent)
    rig.world = World()
    return Stopped(fault.name, max(lasting, default=began) - began, thrust, after, rig.said[-1])


def faults(first: int, count: int, seed: int) -> list[Stopped]:
    """Return what came of some faults, one after the other with one vehicle."""
    rng = np.random.default_rng([seed, first])
    way = Way.RC if (first // BATCH) % 2 else Way.MANUAL
    rig = Rig(SimulatedSub(load_vehicle(VEHICLE), START, seed=first), helm(), gentle(), way, lead=0.3)
    return [befall(rig, rng, first + k) for k in range(count)]


def wall(seed: int) -> tuple[float, float]:
    """Return the least clearance [m] of a run that a guard must keep in the tank, and the share of bent commands."""
    guard, rng = guard_of(VEHICLE), np.random.default_rng([seed, 7])
    truth = scaled(guard.vehicle, lambda: 1.0 + 0.3 * rng.choice([-1.0, 1.0]), 0.25)
    wrench = telegraphs(guard, seed, False)[: round(25 * WALL_SECONDS)] @ guard.brake.matrix.T
    steered, sub = Helm(guard), SimulatedSub(truth, START, seed=seed)
    rig = Rig(sub, steered, wrench, world=World(key=False))
    rig.run(0.6)
    refused = rig.switch(True)
    rig.begin()
    rig.world.key = True
    rig.run(0.1)
    least, bent, turns = math.inf, 0, 0
    while sub.t < rig.starts + WALL_SECONDS - PERIOD:
        rig.turn()
        place = steered._in_tank(sub.eta)
        least = min(least, float(guard.space.clearance(place[:3], guard.radius)))
        bent, turns = bent + steered.bent, turns + 1
        if rig.stage is not Stage.DRIVING:
            raise RuntimeError(f"seed {seed}: {refused or rig.said[-1]}")
    return least, bent / turns


def sockets() -> dict[str, list[tuple[float, int]]]:
    """Return for each loss how long thrust went on [s], and commands sent afterwards."""
    found: dict[str, list[tuple[float, int]]] = {name: [] for name in LOSSES}
    with driven(SimulatedSub(load_vehicle(VEHICLE), START), plan_of(ATTEMPTS * LOSSES_EACH * len(LOSSES))) as run:
        for _ in range(LOSSES_EACH):
            for name in LOSSES:
                found[name].append(lost(run, name))
    return found


def table(found: Sequence[Stopped]) -> Table:
    out = Table(title=f"{len(found)} faults, simulated time", title_justify="left")
    for name in (
        "fault",
        "runs",
        "thrust ends, median s",
        "longest",
        "last command, longest s",
        "sent after",
        "told as",
    ):
        out.add_column(name, justify="left" if name in ("fault", "told as") else "right")
    for fault in FAULTS:
        own = [each for each in found if each.fault == fault.name]
        if own:
            thrust = [each.thrust for each in own if math.isfinite(each.thrust)]
            out.add_row(
                fault.name, str(len(own)),
                f"{np.median(thrust):.2f}" if thrust else "-", f"{max(thrust):.2f}" if thrust else "-",
                f"{max(each.commands for each in own):.2f}", str(sum(each.after for each in own)), own[-1].why,
            )  # fmt: skip
    return out


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study; 0 where everything that must hold holds."""
    options = arguments(__doc__ or "", 1000, argv)
    parts = (options.only or "faults,walls,sockets").split(",")
    held: list[Check] = []
    document: dict[str, object] = {"study": "drive", "runs": options.runs, "seed": options.seed}
    if "faults" in parts:
        tasks = [(k, min(BATCH, options.runs - k), options.seed) for k in range(0, options.runs, BATCH)]
        found = [each for part in over("faults", faults, tasks, options.workers) for each in part]
        last = max(each.commands for each in found)
        ended = [each.thrust if math.isfinite(each.thrust) else math.inf for each in found]
        held += [
            Check("last command after a fault, longest, s", last, high=WITHIN, note=f"{len(found)} faults"),
            Check("thrust after a fault, longest, s", max(ended), high=WITHIN),
            Check("commands after a stop", float(sum(each.after for each in found)), high=0.0),
        ]
        document["faults"] = [asdict(each) for each in found]
        show(table(found))
    if "walls" in parts:
        runs = over("walls", wall, [(options.seed + k,) for k in range(max(options.runs // 10, 1))], options.workers)
        least, bent = np.array(runs).T
        held.append(Check("runs that touch a wall", float(np.sum(least <= 0.0)), high=0.0, note=f"{len(runs)} runs"))
        document["walls"] = {"clearance": least, "bent": bent}
        show(f"walls: least clearance {least.min():.3f} m, {100.0 * bent.mean():.0f} % of the time bent")
    if "sockets" in parts:
        links = sockets()
        for name, times in links.items():
            show(f"sockets, {name}: " + ", ".join(f"{took:.3f}" for took, _ in times) + " s")
        longest = [max(took if took >= 0.0 else math.inf for took, _ in times) for times in links.values()]
        held += [
            Check("thrust after a loss over sockets, longest, s", max(longest), high=WITHIN, note="real time"),
            Check("commands after it", float(sum(n for times in links.values() for _, n in times)), high=0.0),
        ]
        document["sockets"] = links
    show(checks_table("must hold", held))
    write_json(options.output, {**document, "checks": [check.document() for check in held]})
    return 0 if all(check.met for check in held) else 1


if __name__ == "__main__":
    sys.exit(main())
