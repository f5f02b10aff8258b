"""What counts of a stream: the same as of the log of it, but for what only the whole log can tell."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from towtank.core.arrays import Array
from towtank.core.attitude import quaternions_from_eulers
from towtank.recording import Channel, Recording
from towtank.recording.grids.free_motion import DEPTH_BELOW_SURFACE, free_motion
from towtank.recording.grids.online_free_motion import OnlineFreeMotion, Standing
from towtank.recording.standard import QUATERNION
from towtank.vehicle import Vehicle, load_vehicle

SECONDS, RATE = 100.0, 20.0
T = np.arange(round(SECONDS * RATE) + 1) / RATE
ROV = load_vehicle("bluerov2")
BOAT = load_vehicle("blueboat")
DEEP = dict([DEPTH_BELOW_SURFACE])
States = Mapping[str, tuple[list[float], list[float]]]


def dive(states: States | None = None, attributes: Mapping[str, str] | None = None, **columns: Array) -> Recording:
    """A run under water, level, with commands at 20 Hz; columns take the place of its own."""
    own = {"z": np.full(T.size, 3.0), "phi": 0.1 * np.sin(T), "theta": 0.1 * np.cos(T), "r": np.sin(T)}
    run = Recording.from_table(T, {**own, "cmd_1": 1500.0 + 100.0 * np.sign(np.sin(T)), **columns}, source="dive")
    run = run.replace([Channel(name, *pair, "1") for name, pair in (states or {}).items()])
    return Recording(run.channels, run.source, attributes=DEEP if attributes is None else attributes)


def instants(run: Recording) -> list[tuple[float, dict[str, float]]]:
    """The channels of a recording, one instant after the other."""
    found: dict[float, dict[str, float]] = {}
    for channel in run.channels.values():
        for t, value in zip(channel.t.tolist(), channel.values.tolist(), strict=True):
            found.setdefault(t, {})[channel.name] = value
    return sorted(found.items())


def counted(run: Recording, vehicle: Vehicle = ROV) -> tuple[Array, Array]:
    """Return the instants of a stream (n,), and whether each counts (n,) once all that is in doubt is decided."""
    water = OnlineFreeMotion(vehicle)
    times, counts = [], np.zeros(len(instants(run)), dtype=bool)
    held: list[int] = []
    for k, (t, sample) in enumerate(instants(run)):
        times.append(t)
        standing = water.see(t, sample, run.attributes).standing
        held = [] if standing is Standing.LEFT_OUT else [*held, k]
        if standing is Standing.COUNTS:
            counts[held] = True
            held = []
    counts[held] = True
    return np.array(times), counts


def of_log(run: Recording, t: Array, vehicle: Vehicle = ROV) -> Array:
    found = free_motion(run, vehicle)
    cut = [each for each in found.left_out if each.kind != "too short"]
    return ~np.any([(t >= each.start) & (t < each.end) for each in cut] or [np.zeros(t.size, dtype=bool)], axis=0)


def assert_agree(run: Recording, vehicle: Vehicle = ROV, within: float = 0.11, doubt: float = 0.0) -> None:
    """Stream and log leave out the same, edges within a sample or two; the stream also `doubt` [s] before a cut."""
    t, mine = counted(run, vehicle)
    log = of_log(run, t, vehicle)
    edges = np.flatnonzero(np.diff(log)) + 1
    sure = np.all([np.abs(t - t[edge]) > within for edge in edges] or [np.ones(t.size, dtype=bool)], axis=0)
    assert not (sure & mine & ~log).any()
    begun = [t[edge] for edge in edges if not log[edge]]
    before = np.any([(t >= each - doubt) & (t < each) for each in begun] or [np.zeros(t.size, dtype=bool)], axis=0)
    assert not (sure & ~mine & log & ~before).any()


def between(start: float, end: float, inside: float, outside: float) -> Array:
    return np.where((start <= T) & (end > T), inside, outside)


def test_a_run_under_water_counts_whole_and_nothing_of_it_is_ever_in_doubt() -> None:
    water = OnlineFreeMotion(ROV)
    assert {water.see(t, sample, DEEP).standing for t, sample in instants(dive())} == {Standing.COUNTS}


@pytest.mark.parametrize(
    "run",
    [
        dive({"armed": ([0.0, 41.0, 90.0], [0.0, 1.0, 0.0])}),
        dive({"mode": ([0.0, 50.0, 70.0], [19.0, 9.0, 19.0])}, DEEP | {"modes": "9 SURFACE, 19 MANUAL"}),
        dive({"mode": ([0.0, 50.0, 70.0], [19.0, 4.0, 19.0])}, DEEP | {"modes": "4 GUIDED, 19 MANUAL"}),
        dive({"bottomed": ([0.0, 12.0, 30.0], [0.0, 1.0, 0.0])}),
        dive(z=between(20.0, 30.0, 0.02, 3.0)),
        dive(z=between(20.0, 30.0, 0.02, 3.0), attributes={}),
        dive(z=between(60.0, 60.3, -0.3, 3.0)),  # a spike
        dive(z=between(20.0, 20.6, 0.0, 3.0) + between(21.2, 21.9, 0.0, 3.0) - 3.0),  # two in a row are one surfacing
        dive(z=np.where((T >= 20.0) & (T < 30.0), 0.06 + 0.06 * np.sin(4.0 * T), 3.0)),  # waves
        dive(phi=between(40.0, 55.0, 3.0, 0.1)),
        dive(phi=np.pi * np.sin(0.9 * T)),  # tumbling
        dive(theta=between(20.0, 60.0, 1.5, 0.0)),
        dive(phi=np.full(T.size, 3.1)),  # the sensor is mounted so
        dive({"mode": ([0.0, 30.0], [19.0, 1.0])}, {"modes": "1 ACRO, 19 MANUAL"}, phi=between(40.0, 55.0, 3.0, 0.1)),
    ],
    ids=[
        *("disarmed", "a mode that comes up", "a mode that counts", "bottom", "surface", "depth from anywhere"),
        *("a splash", "two splashes", "waves", "on its back", "tumbling", "vertical", "mounted so", "acrobatic"),
    ],
)
def test_the_stream_leaves_out_what_the_log_does(run: Recording) -> None:
    assert_agree(run)


def test_the_attitude_counts_whatever_tells_it() -> None:
    run = dive(phi=between(40.0, 55.0, 3.0, 0.1))
    phi, theta = run["phi"].values, run["theta"].values
    q = quaternions_from_eulers(np.column_stack([phi, theta, 0.3 * T]))
    turned = run.without("phi", "theta")
    columns = dict(zip(QUATERNION, q.T, strict=True))
    assert_agree(Recording(turned.replace(Recording.from_table(T, columns).channels).channels, attributes=DEEP))
    down = np.column_stack([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])
    force = dict(zip(("ax", "ay", "az"), -9.8 * down.T, strict=True))
    by_force = Recording(turned.replace(Recording.from_table(T, force).channels).channels, attributes=DEEP)
    assert_agree(by_force, within=0.6)  # a mean over the second before, where the log has the one around
    _, counts = counted(by_force)
    assert 14.0 < np.count_nonzero(~counts) / RATE < 16.0


def test_before_the_first_command_nothing_counts() -> None:
    late = dive().without("cmd_1")
    t = np.arange(10.0, 100.0, 0.05)
    assert_agree(late.replace(Recording.from_table(t, {"cmd_1": np.sin(t)}).channels))


def test_a_boat_counts_at_the_surface_until_it_has_dived() -> None:
    flat = dive(z=np.full(T.size, 0.01))
    assert counted(flat, BOAT)[1].all()
    assert not counted(flat, ROV)[1].any()
    z = between(20.0, 30.0, 3.0, 0.02)
    t, counts = counted(dive(z=z), BOAT)
    assert counts[t < 30.0].all()  # the log of it would leave out the start as well
    assert not counts[t > 30.1].any()


def test_instants_are_in_doubt_no_longer_than_it_takes() -> None:
    for run, longest in ((dive(z=between(20.0, 30.0, 0.0, 3.0)), 1.0), (dive(phi=between(40.0, 55.0, 3.0, 0.1)), 5.0)):
        water, since = OnlineFreeMotion(ROV), np.nan
        for t, sample in instants(run):
            found = water.see(t, sample, DEEP)
            since = (since if np.isfinite(since) else t) if found.standing is Standing.IN_DOUBT else np.nan
            assert not t - since > longest


def test_depths_and_attitudes_that_stop_say_nothing_after_two_seconds() -> None:
    run = dive(z=between(20.0, 30.0, 0.0, 3.0))
    silent = run["z"].t < 25.0
    run = run.replace([Channel("z", run["z"].t[silent], run["z"].values[silent], "m", "NED")])
    t, counts = counted(run)
    assert not counts[(t > 20.0) & (t < 27.0)].any()
    assert counts[t > 27.1].all()
    assert_agree(run)


@pytest.mark.parametrize("seed", range(20))
def test_dives_of_all_kinds_are_cut_as_their_logs_are(seed: int) -> None:
    """Arming, modes, surfacings and turns at random, of any length; NaN and gaps among them."""
    rng = np.random.default_rng(seed)

    def switching(values: list[float]) -> tuple[list[float], list[float]]:
        times = np.concatenate([[0.0], np.sort(rng.uniform(1.0, SECONDS, 6))])
        return times.tolist(), rng.choice(values, 7).tolist()

    z = 3.0 + 0.0 * T
    phi = 0.1 * np.sin(T)
    for _ in range(5):
        start, long = rng.uniform(5.0, 95.0), rng.choice([0.3, 2.0, 8.0])
        z = np.where((start <= T) & (start + long > T), rng.uniform(-0.2, 0.09), z)
        start, long = rng.uniform(50.0, 95.0), rng.choice([1.0, 4.0, 9.0])
        phi = np.where((start <= T) & (start + long > T), 3.0, phi)
    z[rng.random(T.size) < 0.1] = np.nan
    states = {"armed": switching([0.0, 1.0, 1.0]), "mode": switching([0.0, 9.0, 19.0])}
    assert_agree(
        dive(states, DEEP | {"modes": "0 STABILIZE, 9 SURFACE, 19 MANUAL"}, z=z, phi=phi), within=0.16, doubt=5.0
    )
